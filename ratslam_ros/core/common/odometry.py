# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Convert odometry messages to motions; time intervals are differences of stamps."""

from __future__ import annotations

import copy
import math
from collections.abc import Iterable
from dataclasses import dataclass, replace
from typing import NamedTuple

from ratslam_ros.core.common.angles import wrap
from ratslam_ros.core.common.pose import Pose, heading_of, quaternion_of
from ratslam_ros.core.common.saved import MAX_STAMP_NS, Field, Saved
from ratslam_ros.core.common.turn_correction import UNCORRECTED, TurnCorrection

MAX_PLAUSIBLE_VALUE = 1e9
"""Messages with a larger speed (m/s, rad/s), position (m) or heading (rad) are rejected."""

MAX_GAP_NS = 60_000_000_000
"""Longest interval between two messages over which a motion is ever computed."""


class Twist(NamedTuple):
    """Forward speed, turn rate, counter-clockwise positive, and speed to the left."""

    linear_x_mps: float
    angular_z_radps: float
    linear_y_mps: float = 0.0


@dataclass(frozen=True, slots=True)
class Odometry:
    """One odometry message.

    ``twist`` applies to the interval that ends at ``stamp_ns``; ``pose`` is in the odometry frame.
    ``scale_known``: False for odometry from images, whose speed is in arbitrary units and whose
    turns depend on the field of view.
    """

    stamp_ns: int
    twist: Twist
    pose: Pose = Pose(0.0, 0.0, 0.0)
    scale_known: bool = True

    def as_received(self) -> Odometry:
        """Return this message as a subscriber receives it, its heading converted by quaternion.

        The conversion may change the last bit of the heading. Offline runs apply it as well, so
        that they are bit-identical to live runs.
        """
        heading_rad = heading_of(0.0, 0.0, *quaternion_of(self.pose.heading_rad))
        return replace(self, pose=self.pose._replace(heading_rad=heading_rad))


@dataclass(frozen=True, slots=True)
class Motion:
    """Motion of the robot between two odometry messages: an arc of constant curvature.

    ``distance_m`` is the arc length, negative when driving backwards. ``is_known``: False if the
    odometry had a gap, after which the robot may be anywhere; distance and turn are 0 then.
    ``course_rad``: direction of travel relative to the heading, from -pi/2 to pi/2; 0 unless the
    robot is omnidirectional. ``scale_known``: see ``Odometry``.
    """

    dt_s: float
    distance_m: float
    turn_rad: float
    is_known: bool = True
    course_rad: float = 0.0
    scale_known: bool = True

    @property
    def chord_m(self) -> float:
        """Length of the chord of the arc; negative when driving backwards."""
        return self.distance_m * _sinc(0.5 * self.turn_rad)

    def corrected(self, correction: TurnCorrection) -> Motion:
        """Return the motion with a correction of its turn."""
        if correction == UNCORRECTED:
            return self
        return replace(self, turn_rad=correction.corrected(self.turn_rad, self.distance_m))


def odometry_state(odometry: Odometry) -> list[int | float | bool]:
    """Return a message for a saved state."""
    v, w, sideways = odometry.twist
    optional = [sideways] if sideways else []
    return [odometry.stamp_ns, v, w, *odometry.pose, odometry.scale_known, *optional]


def odometry_from_state(values: list[int | float | bool]) -> Odometry:
    """Return a message from ``odometry_state``."""
    stamp_ns, v, w, x, y, heading, scale_known, *sideways = values
    twist = Twist(v, w, *sideways)
    return Odometry(int(stamp_ns), twist, Pose(x, y, heading), bool(scale_known))


class MotionFromOdometry(Saved):
    """Conversion of successive odometry messages to motions.

    ``odom_source`` is ``'twist'`` or ``'pose'``: the part of the messages that is used. After an
    interval longer than ``max_gap_s`` the motion is unknown. If that is ``MAX_GAP_NS``, the robot
    is assumed to have been stationary in longer intervals.
    """

    SAVED = (
        Field('last', '_last', float, ('',), -MAX_STAMP_NS, MAX_STAMP_NS, save=odometry_state,
              load=odometry_from_state, nullable=True,
              fits=('7 or 8 numbers', lambda last, _: 7 <= len(last) <= 8)),
        Field('correction', 'correction', float, (2,), make=TurnCorrection),
    )

    def __init__(
        self, odom_source: str, max_gap_s: float = MAX_GAP_NS * 1e-9,
        correction: TurnCorrection = UNCORRECTED,
    ) -> None:
        self.source = odom_source
        """Part of the messages that is used: 'twist' or 'pose'."""
        self._max_gap_ns = round(max_gap_s * 1e9)
        self.correction = correction
        """Correction of the turns of the messages that follow."""
        self._last: Odometry | None = None

    def accepts(self, odometry: Odometry) -> bool:
        """Return whether the used part of a message is finite and plausible."""
        used = odometry.pose if self.source == 'pose' else odometry.twist
        return all([abs(value) <= MAX_PLAUSIBLE_VALUE for value in used])  # False for NaN, too

    def restart(self) -> None:
        """Treat the next message as the first one: no motion is computed for the gap before it."""
        self._last = None

    def reaches(self, stamp_ns: int) -> bool:
        """Return whether a stamp is close enough to the last message for the motion to be known.

        Always True if unknown motions are switched off, and before the first message.
        """
        if self._last is None or self._max_gap_ns >= MAX_GAP_NS:
            return True
        return stamp_ns - self._last.stamp_ns <= self._max_gap_ns

    def update(self, odometry: Odometry) -> Motion | None:
        """Return the motion since the previous message.

        Twist n applies to the interval (t[n-1], t[n]]. With poses, the motion is the arc between
        the two poses in the robot's frame (docs/algorithm.md, "Odometry"), and sideways only if
        the twist is: the poses of other robots are noisy.

        Returns:
            The motion, or None if the robot is assumed not to have moved: for the first message,
            and after a gap if unknown motions are switched off.
        """
        last, self._last = self._last, odometry
        if last is None:
            return None
        dt_s = (odometry.stamp_ns - last.stamp_ns) * 1e-9
        if odometry.stamp_ns - last.stamp_ns > self._max_gap_ns:
            return Motion(dt_s, 0.0, 0.0, False) if self._max_gap_ns < MAX_GAP_NS else None
        if self.source == 'pose':
            turn = wrap(odometry.pose.heading_rad - last.pose.heading_rad)
            direction = last.pose.heading_rad + 0.5 * turn
            dx, dy = odometry.pose.x_m - last.pose.x_m, odometry.pose.y_m - last.pose.y_m
            per_chord = _sinc(0.5 * turn)
            ahead = (dx * math.cos(direction) + dy * math.sin(direction)) / per_chord
            left = (dy * math.cos(direction) - dx * math.sin(direction)) / per_chord
            left = left if odometry.twist.linear_y_mps else 0.0
        else:
            v, w, sideways = odometry.twist
            ahead, left, turn = v * dt_s, sideways * dt_s, w * dt_s
        return _motion(dt_s, ahead, left, turn, odometry.scale_known).corrected(self.correction)

    def ahead(self, waiting: Iterable[Odometry], offset: Pose) -> Pose:
        """Return ``offset`` moved on by queued messages, without changing this object.

        Args:
            waiting: messages that have not been passed to ``update`` yet, in order.
            offset: pose after the last message passed to ``update``.
        """
        motion_of = copy.copy(self)
        for odometry in waiting:
            motion = motion_of.update(odometry)
            if motion is not None:
                offset = moved(offset, motion)
        return offset


def _motion(
    dt_s: float, ahead_m: float, left_m: float, turn_rad: float, scale_known: bool
) -> Motion:
    """Return the motion along an arc whose tangent has two components in the robot's frame."""
    if not left_m:
        return Motion(dt_s, ahead_m, turn_rad, scale_known=scale_known)
    sign = -1.0 if ahead_m < 0.0 else 1.0
    course_rad = math.atan2(sign * left_m, sign * ahead_m)
    distance_m = sign * math.hypot(ahead_m, left_m)
    return Motion(dt_s, distance_m, turn_rad, True, course_rad, scale_known)


def _sinc(x: float) -> float:
    """Return sin(x) / x, with the limit 1 at x = 0."""
    return math.sin(x) / x if abs(x) > 1e-8 else 1.0


def moved(pose: Pose, motion: Motion) -> Pose:
    """Return ``pose`` after ``motion``, integrated exactly along the arc."""
    direction = pose.heading_rad + 0.5 * motion.turn_rad + motion.course_rad
    chord = motion.chord_m
    return Pose(
        pose.x_m + chord * math.cos(direction),
        pose.y_m + chord * math.sin(direction),
        wrap(pose.heading_rad + motion.turn_rad),
    )
