# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""``ratslam camera``: map from a webcam or a stream."""

from __future__ import annotations

import argparse
import os
from pathlib import Path

from ratslam_ros.cli.options import Commands, add_config, add_out, add_view_options, results_folder
from ratslam_ros.cli.replaying import report_result
from ratslam_ros.console import print_notice
from ratslam_ros.errors import DONE
from ratslam_ros.own_stages import add_stage, own_stages


def add_camera(commands: Commands) -> None:
    """Add ``ratslam camera``."""
    camera = commands.add_parser(
        'camera', help='map from a webcam or a stream, and show it in a browser',
        description='Map from a camera until Ctrl-C, and show the map in a browser. The motion is '
                    'estimated from the images.',
    )
    camera.add_argument('source', nargs='?', default='0', metavar='SOURCE',
                        help='number of a camera, a device such as /dev/video2, or the URL of a '
                             'stream, such as rtsp://HOST/PATH (default: 0)')
    camera.add_argument('--record', type=Path, metavar='FILE.mcap',
                        help='keep the images in this new file: "ratslam replay FILE.mcap '
                             '--no-inspect" with the same options gives the same map')
    camera.add_argument('--map', type=Path, metavar='FILE',
                        help='save the map in this file while it is built; if there is one, '
                             'continue it')
    add_config(camera)
    add_stage(camera)
    add_out(camera, 'results/camera-TIME, with the link results/latest')
    camera.add_argument('--quiet', action='store_true', help='no summary')
    camera.add_argument('--no-view', action='store_false', dest='view',
                        help='map without a browser')
    add_view_options(camera, always=True)
    camera.set_defaults(run=_camera, parser=camera)


def _camera(options: argparse.Namespace) -> int:
    # OpenCV reads it when it is imported. Errors are reported in one line, without its own ones.
    os.environ.setdefault('OPENCV_LOG_LEVEL', 'SILENT')
    if options.view:
        from ratslam_ros.cli.view_command import view_camera

        return view_camera(options)
    from ratslam_ros.files.config import parse_setting
    from ratslam_ros.offline.map_recording import map_recording
    from ratslam_ros.recordings.camera import Camera

    with Camera(options.source, options.record) as camera:
        if not options.quiet:
            print_notice(f'mapping from camera {options.source}; Ctrl-C ends it')
        result = map_recording(
            camera, results_folder(options, camera.name), config=options.config,
            settings=dict(parse_setting(text) for text in options.settings),
            map_file=options.map, stages=own_stages(options.own_stages), quiet=options.quiet,
        )
    code = report_result(options, result)
    if code == DONE and options.record is not None and not options.quiet:
        print(options.record)
    return code
