# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""``ratslam run``: run one node in this process."""

from __future__ import annotations

import sys
from collections.abc import Sequence
from importlib import import_module
from importlib.util import find_spec
from types import ModuleType

from ratslam_ros.errors import UnusableInput, missing_package
from ratslam_ros.live import ros
from ratslam_ros.quick_start import quick_start
from ratslam_ros.signals import StopAtOnce
from ratslam_ros.starting import announced

NODES = {
    'visual_odometry': 'visual_odometry_node',
    'local_view': 'local_view_node',
    'pose_cells': 'pose_cells_node',
    'experience_map': 'experience_map_node',
    'goal_follower': 'navigation.goal_follower_node',
    'route_to_nav2': 'navigation.route_to_nav2_node',
    'route_server_graph': 'navigation.route_server_graph_node',
    'landmark_map': 'landmark_map_node',
    'simulator': 'simulator_node',
    'viewer': 'viewing.viewer_node',
    'single_process': 'single_process',
}
"""Module of ratslam_ros.ros that has ``main``, by node."""

MODULES = 'numpy', 'numba', 'llvmlite', 'msgspec'
"""Modules of other packages that every node imports."""

IMAGE_MODULES = ('cv2',)
"""Further ones that the nodes with images import."""

VIEWER_PACKAGES = {'viser': 'viser>=1.1,<1.2', 'zstandard': 'zstandard>=0.22'}
"""Further packages that the viewer imports: name for pip by module."""

IMAGE_NODES = frozenset(
    {'visual_odometry', 'local_view', 'simulator', 'single_process', 'viewer'}
)


def run(node: str, arguments: Sequence[str] = ()) -> int:
    """Run a node until SIGINT or SIGTERM.

    Args:
        node: one of `NODES`.
        arguments: arguments of the node, such as ``--ros-args ...``.

    Returns:
        The exit code of the node.

    Raises:
        UnusableInput: there is no such node, or a required package is not installed.
    """
    if node not in NODES:
        raise UnusableInput(f'there is no node {node!r}: expected one of {", ".join(NODES)}')
    with quick_start(), announced(node), StopAtOnce():
        require_packages(node)
        ros.require()
        return int(load(node).main(list(arguments)))


def load(node: str) -> ModuleType:
    """Import the module of a node."""
    return import_module(f'ratslam_ros.ros.{NODES[node]}')


def require_packages(node: str) -> None:
    """Check, without importing them, that the packages of a node are installed.

    Raises:
        UnusableInput: a package is missing.
    """
    if node == 'viewer':
        for module, package in VIEWER_PACKAGES.items():
            if find_spec(module) is None:
                raise UnusableInput(
                    f'the live view needs {module}, which this Python ({sys.executable}) does not '
                    f"have: python3 -m pip install '{package}'"
                )
    for module in (*MODULES, *(IMAGE_MODULES if node in IMAGE_NODES else ())):
        if find_spec(module) is None:
            raise missing_package(module)
