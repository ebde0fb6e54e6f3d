# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Relocations of the experience map, which the pose cells adopt a fixed number of views later.

The map relocates the robot after an action, and so after the view that the action resulted from.
Pose cells and map are separate processes. If the pose cells adopted a relocation when it arrived,
their state would depend on the time of arrival. They adopt it before the view that follows
``ADOPTION_DELAY`` views later, and process that view only once the map has answered.
"""

from __future__ import annotations

from collections import deque
from typing import NamedTuple

from ratslam_ros.core.common.odometry import Motion, moved
from ratslam_ros.core.common.pose import Pose, composed, inverse
from ratslam_ros.core.common.saved import MAX_COUNT, MAX_ID, Field, Saved

ADOPTION_DELAY = 4
"""Number of views between an action after which the map relocated the robot, and the view before
which the pose cells adopt it. A second at the rate of the papers' cameras, in which the map has
answered."""


class MapRelocation(NamedTuple):
    """A relocation by the map: an experience with its template, and the robot in its frame."""

    experience_id: int
    template_id: int
    offset: Pose


class RecentOdometry(Saved):
    """Poses by odometry at the last views."""

    SAVED = (
        Field('present/odometry', '_now', float, (3,), make=Pose),
        Field('present/at_views', '_at_views', float, ('', 3), make=Pose),
    )

    def __init__(self) -> None:
        self._now = Pose(0.0, 0.0, 0.0)
        self._at_views: deque[Pose] = deque(maxlen=ADOPTION_DELAY)

    def integrate(self, motion: Motion) -> None:
        """Add a known motion."""
        self._now = moved(self._now, motion)

    def view(self) -> None:
        """Record a view."""
        self._at_views.append(self._now)

    def interrupt(self) -> None:
        """Forget the last views: a motion is unknown."""
        self._at_views.clear()

    def carried(self, relocation: MapRelocation) -> Pose | None:
        """Return where the robot is now in the frame of the experience of a due relocation.

        None if the odometry had a gap since.
        """
        if len(self._at_views) < ADOPTION_DELAY:
            return None
        return composed(relocation.offset, composed(inverse(self._at_views[0]), self._now))


class MapRelocations(Saved):
    """Answers of the map to actions, by the number of the action."""

    SAVED = (
        Field('last', '_last', int, nullable=True),
        Field('relocations', '_relocations', float, ('', 6), -MAX_ID, MAX_COUNT,
              save=lambda found: [
                  (sequence, one.experience_id, one.template_id, *one.offset)
                  for sequence, one in found.items()
              ],
              load=lambda rows: {
                  sequence: MapRelocation(experience_id, template_id, Pose(*offset))
                  for sequence, experience_id, template_id, *offset in rows
              }),
    )

    def __init__(self) -> None:
        self._last: int | None = None
        self._relocations: dict[int, MapRelocation] = {}

    def answer(self, sequence: int, relocation: MapRelocation | None) -> None:
        """Record the answer of the map to an action; None if it did not relocate the robot."""
        # A restarted map answers earlier actions again.
        self._last = sequence if self._last is None else max(self._last, sequence)
        if relocation is not None:
            self._relocations[sequence] = relocation

    def await_after(self, sequence: int | None) -> None:
        """Await the answers to later actions; None: to none before the map has answered again."""
        self._last = sequence

    def is_awaited(self, sequence: int) -> bool:
        """Return whether a view must wait for the map; False if the map has never answered.

        Args:
            sequence: number of the action that the view will result in.
        """
        return self._last is not None and self._last < sequence - ADOPTION_DELAY

    def due(self, sequence: int) -> MapRelocation | None:
        """Return the relocation to adopt before the view with a number, if any."""
        return self._relocations.pop(sequence - ADOPTION_DELAY, None)
