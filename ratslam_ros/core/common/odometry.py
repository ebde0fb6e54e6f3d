# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Odometry: message -> Motion, by stamps alone."""

from __future__ import annotations

import copy
import math
from collections.abc import Iterable
from dataclasses import dataclass, replace
from typing import NamedTuple

from ratslam_ros.core.common.angles import wrap
from ratslam_ros.core.common.pose import Pose, heading_of, quaternion_of

MOST = 1e9
"""No robot is this fast (m/s, rad/s) or this far off (m); such a message is refused."""

LONGEST_GAP_NS = 60_000_000_000
"""After a longer time without odometry nobody knows where the robot went: that is no motion."""


class Twist(NamedTuple):
    """Forward speed and turn rate, counter-clockwise positive."""

    linear_x_mps: float
    angular_z_radps: float


@dataclass(frozen=True, slots=True)
class Odometry:
    """One odometry message: the twist over the time up to its stamp, and the pose if known."""

    stamp_ns: int
    twist: Twist
    pose: Pose

    def as_received(self) -> Odometry:
        """Return it with the heading that a receiver reads from the message's quaternion.

        It may differ in the last bit; live and offline must agree to that as well.
        """
        heading_rad = heading_of(0.0, 0.0, *quaternion_of(self.pose.heading_rad))
        return replace(self, pose=self.pose._replace(heading_rad=heading_rad))


@dataclass(frozen=True, slots=True)
class Motion:
    """What the robot did between two odometry messages, as an arc of constant curvature."""

    dt_s: float
    distance_m: float
    turn_rad: float

    @property
    def chord_m(self) -> float:
        """Length of the straight line between the arc's ends; negative when driving back."""
        return self.distance_m * sinc(0.5 * self.turn_rad)


class MotionFromOdometry:
    """Turn odometry messages into motions; the first message only sets the clock."""

    def __init__(self, odom_source: str) -> None:
        self._from_pose = odom_source == 'pose'
        self._last: Odometry | None = None

    def accepts(self, odometry: Odometry) -> bool:
        """Tell whether the part of a message that is used is finite and below any real speed."""
        used = odometry.pose if self._from_pose else odometry.twist
        return all(math.isfinite(value) and abs(value) <= MOST for value in used)

    def restart(self) -> None:
        """Take the next message for the first one: what lies between is no motion."""
        self._last = None

    def update(self, odometry: Odometry) -> Motion | None:
        """Return the motion since the message before; None for the first one, or after a gap.

        Twist n acts over (t[n-1], t[n]]. From poses: the arc that joins the two poses, seen in
        the robot's frame. Algorithm.md, Odometry input.
        """
        last, self._last = self._last, odometry
        if last is None:
            return None
        dt_s = (odometry.stamp_ns - last.stamp_ns) * 1e-9
        if odometry.stamp_ns - last.stamp_ns > LONGEST_GAP_NS:
            return None
        if not self._from_pose:
            v, w = odometry.twist
            return Motion(dt_s, v * dt_s, w * dt_s)
        turn = wrap(odometry.pose.heading_rad - last.pose.heading_rad)
        direction = last.pose.heading_rad + 0.5 * turn
        chord = (odometry.pose.x_m - last.pose.x_m) * math.cos(direction) + (
            odometry.pose.y_m - last.pose.y_m
        ) * math.sin(direction)
        return Motion(dt_s, chord / sinc(0.5 * turn), turn)

    def ahead(self, waiting: Iterable[Odometry], offset: Pose) -> Pose:
        """Return where messages that still wait for their turn will lead; takes none of them."""
        motion_of = copy.copy(self)
        for odometry in waiting:
            motion = motion_of.update(odometry)
            if motion is not None:
                offset = moved(offset, motion)
        return offset


def sinc(x: float) -> float:
    """Return sin(x) / x, and 1 at 0."""
    return math.sin(x) / x if abs(x) > 1e-8 else 1.0


def moved(pose: Pose, motion: Motion) -> Pose:
    """Return the pose after a motion along the exact arc."""
    direction = pose.heading_rad + 0.5 * motion.turn_rad
    chord = motion.chord_m
    return Pose(
        pose.x_m + chord * math.cos(direction),
        pose.y_m + chord * math.sin(direction),
        wrap(pose.heading_rad + motion.turn_rad),
    )
