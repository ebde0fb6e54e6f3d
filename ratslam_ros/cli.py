# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The ratslam command: info, replay, demo, evaluate, plot, tune."""

from __future__ import annotations

import argparse
import errno
import signal
import sys
import threading
import time
from collections.abc import Sequence
from pathlib import Path
from typing import NoReturn

from ratslam_ros import __version__
from ratslam_ros.core.config import Config
from ratslam_ros.errors import RatslamError, UnusableInput

NO_ROOM = (errno.ENOSPC, errno.EDQUOT, errno.EFBIG)

DONE, INTERNAL_ERROR, UNUSABLE, INTERRUPTED = 0, 1, 2, 130


def main(arguments: Sequence[str] | None = None) -> int:
    """Run one command; return its exit code.

    0 done, 1 an error of the program's own, 2 unusable input or wrong use, 130 interrupted.
    """
    signal.signal(signal.SIGTERM, _interrupt)
    try:
        options = _parser().parse_args(arguments)
        return int(options.run(options))
    except RatslamError as error:
        _say(f'ratslam: {error}')
        return UNUSABLE
    except KeyboardInterrupt:
        _say('ratslam: interrupted')
        return INTERRUPTED
    except SystemError as error:
        if not isinstance(error.__cause__, KeyboardInterrupt):  # one that fell in compiled code
            raise
        _say('ratslam: interrupted')
        return INTERRUPTED
    except BrokenPipeError:  # as in `ratslam info X | head`
        sys.stderr.close()
        return DONE
    except OSError as error:
        if error.errno not in NO_ROOM:
            raise
        _say(f'ratslam: {error.strerror} while writing; make room, or give another --out')
        return UNUSABLE


def _interrupt(signal_number: int, frame: object) -> NoReturn:
    raise KeyboardInterrupt


def _say(text: str) -> None:
    print(text, file=sys.stderr, flush=True)


class _Parser(argparse.ArgumentParser):
    """Answers wrong use with one line."""

    def error(self, message: str) -> NoReturn:
        raise UnusableInput(f'{message}; see {self.prog} --help')


def _parser() -> argparse.ArgumentParser:
    parser = _Parser(prog='ratslam', description='RatSLAM: from a recording to a map.')
    parser.add_argument('--version', action='version', version=f'ratslam {__version__}')
    commands = parser.add_subparsers(title='commands', metavar='COMMAND', required=True)

    info = commands.add_parser('info', help='what is in a recording, and the next command')
    _add_recording(info)
    info.set_defaults(run=_info)

    replay = commands.add_parser('replay', help='a map from a recording')
    _add_recording(replay)
    _add_config(replay)
    _add_topics(replay)
    replay.add_argument('--visual-odometry', action='store_true',
                        help='odometry from the camera, even where there is an odometry topic')
    _add_span(replay)
    replay.add_argument('--truth', type=Path, metavar='FILE.tum',
                        help='the true trajectory, for the picture and the error')
    replay.add_argument('--video', type=Path, metavar='FILE.mp4', help='film the map as it grows')
    _add_out(replay, 'results/NAME-TIME, with the link results/latest')
    replay.add_argument('--quiet', action='store_true', help='no progress bar, no summary')
    replay.set_defaults(run=_replay)

    demo = commands.add_parser('demo', help='simulate a robot in an office, and map it')
    demo.add_argument('--seed', type=_whole, default=1, help='of world and noise (default: 1)')
    demo.add_argument('--seeds', type=_positive, metavar='N',
                      help='run N seeds from --seed on and print mean and worst')
    _add_out(demo, 'results/demo-TIME, with the link results/latest')
    demo.add_argument('--quiet', action='store_true', help='no progress bar')
    demo.set_defaults(run=_demo)

    evaluate = commands.add_parser('evaluate', help='errors of a trajectory against the truth')
    evaluate.add_argument('trajectory', type=Path, metavar='TRAJECTORY', help='a TUM file')
    evaluate.add_argument('truth', type=Path, metavar='TRUTH', help='a TUM file')
    evaluate.add_argument('--align', choices=('se2', 'sim2', 'none'), default='se2',
                          help='turn and shift; scale as well; neither (default: se2)')
    evaluate.add_argument('--json', action='store_true', help='print JSON')
    evaluate.add_argument('--plot', type=Path, metavar='FILE.png',
                          help='where to draw (default: beside the trajectory)')
    evaluate.set_defaults(run=_evaluate)

    plot = commands.add_parser('plot', help='draw the pictures of a results folder again')
    plot.add_argument('folder', type=Path, metavar='DIR')
    plot.add_argument('--truth', type=Path, metavar='FILE.tum')
    plot.set_defaults(run=_plot)

    tune = commands.add_parser('tune', help='propose a threshold, template size and crop')
    _add_recording(tune)
    _add_config(tune)
    _add_topics(tune)
    _add_out(tune, 'results/NAME-tune-TIME')
    tune.set_defaults(run=_tune)
    return parser


def _add_recording(parser: argparse.ArgumentParser) -> None:
    parser.add_argument('recording', type=Path, metavar='RECORDING',
                        help='rosbag2 folder or file, ROS 1 bag, video, or folder of images')
    parser.add_argument('--images-rate', type=float, default=10.0, metavar='HZ',
                        help='rate of a folder of images with no times (default: 10)')


def _add_topics(parser: argparse.ArgumentParser) -> None:
    parser.add_argument('--image-topic', metavar='T')
    parser.add_argument('--odom-topic', metavar='T')


def _add_config(parser: argparse.ArgumentParser) -> None:
    parser.add_argument('--config', metavar='FILE|PRESET',
                        help='YAML, an INI file of OpenRatSLAM, or the name of a preset')
    parser.add_argument('--set', action='append', default=[], dest='settings',
                        metavar='section.name=value', help='one parameter; may be repeated')


def _add_span(parser: argparse.ArgumentParser) -> None:
    parser.add_argument('--start', type=float, default=0.0, metavar='S',
                        help='skip this much of the recording')
    parser.add_argument('--duration', type=float, metavar='S', help='stop after this much')


def _add_out(parser: argparse.ArgumentParser, default: str) -> None:
    parser.add_argument('--out', type=Path, metavar='DIR', help=f'(default: {default})')


def _whole(text: str) -> int:
    if not text.isdecimal():
        raise argparse.ArgumentTypeError(f'{text!r} is not a whole number of 0 or more')
    return int(text)


def _positive(text: str) -> int:
    if _whole(text) == 0:
        raise argparse.ArgumentTypeError('0 is not a number of 1 or more')
    return int(text)


def _config(options: argparse.Namespace, default: str | None = None) -> Config:
    from ratslam_ros.config_files import load_config, parse_setting

    config, notices = load_config(options.config or default)
    for notice in notices:
        _say(notice)
    return config.with_values(dict(parse_setting(text) for text in options.settings))


def _results_folder(options: argparse.Namespace, name: str) -> Path:
    if options.out is not None:
        return Path(options.out)
    return Path('results') / f'{name}-{time.strftime("%Y%m%d-%H%M%S")}'


def _make(folder: Path) -> Path:
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise UnusableInput(
            f'{folder} cannot be written to ({error.strerror}); give another --out'
        ) from None
    return folder


def _warm_up() -> float:
    """Compile the inner loops, telling so where it takes long; return the seconds it took."""
    start_s = time.perf_counter()
    notice = threading.Timer(
        1.0,
        _say,
        ['compiling the inner loops: once for this installation, about half a minute ...'],
    )
    notice.daemon = True
    notice.start()
    from ratslam_ros.core.warm_up import warm_up

    try:
        warm_up()
    finally:
        notice.cancel()
    return time.perf_counter() - start_s


def _info(options: argparse.Namespace) -> int:
    from ratslam_ros.recordings import describe, open_recording

    with open_recording(options.recording, images_rate_hz=options.images_rate) as recording:
        print(describe(recording).format())
    return DONE


def _warn(warnings: Sequence[str]) -> None:
    for warning in warnings:
        _say(f'warning: {warning}')


def _replay(options: argparse.Namespace) -> int:
    from ratslam_ros.pictures import draw_all
    from ratslam_ros.recordings import open_recording
    from ratslam_ros.replay import ReplayOptions, replay
    from ratslam_ros.results import link_latest

    config = _config(options)
    truth = _truth(options.truth)
    with open_recording(options.recording, images_rate_hz=options.images_rate) as recording:
        selection = recording.select(
            options.image_topic, options.odom_topic, options.visual_odometry
        )
        if not options.quiet:
            for notice in selection.notices:
                _say(notice)
        _warm_up()
        folder = _results_folder(options, recording.name)
        outcome = replay(
            recording, selection, config, folder,
            ReplayOptions(options.start, options.duration, options.video, not options.quiet),
        )  # fmt: skip
        _warn(recording.warnings)
        _warn(_nothing_mapped(outcome.summary))
        _warn(_much_lost(outcome.summary))
    if options.out is None:
        link_latest(folder)
    pictures = draw_all(folder, truth, config.local_view.vt_match_threshold)
    if outcome.interrupted:
        _say(f'interrupted: the results so far are in {folder}')
        return INTERRUPTED
    if not options.quiet:
        print(_summary_text(outcome.summary))
        if truth is not None:
            _print_errors(folder, truth)
        for path in pictures:
            print(path)
    return DONE


def _truth(path: Path | None):  # type: ignore[no-untyped-def]
    """Read the truth before anything is done, so that a wrong file costs nothing."""
    if path is None:
        return None
    from ratslam_ros.evaluation import read_tum

    return read_tum(path)


def _much_lost(summary: dict) -> list[str]:  # type: ignore[type-arg]
    lost = {key: summary[key] for key in ('dropped', 'late', 'refused') if summary[key]}
    if sum(lost.values()) * 10 < summary['frames'] + summary['odometry']:
        return []
    told = ', '.join(f'{number} {key}' for key, number in lost.items())
    return [f'many messages were not used ({told}): images that cannot be decoded are dropped, '
            'stamps that do not increase refused, those behind the other streams by more than '
            'pose_cells.max_lateness_s late'] if lost else []


def _nothing_mapped(summary: dict) -> list[str]:  # type: ignore[type-arg]
    if not summary['odometry']:
        return ['no odometry could be used, so the map is empty; try --visual-odometry, or more '
                'of the recording']
    if not summary['frames']:
        return ['no image or template could be used, so the map is empty']
    return []


def _summary_text(summary: dict) -> str:  # type: ignore[type-arg]
    text = (
        '{frames} frames and {odometry} odometry messages over {duration_s:.1f} s, in '
        '{wall_s:.1f} s ({times_realtime:.0f}x real time)\n'
        '{templates} templates, {experiences} experiences, {links} links, '
        '{loop_closures} loop closures'
    ).format(**summary)
    lost = [f'{summary[key]} {key}' for key in ('dropped', 'late', 'refused') if summary[key]]
    return text + (f'\nmessages not used: {", ".join(lost)}' if lost else '')


def _print_errors(folder: Path, truth) -> None:  # type: ignore[no-untyped-def]
    from ratslam_ros.evaluation import evaluate, read_tum

    for name in ('trajectory_final', 'trajectory', 'dead_reckoning'):
        ate = evaluate(read_tum(folder / f'{name}.tum'), truth).ate
        print(f'{name.replace("_", " "):17} ATE {ate.rmse:7.3f} m RMSE, {ate.max:7.3f} m at most')


def _demo(options: argparse.Namespace) -> int:
    from ratslam_ros.demo import run_demo, run_seeds

    _warm_up()
    if options.seeds is not None:
        print(run_seeds(range(options.seed, options.seed + options.seeds)))
        return DONE
    folder = _make(_results_folder(options, 'demo'))
    print(run_demo(options.seed, folder, progress=not options.quiet))
    if options.out is None:
        from ratslam_ros.results import link_latest

        link_latest(folder)
    return DONE


def _evaluate(options: argparse.Namespace) -> int:
    from ratslam_ros.evaluation import evaluate, read_tum
    from ratslam_ros.pictures import plot_evaluation

    trajectory, truth = read_tum(options.trajectory), read_tum(options.truth)
    evaluation = evaluate(trajectory, truth, options.align)
    path = options.plot or options.trajectory.with_name(f'{options.trajectory.stem}_error.png')
    try:
        plot_evaluation(evaluation, path)
    except OSError as error:
        raise UnusableInput(f'{path} cannot be written ({error.strerror}); give --plot') from None
    print(evaluation.to_json() if options.json else f'{evaluation.format()}\n{path}')
    return DONE


def _plot(options: argparse.Namespace) -> int:
    from ratslam_ros.pictures import draw_all

    for path in draw_all(options.folder, _truth(options.truth)):
        print(path)
    return DONE


def _tune(options: argparse.Namespace) -> int:
    from ratslam_ros.recordings import open_recording
    from ratslam_ros.revisits import sample_frames
    from ratslam_ros.tuning import plot_proposal, propose

    config = _config(options)
    with open_recording(options.recording, images_rate_hz=options.images_rate) as recording:
        selection = recording.select(options.image_topic, options.odom_topic)
        if selection.image_topic is None:
            raise UnusableInput(
                f'{recording.path} holds templates and no images; expected images to tune on'
            )
        _warm_up()
        proposal = propose(sample_frames(recording, selection.image_topic), config.local_view)
        folder = _make(_results_folder(options, f'{recording.name}-tune'))
        path = plot_proposal(proposal, folder / 'tune.png')
        _warn(recording.warnings)
    print(f'{proposal.format()}\n{path}')
    return DONE
