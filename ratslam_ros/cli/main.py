# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The ratslam command: info, replay, demo, evaluate, plot, tune; live run, launch, play, ..."""

from __future__ import annotations

import argparse
import errno
import json
import math
import signal
import sys
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any, NoReturn

from ratslam_ros import __version__
from ratslam_ros.core.config import Config
from ratslam_ros.errors import RatslamError, UnusableInput

NO_ROOM = (errno.ENOSPC, errno.EDQUOT, errno.EFBIG)

DONE, INTERNAL_ERROR, UNUSABLE, INTERRUPTED = 0, 1, 2, 130
NO_ANSWER = 1


def main(arguments: Sequence[str] | None = None) -> int:
    """Run one command; return its exit code.

    0 done, 1 an error of the program's own, 2 unusable input or wrong use, 130 interrupted.
    """
    signal.signal(signal.SIGTERM, signal.default_int_handler)  # raises KeyboardInterrupt
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
    replay.add_argument('--scan-topic', metavar='T',
                        help='the laser, read where experience_map.exp_align_scans is set')
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

    _add_simulate(commands)

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
    plot.add_argument('--times-from', type=int, metavar='ID',
                      help='also draw how long it takes from this experience to all others')
    plot.add_argument('--route-to', type=int, metavar='ID',
                      help='with the route to this one, from --times-from or where the robot was')
    plot.set_defaults(run=_plot)

    tune = commands.add_parser('tune', help='propose a threshold, template size and crop')
    _add_recording(tune)
    _add_config(tune)
    _add_topics(tune)
    _add_out(tune, 'results/NAME-tune-TIME')
    tune.set_defaults(run=_tune)

    _add_live(commands)
    return parser


def _add_simulate(commands: Any) -> None:
    simulate = commands.add_parser(
        'simulate', help='a simulated robot explores a floor plan, and goes to goals'
    )
    simulate.add_argument('--plan', metavar='NAME|FILE',
                          help='floor plan: one of the package, or a text or PNG file')
    simulate.add_argument('--cell-m', type=float, metavar='M', help='side of a cell or pixel')
    simulate.add_argument('--start', metavar='PLACE|X,Y,DEG', help='(default: S, or any)')
    simulate.add_argument('--seed', type=_whole, help='of world and noise (default: 1)')
    simulate.add_argument('--explore', type=float, default=30.0, metavar='MINUTES',
                          help='how long to explore before the goals (default: 30)')
    which = simulate.add_mutually_exclusive_group()
    which.add_argument('--goals', metavar='A,B,C',
                       help='places of the plan, in order (default: all that were passed)')
    which.add_argument('--random-goals', type=_positive, default=0, metavar='N',
                       help='go to so many places that were passed, drawn by lot')
    simulate.add_argument('--people', type=_whole, metavar='N', help='who walk about')
    simulate.add_argument('--obstacle', action='append', metavar='NAME,X,Y,W,D,FROM_S,TO_S',
                          help='put up a box, and take it away; may be repeated')
    simulate.add_argument('--noise', type=float, metavar='FACTOR', help='(default: 1)')
    _add_config(simulate, 'navigation')
    simulate.add_argument('--record', type=Path, metavar='DIR',
                          help='write a recording (rosbag2) of all that the robot senses')
    simulate.add_argument('--live', action='store_true',
                          help='be the robot of live nodes: publish image, odom, scan and /clock')
    simulate.add_argument('--rate', type=float, metavar='R',
                          help='of --live: speed of time (default: 1)')
    _add_out(simulate, 'results/simulate-TIME, with the link results/latest')
    simulate.add_argument('--quiet', action='store_true', help='no progress bar')
    simulate.set_defaults(run=_simulate)


def _add_live(commands: Any) -> None:
    """Add the commands that talk to others, over ROS 2 or over the stand-in for it."""
    from ratslam_ros.live.run import NODES

    run = commands.add_parser('run', help='run one node')
    run.add_argument('node', metavar='NODE', help=f'one of {", ".join(NODES)}')
    run.add_argument('arguments', nargs=argparse.REMAINDER, metavar='--ros-args ...',
                     help="the node's own, such as --ros-args -p use_sim_time:=true")
    run.set_defaults(run=_run)

    launch = commands.add_parser('launch', help='run all nodes, each in its own process')
    _add_config(launch)
    launch.add_argument('--visual-odometry', action='store_true',
                        help='odometry from the camera; without it the robot publishes odom')
    launch.add_argument('--single-process', action='store_true', help='all nodes in one process')
    launch.add_argument('--goal-follower', action='store_true',
                        help='drive to goals by a laser scan: publish cmd_vel')
    launch.add_argument('--use-sim-time', action='store_true',
                        help='time from /clock, as ratslam play --clock publishes it')
    launch.add_argument('--namespace', default='', metavar='NS')
    launch.add_argument('--image-topic', default='', metavar='T',
                        help="the camera's topic, raw or .../compressed (default: image)")
    launch.add_argument('--odom-topic', default='', metavar='T',
                        help='the odometry (default: odom)')
    launch.add_argument('--scan-topic', default='', metavar='T',
                        help="the laser's topic (default: scan)")
    launch.add_argument('--cmd-vel-topic', default='', metavar='T',
                        help="the motors' topic (default: cmd_vel)")
    launch.add_argument('--log-level', default='', metavar='L',
                        help='debug, info, warn, error or fatal')
    launch.set_defaults(run=_launch)

    play = commands.add_parser('play', help='publish a recording, in place of a robot')
    _add_recording(play)
    play.add_argument('--rate', type=float, default=1.0, metavar='R',
                      help='speed; 0: as fast as possible (default: 1)')
    play.add_argument('--clock', action='store_true',
                      help="publish the recording's time on /clock")
    play.add_argument('--loop', action='store_true', help='again and again')
    play.add_argument('--lockstep', action='store_true',
                      help='wait until each image has been acted on')
    _add_span(play)
    _add_topics(play)
    play.add_argument('--scan-topic', metavar='T',
                      help='publish these scans too, for experience_map.exp_align_scans')
    play.add_argument('--visual-odometry', action='store_true',
                      help='publish no odometry, even where there is some')
    play.add_argument('--wait', type=float, default=10.0, metavar='S',
                      help='wait this long for subscribers at the start (default: 10)')
    play.add_argument('--quiet', action='store_true', help='no progress bar, no summary')
    _add_ros(play)
    play.set_defaults(run=_play)

    call = commands.add_parser('call', help='call a service')
    call.add_argument('service', metavar='SERVICE')
    call.add_argument('type', metavar='TYPE', help='such as std_srvs/srv/Trigger')
    call.add_argument('values', metavar='YAML', nargs='?', default='',
                      help='the request, such as "{data: true}"')
    call.add_argument('--timeout', type=float, default=10.0, metavar='S', help='(default: 10)')
    _add_ros(call)
    call.set_defaults(run=_call)

    echo = commands.add_parser('echo', help='print the messages of a topic')
    echo.add_argument('topic', metavar='TOPIC')
    echo.add_argument('type', metavar='TYPE', nargs='?', help='(default: found by the topic)')
    echo.add_argument('--once', action='store_true', help='one message, and end')
    echo.add_argument('--field', metavar='NAME', help='print just this field, such as pose.pose')
    echo.add_argument('--timeout', type=float, default=math.inf, metavar='S',
                      help='end after so long without a message (default: never)')
    _add_ros(echo)
    echo.set_defaults(run=_echo)


def _add_ros(parser: argparse.ArgumentParser) -> None:
    parser.add_argument('--ros-args', nargs=argparse.REMAINDER, default=[], metavar='...',
                        help='all that follows is for ROS: -r image:=/camera/image, -r __ns:=/b')


def _add_recording(parser: argparse.ArgumentParser) -> None:
    parser.add_argument('recording', type=Path, metavar='RECORDING',
                        help='rosbag2 folder or file, ROS 1 bag, video, or folder of images')
    parser.add_argument('--images-rate', type=float, default=10.0, metavar='HZ',
                        help='rate of a folder of images with no times (default: 10)')


def _add_topics(parser: argparse.ArgumentParser) -> None:
    parser.add_argument('--image-topic', metavar='T')
    parser.add_argument('--odom-topic', metavar='T')


def _add_config(parser: argparse.ArgumentParser, default: str | None = None) -> None:
    told = f' (default: {default})' if default else ''
    parser.add_argument('--config', metavar='FILE|PRESET', default=default,
                        help=f'YAML, an INI file of OpenRatSLAM, or the name of a preset{told}')
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


def _config(options: argparse.Namespace) -> Config:
    from ratslam_ros.files.config import load_config, parse_setting

    config, notices = load_config(options.config)
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


def _warm_up() -> None:
    """Compile the inner loops or load them from the cache; print a notice if they are compiled."""
    from ratslam_ros.compilation import announced_compilation
    from ratslam_ros.core.warm_up import warm_up

    with announced_compilation(_say):
        warm_up()


def _info(options: argparse.Namespace) -> int:
    from ratslam_ros.recordings import describe, open_recording

    with open_recording(options.recording, images_rate_hz=options.images_rate) as recording:
        print(describe(recording).format())
    return DONE


def _warn(warnings: Sequence[str]) -> None:
    for warning in warnings:
        _say(f'warning: {warning}')


def _replay(options: argparse.Namespace) -> int:
    from ratslam_ros.offline.replay import ReplayOptions, replay
    from ratslam_ros.recordings import open_recording
    from ratslam_ros.results.plots import draw_all
    from ratslam_ros.results.writer import link_latest

    config = _config(options)
    truth = _truth(options.truth)
    with open_recording(options.recording, images_rate_hz=options.images_rate) as recording:
        selection = recording.select(
            options.image_topic, options.odom_topic, options.visual_odometry,
            options.scan_topic, config.experience_map.exp_align_scans,
        )  # fmt: skip
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
    from ratslam_ros.results.evaluation import read_tum

    return read_tum(path)


def _much_lost(summary: dict) -> list[str]:  # type: ignore[type-arg]
    lost = {key: summary[key] for key in ('dropped', 'late', 'refused') if summary[key]}
    if sum(lost.values()) * 10 < summary['frames'] + summary['odometry']:
        return []
    told = ', '.join(f'{number} {key}' for key, number in lost.items())
    return [f'many messages were not used ({told}): images and scans in which nothing can be seen '
            'are dropped, stamps that do not increase refused, those behind the other streams by '
            'more than pose_cells.max_lateness_s late'] if lost else []


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
    from ratslam_ros.results.evaluation import evaluate, read_tum

    for name in ('trajectory_final', 'trajectory', 'dead_reckoning'):
        ate = evaluate(read_tum(folder / f'{name}.tum'), truth).ate
        print(f'{name.replace("_", " "):17} ATE {ate.rmse:7.3f} m RMSE, {ate.max:7.3f} m at most')


def _demo(options: argparse.Namespace) -> int:
    from ratslam_ros.offline.demo import run_demo, run_seeds

    _warm_up()
    if options.seeds is not None:
        print(run_seeds(range(options.seed, options.seed + options.seeds)))
        return DONE
    folder = _make(_results_folder(options, 'demo'))
    print(run_demo(options.seed, folder, progress=not options.quiet))
    if options.out is None:
        from ratslam_ros.results.writer import link_latest

        link_latest(folder)
    return DONE


def _simulate(options: argparse.Namespace) -> int:
    from ratslam_ros.simulator.config import SimulatorParameters

    given = {
        name: value
        for name in ('plan', 'cell_m', 'start', 'seed', 'people', 'noise', 'rate')
        if (value := getattr(options, name)) is not None
    }
    if options.obstacle:
        given['obstacles'] = ';'.join(options.obstacle)
    if options.live:
        from ratslam_ros.live.run import run

        values = [f'{name}:={json.dumps(value)}' for name, value in given.items()]
        return run('simulator', ['--ros-args', *(w for value in values for w in ('-p', value))])
    from ratslam_ros.offline.simulate import SimulateOptions, simulate
    from ratslam_ros.results.writer import link_latest

    config = _config(options)
    parameters = SimulatorParameters(**given)
    if not 0.0 <= options.explore < math.inf:
        raise UnusableInput(f'--explore is {options.explore}; expected 0 or more minutes')
    _warm_up()
    folder = _make(_results_folder(options, 'simulate'))
    goals = None if options.goals is None else options.goals.split(',')
    print(
        simulate(
            parameters, config, folder,
            SimulateOptions(60.0 * options.explore, goals, options.random_goals, options.record,
                            not options.quiet),
        )
    )  # fmt: skip
    if options.out is None:
        link_latest(folder)
    return DONE


def _evaluate(options: argparse.Namespace) -> int:
    from ratslam_ros.results.evaluation import evaluate, read_tum
    from ratslam_ros.results.plots import plot_evaluation

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
    from ratslam_ros.results.plots import draw_all

    paths = draw_all(options.folder, _truth(options.truth))
    if options.times_from is not None or options.route_to is not None:
        from ratslam_ros.results.goal_plots import draw_times

        paths.append(draw_times(options.folder, options.times_from, options.route_to))
    for path in paths:
        print(path)
    return DONE


def _tune(options: argparse.Namespace) -> int:
    from ratslam_ros.offline.revisits import sample_frames
    from ratslam_ros.offline.tuning import plot_proposal, propose
    from ratslam_ros.recordings import open_recording

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


def _run(options: argparse.Namespace) -> int:
    from ratslam_ros.live.run import run

    return run(options.node, options.arguments)


def _launch(options: argparse.Namespace) -> int:
    from ratslam_ros.live import ros
    from ratslam_ros.live.launch import LaunchOptions, launch

    ros.look()
    return launch(
        _config(options),
        LaunchOptions(
            visual_odometry=options.visual_odometry,
            single_process=options.single_process,
            goal_follower=options.goal_follower,
            use_sim_time=options.use_sim_time,
            namespace=options.namespace,
            image_topic=options.image_topic,
            odom_topic=options.odom_topic,
            scan_topic=options.scan_topic,
            cmd_vel_topic=options.cmd_vel_topic,
            log_level=options.log_level,
        ),
    )


def _play(options: argparse.Namespace) -> int:
    from ratslam_ros.live import ros
    from ratslam_ros.recordings import open_recording

    with open_recording(options.recording, images_rate_hz=options.images_rate) as recording:
        selection = recording.select(
            options.image_topic, options.odom_topic, options.visual_odometry,
            options.scan_topic, options.scan_topic is not None,
        )  # fmt: skip
        ros.require()
        from ratslam_ros.live.player import PlayOptions, play

        if not options.quiet:
            for notice in selection.notices:
                _say(notice)
        told = play(
            recording,
            selection,
            PlayOptions(
                rate=options.rate,
                clock=options.clock,
                loop=options.loop,
                lockstep=options.lockstep,
                start_s=options.start,
                duration_s=options.duration,
                wait_s=options.wait,
                progress=not options.quiet,
            ),
            options.ros_args,
        )
    if not options.quiet:
        print(told)
    return DONE


def _call(options: argparse.Namespace) -> int:
    from ratslam_ros.live import ros

    ros.require()
    from ratslam_ros.live.call import call

    try:
        print(call(options.service, options.type, options.values, options.timeout,
                   options.ros_args))
    except ros.Silence as silence:
        _say(f'ratslam: {silence}')
        return NO_ANSWER
    return DONE


def _echo(options: argparse.Namespace) -> int:
    from ratslam_ros.live import ros

    ros.require()
    from ratslam_ros.live.echo import EchoOptions, echo

    try:
        echo(
            options.topic,
            EchoOptions(options.type, options.once, options.field, options.timeout),
            options.ros_args,
        )
    except ros.Silence as silence:
        _say(f'ratslam: {silence}')
        return NO_ANSWER
    return DONE
