# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
import math

import numpy as np
import pytest

from ratslam_ros.core.common.pose import Pose
from ratslam_simulator.robot import Robot, RobotOptions, WheelOdometry, after_arc

EXACT = RobotOptions(
    wheel_radius_error=0.0, wheel_base_error=0.0, slip_m=0.0, encoder_counts_per_turn=10**9
)
START = Pose(0.0, 0.0, 0.0)


def drive(options, seed=0, steps=2400):
    """Drive a figure of eight for two minutes; return the true pose and the odometry reading."""
    robot = Robot(START, np.random.Generator(np.random.PCG64(seed)), options)
    odometry = WheelOdometry(options)
    report = odometry.update(robot.encoder_counts(), 0.05)
    for step in range(steps):
        robot.command(0.5, math.copysign(0.4, math.sin(step / 100)), 0.05)
        robot.move(0.025)
        robot.move(0.025)
        report = odometry.update(robot.encoder_counts(), 0.05)
    return robot.pose, report


def distance_m(a, b):
    return math.hypot(a.x_m - b.x_m, a.y_m - b.y_m)


def test_after_arc_matches_closed_form():
    quarter = after_arc(START, math.pi / 2, math.pi / 2)
    assert (quarter.x_m, quarter.y_m) == pytest.approx((1.0, 1.0), abs=1e-12)
    assert quarter.heading_rad == pytest.approx(math.pi / 2)
    straight = after_arc(START, 2.0, 0.0)
    assert straight == Pose(2.0, 0.0, 0.0)


def test_odometry_without_errors_equals_truth():
    truth, report = drive(EXACT)
    assert distance_m(truth, report.pose) < 1e-5
    assert report.pose.heading_rad == pytest.approx(truth.heading_rad, abs=1e-6)
    assert report.speed_mps == pytest.approx(0.5, abs=1e-6)


def test_odometry_error_grows_with_noise():
    errors_m = []
    for factor in (0.0, 1.0, 4.0):
        nominal = RobotOptions()
        options = RobotOptions(
            wheel_radius_error=factor * nominal.wheel_radius_error,
            wheel_base_error=factor * nominal.wheel_base_error,
            slip_m=factor * nominal.slip_m,
        )
        runs = [drive(options, seed) for seed in range(5)]
        errors_m.append(np.mean([distance_m(truth, report.pose) for truth, report in runs]))
    assert errors_m[0] < 0.1 * errors_m[1]
    assert errors_m[1] < 0.5 * errors_m[2]


def test_robot_at_rest_keeps_pose_and_counts():
    robot = Robot(START, np.random.Generator(np.random.PCG64(0)), RobotOptions())
    for _ in range(100):
        robot.command(0.0, 0.0, 0.05)
        robot.move(0.05)
    assert robot.pose == START
    assert robot.encoder_counts() == (0, 0)


def test_command_limits_acceleration():
    robot = Robot(START, np.random.Generator(np.random.PCG64(0)), RobotOptions())
    robot.command(1.0, -2.0, 0.1)
    assert robot.speed_mps == pytest.approx(0.04)
    assert robot.turn_rate_radps == pytest.approx(-0.15)
