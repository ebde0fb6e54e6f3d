# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Publisher of ``pose_cells/grid``: the occupancy plot of sonars on the pose cells."""

from __future__ import annotations

import math
import time

from nav_msgs.msg import OccupancyGrid
from sensor_msgs.msg import Range
from tf2_msgs.msg import TFMessage

from ratslam_ros.core.common.mount import FrameTree, UnusableMount
from ratslam_ros.core.common.pose import Pose
from ratslam_ros.core.mapping.occupancy import Picture
from ratslam_ros.core.mapping.sonar_grid import SonarGrid
from ratslam_ros.core.pose_cells.torus import Torus
from ratslam_ros.pipeline.pose_cells import PoseCellsStage
from ratslam_ros.ros.convert import grid_message, stamp_ns
from ratslam_ros.ros.hosted_node import HostedNode
from ratslam_ros.ros.mapping.scans import add_transforms
from ratslam_ros.ros.qos import LATCHED, STATIC, WATCH

PERIOD_S = 2.0
"""Shortest time between two messages, as of experience_map/grid."""

SONARS_COUNT = 8
"""Sonars whose topics, ``sonar_0`` and so on, are used."""


class SonarPlot:
    """Adds ranges at the peak of the active packet, from the first subscriber on."""

    def __init__(self, node: HostedNode, stage: PoseCellsStage) -> None:
        """Create the topic of the node of a stage."""
        self._node, self._stage = node, stage
        self._publisher = node.create_publisher(OccupancyGrid, 'pose_cells/grid', LATCHED)
        self._tree = FrameTree()
        self._has_subscribed = False
        self._next_s = 0.0
        self.reset()

    def reset(self) -> None:
        """Begin an empty plot."""
        self._grid = SonarGrid(Torus(*self._stage.core.dims))

    def update(self) -> None:
        """Subscribe to the sonars once the plot has a subscriber."""
        if self._has_subscribed or self._publisher.get_subscription_count() == 0:
            return
        self._has_subscribed = True
        self._node.create_subscription(TFMessage, '/tf_static', self._on_transforms, STATIC)
        for number in range(SONARS_COUNT):
            self._node.create_subscription(Range, f'sonar_{number}', self._on_range, WATCH)

    def _on_transforms(self, message: TFMessage) -> None:
        add_transforms(self._tree, message)

    def _on_range(self, message: Range) -> None:
        """Add a range, and publish the plot if it is due and has a subscriber."""
        base = self._node.frames.known_base
        try:
            mount = None if base is None else self._tree.mount_of(message.header.frame_id, base)
        except UnusableMount as error:
            self._node.diagnostics.refuse(message.header.frame_id, str(error))
            return
        if mount is None:
            return  # not known yet
        cells = self._stage.core
        self._grid.add(
            cells.peak, cells.lengths.cell_m, Pose(mount.x_m, mount.y_m, mount.yaw_rad),
            float(message.field_of_view),
            float(message.range) if message.range <= message.max_range else math.inf,
        )
        now_s = time.monotonic()
        if now_s >= self._next_s and self._publisher.get_subscription_count() > 0:
            self._next_s = now_s + PERIOD_S
            # In cells, which are centred at whole numbers, as those of pose_cells/cells.
            picture = Picture(-0.5, -0.5, 1.0, self._grid.percent())
            self._publisher.publish(
                grid_message(picture, stamp_ns(message.header), 'pose_cells')
            )
