# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Prediction of the actions that the nodes publish, for playback in lockstep."""

from __future__ import annotations

from ratslam_ros.core.common.odometry import MotionFromOdometry
from ratslam_ros.event_inputs import odometry_from_event
from ratslam_ros.pipeline.order import Released, StampOrder
from ratslam_ros.recordings import Event, ImageEvent, OdometryEvent, ScanEvent

UNLIMITED_NS = 2**63
"""Bound on lateness. The bound of the nodes is unknown to the player; without one, only views
that the nodes process in any case are awaited."""


class Lockstep:
    """Predicts which views the nodes can process by now, with the stamp order that they use.

    pose_cells holds a view until odometry has reached its stamp, and images whose stamps do not
    increase are refused. The player must not wait for the actions of these.
    """

    def __init__(self, odometry_is_played: bool) -> None:
        """Start without messages.

        Args:
            odometry_is_played: False if visual_odometry estimates odometry from the images.
        """
        self._odometry_is_played = odometry_is_played
        self._images: StampOrder[None] = StampOrder(('image',), UNLIMITED_NS)
        self._order: StampOrder[None] = StampOrder(
            ('odometry', 'template'), UNLIMITED_NS, 'odometry'
        )
        self._accepts = [MotionFromOdometry(source).accepts for source in ('twist', 'pose')]
        self._previous_ns: int | None = None

    def publish(self, event: Event) -> list[int]:
        """Add a message before it is published.

        Returns:
            Stamps, in ns, of the views that pose_cells processes because of this message.
        """
        if isinstance(event, ImageEvent):
            images = _push(self._images, 'image', event.stamp_ns)
            return [stamp_ns for image in images for stamp_ns in self._image(image)]
        if isinstance(event, OdometryEvent):
            return self._odometry(event)
        if isinstance(event, ScanEvent):
            return []
        return self._push('template', event.stamp_ns)

    def _image(self, image: Released[None]) -> list[int]:
        processed = []
        if not self._odometry_is_played:
            # visual_odometry publishes nothing for the first image and for undecodable ones.
            # The previous view is released by the newest image in any case.
            if self._previous_ns is not None:
                processed = self._push('odometry', self._previous_ns)
            self._previous_ns = image.stamp_ns
        return processed + self._push('template', image.stamp_ns)

    def _odometry(self, event: OdometryEvent) -> list[int]:
        odometry = odometry_from_event(event)
        if not all(accepts(odometry) for accepts in self._accepts):
            return []
        return self._push('odometry', event.stamp_ns)

    def _push(self, stream: str, stamp_ns: int) -> list[int]:
        released = _push(self._order, stream, stamp_ns)
        return [message.stamp_ns for message in released if message.stream == 'template']


def _push(order: StampOrder[None], stream: str, stamp_ns: int) -> list[Released[None]]:
    released = order.push(stream, stamp_ns, None)
    # With --loop the stamps jump back, and the nodes start over.
    return [*released, *order.restart()] if order.jumped_back else released
