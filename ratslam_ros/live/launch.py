# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""``ratslam launch``: run the nodes as child processes, started and ended together."""

from __future__ import annotations

import argparse
import json
import sys
import tempfile
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

from ratslam_ros.console import print_status
from ratslam_ros.core.config import Config
from ratslam_ros.errors import UNUSABLE, UnusableParameter
from ratslam_ros.files.config import to_yaml
from ratslam_ros.pipeline import choice
from ratslam_ros.supervision import supervise

OPTIONAL = frozenset({'viewer', 'route_server_graph'})
"""Nodes that the others do not need: if one ends, the others go on."""

MANAGED = frozenset({*choice.NAMES, 'single_process', 'goal_follower', 'landmark_map'})
"""Nodes that can be managed nodes of ROS 2."""

PARAMETERS_FILE = 'parameters.yaml'


def nodes(
    stages: str, odometry: str, split: bool, goal_follower: bool = False,
    landmarks: bool = False, viewer: bool = False, nav2: bool = False,
    route_server: bool = False, own_stages: Sequence[str] = (), scans: str = '',
) -> dict[str, list[str]]:
    """Return the nodes to start, with the arguments that only they have.

    Mapping nodes run in one process unless a node between them is missing, because it is foreign;
    with split, each runs in a process of its own that follows the one before it, but
    visual_odometry in that of local_view. goal_follower is always a process of its own, so that no
    other node can delay a stop of the robot. So is landmark_map, which does not depend on the
    others, and viewer, which must not delay them.

    Args:
        stages: names of the mapping nodes, separated by commas.
        odometry: one of ``choice.ODOMETRY``.
        split: whether each runs in a process of its own.
        goal_follower, landmarks, viewer, nav2, route_server: further nodes.
        own_stages: stages of the user (own_stages.py), in the process of all mapping nodes.
        scans: topics of the scans for experience_map, separated by commas, for a split.

    Raises:
        UnusableParameter: a stage is unknown or missing, or two nodes would drive the robot.
    """
    if goal_follower and nav2:
        raise UnusableParameter(
            'goal_follower and nav2 are both true, and both would drive the robot; set one of them'
        )
    further = {
        'goal_follower': goal_follower, 'route_to_nav2': nav2,
        'route_server_graph': route_server, 'landmark_map': landmarks, 'viewer': viewer,
    }
    chosen = choice.chosen_stages(stages, odometry)
    mapping: dict[str, list[str]] = {}
    for group in choice.neighbours(chosen):
        processes = _split(group) if split else [group]
        for number, process in enumerate(processes):
            is_first = not mapping and odometry == choice.AUTO
            is_answered = number > 0 or 'experience_map' in group
            name, arguments = _process(process, is_answered, is_first)
            if number > 0:
                arguments += ['--follows', processes[number - 1][-1]]
            if number < len(processes) - 1:
                arguments += ['--followed', *([scans] if scans and number == 0 else ())]
            mapping[name] = arguments
    if own_stages and len(mapping) > 1:
        raise UnusableParameter(
            f'there are processes for {", ".join(mapping)}; expected one process for all mapping '
            'nodes: a stage of your own (--stage) reads what these exchange'
        )
    words = [word for one in own_stages for word in ('--stage', one)]
    mapping = {name: [*arguments, *words] for name, arguments in mapping.items()}
    return {**mapping, **{node: [] for node, is_chosen in further.items() if is_chosen}}


def _split(group: Sequence[str]) -> list[Sequence[str]]:
    """Return the stages of each process, none of which waits for the odometry of another one."""
    first = 2 if group[0] == 'visual_odometry' else 1
    return [group[:first], *([one] for one in group[first:])]


def _process(
    group: Sequence[str], is_answered: bool, decides: bool
) -> tuple[str, list[str]]:
    """Return the program that runs some mapping nodes, and its arguments."""
    if len(group) == 1 and not decides and (is_answered or group[0] != 'pose_cells'):
        return group[0], []
    # Without answers, pose_cells must not wait for them: only its own program may.
    odometry = ['--odometry', choice.AUTO] if decides else []
    return 'single_process', ['--stages', ','.join(group), *odometry]


def used_scans(config: Config) -> str:
    """Return the topics of the scans that experience_map uses, separated by commas."""
    p = config.experience_map
    return p.scan_topics if p.exp_align_scans else ''


def remappings(
    image_topic: str, odom_topic: str, scan_topic: str = '', cmd_vel_topic: str = ''
) -> list[tuple[str, str]]:
    """Return the remappings (from, to) of the nodes' topics; an empty name gives none.

    The raw and the compressed topic of a camera are remapped together; either name is accepted.
    """
    result = []
    if image_topic:
        raw = image_topic.removesuffix('/compressed')
        result += [('image', raw), ('image/compressed', f'{raw}/compressed')]
        folder, slash, _ = raw.rpartition('/')
        if slash:  # Drivers publish camera_info beside the images.
            result.append(('camera_info', f'{folder}/camera_info'))
    others = (('odom', odom_topic), ('scan', scan_topic), ('cmd_vel', cmd_vel_topic))
    return result + [(name, topic) for name, topic in others if topic]


def ros_arguments(options: argparse.Namespace, parameters: Path) -> list[str]:
    """Return the arguments of every node after ``--ros-args``."""
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


def with_map(config: Config, path: str, localize: bool, keep_log: bool = False) -> Config:
    """Return a configuration whose nodes use a map file; '' leaves it unchanged.

    Raises:
        UnusableParameter: ``localize`` or ``keep_log`` is given without a file, or both are.
    """
    if localize and keep_log:
        raise UnusableParameter('localize writes no map beside which a log is kept; leave one out')
    if not path:
        if localize:
            raise UnusableParameter('localize needs the map in which to localise; give its file')
        if keep_log:
            raise UnusableParameter(
                'keep_log keeps the log beside the map: give its file (--map FILE, or map:=FILE)'
            )
        return config
    file = str(Path(path).expanduser().absolute())
    return config.with_values({
        'memory.map': file, 'memory.localize': localize,
        **({'memory.keep_log': True} if keep_log else {}),
    })


def launch(config: Config, options: argparse.Namespace) -> int:
    """Run the nodes until they are interrupted.

    With a map file, a node that crashes or is killed is started again, and continues from there;
    if that happens at short intervals, after growing pauses.

    Args:
        config: the parameters of the nodes.
        options: those of ``ratslam launch``.

    Returns:
        The exit code: 1 if a node ended by itself or with an error, otherwise 0.
    """
    config = with_map(config, options.map, options.localize, options.keep_log)
    with tempfile.TemporaryDirectory(prefix='ratslam-') as folder:
        parameters = Path(folder) / PARAMETERS_FILE
        parameters.write_text(to_yaml(config), encoding='utf-8')
        command = [sys.executable, '-m', 'ratslam_ros', 'run']
        common = ['--ros-args', *ros_arguments(options, parameters)]
        started = nodes(
            options.stages, options.odometry, options.split, options.goal_follower,
            options.landmarks, options.view, own_stages=options.own_stages,
            scans=used_scans(config),
        )
        commands = {name: [*command, name, *own, *common] for name, own in started.items()}
        viewer = {
            'host': options.host, 'port': options.port,
            'open_browser': None if options.browser else False,
        }
        for name, value in viewer.items() if options.view else ():
            if value is not None:
                commands['viewer'] += ['-p', f'{name}:={json.dumps(value)}']
        print_status(f'starting {", ".join(commands)}')
        return supervise(commands, optional=OPTIONAL, respawn=bool(options.map), are_nodes=True)


def ending_launch(name: str, is_restarted: bool = False) -> Callable[[Any, Any], None]:
    """Return a handler for ``on_exit`` of a process that the launch cannot do without.

    When the process ends, the handler raises an error: launch then prints its text in one line,
    stops all other processes, and exits with 1. While launch is stopping, it does nothing.

    Args:
        name: the process.
        is_restarted: launch starts the process again if it fails, unless by ``UNUSABLE``.
    """

    def on_exit(event: Any, context: Any) -> None:
        fails = event.returncode not in (0, UNUSABLE)
        if not context.is_shutdown and not (is_restarted and fails):
            raise RuntimeError(f'{name} has ended {ending(event.returncode)}')

    return on_exit


def ending(code: int) -> str:
    """Describe an exit code."""
    return f'by signal {-code}' if code < 0 else f'with code {code}'
