# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Waiting for the actions of pose_cells and for experience_map, for playback in lockstep."""

from __future__ import annotations

import time
from collections import deque
from typing import Any

import rclpy
from geometry_msgs.msg import PoseStamped
from std_msgs.msg import String

from ratslam_ros.console import print_notice
from ratslam_ros.errors import UnusableInput
from ratslam_ros.live.lockstep import Lockstep
from ratslam_ros.recordings import Event, OdometryEvent
from ratslam_ros.ros.convert import stamp_of
from ratslam_ros.ros.qos import INPUT, STATE
from ratslam_ros.starting import starting

ACTION, POSE = 'pose_cells/action', 'experience_map/pose'
ACTION_TIMEOUT_S = 10.0
POSE_TIMEOUT_S = 2.0
"""Longest wait for a pose. Without it, only a loaded machine is disturbed, and a node that was
restarted does not publish all of them again."""

DELIVERY_SPREAD_S = 0.05
"""Largest expected difference between the times at which two subscribers receive an action."""

EARLY_COUNT = 10
"""Number of actions that may arrive before they are awaited; usually it is one."""

MAX_LEAD_NS = 1_000_000_000
"""Lead of a published stamp over an action in delivery, and over the odometry that experience_map
has received: half of the default max_lateness_s."""

POLL_S = 0.002


class ActionWait:
    """Subscription to the actions, which blocks playback until the expected ones arrived.

    experience_map must receive an action before odometry whose stamp is later by max_lateness_s.
    It receives the action from pose_cells at about the same time as this node; a difference of
    DELIVERY_SPREAD_S is allowed for.

    It must not fall behind either. Its executor takes one message of each topic in turn: of those
    that wait, actions, which are fewer, would soon be far ahead of the odometry. Therefore its
    poses are awaited too, which it publishes when it receives odometry.
    """

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
        self._received: deque[tuple[int, float]] = deque()
        node.create_subscription(String, ACTION, self._receive, INPUT)
        node.create_subscription(PoseStamped, POSE, self._receive_pose, STATE)

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
        limit_ns = event.stamp_ns - MAX_LEAD_NS
        self._wait_for_poses(limit_ns)
        self.wait(limit_ns if isinstance(event, OdometryEvent) else None)
        while any(stamp_ns < limit_ns for stamp_ns, _ in self._in_delivery()):
            time.sleep(POLL_S)

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

    def _wait_for_poses(self, before_ns: int) -> None:
        """Wait until experience_map has received the odometry before a stamp."""
        waiting, end_s = self._lockstep.odometry, time.monotonic() + POSE_TIMEOUT_S
        while waiting and waiting[0] < before_ns:
            if not self._node.count_publishers(self._node.resolve_topic_name(POSE)):
                waiting.clear()
                return
            rclpy.spin_once(self._node, timeout_sec=0.1)
            if time.monotonic() >= end_s and not starting():
                waiting.clear()

    def _receive_pose(self, message: PoseStamped) -> None:
        reached_ns, waiting = stamp_of(message), self._lockstep.odometry
        while waiting and waiting[0] <= reached_ns:
            waiting.popleft()

    def _in_delivery(self) -> deque[tuple[int, float]]:
        """Return stamp and arrival of actions that other subscribers may not have received."""
        now_s = time.monotonic()
        while self._received and now_s - self._received[0][1] > DELIVERY_SPREAD_S:
            self._received.popleft()
        return self._received

    def _receive(self, message: String) -> None:
        stamp_ns = stamp_of(message)
        if not stamp_ns:
            return  # experience_map reports malformed messages.
        if stamp_ns in self._awaited:
            self._awaited.remove(stamp_ns)
        else:
            self._early.append(stamp_ns)
        self._received.append((stamp_ns, time.monotonic()))
