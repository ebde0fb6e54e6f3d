# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Wall following: local movement, side -> Command; what exploring and going to goals share."""

from __future__ import annotations

import math

from ratslam_ros.core.local_movement import Behaviour, LocalMovement, Option
from ratslam_ros.core.movement_config import GoalFollowerParameters
from ratslam_ros.core.steering import Command, drive, turn

NOT_BESIDE_RAD = math.radians(50.0)
"""Out of a dead end the robot turns until something opens no further to its side than this."""


class WallFollowing:
    """Follows a wall in the same lane, whoever asks.

    A camera knows a way again where it was learned: the robot must come back along it as it came
    then, round corners and through doors.
    """

    def __init__(self, parameters: GoalFollowerParameters) -> None:
        self._p = parameters
        self._dead_end = False

    def restart(self) -> None:
        """Forget where the wall led."""
        self._dead_end = False

    def way_on(self, movement: LocalMovement, side: Behaviour) -> Option | None:
        """Return the way on along the wall on that side, None where it ends in a dead end."""
        found = [option for option in movement.options() if option.behaviour == side]
        if self._dead_end:  # by what opens beside it, it would turn to and fro for ever
            found = [option for option in found if abs(option.heading_rad) < NOT_BESIDE_RAD]
        self._dead_end = not found
        return found[0] if found else None

    def along(self, movement: LocalMovement, side: Behaviour, option: Option | None) -> Command:
        """Return how to take a way on, or how to turn away from the wall until one opens."""
        if option is not None:
            return drive(movement, option, self._p)
        return turn(-math.pi / 2 if side == 'left_wall' else math.pi / 2, self._p)
