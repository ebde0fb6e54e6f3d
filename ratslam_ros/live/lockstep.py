# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Which actions must have come before a recording may go on."""

from __future__ import annotations

from ratslam_ros.core.common.odometry import MotionFromOdometry, Odometry, Twist
from ratslam_ros.core.common.pose import Pose
from ratslam_ros.core.common.stamp_order import Released, StampOrder
from ratslam_ros.recordings import Event, ImageEvent, OdometryEvent, ScanEvent

NEVER_NS = 2**63  # the nodes' own bound on lateness is not known here, and waits need none


class Lockstep:
    """Tells, by the order rule that the nodes follow, which views they can act on by now.

    pose_cells holds a view until odometry has reached its stamp, and images whose stamps do not
    increase are refused: to wait for the action of either would be to wait in vain.
    """

    def __init__(self, odometry_is_played: bool) -> None:
        """Begin; without played odometry, visual_odometry makes it from the images."""
        self._odometry_is_played = odometry_is_played
        self._images: StampOrder[None] = StampOrder(('image',), NEVER_NS)
        self._order: StampOrder[None] = StampOrder(('odometry', 'template'), NEVER_NS)
        self._usable = [MotionFromOdometry(source).accepts for source in ('twist', 'pose')]
        self._before_ns: int | None = None

    def publish(self, event: Event) -> list[int]:
        """Note a message that goes out; return the stamps of the actions that it makes certain."""
        if isinstance(event, ImageEvent):
            images = _push(self._images, 'image', event.stamp_ns)
            return [stamp for image in images for stamp in self._image(image)]
        if isinstance(event, OdometryEvent):
            return self._odometry(event)
        if isinstance(event, ScanEvent):
            return []
        return self._push('template', event.stamp_ns)

    def _image(self, image: Released[None]) -> list[int]:
        certain = []
        if not self._odometry_is_played:
            # The first image gives no odometry, nor does one that cannot be decoded; the view
            # before the newest is let go by the newest all the same.
            if self._before_ns is not None:
                certain = self._push('odometry', self._before_ns)
            self._before_ns = image.stamp_ns
        return certain + self._push('template', image.stamp_ns)

    def _odometry(self, event: OdometryEvent) -> list[int]:
        odometry = Odometry(
            event.stamp_ns,
            Twist(event.linear_x, event.angular_z),
            Pose(event.x, event.y, event.heading_rad),
        )
        if not all(usable(odometry) for usable in self._usable):
            return []
        return self._push('odometry', event.stamp_ns)

    def _push(self, stream: str, stamp_ns: int) -> list[int]:
        released = _push(self._order, stream, stamp_ns)
        return [message.stamp_ns for message in released if message.stream == 'template']


def _push(order: StampOrder[None], stream: str, stamp_ns: int) -> list[Released[None]]:
    released = order.push(stream, stamp_ns, None)
    # A recording played again: its stamps jump back, and the nodes follow.
    return [*released, *order.restart()] if order.jumped_back else released
