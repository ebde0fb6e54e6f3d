# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""ratslam run: one node, in this process."""

from __future__ import annotations

from collections.abc import Sequence
from importlib import import_module

from ratslam_ros.errors import UnusableInput
from ratslam_ros.live import ros
from ratslam_ros.quick_start import quick_start

NODES = {
    'visual_odometry': 'visual_odometry_node',
    'local_view': 'local_view_node',
    'pose_cells': 'pose_cells_node',
    'experience_map': 'experience_map_node',
    'goal_follower': 'goal_follower_node',
    'simulator': 'simulator_node',
    'single_process': 'single_process',
}
"""The nodes, and the modules of ratslam_ros.nodes with their ``main``."""


def run(node: str, arguments: Sequence[str] = ()) -> int:
    """Run a node until it ends or is interrupted; return its exit code.

    SIGTERM raises KeyboardInterrupt as SIGINT does (see cli.main). rclpy puts its own handlers
    before these and calls them too, so that a node sees one end, whichever of the two came.

    Raises:
        UnusableInput: no such node, or nothing to run it on.
    """
    if node not in NODES:
        raise UnusableInput(f'there is no node {node!r}: expected one of {", ".join(NODES)}')
    try:
        with quick_start():
            ros.require()
            module = import_module(f'ratslam_ros.nodes.{NODES[node]}')
            return int(module.main(list(arguments)))
    except KeyboardInterrupt:  # also while it was starting
        return 0
