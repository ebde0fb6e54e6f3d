# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
import math

import numpy as np
import pytest

from ratslam_simulator.floor_plan import parse_floor_plan
from ratslam_simulator.laser import Laser, LaserOptions
from ratslam_simulator.world import PERSON_RADIUS_M, build_world

# A room of 8 x 5 m, from (1, 1) to (9, 6).
ROOM = parse_floor_plan('\n'.join(['#' * 10, *['#........#'] * 5, '#' * 10]), cell_m=1.0)
QUIET = LaserOptions(noise_m=0.0, range_max_m=20.0)


def rng(seed=0):
    return np.random.Generator(np.random.PCG64(seed))


@pytest.fixture
def world():
    return build_world(ROOM, rng())


def wall_distance_m(x_m, y_m, direction_rad):
    """Return the distance to the walls of the room in closed form."""
    cos, sin = math.cos(direction_rad), math.sin(direction_rad)
    along_x = ((9.0 if cos > 0 else 1.0) - x_m) / cos if abs(cos) > 1e-12 else math.inf
    along_y = ((6.0 if sin > 0 else 1.0) - y_m) / sin if abs(sin) > 1e-12 else math.inf
    return min(along_x, along_y)


@pytest.mark.parametrize('pose', [(5.0, 3.5, 0.0), (2.3, 4.1, 2.0), (8.0, 1.5, -2.9)])
def test_scan_of_room_matches_wall_distances(world, pose):
    ranges_m = Laser(world, rng(), QUIET).scan(*pose)
    assert (ranges_m.shape, ranges_m.dtype) == ((181,), np.float32)
    x_m, y_m, heading_rad = pose
    for beam, range_m in enumerate(ranges_m):
        direction_rad = heading_rad + math.radians(beam - 90)
        assert range_m == pytest.approx(wall_distance_m(x_m, y_m, direction_rad), abs=0.01)


def test_scan_with_fewer_beams_covers_smaller_angle(world):
    options = LaserOptions(beams=5, fov_deg=90.0, noise_m=0.0)
    ranges_m = Laser(world, rng(), options).scan(5.0, 3.0, 0.0)
    degrees = (-45, -22.5, 0, 22.5, 45)
    expected_m = [wall_distance_m(5.0, 3.0, math.radians(degree)) for degree in degrees]
    assert ranges_m == pytest.approx(expected_m, abs=1e-5)
    assert options.first_rad == pytest.approx(-math.pi / 4)
    assert options.step_rad == pytest.approx(math.pi / 8)


def test_ranges_beyond_maximum_are_infinite(world):
    ranges_m = Laser(world, rng(), LaserOptions(noise_m=0.0, range_max_m=3.0)).scan(5.0, 3.5, 0.0)
    assert np.isinf(ranges_m[90])
    assert ranges_m[0] == pytest.approx(2.5)
    assert ranges_m[np.isfinite(ranges_m)].max() <= 3.0


def test_people_appear_as_discs_and_occlude(world):
    world.people = np.array([(7.0, 3.5, 0.0, 0.0), (8.0, 3.5, 0.0, 0.0)])
    ranges_m = Laser(world, rng(), QUIET).scan(5.0, 3.5, 0.0)
    assert ranges_m[90] == pytest.approx(2.0 - PERSON_RADIUS_M, abs=1e-5)
    half_width_deg = math.degrees(math.asin(PERSON_RADIUS_M / 2.0))
    near = np.abs(np.arange(181) - 90) < half_width_deg
    assert (ranges_m[near] < 2.0).all()
    assert (ranges_m[~near] > 2.4).all()


def test_obstacle_changes_scan_until_removed(world):
    laser = Laser(world, rng(), QUIET)
    before = laser.scan(5.0, 3.5, 0.0)
    world.add_obstacle('box', world.obstacle_cells(7.5, 3.5, 1.0, 1.0))
    assert laser.scan(5.0, 3.5, 0.0)[90] == pytest.approx(2.0)
    world.remove_obstacle('box')
    assert np.array_equal(laser.scan(5.0, 3.5, 0.0), before)


def test_range_noise_is_reproducible_with_given_deviation(world):
    first, again, other = (
        Laser(world, rng(seed), LaserOptions(noise_m=0.02, range_max_m=20.0)).scan(5.0, 3.5, 0.0)
        for seed in (1, 1, 2)
    )
    assert np.array_equal(first, again)
    assert not np.array_equal(first, other)
    error_m = first - Laser(world, rng(), QUIET).scan(5.0, 3.5, 0.0)
    assert error_m.std() == pytest.approx(0.02, rel=0.2)
