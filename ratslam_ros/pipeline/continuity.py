# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""What a restarted node has lost of a regular stream, recognised by the stamps."""

from __future__ import annotations

from collections.abc import Iterable
from itertools import pairwise
from statistics import median

NEW_COUNT = 5
"""Number of messages after the restart by which a stream is judged: enough for its usual step."""

MIN_STEPS = 3
"""Smallest number of steps that have a usual one."""

LOST_RATIO = 1.5
"""Step, relative to the usual one, from which on a message must be missing: without one, the
step doubles."""


LATE_NS = 30_000_000_000
"""Messages this much older than the restored state belong to a recording that was started again,
also after an interruption."""


def begins_session(
    stamp_ns: int, cut_ns: int, max_gap_ns: int, was_interrupted: bool
) -> bool:
    """Return whether a first message does not follow a restored state.

    Args:
        stamp_ns: stamp of the message.
        cut_ns: stamp of the state.
        max_gap_ns: longest time between the two.
        was_interrupted: whether messages may come late that belong before the state.
    """
    after_ns = stamp_ns - cut_ns
    if was_interrupted and -LATE_NS < after_ns <= 0:
        return False
    return not 0 < after_ns <= max_gap_ns


def gaps(stamps_ns: Iterable[int]) -> list[tuple[int, int]]:
    """Return the pairs of successive stamps between which messages are missing, in ns."""
    ordered = sorted(set(stamps_ns))
    steps_ns = [b - a for a, b in pairwise(ordered)]
    if len(steps_ns) < MIN_STEPS:
        return []
    limit_ns = LOST_RATIO * median(steps_ns)
    return [(a, b) for a, b in pairwise(ordered) if b - a > limit_ns]


class Continuity:
    """The stamps of a stream before an interruption of its receiver, and after it.

    Inputs come at regular times, and few sources send them again.
    """

    def __init__(self, known_ns: list[int]) -> None:
        """Begin with the stamps of the messages that were received before."""
        self._stamps_ns = known_ns
        self._new_count = 0

    @property
    def has_new(self) -> bool:
        """Whether a message has arrived since the restart."""
        return self._new_count > 0

    @property
    def last_ns(self) -> int:
        """The newest stamp, 0 if there is none."""
        return max(self._stamps_ns, default=0)

    def add(self, stamp_ns: int) -> bool:
        """Add a message after the restart; return whether there are enough of them."""
        self._stamps_ns.append(stamp_ns)
        self._new_count += 1
        return self._new_count >= NEW_COUNT

    def lost(self) -> tuple[int, int] | None:
        """Return between which stamps messages are missing, in ns; None if none are."""
        found = gaps(self._stamps_ns)
        return (found[0][0], found[-1][1]) if found else None
