# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Publishers of ``experience_map/changes`` and ``experience_map/closures``."""

from __future__ import annotations

import time
from collections.abc import Iterable

from ratslam_ros.core.mapping.loop_closure_gate import ClosureEvent
from ratslam_ros.core.mapping.map_changes import MapChangeTracker
from ratslam_ros.messages.map_changes import ClosurePayload, MapChangePayload
from ratslam_ros.pipeline.live_stages import LiveExperienceMap
from ratslam_ros.ros.node import RatslamNode
from ratslam_ros.ros.qos import STATE

CHANGE_PERIOD_S = 0.1
"""Shortest time between two changes."""

MAX_ITEMS = 500
"""Largest number of experiences and links in a change: comparing and encoding them takes 1 to
3 ms. After a loop closure that moves 20,000 experiences, all are sent within 4 s."""


class MapChangePublisher:
    """Publishes the changes of the map while there are subscribers."""

    def __init__(self, node: RatslamNode, stage: LiveExperienceMap) -> None:
        """Create the topics and the service of the node of the map."""
        self._stage, self._frame_id = stage, node.section.map_frame
        self._changes = node.create_payload_publisher(MapChangePayload, STATE)
        self._closures = node.create_payload_publisher(ClosurePayload, STATE)
        node.offer('experience_map/send_all', self._on_send_all)
        self._tracker = MapChangeTracker()
        self._viewers = self._sequence = 0
        self._sender = time.time_ns()
        self._next_s = 0.0
        self._last: tuple[int, int] | None = None

    def publish_closures(
        self, stamp_ns: int, sequence: int, events: Iterable[ClosureEvent]
    ) -> None:
        """Publish the events of the action with a stamp and a number."""
        for event in events:
            if self._closures.get_subscription_count() > 0:
                self._closures.publish(ClosurePayload.of(stamp_ns, sequence, event))

    def update(self) -> bool:
        """Publish the next change if it is due; return whether the map was compared for it."""
        now_s = time.monotonic()
        if now_s < self._next_s:
            return False
        self._next_s = now_s + CHANGE_PERIOD_S
        viewers = self._changes.get_subscription_count()
        if viewers > self._viewers:
            self._tracker.restart()
        self._viewers = viewers
        if viewers == 0:
            return False
        change = self._tracker.next_change(self._stage.core, self._stage.action_ns, MAX_ITEMS)
        now = change.stamp_ns, change.current_id
        if not len(change) and not change.is_restart and now == self._last:
            return True
        self._last = now
        payload = MapChangePayload.of(change, self._sequence, self._sender, self._frame_id)
        self._changes.publish(payload)
        self._sequence += 1
        return True

    def _on_send_all(self) -> str:
        self._tracker.restart()
        return f'the whole map follows on {MapChangePayload.TOPIC}'
