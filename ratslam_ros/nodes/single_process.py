# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""All mapping nodes in one process on one executor."""

from __future__ import annotations

import argparse
import sys

from rclpy.utilities import remove_ros_args

from ratslam_ros.nodes.experience_map_node import ExperienceMapNode
from ratslam_ros.nodes.local_view_node import LocalViewNode
from ratslam_ros.nodes.managed import AUTOSTART, LIFECYCLE
from ratslam_ros.nodes.pose_cells_node import PoseCellsNode
from ratslam_ros.nodes.run import run
from ratslam_ros.nodes.visual_odometry_node import VisualOdometryNode


def main(args: list[str] | None = None) -> int:
    """Run three nodes, or four with --visual-odometry, until they are interrupted."""
    parser = argparse.ArgumentParser(
        prog='single_process', description='All mapping nodes of RatSLAM in one process.'
    )
    parser.add_argument('--visual-odometry', action='store_true',
                        help='run visual_odometry too, which publishes odom')
    parser.add_argument(LIFECYCLE, action='store_true', help='run managed nodes (ROS 2)')
    parser.add_argument(AUTOSTART, action='store_true', help='activate them')
    given = sys.argv if args is None else ['single_process', *args]
    options = parser.parse_args(remove_ros_args(given)[1:])
    kinds = [LocalViewNode, PoseCellsNode, ExperienceMapNode]
    if options.visual_odometry:
        kinds.insert(0, VisualOdometryNode)
    return run(*kinds, args=args)
