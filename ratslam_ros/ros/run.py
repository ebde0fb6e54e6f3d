# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Run nodes until SIGINT or SIGTERM, and end them cleanly."""

from __future__ import annotations

import argparse
import sys
import threading
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from typing import Any

import rclpy
from rclpy.executors import SingleThreadedExecutor
from rclpy.logging import get_logger
from rclpy.signals import SignalHandlerOptions
from rclpy.utilities import remove_ros_args

from ratslam_ros import starting
from ratslam_ros.chain import add_chain, chain_of
from ratslam_ros.compilation import announced_compilation
from ratslam_ros.core.warm_up import warm_up
from ratslam_ros.errors import DONE, UNUSABLE, RatslamError, UnusableInput
from ratslam_ros.own_stages import add_stage
from ratslam_ros.pipeline.commands import UseOdometry
from ratslam_ros.quick_start import import_numba, settle
from ratslam_ros.ros.host import Host
from ratslam_ros.ros.managed import AUTOSTART, LIFECYCLE, managed
from ratslam_ros.ros.node import RatslamNode
from ratslam_ros.ros.parameters import initial_config
from ratslam_ros.signals import StopSignals, end_process

SIGNAL_CHECK_PERIOD_S = 0.1

REPEATED_SIGNAL_S = 1.0
"""Time for which a second signal counts as the same. Ctrl-C reaches all processes of a terminal,
and ``ros2 launch`` sends SIGINT again to its nodes if its standard input is not the terminal."""


def run(
    *kinds: type[Any], args: list[str] | None = None, decided: str = '',
    options: argparse.Namespace | None = None,
) -> int:
    """Create nodes and spin them on one executor until SIGINT or SIGTERM.

    Stop signals are handled by the caller until the nodes are created, and after they are closed;
    see `StopAtOnce`.

    Args:
        kinds: node classes: RatslamNodes, whose constructors take the initial configuration, or
            classes with the same ``SECTION``, ``warm_up`` and ``close``, whose constructors take
            no arguments.
        args: arguments for rclpy; None: those of the process. With ``--lifecycle``, RatslamNodes
            are managed nodes, and with ``--autostart`` they activate themselves.
        decided: what `auto` has decided about the odometry, '' if nothing.
        options: arguments of single_process; None: those of the program of one node are parsed.

    Returns:
        The exit code: 0 after a signal, 2 if a parameter or argument cannot be used.

    Raises:
        UnusableInput: an argument for ROS cannot be used.
    """
    given = sys.argv[1:] if args is None else args
    is_alone = options is None
    if options is None:
        options = parsed(parser_of(kinds[0].SECTION, kinds[0].__doc__ or ''), args)
    stop = StopSignals(repeats_s=REPEATED_SIGNAL_S)
    nodes: list[Any] = []
    threads: list[threading.Thread] = []
    try:
        if options.own_stages:
            from ratslam_ros.ros.own_nodes import with_own  # it imports OpenCV

            kinds = tuple(with_own(kinds, options.own_stages))
        init(args)
        _warm_up(kinds)
        initial = initial_config(given)
        host = Host(is_alone, chain_of(options))
        for kind in kinds:  # It compiles what only some parameters need.
            if issubclass(kind, RatslamNode):
                created: type[Any] = managed(kind) if options.lifecycle else kind
                nodes.append(created(initial, host))
            else:
                nodes.append(kind())
        if host.nodes:
            host.start()
        if decided:
            host.command(UseOdometry(decided))
        with stop:
            if host.nodes and not options.lifecycle:
                host.map.open()
            executor = SingleThreadedExecutor()
            for node in nodes:
                executor.add_node(node)
            for node in host.nodes if options.lifecycle and options.autostart else ():
                node.start()
            settle()
            starting.ready()
            for node in nodes:
                node.get_logger().info('ready')
            for part in {part for node in host.nodes for part in node.parts}:
                # Its imports take long and no stream of messages needs it: not before `ready`.
                threads.append(threading.Thread(target=warm_up, args=(part,)))
                threads[-1].start()
            while not stop.received and rclpy.ok():
                executor.spin_once(timeout_sec=SIGNAL_CHECK_PERIOD_S)
                for node in nodes:
                    if getattr(node, 'error', None) is not None:
                        raise node.error
            for node in nodes:
                node.close()
            executor.shutdown()
    except RatslamError as error:
        print(f'ratslam: {error}', file=sys.stderr, flush=True)
        return UNUSABLE
    finally:
        for node in nodes:
            node.destroy_node()
        rclpy.try_shutdown()
    if any(thread.is_alive() for thread in threads):
        end_process(DONE)
    return DONE


def init(args: list[str] | None) -> None:
    """Initialise rclpy without handlers of signals: these end the loop of ``run``.

    The nodes then still process and publish what they hold.

    Raises:
        UnusableInput: an argument for ROS cannot be used.
    """
    with _usable_ros_arguments():
        rclpy.init(args=args, signal_handler_options=SignalHandlerOptions.NO)


def parsed(parser: argparse.ArgumentParser, args: list[str] | None) -> argparse.Namespace:
    """Parse the arguments that are not for ROS.

    Args:
        parser: the parser of the program.
        args: all arguments; None: those of the process.

    Raises:
        UnusableInput: an argument for ROS cannot be used.
    """
    with _usable_ros_arguments():
        own = remove_ros_args(['', *(sys.argv[1:] if args is None else args)])[1:]
    return parser.parse_args(own)


@contextmanager
def _usable_ros_arguments() -> Iterator[None]:
    try:
        yield
    except Exception as error:  # rclpy raises several types; the text contains the arguments
        raise UnusableInput(str(error)[:300]) from None


def parser_of(name: str, description: str) -> argparse.ArgumentParser:
    """Return a parser of the arguments of a program that are not for ROS."""
    parser = argparse.ArgumentParser(
        prog=name, description=description.partition('\n')[0],
        epilog='Arguments after --ros-args, such as -p NAME:=VALUE and -r FROM:=TO, are those of '
        'ROS 2. docs/parameters.md describes the parameters.',
    )
    add_stage(parser)
    add_chain(parser)
    parser.add_argument(LIFECYCLE, action='store_true', help='managed nodes (ROS 2)')
    parser.add_argument(AUTOSTART, action='store_true', help='configure and activate them')
    return parser


def _warm_up(kinds: Sequence[type[Any]]) -> None:
    """Compile everything before the first message, which must not wait for the compiler."""
    import_numba()
    name = kinds[0].SECTION if len(kinds) == 1 else 'ratslam'
    with announced_compilation(get_logger(name).info):
        for kind in kinds:
            kind.warm_up()
