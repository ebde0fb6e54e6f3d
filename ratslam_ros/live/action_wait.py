# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Waiting for the actions of pose_cells, for playback in lockstep."""

from __future__ import annotations

import time
from collections import deque
from typing import Any

import rclpy
from std_msgs.msg import String

from ratslam_ros.console import print_notice
from ratslam_ros.errors import UnusableInput
from ratslam_ros.live.lockstep import Lockstep
from ratslam_ros.recordings import Event, OdometryEvent
from ratslam_ros.ros.convert import stamp_of
from ratslam_ros.ros.qos import INPUT
from ratslam_ros.starting import starting

ACTION = 'pose_cells/action'
ACTION_TIMEOUT_S = 10.0
EARLY_COUNT = 10
"""Number of actions that may arrive before they are awaited; usually it is one."""

MAX_LEAD_NS = 1_000_000_000
"""Lead of odometry over an action that is awaited: half of the default max_lateness_s."""


class ActionWait:
    """Subscription to the actions, which blocks playback until the expected ones arrived."""

    def __init__(self, node: Any, odometry_is_played: bool) -> None:
        """Subscribe to the actions.

        Args:
            node: the node of the player.
            odometry_is_played: False if visual_odometry estimates odometry from the images.
        """
        self.missed = 0
        """Number of actions that did not arrive in time."""
        self._node = node
        self._lockstep = Lockstep(odometry_is_played)
        self._awaited: set[int] = set()
        self._early: deque[int] = deque(maxlen=EARLY_COUNT)
        """Stamps of actions that arrived before they were awaited: visual_odometry may release a
        view at once, but is sure to do so only at the next image."""
        node.create_subscription(String, ACTION, self._receive, INPUT)

    def add(self, event: Event) -> None:
        """Add the actions that an event causes; call it before the event is published."""
        for stamp_ns in self._lockstep.publish(event):
            if stamp_ns in self._early:
                self._early.remove(stamp_ns)
            else:
                self._awaited.add(stamp_ns)

    def wait_before(self, event: Event) -> None:
        """Wait for all actions that must arrive before an event is published.

        Raises:
            UnusableInput: pose_cells has ended.
        """
        self.wait(event.stamp_ns - MAX_LEAD_NS if isinstance(event, OdometryEvent) else None)

    def wait(self, before_ns: int | None = None) -> None:
        """Wait for the actions of all views that the nodes can process.

        Args:
            before_ns: wait only for views with smaller stamps.

        Raises:
            UnusableInput: pose_cells has ended.
        """
        end_s = time.monotonic() + ACTION_TIMEOUT_S
        while awaited := [s for s in self._awaited if before_ns is None or s < before_ns]:
            rclpy.spin_once(self._node, timeout_sec=0.1)
            if starting():  # actions take longer
                end_s = time.monotonic() + ACTION_TIMEOUT_S
            if time.monotonic() < end_s:
                continue
            topic = self._node.resolve_topic_name(ACTION)
            if not self._node.count_publishers(topic):
                raise UnusableInput('--lockstep: pose_cells has ended; start the nodes again')
            if not self.missed:
                print_notice(
                    f'warning: no {topic} for the image with stamp {min(awaited) * 1e-9:.3f} s '
                    f'within {ACTION_TIMEOUT_S:g} s; going on'
                )
            self.missed += len(awaited)
            self._awaited.difference_update(awaited)

    def _receive(self, message: String) -> None:
        stamp_ns = stamp_of(message)
        if not stamp_ns:
            return  # experience_map reports malformed messages.
        if stamp_ns in self._awaited:
            self._awaited.remove(stamp_ns)
        else:
            self._early.append(stamp_ns)
