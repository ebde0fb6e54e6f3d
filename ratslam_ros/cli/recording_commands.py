# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""``ratslam info``, ``replay`` and ``tune``: from a recording to a map."""

from __future__ import annotations

import argparse
import contextlib
import shlex
from pathlib import Path

from ratslam_ros.cli.options import (
    Commands,
    add_config,
    add_out,
    add_recording,
    add_replay_options,
    add_span,
    add_topics,
    add_view_options,
    config_of,
    make_folder,
    results_folder,
    words_of,
)
from ratslam_ros.cli.replaying import replayed
from ratslam_ros.console import print_notice, print_notices, ticking
from ratslam_ros.errors import DONE, UNUSABLE, UnusableInput, UnusableParameter


def add_info(commands: Commands) -> None:
    """Add ``ratslam info``."""
    info = commands.add_parser('info',
                               help='list the contents of a recording and print the next command')
    add_recording(info)
    info.set_defaults(run=_info)


def add_replay(commands: Commands) -> None:
    """Add ``ratslam replay``."""
    replay = commands.add_parser('replay', help='build a map from a recording')
    add_replay_options(replay)
    replay.add_argument('--video', type=Path, metavar='FILE.mp4',
                        help='write a video of the growing map, with a frame for every 4 images; '
                             'the replay takes up to twice as long')
    replay.add_argument('--no-history', action='store_true',
                        help='do not write history.sqlite, from which `ratslam view` shows any '
                             'moment of the run')
    replay.add_argument('--map', type=Path, metavar='FILE',
                        help='save the map in this file while it is built; if there is one, '
                             'continue it')
    replay.add_argument('--localize', action='store_true',
                        help='with --map: leave the map unchanged, and only localise the robot')
    replay.add_argument('--log', action='store_true',
                        help='RECORDING is a map of live nodes that have kept their log '
                             '(ratslam launch --keep-log): repeat their last run, and compare '
                             'the maps')
    add_out(replay, 'results/NAME-TIME, with the link results/latest')
    replay.add_argument('--quiet', action='store_true', help='no progress bar, no summary')
    add_view_options(replay)
    replay.set_defaults(run=_replay, parser=replay)


def add_tune(commands: Commands) -> None:
    """Add ``ratslam tune``."""
    tune = commands.add_parser('tune', help='propose a configuration by the maps it gives')
    add_recording(tune)
    add_config(tune)
    add_topics(tune)
    tune.add_argument('--visual-odometry', action='store_true',
                      help='estimate odometry from the camera, even if there is an odometry topic')
    add_span(tune)
    add_out(tune, 'results/NAME-tune-TIME')
    tune.set_defaults(run=_tune, parser=tune)


def _info(options: argparse.Namespace) -> int:
    from ratslam_ros.recordings import describe, open_recording

    with open_recording(options.recording, images_rate_hz=options.images_rate) as recording:
        print(describe(recording))
    return DONE


def _replay(options: argparse.Namespace) -> int:
    if options.log:
        return _replay_log(options)
    if options.view:
        from ratslam_ros.cli.view_command import view_replay

        return view_replay(options)
    return replayed(options)[0]


WITH_LOG = frozenset({
    'recording', 'images_rate', 'own_stages', 'log', 'out', 'overwrite', 'quiet', 'host', 'port',
    'browser',
})
"""Options that are accepted with a log; the others, of a recording, have no meaning for it."""


def _replay_log(options: argparse.Namespace) -> int:
    from ratslam_ros.offline.replay_log import MAP_NAME, replay_log

    for word in words_of(options.parser, options, without=WITH_LOG):
        name = word.partition('=')[0]
        raise UnusableInput(f'--log repeats a live run as it was; leave out {name}')
    file = Path(options.recording)
    folder = results_folder(options, file.stem)
    with ticking('replaying:', not options.quiet):
        outcome = replay_log(file, folder)
    if not outcome.has_ended:
        print_notice(
            'the log has no end, as the nodes were killed, still run, or could not write it: the '
            'map is that of its last message'
        )
    if not options.quiet:
        print(
            '{frames} frames and {odometry} odometry messages; {late} late, {refused} refused\n'
            '{templates} templates, {experiences} experiences, {links} links, '
            '{loop_closures} loop closures'.format(**outcome.summary)
        )
        for path in (*outcome.plots, folder / MAP_NAME):
            print(path)
    if outcome.differing is None:
        print_notice(f'{file} is not of the end of the log: the maps are not compared')
    elif outcome.differing:
        print_notice(
            f'{file} differs from the replay in {", ".join(outcome.differing)}: the map was '
            'changed since, or another version of a library is installed'
        )
        return UNUSABLE
    elif not options.quiet:
        print(f'{file}: reproduced, byte for byte')
    return DONE


IN_TUNED = frozenset({'config', 'settings', 'start', 'duration', 'out', 'overwrite'})
"""Options of `tune` that the replay with its configuration does not repeat."""


def _tune(options: argparse.Namespace) -> int:
    from ratslam_ros.files.config import load_config, parse_setting, presets, to_yaml
    from ratslam_ros.offline.compile_all import compile_kernels
    from ratslam_ros.offline.inspection import inspect
    from ratslam_ros.recordings import open_recording
    from ratslam_tuning.trials import Span
    from ratslam_tuning.tuning import plot_proposal, propose

    fixed = dict(parse_setting(text) for text in options.settings)
    default = load_config(None)[0].with_values(fixed)
    others = {'--config': config_of(options)} if options.config else {}
    for name in presets():
        with contextlib.suppress(UnusableParameter):  # A preset may contradict a setting.
            others[f'preset {name}'] = load_config(name)[0].with_values(fixed)
    with open_recording(options.recording, images_rate_hz=options.images_rate) as recording:
        selection = recording.select(
            options.image_topic, options.odom_topic, options.visual_odometry
        )
        if selection.image_topic is None:
            raise UnusableInput(
                f'{recording.path} has templates but no images; expected images to tune on '
                '(ratslam study varies parameters of recordings with templates)'
            )
        folder = make_folder(results_folder(options, f'{recording.name}-tune'))
        compile_kernels()
        span = Span(options.start, options.duration)
        inspection = inspect(
            recording, selection, default, list(fixed), span.start_s, span.duration_s, True
        )
        print_notices(inspection.lines)
        if inspection.jumps:
            recording.warn(inspection.jumps)
        proposal = propose(recording, selection, inspection.config, others, span, print_notice)
        path = plot_proposal(proposal, folder / 'tune.png')
        files = {'tuned.yaml': proposal.config}
        if proposal.runner_up is not None:
            files['runner_up.yaml'] = proposal.runner_up.trial.config
        for name, config in files.items():
            (folder / name).write_text(to_yaml(config), encoding='ascii')
        print_notices(f'warning: {warning}' for warning in recording.warnings)
    print(proposal.format())
    read = words_of(options.parser, options, without=IN_TUNED)
    print(f'\n{path}')
    print(shlex.join(['ratslam', 'replay', *read, '--config', str(folder / 'tuned.yaml')]))
    return DONE
