# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""``ratslam run``: run one node in this process."""

from __future__ import annotations

import sys
from collections.abc import Callable, Sequence
from functools import partial
from importlib import import_module
from importlib.util import find_spec

from ratslam_ros.errors import UnusableInput
from ratslam_ros.live import ros
from ratslam_ros.quick_start import quick_start
from ratslam_ros.signals import StopAtOnce
from ratslam_ros.starting import announced

NODES = {
    'visual_odometry': '.visual_odometry_node.VisualOdometryNode',
    'local_view': '.local_view_node.LocalViewNode',
    'pose_cells': '.pose_cells_node.PoseCellsNode',
    'experience_map': '.experience_map_node.ExperienceMapNode',
    'goal_follower': '.navigation.goal_follower_node.GoalFollowerNode',
    'route_to_nav2': '.navigation.route_to_nav2_node.RouteToNav2Node',
    'route_server_graph': '.navigation.route_server_graph_node.RouteServerGraphNode',
    'landmark_map': '.landmark_map_node.LandmarkMapNode',
    'simulator': 'ratslam_simulator.node.SimulatorNode',
    'viewer': '.viewing.viewer_node.ViewerNode',
    'single_process': '.single_process.main',
}
"""Class of each node, or the function that runs it, in ratslam_ros.ros or elsewhere."""

VIEWER_PACKAGES = {'viser': 'viser>=1.1,<1.2', 'zstandard': 'zstandard>=0.22'}
"""Packages that only the viewer imports: name for pip by module."""


def run(node: str, arguments: Sequence[str] | None = ()) -> int:
    """Run a node until SIGINT or SIGTERM.

    Args:
        node: one of `NODES`.
        arguments: arguments of the node, such as ``--ros-args ...``; None: of the process.

    Returns:
        The exit code of the node.

    Raises:
        UnusableInput: there is no such node, or a package of the viewer is not installed.
    """
    if node not in NODES:
        raise UnusableInput(f'there is no node {node!r}: expected one of {", ".join(NODES)}')
    with quick_start(), announced(node), StopAtOnce():
        if node == 'viewer':
            _check_viewer()
        ros.require()
        return load(node)(args=None if arguments is None else list(arguments))


def load(node: str) -> Callable[..., int]:
    """Import a node; return the function that runs it, given its arguments as ``args``."""
    module, _, name = NODES[node].rpartition('.')
    found: Callable[..., int] = getattr(import_module(module, 'ratslam_ros.ros'), name)
    if not isinstance(found, type):
        return found
    return partial(import_module('ratslam_ros.ros.run').run, found)


def _check_viewer() -> None:
    """Check, without importing them, that the packages of the viewer are installed."""
    for module, package in VIEWER_PACKAGES.items():
        if find_spec(module) is None:
            raise UnusableInput(
                f'the live view needs {module}, which this Python ({sys.executable}) does not '
                f"have: python3 -m pip install '{package}'"
            )
