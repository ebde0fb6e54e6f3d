# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""pose_cells/grid: the ranges of sonars at the peak of the packet, for subscribers."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from nav_msgs.msg import OccupancyGrid
from nav_msgs.msg import Odometry as OdometryMessage
from ros_messages import MakeWorld
from sensor_msgs.msg import Range
from tf2_msgs.msg import TFMessage

from ratslam_ros.core.common.pose import Pose
from ratslam_ros.ros.convert import header_of, transform
from ratslam_ros.ros.pose_cells_node import PoseCellsNode
from ratslam_ros.ros.qos import LATCHED, STATIC

ARGUMENTS = ('-p', 'pc_cell_x_size:=0.25', '-p', 'pc_dim_x:=40', '-p', 'pc_dim_y:=30')


def odometry(stamp_s: float) -> Any:
    """Return odometry of a robot that stands."""
    message = OdometryMessage(header=header_of(round(stamp_s * 1e9), 'odom'))
    message.child_frame_id = 'base_link'
    return message


def range_of(range_m: float) -> Any:
    return Range(
        header=header_of(10**9, 'sonar_3'), field_of_view=math.radians(30.0), min_range=0.1,
        max_range=5.0, range=range_m,
    )


def test_ranges_appear_ahead_of_the_packet(world: MakeWorld) -> None:
    made = world(PoseCellsNode, arguments=ARGUMENTS)
    [node] = made.nodes
    grids = made.listen(OccupancyGrid, 'pose_cells/grid', LATCHED)
    made.until(lambda: node._sonars._has_subscribed)
    mount = transform(0, 'base_link', 'sonar_3', Pose(0.25, 0.0, 0.0))
    made.send('/tf_static', TFMessage(transforms=[mount]), STATIC)
    stamps = iter(range(1, 10**6))

    def arrived() -> bool:
        made.send('odom', odometry(0.1 * next(stamps)))
        made.send('sonar_3', range_of(2.0))
        return bool(grids)

    made.until(arrived)
    grid, peak = grids[-1], node._core.peak
    assert grid.header.frame_id == 'pose_cells'
    assert (grid.info.width, grid.info.height, grid.info.resolution) == (40, 30, 1.0)
    assert (grid.info.origin.position.x, grid.info.origin.position.y) == (-0.5, -0.5)
    percent = np.array(grid.data, np.int8).reshape(30, 40)
    heading_rad = peak.theta / node._core.dims[2] * math.tau

    def ahead(cells: float) -> int:
        x = round(peak.x + cells * math.cos(heading_rad))
        y = round(peak.y + cells * math.sin(heading_rad))
        return int(percent[y % 30, x % 40])

    assert ahead(9.0) > 50  # the mount and 2 m
    assert 0 <= ahead(3.0) < 50
    assert ahead(-3.0) == -1


def test_sonar_that_is_tilted_is_reported(world: MakeWorld) -> None:
    made = world(PoseCellsNode, arguments=ARGUMENTS)
    [node] = made.nodes
    made.listen(OccupancyGrid, 'pose_cells/grid', LATCHED)
    made.until(lambda: node._sonars._has_subscribed)
    tilted = transform(0, 'base_link', 'sonar_3', Pose(0.25, 0.0, 0.0))
    half = math.sqrt(0.5)
    tilted.transform.rotation.x, tilted.transform.rotation.w = half, half
    made.send('/tf_static', TFMessage(transforms=[tilted]), STATIC)
    stamps = iter(range(1, 10**6))

    def refused() -> bool:
        made.send('odom', odometry(0.1 * next(stamps)))
        made.send('sonar_3', range_of(2.0))
        return node.diagnostics.counts['refused'] > 0

    made.until(refused)


def test_sonars_are_not_used_without_a_subscriber(world: MakeWorld) -> None:
    made = world(PoseCellsNode, arguments=ARGUMENTS)
    for number in range(10):
        made.send('odom', odometry(0.1 * number))
    made.spin(0.3)
    assert 'sonar_3' not in {found.topic_name.lstrip('/') for found in made.nodes[0].subscriptions}
    assert (made.nodes[0]._sonars._grid.percent() == -1).all()
