# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Mapping nodes in one process on one executor."""

from __future__ import annotations

import time
from pathlib import Path

import rclpy
from rclpy.node import Node

from ratslam_ros.console import print_notice
from ratslam_ros.errors import UnusableParameter
from ratslam_ros.maps import read_map
from ratslam_ros.pipeline import choice
from ratslam_ros.pipeline.choice import AUTO, CAMERA, DEFAULT, TOPIC, chosen_stages
from ratslam_ros.ros.experience_map_node import ExperienceMapNode
from ratslam_ros.ros.local_view_node import LocalViewNode
from ratslam_ros.ros.node import RatslamNode
from ratslam_ros.ros.pose_cells_node import PoseCellsNode
from ratslam_ros.ros.run import init, parsed, parser_of, run
from ratslam_ros.ros.visual_odometry_node import VisualOdometryNode
from ratslam_ros.starting import announce, ready

KINDS: tuple[type[RatslamNode], ...] = (
    VisualOdometryNode, LocalViewNode, PoseCellsNode, ExperienceMapNode,
)

ODOMETRY_WAIT_S = 2.0
"""Time after the first publisher of images in which that of the odometry must be visible."""

POLL_S = 0.02


def main(args: list[str] | None = None) -> int:
    """Run the nodes of --stages until they are interrupted."""
    parser = parser_of('single_process', 'Mapping nodes of RatSLAM in one process.')
    parser.add_argument('--stages', default=DEFAULT, metavar='A,B',
                        help=f'the nodes to run, which follow one another (default: {DEFAULT})')
    parser.add_argument('--odometry', choices=choice.ODOMETRY, default=TOPIC,
                        help='topic: that of the robot, the default; camera: add visual_odometry; '
                             'auto: add it if odom has no publisher '
                             f'{ODOMETRY_WAIT_S:g} s after the first one of images')
    options = parsed(parser, args)
    try:
        stages = chosen_stages(options.stages, options.odometry)
    except UnusableParameter as error:
        parser.error(str(error))
    if len(choice.neighbours(stages)) > 1:
        parser.error(
            f'stages are {options.stages}, between which one is missing; expected stages that '
            'follow one another: run the others in another process'
        )
    decided = ''
    if options.odometry == AUTO:
        decided = _decided_odometry(args)
        stages = chosen_stages(options.stages, decided)
    kinds = [kind for kind in KINDS if kind.SECTION in stages]
    return run(*kinds, args=args, decided=decided, options=options)


def _decided_odometry(args: list[str] | None) -> str:
    """Decide and print where the odometry comes from, before the nodes and their inputs exist.

    The decision of the map file lasts. Otherwise it depends on the publishers alone: a player or
    driver that waits for subscribers sends nothing until the nodes are there.
    """
    init(args)
    node = Node(
        'local_view', automatically_declare_parameters_from_overrides=True,
        start_parameter_services=False, enable_rosout=False,
    )
    try:
        path = Path(node.get_parameter('map').value if node.has_parameter('map') else '')
        saved = read_map(path.expanduser()).states if path.expanduser().is_file() else {}
        decided = choice.decided_odometry(saved)
        reason = f'as decided before for {path}'
        if not decided:
            decided, reason = _published_odometry(node)
    finally:
        node.destroy_node()
        rclpy.try_shutdown()
    print_notice(f'odometry: {decided}, {reason}')
    return decided


def _published_odometry(node: Node) -> tuple[str, str]:
    """Wait for images; return whose odometry to use, and the reason."""
    *images, odom = map(node.resolve_topic_name, ('image', 'image/compressed', 'odom'))
    ready()  # `ratslam play` need not wait for this process: this one may wait for long
    print_notice(f'odometry: waiting for a publisher of {" or ".join(images)}')
    while not any(map(node.count_publishers, images)):
        time.sleep(POLL_S)
    announce('single_process')
    end_s = time.monotonic() + ODOMETRY_WAIT_S
    while time.monotonic() < end_s:
        # ROS still lists the visual_odometry of a killed process for some seconds.
        publishers = {one.node_name for one in node.get_publishers_info_by_topic(odom)}
        if publishers - {VisualOdometryNode.SECTION}:
            return TOPIC, f'as {odom} has a publisher'
        time.sleep(POLL_S)
    return CAMERA, f'as {odom} has no publisher {ODOMETRY_WAIT_S:g} s after the first of images'
