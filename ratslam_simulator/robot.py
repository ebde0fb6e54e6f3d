# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Differential-drive robot like a Pioneer, with wheel slip, calibration errors and encoders."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from ratslam_ros.core.common.pose import Pose


@dataclass(frozen=True)
class RobotOptions:
    """Properties of a differential drive and of its calibration errors.

    body_radius_m: radius of the body, which is round
    wheel_radius_error: relative difference between the wheel radii; its sign is drawn per run
    wheel_base_error: relative error of the wheel base; its sign is drawn per run
    slip_m: standard deviation of a wheel's slip after 1 m; it grows with the root of the distance
    """

    wheel_radius_m: float = 0.0825
    wheel_base_m: float = 0.33
    encoder_counts_per_turn: int = 2000
    body_radius_m: float = 0.22
    max_speed_mps: float = 1.6
    max_turn_rate_radps: float = 5.2
    max_acceleration_mps2: float = 0.4
    max_turn_acceleration_radps2: float = 1.5
    wheel_radius_error: float = 0.0022
    wheel_base_error: float = 0.025
    slip_m: float = 0.007


@dataclass(frozen=True)
class OdometryReading:
    """Wheel odometry: the integrated pose, and the mean speeds since the previous reading."""

    pose: Pose
    speed_mps: float
    turn_rate_radps: float


class Robot:
    """A robot's true motion and its encoders.

    Attributes:
        pose: true pose.
        speed_mps, turn_rate_radps: present speeds of the motors.
    """

    def __init__(self, start: Pose, rng: np.random.Generator, options: RobotOptions) -> None:
        self.pose = start
        self.speed_mps = 0.0
        self.turn_rate_radps = 0.0
        self._rng = rng
        self._options = options
        # At least half of the nominal error, so that odometry drifts in every run.
        sizes, signs = rng.uniform(0.5, 1.5, 2), rng.choice([-1.0, 1.0], 2)
        radius_error = options.wheel_radius_error * float(sizes[0] * signs[0])
        base_error = options.wheel_base_error * float(sizes[1] * signs[1])
        self._radii_m = (
            options.wheel_radius_m * (1 - radius_error / 2),
            options.wheel_radius_m * (1 + radius_error / 2),
        )
        self._base_m = options.wheel_base_m * (1 + base_error)
        self._angles_rad = [0.0, 0.0]

    def command(self, speed_mps: float, turn_rate_radps: float, duration_s: float) -> None:
        """Accelerate towards the commanded speeds, within the limits of the motors."""
        speed_mps = _clamp(speed_mps, self._options.max_speed_mps)
        turn_rate_radps = _clamp(turn_rate_radps, self._options.max_turn_rate_radps)
        limit_mps = self._options.max_acceleration_mps2 * duration_s
        limit_radps = self._options.max_turn_acceleration_radps2 * duration_s
        self.speed_mps += _clamp(speed_mps - self.speed_mps, limit_mps)
        self.turn_rate_radps += _clamp(turn_rate_radps - self.turn_rate_radps, limit_radps)

    def move(self, duration_s: float) -> None:
        """Drive for some time at the present speeds."""
        options = self._options
        around_mps = self.turn_rate_radps * options.wheel_base_m / 2
        rolled_m = [0.0, 0.0]
        for wheel, side in enumerate((-1.0, 1.0)):
            turned_rad = (self.speed_mps + side * around_mps) / options.wheel_radius_m * duration_s
            self._angles_rad[wheel] += turned_rad
            ground_m = turned_rad * self._radii_m[wheel]
            slip_m = options.slip_m * math.sqrt(abs(ground_m)) * float(self._rng.standard_normal())
            rolled_m[wheel] = ground_m + slip_m
        left_m, right_m = rolled_m
        self.pose = after_arc(
            self.pose, (left_m + right_m) / 2, (right_m - left_m) / self._base_m
        )

    def encoder_counts(self) -> tuple[int, int]:
        """Return the counts of the left and the right encoder."""
        counts_per_rad = self._options.encoder_counts_per_turn / math.tau
        left, right = (math.floor(angle_rad * counts_per_rad) for angle_rad in self._angles_rad)
        return left, right


class WheelOdometry:
    """Integrates encoder counts with the nominal wheel radius and wheel base."""

    def __init__(self, options: RobotOptions) -> None:
        self._options = options
        self._counts = (0, 0)
        self._pose = Pose(0.0, 0.0, 0.0)

    def update(self, counts: tuple[int, int], duration_s: float) -> OdometryReading:
        """Integrate the counts since the previous update, ``duration_s`` ago."""
        options = self._options
        m_per_count = math.tau * options.wheel_radius_m / options.encoder_counts_per_turn
        left_m = (counts[0] - self._counts[0]) * m_per_count
        right_m = (counts[1] - self._counts[1]) * m_per_count
        self._counts = counts
        distance_m, turn_rad = (left_m + right_m) / 2, (right_m - left_m) / options.wheel_base_m
        self._pose = after_arc(self._pose, distance_m, turn_rad)
        return OdometryReading(self._pose, distance_m / duration_s, turn_rad / duration_s)


def after_arc(pose: Pose, distance_m: float, turn_rad: float) -> Pose:
    """Return the pose at the end of an arc of constant curvature.

    Not the same as `core.common.odometry.moved`, from which it may differ in the last bit.

    Args:
        pose: start of the arc.
        distance_m: length of the arc, negative when driving backwards.
        turn_rad: change of heading along the arc, counter-clockwise positive.
    """
    half_rad = turn_rad / 2
    # sin(x) / x, by its series near 0: the ratio of the chord to the arc.
    shrink = math.sin(half_rad) / half_rad if abs(half_rad) > 1e-6 else 1 - half_rad**2 / 6
    chord_m = distance_m * shrink
    return Pose(
        pose.x_m + chord_m * math.cos(pose.heading_rad + half_rad),
        pose.y_m + chord_m * math.sin(pose.heading_rad + half_rad),
        math.remainder(pose.heading_rad + turn_rad, math.tau),
    )


def _clamp(value: float, limit: float) -> float:
    return min(max(value, -limit), limit)
