# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""LaserScan messages as scans in the frame of the robot, wherever the laser is mounted."""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Any

from rclpy.node import Node
from sensor_msgs.msg import LaserScan
from tf2_msgs.msg import TFMessage

from ratslam_ros.core.common.mount import CENTRED, FrameTree, Mount, UnusableMount
from ratslam_ros.core.common.scan import Scan, UnusableScan, checked_scan
from ratslam_ros.ros.convert import stamp_ns
from ratslam_ros.ros.mapping.odometry_frames import BASE_FRAME
from ratslam_ros.ros.qos import STATE, STATIC

MOUNT_TIMEOUT_S = 2.0
"""Time to wait for the transform of a laser. Publishers on /tf_static are found within 1 s; those
of ROS 1 habits repeat the transform on /tf at 10 Hz or more."""

MAX_WAITING = 200
"""Scans that are kept while the transform is awaited: 2 s of a laser at 100 Hz."""


class ScanInput:
    """Converts scans once it is known from /tf_static or /tf where the laser is mounted.

    Scans that arrive before are kept. A laser without a transform is taken to sit at the centre
    of the robot and to look ahead, with a warning.
    """

    def __init__(
        self,
        node: Node,
        warn: Callable[[str], None],
        base_frame: Callable[[], str | None],
        refuse: Callable[[str, str], None],
        use: Callable[[Scan], None],
    ) -> None:
        """Subscribe to the transforms.

        Args:
            node: the node.
            warn: called with a text for the user if a transform is missing.
            base_frame: returns the frame of the robot; None while it is unknown.
            refuse: called with the stream and the reason if a scan is unusable.
            use: called with each scan, in order.
        """
        self._node, self._warn = node, warn
        self._base_frame, self._refuse, self._use = base_frame, refuse, use
        self._tree = FrameTree()
        self._mounts: dict[str, Mount] = {}
        """The known mounts by frame."""
        self._waiting: list[LaserScan] = []
        self._waiting_since_s = 0.0
        self._subscriptions: dict[str, Any] = {
            topic: node.create_subscription(TFMessage, topic, self._on_transforms, qos)
            for topic, qos in (('/tf_static', STATIC), ('/tf', STATE))
        }

    def receive(self, message: LaserScan) -> None:
        """Use a scan, or keep it until the place of its laser is known."""
        if not self._waiting:
            self._waiting_since_s = time.monotonic()
        elif len(self._waiting) >= MAX_WAITING:
            self._refuse('scan', 'too many scans wait for the transform of the laser')
            return
        self._waiting.append(message)
        self.update()

    def close(self) -> None:
        """End the subscriptions."""
        for subscription in self._subscriptions.values():
            self._node.destroy_subscription(subscription)
        self._subscriptions.clear()

    def update(self) -> None:
        """Use the scans whose transform has come, or which have waited for too long."""
        while self._waiting and self._try(self._waiting[0], self._base_frame()):
            del self._waiting[0]
        if not self._waiting or time.monotonic() - self._waiting_since_s < MOUNT_TIMEOUT_S:
            return
        # Odometry that has not come has not named the frame of the robot.
        frame, base = self._waiting[0].header.frame_id, self._base_frame() or BASE_FRAME
        if self._try(self._waiting[0], base):
            del self._waiting[0]
        else:
            self._mounts[frame] = CENTRED
            self._warn(
                f'there is no transform from {base} to {frame} on /tf_static or /tf: the laser is '
                "taken to sit at the robot's centre and to look ahead. If it does not: ros2 run "
                f'tf2_ros static_transform_publisher --x 0.1 --yaw 0 --frame-id {base} '
                f'--child-frame-id {frame}'
            )
        self._waiting_since_s = time.monotonic()
        self.update()

    def _try(self, message: LaserScan, base: str | None) -> bool:
        """Use or refuse a scan; return False if the place of its laser is not known yet."""
        frame = message.header.frame_id
        try:
            mount = self._mounts.get(frame)
            if mount is None and (base is not None or not frame):
                mount = self._tree.mount_of(frame, base or BASE_FRAME)
            if mount is None:
                return False
            self._mounts[frame] = mount
            self._use(scan_from_message(message, mount))
        except (UnusableMount, UnusableScan) as error:
            self._refuse('scan', str(error))
        return True

    def _on_transforms(self, message: TFMessage) -> None:
        add_transforms(self._tree, message)
        self.update()
        if self._mounts and not self._waiting and '/tf' in self._subscriptions:
            # The transforms of a moving robot are many, and of no use here.
            self._node.destroy_subscription(self._subscriptions.pop('/tf'))


def add_transforms(tree: FrameTree, message: TFMessage) -> None:
    """Add the transforms of a message to the tree of frames."""
    for one in message.transforms:
        tree.add_stamped(one)


def scan_from_message(message: LaserScan, mount: Mount = CENTRED) -> Scan:
    """Convert a scan; raises UnusableScan."""
    return checked_scan(
        stamp_ns(message.header),
        float(message.angle_min),
        float(message.angle_increment),
        float(message.range_min),
        float(message.range_max),
        message.ranges,
        mount,
    )
