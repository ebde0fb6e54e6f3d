# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
import math

import numpy as np
import pytest

from ratslam_simulator.camera import Camera, CameraOptions
from ratslam_simulator.floor_plan import parse_floor_plan
from ratslam_simulator.textures import WALL_HEIGHT_M, PanelLibrary
from ratslam_simulator.world import World

QUIET = CameraOptions(noise_grey=0.0, exposure_spread=0.0)
ROOM = parse_floor_plan('\n'.join(['#' * 14, *['#............#'] * 12, '#' * 14]), cell_m=1.0)


def rng(seed=0):
    return np.random.Generator(np.random.PCG64(seed))


def room(textures):
    """Return a world with a room from (1, 1) to (13, 13) and the same panel on every wall."""
    shape = (*ROOM.solid.shape, 4)
    library = PanelLibrary(textures.astype(np.float32), (0,))
    return World(ROOM, library, np.zeros(shape, np.int16), np.zeros(shape, np.float32),
                 np.ones(ROOM.solid.shape, np.float32))


WHITE_ROOM = room(np.ones((7, 1, 60, 100)))


@pytest.mark.parametrize('distance_m', [3.0, 5.0, 8.0])
def test_wall_ahead_has_projected_height(distance_m):
    image = Camera(WHITE_ROOM, rng(), QUIET).take(13.0 - distance_m, 7.0, 0.0)
    middle = image[:, QUIET.width // 2]
    foot_row = QUIET.height / 2 + QUIET.height_m * QUIET.focal_px / distance_m
    top_row = QUIET.height / 2 - (WALL_HEIGHT_M - QUIET.height_m) * QUIET.focal_px / distance_m
    wall = np.flatnonzero(middle == middle[QUIET.height // 2])
    assert wall[0] == pytest.approx(max(top_row, 0), abs=1)
    assert wall[-1] + 1 == pytest.approx(min(foot_row, QUIET.height), abs=1)


def test_corner_appears_at_projected_column():
    # The south wall is darker than the east wall, so that their corner is visible.
    corner_rad = -math.pi / 4
    for turned_rad in (-0.2, 0.0, 0.2):
        image = Camera(WHITE_ROOM, rng(), QUIET).take(9.0, 5.0, corner_rad + turned_rad)
        row = image[QUIET.height // 2].astype(int)
        edge = int(np.argmax(np.abs(np.diff(row)))) + 1
        # A turn to the left moves the image content to the right.
        expected = QUIET.width / 2 + QUIET.focal_px * math.tan(turned_rad)
        assert edge == pytest.approx(expected, abs=1)


@pytest.mark.parametrize('turned_rad', [0.0, 0.4, 3.0])
def test_panorama_shows_all_corners_at_their_bearings(turned_rad):
    options = CameraOptions(width=720, fov_deg=360.0, noise_grey=0.0, exposure_spread=0.0)
    image = Camera(WHITE_ROOM, rng(), options).take(7.0, 7.0, turned_rad)
    row = image[options.height // 2].astype(int)
    shades = np.abs(row - np.roll(row, 1))
    edges = [column for column in range(720) if shades[column] > 15]  # walls along x are darker
    corners_rad = [math.pi * (0.25 + quarter / 2) - turned_rad for quarter in range(4)]
    expected = sorted((360.0 - math.degrees(rad) * 2.0) % 720.0 for rad in corners_rad)
    assert edges == pytest.approx(expected, abs=1)
    wall = np.flatnonzero(image[:, int(expected[0])] == image[60, int(expected[0])])
    foot_row = 60 + options.focal_px * options.height_m / math.hypot(6.0, 6.0)
    assert wall[-1] + 1 == pytest.approx(foot_row, abs=1)


def test_panels_are_not_mirrored_on_any_wall():
    dark_on_the_left = np.ones((7, 1, 60, 100))
    dark_on_the_left[:, :, :30] = 0.2
    world = room(dark_on_the_left)
    for heading_rad in (0.0, math.pi / 2, math.pi, -math.pi / 2):
        # One metre from the wall, in front of the edge of the dark half.
        cos, sin = math.cos(heading_rad), math.sin(heading_rad)
        x_m, y_m = 7.0 + 5.0 * cos - 0.25 * sin, 7.0 + 5.0 * sin + 0.25 * cos
        row = Camera(world, rng(), QUIET).take(x_m, y_m, heading_rad)[QUIET.height // 2]
        left, right = row[: QUIET.width // 2], row[QUIET.width // 2 :]
        # Leave out the columns at the edge, where the two shades are interpolated.
        assert left[:-3].max() < 60
        assert right[3:20].min() > 200


def test_pixel_noise_is_reproducible_with_given_deviation():
    options = CameraOptions(noise_grey=3.0, exposure_spread=0.0)
    images = [Camera(WHITE_ROOM, rng(seed), options).take(7.0, 7.0, 0.0) for seed in (1, 1, 2)]
    assert np.array_equal(images[0], images[1])
    difference = images[0].astype(float) - images[2]
    floor = difference[-20:]
    assert floor.std() == pytest.approx(3.0 * math.sqrt(2.0), rel=0.1)
