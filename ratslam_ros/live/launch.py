# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""ratslam launch: the nodes as child processes, started and ended together."""

from __future__ import annotations

import ctypes
import math
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from ratslam_ros.core.config import Config
from ratslam_ros.files.config import to_yaml
from ratslam_ros.signals import StopSignals

GRACE_S = 20.0  # to end in, which includes writing a map
POLL_S = 0.05
PARAMETERS = 'parameters.yaml'
FORWARDED_SIGNALS = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)

_PR_SET_PDEATHSIG = 1


@dataclass(frozen=True)
class LaunchOptions:
    """Which nodes are started, and what they are told."""

    visual_odometry: bool = False
    single_process: bool = False
    goal_follower: bool = False
    use_sim_time: bool = False
    namespace: str = ''
    image_topic: str = ''
    odom_topic: str = ''
    scan_topic: str = ''
    cmd_vel_topic: str = ''
    log_level: str = ''


def nodes(
    visual_odometry: bool, single_process: bool, goal_follower: bool = False
) -> dict[str, list[str]]:
    """Return the nodes to start, with arguments of their own.

    Without visual_odometry the odometry comes from the robot. What moves the robot is a process
    of its own in any case: nothing else shall keep it from stopping.
    """
    follower = ['goal_follower'] if goal_follower else []
    if single_process:
        mapping = {'single_process': ['--visual-odometry'] if visual_odometry else []}
        return {**mapping, **{node: [] for node in follower}}
    first = ['visual_odometry'] if visual_odometry else []
    mappers = [*first, 'local_view', 'pose_cells', 'experience_map']
    return {node: [] for node in [*mappers, *follower]}


def remappings(
    image_topic: str, odom_topic: str, scan_topic: str = '', cmd_vel_topic: str = ''
) -> list[tuple[str, str]]:
    """Return what the nodes' topics are called on this robot; an empty name changes nothing.

    A camera's raw and compressed images go together; either of the two names is understood.
    """
    found = []
    if image_topic:
        raw = image_topic.removesuffix('/compressed')
        found += [('image', raw), ('image/compressed', f'{raw}/compressed')]
        folder, slash, _ = raw.rpartition('/')
        if slash:  # where a driver publishes it: beside the images
            found.append(('camera_info', f'{folder}/camera_info'))
    others = (('odom', odom_topic), ('scan', scan_topic), ('cmd_vel', cmd_vel_topic))
    return found + [(name, topic) for name, topic in others if topic]


def ros_arguments(options: LaunchOptions, parameters: Path) -> list[str]:
    """Return what each node is given after `--ros-args`."""
    arguments = ['--params-file', str(parameters)]
    if options.use_sim_time:
        arguments += ['-p', 'use_sim_time:=true']
    if options.namespace:
        arguments += ['-r', f'__ns:=/{options.namespace.strip("/")}']
    for name, target in remappings(
        options.image_topic, options.odom_topic, options.scan_topic, options.cmd_vel_topic
    ):
        arguments += ['-r', f'{name}:={target}']
    if options.log_level:
        arguments += ['--log-level', options.log_level]
    return arguments


def launch(config: Config, options: LaunchOptions) -> int:
    """Run the nodes until they are interrupted; return 1 if one ended by itself or badly."""
    with tempfile.TemporaryDirectory(prefix='ratslam-') as folder:
        parameters = Path(folder) / PARAMETERS
        parameters.write_text(to_yaml(config), encoding='utf-8')
        command = [sys.executable, '-m', 'ratslam_ros', 'run']
        given = ['--ros-args', *ros_arguments(options, parameters)]
        started = nodes(
            options.visual_odometry, options.single_process, options.goal_follower
        )
        return supervise({name: [*command, name, *own, *given] for name, own in started.items()})


def supervise(commands: Mapping[str, Sequence[str]], grace_s: float = GRACE_S) -> int:
    """Run commands, by name, until all have ended; return 0 if that was asked for and went well.

    An interrupt is passed on, a second one kills. When one command ends by itself the others are
    ended too.
    """
    processes: dict[str, subprocess.Popen[bytes]] = {}
    with StopSignals(FORWARDED_SIGNALS, raise_on_second=False) as signals:
        try:
            for name, command in commands.items():
                processes[name] = _start(command)
            return _watch(processes, signals, grace_s)
        finally:
            for process in processes.values():  # none is left, whatever happened
                if process.poll() is None:
                    process.kill()
                process.wait()


def _start(command: Sequence[str]) -> subprocess.Popen[bytes]:
    # In a session of its own, so that Ctrl-C in the terminal reaches it once, through here.
    return subprocess.Popen(
        command, stdin=subprocess.DEVNULL, start_new_session=True, preexec_fn=_end_with_parent()
    )


def _end_with_parent() -> Callable[[], object] | None:
    """Return what makes a child end when this process is killed; only Linux knows of it."""
    if sys.platform != 'linux':
        return None
    libc = ctypes.CDLL(None)  # looked up before the fork, where little is safe
    return lambda: libc.prctl(_PR_SET_PDEATHSIG, signal.SIGTERM)


def _watch(
    processes: Mapping[str, subprocess.Popen[bytes]], signals: StopSignals, grace_s: float
) -> int:
    asked, failed, kill_at_s = 0, False, math.inf
    while left := [name for name, process in processes.items() if process.poll() is None]:
        number = None
        if signals.count > 1 or time.monotonic() > kill_at_s:
            _say(f'killing {", ".join(left)}')
            _end(processes, left, signal.SIGKILL)
            break
        if signals.count > asked:
            asked, number = signals.count, signals.last
        elif len(left) < len(processes) and not asked and not failed:
            gone = [name for name in processes if name not in left]
            _say(f'{_how(processes, gone)}; ending {", ".join(left)}')
            failed, number = True, signal.SIGINT
        if number is not None:
            _end(processes, left, number)
            kill_at_s = time.monotonic() + grace_s
        time.sleep(POLL_S)
    # One that was still starting may end by the signal itself.
    fine = (0, *(-number for number in FORWARDED_SIGNALS)) if asked else ()
    bad = [name for name, process in processes.items() if process.wait() not in fine]
    if bad and not failed:
        _say(_how(processes, bad))
    return 1 if bad or failed else 0


def _end(
    processes: Mapping[str, subprocess.Popen[bytes]], names: Sequence[str], number: signal.Signals
) -> None:
    for name in names:
        processes[name].send_signal(number)


def _how(processes: Mapping[str, subprocess.Popen[bytes]], names: Sequence[str]) -> str:
    """Return how processes have ended."""
    codes = {name: processes[name].returncode for name in names}
    return ', '.join(
        f'{name} was ended by {signal.Signals(-code).name}'
        if code < 0
        else f'{name} ended with code {code}'
        for name, code in codes.items()
    )


def _say(text: str) -> None:
    print(f'ratslam launch: {text}', file=sys.stderr, flush=True)
