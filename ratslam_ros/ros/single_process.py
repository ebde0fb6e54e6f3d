# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Mapping nodes in one process on one executor."""

from __future__ import annotations

import argparse
import sys

from rclpy.utilities import remove_ros_args

from ratslam_ros.errors import UnusableParameter
from ratslam_ros.pipeline.choice import DEFAULT, chosen_stages, neighbours
from ratslam_ros.ros.experience_map_node import ExperienceMapNode
from ratslam_ros.ros.host import Host
from ratslam_ros.ros.local_view_node import LocalViewNode
from ratslam_ros.ros.managed import AUTOSTART, LIFECYCLE
from ratslam_ros.ros.node import RatslamNode
from ratslam_ros.ros.pose_cells_node import PoseCellsNode
from ratslam_ros.ros.run import run
from ratslam_ros.ros.visual_odometry_node import VisualOdometryNode

KINDS: tuple[type[RatslamNode], ...] = (
    VisualOdometryNode, LocalViewNode, PoseCellsNode, ExperienceMapNode,
)  # fmt: skip


def main(args: list[str] | None = None) -> int:
    """Run the nodes of --stages until they are interrupted."""
    parser = argparse.ArgumentParser(
        prog='single_process', description='Mapping nodes of RatSLAM in one process.'
    )
    parser.add_argument('--stages', default=DEFAULT, metavar='A,B',
                        help=f'the nodes to run, which follow one another (default: {DEFAULT})')
    parser.add_argument(LIFECYCLE, action='store_true', help='run managed nodes (ROS 2)')
    parser.add_argument(AUTOSTART, action='store_true', help='activate them')
    given = sys.argv if args is None else ['single_process', *args]
    options = parser.parse_args(remove_ros_args(given)[1:])
    try:
        stages = chosen_stages(options.stages)
    except UnusableParameter as error:
        parser.error(str(error))
    if len(neighbours(stages)) > 1:
        parser.error(
            f'stages are {options.stages}, between which one is missing; expected stages that '
            'follow one another: run the others in another process'
        )
    kinds = [kind for kind in KINDS if kind.SECTION in stages]
    return run(*kinds, args=args, host=Host(is_answered=False))
