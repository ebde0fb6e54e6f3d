# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The replay of a recording, and the report on what was mapped, for several commands."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import TYPE_CHECKING

from ratslam_ros.cli.options import read_truth, results_folder
from ratslam_ros.console import print_notice, print_status, ticking
from ratslam_ros.errors import DONE, INTERRUPTED, UNUSABLE
from ratslam_ros.own_stages import own_stages

if TYPE_CHECKING:
    from ratslam_ros.offline.map_recording import MapResult
    from ratslam_ros.results.trajectory import Trajectory


def replayed(options: argparse.Namespace) -> tuple[int, Path]:
    """Map a recording as ``ratslam replay``; return the exit code and the folder of results."""
    truth = read_truth(options.truth)
    if not options.quiet:
        print_status(f'reading {options.recording}')
    with ticking('loading:', not options.quiet):
        from ratslam_ros.files.config import parse_setting
        from ratslam_ros.offline.map_recording import map_recording
        from ratslam_ros.recordings import open_recording

    with open_recording(options.recording, images_rate_hz=options.images_rate) as recording:
        result = map_recording(
            recording, results_folder(options, recording.name), config=options.config,
            settings=dict(parse_setting(text) for text in options.settings),
            inspect=not options.no_inspect, image_topic=options.image_topic,
            odom_topic=options.odom_topic, scan_topic=options.scan_topic,
            visual_odometry=options.visual_odometry, landmarks=options.landmarks,
            start_s=options.start, duration_s=options.duration,
            images_rate_hz=options.images_rate, map_file=options.map, localize=options.localize,
            history=not options.no_history, video=options.video,
            stages=own_stages(options.own_stages), quiet=options.quiet,
        )
    return report_result(options, result, truth), result.folder


def report_result(
    options: argparse.Namespace, result: MapResult, truth: Trajectory | None = None
) -> int:
    """Draw the plots and print what was mapped; return the exit code."""
    from ratslam_ros.maps.saved_map import seconds
    from ratslam_ros.results.writer import link_latest

    folder, map_file = result.folder, result.map_file
    if options.out is None:
        link_latest(folder)
    if not options.quiet:
        print_status('drawing the plots')
    with ticking('drawing:', not options.quiet):
        plots = result.plot(truth)
    if result.interrupted:
        print_notice(f'interrupted: the results so far are in {folder}')
        if map_file is not None and map_file.saved is not None:
            print_notice(
                f'{map_file.path} is saved up to stamp {seconds(map_file.saved.stamp_ns)} s; give '
                'the same command again to continue after it'
            )
    if map_file is not None and map_file.problem:
        print_notice(f'the map was not saved: {map_file.problem}')
        return UNUSABLE
    if result.interrupted:
        return INTERRUPTED
    if not options.quiet:
        print(result)
        if truth is not None:
            _print_errors(folder, truth)
        for path in plots:
            print(path)
        if map_file is not None and map_file.localize:
            print(f'localised on {map_file.path}: nothing was learned, and the file is unchanged')
        elif map_file is not None:
            print(f'{map_file.path}: {result.summary["experiences"]} places, saved')
        for line in result.advice:
            print(f'advice: {line}')
    return DONE


def _print_errors(folder: Path, truth: Trajectory) -> None:
    from ratslam_ros.results.evaluation import evaluate
    from ratslam_ros.results.trajectory import read_tum

    for name in ('trajectory_final', 'trajectory', 'dead_reckoning'):
        ate = evaluate(read_tum(folder / f'{name}.tum'), truth).ate
        print(f'{name.replace("_", " "):17} ATE {ate.rmse:7.3f} m RMSE, {ate.max:7.3f} m at most')
