# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Entry points of ``ros2 run ratslam_ros NODE``; without ROS 2 they print advice."""

from __future__ import annotations

import sys
from importlib.util import find_spec

from ratslam_ros.errors import UnusableInput
from ratslam_ros.live.run import load, require_packages
from ratslam_ros.quick_start import quick_start
from ratslam_ros.signals import StopAtOnce
from ratslam_ros.starting import announced


def _main(node: str) -> int:
    if find_spec('rclpy') is None:
        print(
            f'{node}: rclpy is not installed; source ROS 2 (source /opt/ros/jazzy/setup.bash), or '
            f'use "ratslam run {node}", which runs without ROS',
            file=sys.stderr,
        )
        return 2
    try:
        with quick_start(), announced(node), StopAtOnce():
            require_packages(node)
            return int(load(node).main())
    except UnusableInput as error:
        print(f'{node}: {error}', file=sys.stderr)
        return 2


def visual_odometry() -> int:
    """Run visual_odometry."""
    return _main('visual_odometry')


def local_view() -> int:
    """Run local_view."""
    return _main('local_view')


def pose_cells() -> int:
    """Run pose_cells."""
    return _main('pose_cells')


def experience_map() -> int:
    """Run experience_map."""
    return _main('experience_map')


def goal_follower() -> int:
    """Run goal_follower."""
    return _main('goal_follower')


def route_to_nav2() -> int:
    """Run route_to_nav2."""
    return _main('route_to_nav2')


def route_server_graph() -> int:
    """Run route_server_graph."""
    return _main('route_server_graph')


def landmark_map() -> int:
    """Run landmark_map."""
    return _main('landmark_map')


def simulator() -> int:
    """Run simulator."""
    return _main('simulator')


def viewer() -> int:
    """Run viewer."""
    return _main('viewer')


def single_process() -> int:
    """Run all nodes in one process."""
    return _main('single_process')
