# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Sonars: the width of their beams, specular walls, corners, and noise of their own."""

from __future__ import annotations

import math

import numpy as np
import pytest

from ratslam_ros.core.common.pose import Pose
from ratslam_simulator.config import SimulatorParameters, make_simulator
from ratslam_simulator.floor_plan import parse_floor_plan
from ratslam_simulator.samples import SonarSample
from ratslam_simulator.sonar import PIONEER, SonarOptions, Sonars
from ratslam_simulator.world import PERSON_RADIUS_M, World, build_world

# A room of 8 x 5 m, from (1, 1) to (9, 6).
ROOM = parse_floor_plan('\n'.join(['#' * 10, *['#........#'] * 5, '#' * 10]), cell_m=1.0)
ONE = (Pose(0.0, 0.0, 0.0),)
QUIET = SonarOptions(mounts=ONE, noise_ratio=0.0)


def rng() -> np.random.Generator:
    return np.random.Generator(np.random.PCG64(0))


@pytest.fixture
def world() -> World:
    return build_world(ROOM, rng())


def range_m(world: World, x_m: float, y_m: float, degrees: float) -> float:
    """Return the range of one sonar without noise."""
    return float(Sonars(world, rng(), QUIET).ranges_m(Pose(x_m, y_m, math.radians(degrees)))[0])


@pytest.mark.parametrize('degrees', [0.0, 7.0, 15.0, -15.0])
def test_wall_within_cone_is_measured_along_its_normal(world: World, degrees: float) -> None:
    assert range_m(world, 7.0, 3.5, degrees) == pytest.approx(2.0, abs=0.001)


@pytest.mark.parametrize('degrees', [17.0, 25.0, -25.0])
def test_echo_of_grazed_wall_is_lost(world: World, degrees: float) -> None:
    assert range_m(world, 7.0, 3.5, degrees) == math.inf


def test_corner_returns_echo_at_any_angle(world: World) -> None:
    away_m = math.hypot(2.0, 2.5)
    to_corner = math.degrees(math.atan2(2.5, 2.0))
    for degrees in (to_corner - 12.0, to_corner, to_corner + 12.0):
        assert range_m(world, 7.0, 3.5, degrees) == pytest.approx(away_m, abs=0.1)


def test_person_in_mirror_gives_late_echo(world: World) -> None:
    """Ray: 2 m / cos(30) to the wall at x = 9, and as far back to a person at x = 7."""
    lost = range_m(world, 7.0, 2.2, 30.0)
    y_m = 2.2 + 2 * 2.0 * math.tan(math.radians(30.0))
    world.people = np.array([(7.0, y_m, 0.0, 0.0)])
    late_m = 2 * 2.0 / math.cos(math.radians(30.0)) - PERSON_RADIUS_M
    assert lost > 5.0
    assert range_m(world, 7.0, 2.2, 30.0) == pytest.approx(late_m, abs=0.05)
    assert y_m - 2.2 < late_m - 1.0  # the person is nearer than the echo


def test_person_at_edge_of_cone_is_seen(world: World) -> None:
    world.people = np.array([(4.0, 3.5, 0.0, 0.0)])
    half_deg = 15.0 + math.degrees(math.asin(PERSON_RADIUS_M / 2.0))
    assert range_m(world, 2.0, 3.5, half_deg - 1.0) < 2.0
    assert range_m(world, 2.0, 3.5, half_deg + 1.0) > 2.0


def test_ring_is_that_of_pioneer(world: World) -> None:
    degrees = [round(math.degrees(mount.heading_rad)) for mount in PIONEER]
    assert degrees == [90, 50, 30, 10, -10, -30, -50, -90]
    ranges_m = Sonars(world, rng(), SonarOptions(noise_ratio=0.0)).ranges_m(Pose(7.0, 3.5, 0.0))
    assert ranges_m.dtype == np.float32
    assert ranges_m[[0, 7]] == pytest.approx(2.5 - 0.13, abs=0.001)
    assert ranges_m[[3, 4]] == pytest.approx(2.0 - 0.17, abs=0.001)


def test_ranges_beyond_maximum_are_infinite(world: World) -> None:
    assert range_m(world, 3.9, 3.5, 0.0) == math.inf
    assert range_m(world, 4.1, 3.5, 0.0) == pytest.approx(4.9, abs=0.001)


def test_noise_is_one_percent_and_reproducible(world: World) -> None:
    options = SonarOptions(mounts=ONE * 2000)
    first, again = (
        Sonars(world, rng(), options).ranges_m(Pose(6.0, 3.5, 0.0)) for _ in range(2)
    )
    assert np.array_equal(first, again)
    assert first.std() == pytest.approx(0.03, rel=0.1)


def test_sonars_change_no_other_sample() -> None:
    runs = []
    for sonars in (False, True):
        simulator = make_simulator(SimulatorParameters(plan='office', sonars=sonars))
        runs.append([sample for _ in range(80) for sample in simulator.step()])
    heard = [sample for sample in runs[1] if isinstance(sample, SonarSample)]
    others = [sample for sample in runs[1] if not isinstance(sample, SonarSample)]
    assert len(heard) == 6
    assert [str(sample) for sample in others] == [str(sample) for sample in runs[0]]
