# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Quality-of-service profiles of all topics, with their reasons."""

from __future__ import annotations

from rclpy.qos import DurabilityPolicy, HistoryPolicy, QoSProfile, ReliabilityPolicy

BEST_EFFORT, TRANSIENT_LOCAL = ReliabilityPolicy.BEST_EFFORT, DurabilityPolicy.TRANSIENT_LOCAL


def _profile(
    depth: int, reliability: ReliabilityPolicy = ReliabilityPolicy.RELIABLE,
    durability: DurabilityPolicy = DurabilityPolicy.VOLATILE,
) -> QoSProfile:
    """Return a profile of a queue of ``depth`` messages; 0: of all messages."""
    history = HistoryPolicy.KEEP_LAST if depth else HistoryPolicy.KEEP_ALL
    return QoSProfile(
        history=history, depth=depth, reliability=reliability, durability=durability
    )


INPUT = _profile(0)
"""Inputs of the map. A queue with a depth drops messages without notice, which would change the
map; KEEP_ALL does not. The nodes take messages from the queue at once."""

INPUT_BEST_EFFORT = _profile(0, BEST_EFFORT)
"""Inputs from best-effort publishers, such as many camera drivers: DDS counts lost messages."""

def history(depth: int) -> QoSProfile:
    """Return the profile of a topic that keeps its last messages for late subscribers."""
    return _profile(depth, durability=TRANSIENT_LOCAL)


RESULT = _profile(1000)
"""Results of nodes: no message may be lost between two nodes, but a reader that hangs must not
block the writer. 1000 messages are half a minute of images."""

HISTORY_INPUT = _profile(0, durability=TRANSIENT_LOCAL)
"""All messages that a publisher has kept, for a node that was restarted."""

LATCHED = _profile(1, durability=TRANSIENT_LOCAL)
"""Map, markers, route and status: a late subscriber gets the last message at once."""

VIEW = _profile(1)
"""Images for viewers, who need the newest only. Reliable, which is RViz's default."""

STATE = _profile(100)
"""Pose, TF and diagnostics, as their usual subscribers expect them; TF uses a depth of 100."""

STATIC = _profile(100, durability=TRANSIENT_LOCAL)
"""Transforms that do not change, as tf2_ros publishes them: each publisher sends its own once; and
commands, of which a late viewer gets the last ones."""

GOAL = _profile(10)
"""Goals and names: few messages, of which none may be lost."""

PLAYED = _profile(0)
"""Topics of `ratslam play`, which waits for slow readers so that no message is lost."""

CLOCK = _profile(1)
"""Simulated time: only the newest message matters, and the last one must arrive."""

WATCH = _profile(5, BEST_EFFORT)
"""Subscriptions of a viewer that needs only samples of a stream. Best effort is compatible with
all publishers, and never makes one of them wait."""
