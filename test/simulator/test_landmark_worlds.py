# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Worlds of landmarks, the vehicle's drive through them, and the sensor."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from ratslam_ros.core.common.pose import Pose, composed, inverse
from ratslam_ros.errors import UnusableInput
from ratslam_simulator.floor_plan import parse_floor_plan
from ratslam_simulator.landmarks import (
    DISTINCT,
    NORMAL,
    BarOptions,
    LandmarkSensor,
    LandmarkWorld,
    Vehicle,
    drive,
    floor_plan_landmarks,
    lap,
    observe,
    random_pose,
    scattered_bars,
)

EXACT = LandmarkSensor().with_noise(0.0)
ROOM = """
########
#...####
#...##.#
#......#
########
"""


def generator(seed: int = 1) -> np.random.Generator:
    return np.random.Generator(np.random.PCG64(seed))


def room() -> LandmarkWorld:
    return floor_plan_landmarks(parse_floor_plan(ROOM, 1.0))


def test_about_ten_normal_bars_look_alike() -> None:
    # 1.96 SD of the measured length, and of a map that is a little less certain.
    counts = [scattered_bars(generator(seed)).look_alike_count(0.21) for seed in range(10)]
    assert np.mean(counts) == pytest.approx(10.0, abs=1.0)


def test_distinct_walls_rarely_look_alike() -> None:
    world = scattered_bars(generator(), DISTINCT)
    is_wall = world.bars[:, 3] > 0.0
    assert np.count_nonzero(~is_wall) == 40
    assert world.bars[is_wall, 3].min() >= DISTINCT.shortest_m
    assert LandmarkWorld(world.bars[is_wall], world.size_m).look_alike_count(0.21) < 3.0


def test_scattered_bars_keep_their_distances() -> None:
    places_m = scattered_bars(generator()).bars[:, :2]
    distances_m = np.linalg.norm(places_m[:, None] - places_m, axis=2)
    assert distances_m[~np.eye(len(places_m), dtype=bool)].min() >= NORMAL.separation_m
    assert (places_m >= 0.0).all() and (places_m <= NORMAL.size_m).all()


def test_too_many_bars_are_refused() -> None:
    with pytest.raises(UnusableInput, match='of 100 landmarks fit into 5 x 5 m'):
        scattered_bars(generator(), BarOptions(size_m=(5.0, 5.0)))


def test_plan_becomes_walls_and_corners() -> None:
    world = room()
    walls = {tuple(bar) for bar in world.bars.round(6).tolist() if bar[3] > 0.0}
    corners = {tuple(bar) for bar in world.bars.round(6).tolist() if bar[3] == 0.0}
    half, quarter = round(math.pi / 2, 6), round(math.pi / 4, 6)
    three = round(3 * math.pi / 4, 6)
    # The walls run from left to right as seen from the free floor.
    assert walls == {
        (1.0, 4.0, 0.0, 3.0), (4.0, 4.0, -half, 2.0), (4.0, 2.0, 0.0, 2.0),
        (6.0, 2.0, half, 1.0), (6.0, 3.0, 0.0, 1.0), (7.0, 3.0, -half, 2.0),
        (7.0, 1.0, round(math.pi, 6), 6.0), (1.0, 1.0, half, 3.0),
    }
    assert corners == {
        (1.0, 4.0, -quarter, 0.0), (4.0, 4.0, -three, 0.0), (4.0, 2.0, -three, 0.0),
        (6.0, 2.0, -quarter, 0.0), (6.0, 3.0, -quarter, 0.0), (7.0, 3.0, -three, 0.0),
        (7.0, 1.0, three, 0.0), (1.0, 1.0, quarter, 0.0),
    }


def test_walls_block_the_view_of_landmarks() -> None:
    sensor = replace(EXACT, min_range_m=0.1)
    world = room()
    seen = observe(world, Pose(6.5, 2.5, 0.0), sensor, generator())
    assert seen.identifiers is not None
    bars = world.bars[seen.identifiers].round(2)
    # The niche, but not the end of the room above the step.
    assert [7.0, 3.0, -1.57, 2.0] in bars.tolist()
    assert [1.0, 4.0, -0.79, 0.0] not in bars.tolist()
    everything = observe(replace(world, plan=None), Pose(6.5, 2.5, 0.0), sensor, generator())
    assert len(everything) == len(world) > len(seen)


def test_exact_observations_place_landmarks_in_world() -> None:
    world = scattered_bars(generator(), DISTINCT)
    pose = Pose(20.0, 30.0, 2.5)
    seen = observe(world, pose, EXACT, generator())
    assert len(seen) > 5 and seen.identifiers is not None
    for (range_m, bearing_rad, relative_rad, seen_m), identifier in zip(
        seen.values, seen.identifiers, strict=True
    ):
        there = composed(pose, Pose(0.0, 0.0, bearing_rad))
        there = composed(there, Pose(range_m, 0.0, 0.0))
        x_m, y_m, direction_rad, length_m = world.bars[identifier]
        assert there[:2] == pytest.approx((x_m, y_m))
        turn_rad = pose.heading_rad + relative_rad - direction_rad
        assert math.remainder(turn_rad, math.tau) == pytest.approx(0.0, abs=1e-12)
        assert seen_m == length_m


def test_noise_of_observations_has_stated_sd() -> None:
    world = LandmarkWorld(np.array([[5.0, 0.0, 1.0, 3.0], [0.0, 5.0, 1.0, 0.0]]), (5.0, 5.0))
    sensor = LandmarkSensor().with_noise(2.0)
    rng = generator()
    found = np.zeros((2000, 2, 4))
    for row in found:
        seen = observe(world, Pose(0.0, 0.0, 0.0), sensor, rng)
        order = np.argsort(seen.identifiers)  # type: ignore[arg-type]
        row[:] = seen.values[order]
    errors = found - [[5.0, 0.0, 1.0, 3.0], [5.0, math.pi / 2, 1.0, 0.0]]
    expected = [0.2, math.radians(2.0), math.radians(4.0), 0.2]
    assert errors[:, 0].std(axis=0) == pytest.approx(expected, rel=0.06)
    assert np.abs(errors.mean(axis=0)) == pytest.approx(np.zeros((2, 4)), abs=0.02)
    # A measured length is never negative, and unbiased.
    assert (found[:, 1, 3] == 0.0).all()


def test_sensor_reports_at_most_maximum_count() -> None:
    world = scattered_bars(generator())
    pose, rng = random_pose(world, generator(), 12.0), generator()
    few = replace(LandmarkSensor(), max_count=3)
    seen = [observe(world, pose, few, rng).identifiers for _ in range(30)]
    assert {len(identifiers) for identifiers in seen if identifiers is not None} == {3}
    in_view = observe(world, pose, LandmarkSensor(), rng).identifiers
    # They are drawn anew each time.
    assert set(np.concatenate(seen).tolist()) == set(in_view.tolist())  # type: ignore


def test_drive_follows_plan_and_odometry_drifts() -> None:
    world = scattered_bars(generator())
    start, steps = drive(world, lap(world, 12.5), LandmarkSensor(), generator())
    assert len(steps) == pytest.approx(2 * (25 + 40), abs=6)
    deviations_m = [math.dist(step.pose[:2], step.planned[:2]) for step in steps]
    assert 0.02 < np.mean(deviations_m) < 0.3
    odometry = start
    for step in steps:
        odometry = composed(odometry, Pose(*step.motion))
    assert 0.5 < math.dist(odometry[:2], steps[-1].pose[:2]) < 20.0


def test_noise_of_odometry_grows_with_distance_and_turn() -> None:
    world = LandmarkWorld(np.zeros((0, 4)), (40.0, 40.0))
    vehicle = Vehicle()
    errors = []
    for seed in range(300):
        start, steps = drive(world, [(0.0, 0.0), (5.0, 0.0)], EXACT, generator(seed))
        odometry = start
        for step in steps:
            odometry = composed(odometry, Pose(*step.motion))
        errors.append(composed(inverse(odometry), steps[-1].pose))
    metres = len(steps) * vehicle.step_m
    sd = np.array(errors).std(axis=0)
    assert sd[0] == pytest.approx(vehicle.position_sd_m * math.sqrt(metres), rel=0.15)
    # Steering against the drift adds turns.
    assert sd[2] == pytest.approx(vehicle.drift_sd_rad * math.sqrt(metres), rel=0.25)


def test_random_poses_are_on_free_floor() -> None:
    world = room()
    assert world.plan is not None
    rng = generator()
    poses = [random_pose(world, rng) for _ in range(50)]
    assert not any(world.plan.is_solid(pose.x_m, pose.y_m) for pose in poses)


def test_equal_seeds_give_equal_drives() -> None:
    world = scattered_bars(generator())
    one, other = (drive(world, lap(world, 12.5), LandmarkSensor(), generator(3)) for _ in '12')
    for a, b in zip(one[1], other[1], strict=True):
        assert (a.pose, a.motion) == (b.pose, b.motion)
        assert np.array_equal(a.observations.values, b.observations.values)
