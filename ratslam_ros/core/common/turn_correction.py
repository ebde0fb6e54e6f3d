# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Correction of systematic errors of the turns that odometry measures."""

from __future__ import annotations

from typing import NamedTuple


class TurnCorrection(NamedTuple):
    """Correction of measured turns: ``gain`` times the turn, plus ``per_m_rad`` per metre."""

    gain: float = 1.0
    per_m_rad: float = 0.0

    def corrected(self, turn_rad: float, distance_m: float) -> float:
        """Return the turn of a motion of which ``turn_rad`` was measured."""
        return self.gain * turn_rad + self.per_m_rad * distance_m

    def measured(self, turn_rad: float, distance_m: float) -> float:
        """Return the measured turn of a motion whose corrected turn is ``turn_rad``."""
        return (turn_rad - self.per_m_rad * distance_m) / self.gain

    @property
    def inverse(self) -> TurnCorrection:
        """The correction that undoes this one."""
        return TurnCorrection(1.0 / self.gain, -self.per_m_rad / self.gain)

    def after(self, first: TurnCorrection) -> TurnCorrection:
        """Return another correction followed by this one."""
        return TurnCorrection(
            self.gain * first.gain, self.gain * first.per_m_rad + self.per_m_rad
        )


UNCORRECTED = TurnCorrection()
