# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Maps of a simulated robot with a front and a rear laser."""

import math

import numpy as np
import pytest
from navigation import map_error_m
from test_simulated_loop import CONFIG, PLAN, near_walls

from ratslam_ros.core.common.pose import Pose
from ratslam_ros.core.common.scan import points_of
from ratslam_ros.core.driving.steering import Command
from ratslam_ros.errors import UnusableInput
from ratslam_simulator.closed_loop import ClosedLoop, scan_from_sample
from ratslam_simulator.config import SimulatorParameters, make_simulator
from ratslam_simulator.laser import LaserOptions
from ratslam_simulator.samples import ScanSample
from ratslam_simulator.simulation import SimulationOptions, Simulator

LAP = (1.8, 1.75), (7.2, 1.75), (7.2, 5.2), (1.8, 5.2)
"""Corners of a lap around the block, in m."""

FULL = LaserOptions(beams=360, fov_deg=359.0)
FRONT = LaserOptions(mount=Pose(0.15, 0.0, 0.0))
REAR = LaserOptions(mount=Pose(-0.15, 0.0, math.pi))


def along(corners, simulator):
    """Return the steering along a path that depends on nothing but the true pose."""

    def steer(scan):
        here = simulator.truth
        if math.dist(corners[0], here[:2]) < 0.3:
            corners.pop(0)
        x_m, y_m = corners[0]
        direction_rad = math.atan2(y_m - here.y_m, x_m - here.x_m)
        turn_rad = math.remainder(direction_rad - here.heading_rad, math.tau)
        speed_mps = 0.3 if abs(turn_rad) < 0.5 else 0.0
        return Command(speed_mps, max(-1.0, min(1.0, 2.0 * turn_rad)), 'turn')

    return steer


def driven(laser, rear_laser=None, values=None, duration_s=75.0):
    """Drive a lap and a quarter, or for another time."""
    topics = 'scan' if rear_laser is None else 'scan,scan_rear'
    options = SimulationOptions(laser=laser, rear_laser=rear_laser)
    simulator = Simulator(PLAN, Pose(*PLAN.places['S'], 0.0), 1, options)
    config = CONFIG.with_values({'experience_map.scan_topics': topics, **(values or {})})
    loop = ClosedLoop(simulator, config, exploring_seed=1)
    corners = list(LAP) * 2
    loop.run(along(corners, simulator), lambda: loop.now_s >= duration_s)
    assert len(corners) < 4  # it has come round, and recognised places
    return loop


def test_rear_laser_improves_the_map():
    halves, front = driven(FRONT, REAR), driven(FRONT)
    assert near_walls(halves) > 0.95
    assert map_error_m(halves) < 0.02  # a full laser leaves 0.01 m
    assert map_error_m(front) > 2.0 * map_error_m(halves)


def test_rear_laser_leaves_the_front_scans_unchanged():
    one, two = (
        [s for _ in range(40) for s in simulator.step() if isinstance(s, ScanSample)]
        for simulator in (
            make_simulator(SimulatorParameters(plan='office', rear_laser=rear_laser))
            for rear_laser in (False, True)
        )
    )
    assert len(two) == 2 * len(one) > 0
    for alone, front in zip(one, [s for s in two if s.laser == 0], strict=True):
        assert np.array_equal(alone.ranges_m, front.ranges_m)


def test_rear_laser_is_mounted_opposite_to_the_first():
    simulator = make_simulator(
        SimulatorParameters(plan='office', rear_laser=True, laser_mount='0.2,0.1,30', noise=0.0)
    )
    front, rear = (s for s in simulator.step() if isinstance(s, ScanSample))
    assert scan_from_sample(front, simulator).laser == 0
    scan = scan_from_sample(rear, simulator)
    assert (scan.laser, scan.x_m, scan.y_m) == (1, pytest.approx(-0.2), pytest.approx(-0.1))
    assert len(points_of(scan)) > 0


def test_scan_of_an_unnamed_laser_is_refused():
    options = SimulationOptions(laser=FRONT, rear_laser=REAR)
    loop = ClosedLoop(Simulator(PLAN, Pose(*PLAN.places['S'], 0.0), 1, options), CONFIG, 1)
    with pytest.raises(UnusableInput, match='name all lasers'):
        loop.explore(1.0)
