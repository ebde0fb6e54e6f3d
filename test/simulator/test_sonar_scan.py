# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Sonars as a scan, and exploration by it."""

from __future__ import annotations

import math

import numpy as np
import pytest

from ratslam_ros.core.common.pose import Pose
from ratslam_ros.core.common.scan import points_of
from ratslam_ros.files.config import load_config
from ratslam_simulator.closed_loop import ClosedLoop
from ratslam_simulator.config import SimulatorParameters, make_simulator
from ratslam_simulator.sonar import PIONEER
from ratslam_simulator.sonar_scan import MEMORY_S, SonarScans

ORIGIN = Pose(0.0, 0.0, 0.0)
SILENT = [math.inf] * 8


def points(scans: SonarScans, at_s: float, ranges_m: list[float], pose: Pose) -> np.ndarray:
    return points_of(scans.add(round(at_s * 1e9), ranges_m, pose))


def test_echoes_are_points_on_the_axes() -> None:
    ranges_m = [1.0, *SILENT[2:], 2.0]
    found = points(SonarScans(PIONEER), 0.0, ranges_m, ORIGIN)
    assert found == pytest.approx(np.array([(0.075, 1.13), (0.075, -2.13)]), abs=0.02)


def test_echoes_stay_on_the_floor_until_forgotten() -> None:
    scans = SonarScans(PIONEER)
    points(scans, 0.0, [1.0, *SILENT[1:]], ORIGIN)
    turned = Pose(0.075, 0.0, math.pi / 2)
    assert points(scans, 0.5, SILENT, turned) == pytest.approx(np.array([(1.13, 0.0)]), abs=0.02)
    assert len(points(scans, MEMORY_S + 0.1, SILENT, turned)) == 0


def test_robot_explores_by_sonars_without_collisions() -> None:
    """A laser stays, but does not steer."""
    simulator = make_simulator(SimulatorParameters(plan='obstacle_loop', sonars=True))
    loop = ClosedLoop(simulator, load_config('milford2005')[0], 1)
    heard: list[int] = []
    exploring = loop.exploring

    def steer(scan):
        heard.append(len(scan.ranges_m))
        return exploring(scan)

    loop.run(steer, lambda: loop.now_s >= 60.0)
    assert set(heard) == {360} and len(heard) == 181
    assert simulator.collisions == 0
    assert simulator.odometer_m > 5.0
