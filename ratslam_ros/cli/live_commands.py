# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""``ratslam run``, ``launch``, ``play``, ``call``, ``pub`` and ``echo``: live communication."""

from __future__ import annotations

import argparse
import math
from contextlib import ExitStack
from functools import partial

from ratslam_ros.cli.options import (
    Commands,
    add_config,
    add_recording,
    add_ros_args,
    add_span,
    add_topics,
    add_view_options,
    config_of,
    positive,
    positive_number,
)
from ratslam_ros.console import print_notice, print_notices, print_status, ticking
from ratslam_ros.errors import DONE
from ratslam_ros.own_stages import add_stage
from ratslam_ros.pipeline import choice


def add_live(commands: Commands) -> None:
    """Add the commands that communicate, over ROS 2 or over the stand-in for rclpy."""
    from ratslam_ros.live.run import NODES

    run = commands.add_parser('run', help='run one node')
    run.add_argument('node', metavar='NODE', help=f'one of {", ".join(NODES)}')
    run.add_argument('arguments', nargs=argparse.REMAINDER, metavar='--ros-args ...',
                     help='arguments of the node, such as --ros-args -p use_sim_time:=true')
    run.set_defaults(run=_run)

    launch = commands.add_parser('launch', help='run all nodes')
    add_config(launch)
    launch.add_argument('--odometry', choices=choice.ODOMETRY, default=choice.TOPIC,
                        help='topic: the robot publishes odom, the default; camera: estimate it '
                             'from the images; auto: decide when images have a publisher: the '
                             'camera if odom has none 2 s later')
    launch.add_argument('--stages', default=choice.DEFAULT, metavar='A,B',
                        help='the mapping nodes to run, if nodes of your own take the place of '
                             f'the others (default: {choice.DEFAULT})')
    add_stage(launch)
    launch.add_argument('--split', action='store_true',
                        help='each mapping node in a process of its own, instead of one for all')
    launch.add_argument('--goal-follower', action='store_true',
                        help='drive to goals: publish cmd_vel, computed from a laser scan')
    launch.add_argument('--landmarks', action='store_true',
                        help='map corners and edges of walls by a laser scan (landmark_map)')
    launch.add_argument('--map', default='', metavar='FILE',
                        help='save the map in this file while mapping, and continue from it '
                             '(default: in memory only)')
    launch.add_argument('--keep-log', action='store_true',
                        help='with --map: keep everything that is received beside the map, so '
                             'that "ratslam replay FILE --log" repeats the run; it grows without '
                             'a limit')
    launch.add_argument('--localize', action='store_true',
                        help='only localise in the map file, which stays unchanged')
    add_view_options(launch)
    launch.add_argument('--use-sim-time', action='store_true',
                        help='take the time from /clock, which ratslam play --clock publishes')
    launch.add_argument('--namespace', default='', metavar='NS')
    launch.add_argument('--image-topic', default='', metavar='T',
                        help='camera topic, raw or .../compressed (default: image)')
    launch.add_argument('--odom-topic', default='', metavar='T',
                        help='odometry topic (default: odom)')
    launch.add_argument('--scan-topic', default='', metavar='T',
                        help='laser topic (default: scan)')
    launch.add_argument('--cmd-vel-topic', default='', metavar='T',
                        help='velocity command topic (default: cmd_vel)')
    launch.add_argument('--log-level', default='', metavar='L',
                        help='debug, info, warn, error or fatal')
    launch.set_defaults(run=_launch)

    play = commands.add_parser('play', help='publish a recording in place of a robot')
    add_recording(play)
    play.add_argument('--rate', type=float, default=1.0, metavar='R',
                      help='playback speed; 0: as fast as possible (default: 1)')
    play.add_argument('--clock', action='store_true',
                      help='publish the time of the recording on /clock')
    play.add_argument('--loop', action='store_true', help='repeat the recording until interrupted')
    play.add_argument('--lockstep', action='store_true',
                      help='wait for the action of each image before going on')
    add_span(play)
    add_topics(play)
    play.add_argument('--scan-topic', metavar='T',
                      help='also publish these scans, for experience_map.exp_align_scans')
    play.add_argument('--visual-odometry', action='store_true',
                      help='publish no odometry, even if it is recorded')
    play.add_argument('--wait', type=float, default=10.0, metavar='S',
                      help='time to wait for subscribers; nodes that are starting on this machine '
                           'are awaited first (default: 10)')
    play.add_argument('--quiet', action='store_true', help='no progress bar, no summary')
    add_ros_args(play)
    play.set_defaults(run=_play)

    call = commands.add_parser('call', help='call a service')
    call.add_argument('service', metavar='SERVICE')
    call.add_argument('type', metavar='TYPE', help='service type, such as std_srvs/srv/Trigger')
    call.add_argument('values', metavar='YAML', nargs='?', default='',
                      help='the request, such as "{data: true}"')
    call.add_argument('--timeout', type=float, default=10.0, metavar='S',
                      help='time to wait for the response (default: 10)')
    add_ros_args(call)
    call.set_defaults(run=partial(_exchange, 'call'))

    pub = commands.add_parser('pub', help='publish messages on a topic')
    pub.add_argument('topic', metavar='TOPIC')
    pub.add_argument('type', metavar='TYPE', help='message type, such as std_msgs/msg/String')
    pub.add_argument('values', metavar='YAML', nargs='?', default='',
                     help='the message, such as "{data: hello}"')
    pub.add_argument('-r', '--rate', type=positive, default=1.0, metavar='HZ',
                     help='messages per second (default: 1)')
    number = pub.add_mutually_exclusive_group()
    number.add_argument('-1', '--once', action='store_const', const=1, dest='times',
                        help='wait for a subscriber, publish one message and exit')
    number.add_argument('-t', '--times', type=positive_number, metavar='N',
                        help='wait for a subscriber, publish N messages and exit '
                             '(default: publish until interrupted)')
    pub.add_argument('--timeout', type=float, default=math.inf, metavar='S',
                     help='longest time to wait for the subscriber (default: no limit)')
    add_ros_args(pub)
    pub.set_defaults(run=partial(_exchange, 'pub'))

    echo = commands.add_parser('echo', help='print the messages of a topic')
    echo.add_argument('topic', metavar='TOPIC')
    echo.add_argument('type', metavar='TYPE', nargs='?',
                      help='message type (default: that of the publishers)')
    echo.add_argument('--once', action='store_true', help='print one message and exit')
    echo.add_argument('--field', metavar='NAME', help='print only this field, such as pose.pose')
    echo.add_argument('--timeout', type=float, default=math.inf, metavar='S',
                      help='exit after S seconds without a message (default: never)')
    add_ros_args(echo)
    echo.set_defaults(run=partial(_exchange, 'echo'))


def _run(options: argparse.Namespace) -> int:
    from ratslam_ros.live.run import run

    return run(options.node, options.arguments)


def _launch(options: argparse.Namespace) -> int:
    from ratslam_ros.live import ros
    from ratslam_ros.live.launch import launch

    ros.check()
    return launch(config_of(options), options)


def _play(options: argparse.Namespace) -> int:
    try:
        return _play_until_end(options)
    except KeyboardInterrupt:
        if not options.ros_args:
            raise
        return DONE  # In a launch file it is a node, and nodes end cleanly by Ctrl-C.


def _play_until_end(options: argparse.Namespace) -> int:
    if not options.quiet:
        print_status(f'reading {options.recording}')
    with ExitStack() as opened:
        with ticking('reading:', not options.quiet):
            from ratslam_ros.live import ros
            from ratslam_ros.recordings import open_recording

            recording = opened.enter_context(
                open_recording(options.recording, images_rate_hz=options.images_rate)
            )
            selection = recording.select(
                options.image_topic, options.odom_topic, options.visual_odometry,
                options.scan_topic, options.scan_topic is not None,
            )
            ros.require()
            from ratslam_ros.live.player import play

        if not options.quiet:
            print_notices(selection.notices)
            if selection.odom_topic is None:
                print_notice(
                    'the nodes compute visual odometry only if they were started with "ratslam '
                    'launch --odometry camera" or auto; odometry:=camera with ros2 launch'
                )
        summary = play(recording, selection, options)
    if not options.quiet:
        print(summary)
    return DONE


def _exchange(command: str, options: argparse.Namespace) -> int:
    from ratslam_ros.live import ros

    ros.require()
    from ratslam_ros.live import exchange

    getattr(exchange, command)(options)
    return DONE
