# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Camera of the simulated robot: ray casting, one ray per image column, with textured walls."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numba import njit
from numpy.typing import NDArray

from ratslam_simulator.rays import EAST, SOUTH, WEST, cast, cast_at_discs
from ratslam_simulator.textures import TEXELS_PER_M, WALL_HEIGHT_M
from ratslam_simulator.world import PERSON_HEIGHT_M, PERSON_RADIUS_M, World

FLOOR_TILE_M = 0.7
"""Side of a floor tile."""

LAMP_SPACING_M = 3.85
"""Spacing of the grid of ceiling lamps, which is centred on the floor plan."""


@dataclass(frozen=True)
class CameraOptions:
    """Properties of a forward-looking camera above the robot's centre.

    fov_deg: horizontal field of view; from 180 on, images are projected on a cylinder
    noise_grey: standard deviation of the pixel noise, in grey levels
    exposure_spread: standard deviation of the slow relative change of brightness
    """

    width: int = 160
    height: int = 120
    fov_deg: float = 50.0
    height_m: float = 0.9
    rate_hz: int = 8
    noise_grey: float = 2.0
    exposure_spread: float = 0.03

    @property
    def is_panoramic(self) -> bool:
        """Whether the field of view is too wide for a plane."""
        return self.fov_deg >= 180.0

    @property
    def focal_px(self) -> float:
        """Focal length in pixels, equal along both axes; of a panorama, radius of the cylinder."""
        if self.is_panoramic:
            return self.width / math.radians(self.fov_deg)
        return self.width / 2 / math.tan(math.radians(self.fov_deg) / 2)


class Camera:
    """Renders images of a world, with pixel noise and a varying exposure."""

    def __init__(self, world: World, rng: np.random.Generator, options: CameraOptions) -> None:
        self._world = world
        self._rng = rng
        self._options = options
        self._exposure = 0.0

    def take(self, x_m: float, y_m: float, heading_rad: float) -> NDArray[np.uint8]:
        """Render the image from a pose in a free cell.

        Returns:
            (height, width) uint8.
        """
        options, world = self._options, self._world
        # First-order Gauss-Markov exposure with a time constant of 10 s, like an automatic one.
        keep = math.exp(-1.0 / (10.0 * options.rate_hz))
        spread = options.exposure_spread * math.sqrt(1.0 - keep * keep)
        self._exposure = keep * self._exposure + spread * self._rng.standard_normal()
        image = np.empty((options.height, options.width), np.uint8)
        _render(
            world.solid,
            world.plan.cell_m,
            world.panel,
            world.panel_u_m,
            world.library.textures,
            world.light,
            world.people,
            x_m,
            y_m,
            heading_rad,
            options.focal_px,
            options.is_panoramic,
            options.height_m,
            1.0 + self._exposure,
            options.noise_grey,
            np.uint64(self._rng.integers(2**63)),
            image,
        )
        return image


@njit(cache=True)
def _light_at(light, column, row):  # type: ignore[no-untyped-def]
    """Interpolate the light bilinearly between cell centres."""
    n_y, n_x = light.shape
    column = min(max(column - 0.5, 0.0), n_x - 1.001)
    row = min(max(row - 0.5, 0.0), n_y - 1.001)
    i, j = int(column), int(row)
    fi, fj = column - i, row - j
    near = light[j, i] * (1.0 - fi) + light[j, i + 1] * fi
    far = light[j + 1, i] * (1.0 - fi) + light[j + 1, i + 1] * fi
    return near * (1.0 - fj) + far * fj


@njit(cache=True)
def _noise(key, pixel):  # type: ignore[no-untyped-def]
    """Return noise of unit variance for a pixel: the sum of a hash's bytes is nearly Gaussian."""
    # SplitMix64 as a hash: the noise of a pixel depends on the image key and its index alone.
    z = key + np.uint64(pixel + 1) * np.uint64(0x9E3779B97F4A7C15)
    z = (z ^ (z >> np.uint64(30))) * np.uint64(0xBF58476D1CE4E5B9)
    z = (z ^ (z >> np.uint64(27))) * np.uint64(0x94D049BB133111EB)
    z = z ^ (z >> np.uint64(31))
    total = np.int64(0)
    for _ in range(8):
        total += np.int64(z & np.uint64(255))
        z >>= np.uint64(8)
    return (total - 1020) / 209.0


@njit(cache=True)
def _render(  # type: ignore[no-untyped-def]
    solid, cell_m, panel, panel_u_m, textures, light, people, x_m, y_m, heading_rad,
    focal_px, is_panoramic, camera_height_m, gain, noise_grey, key, image,
):
    height, width = image.shape
    n_levels, _, n_u, n_v = textures.shape
    middle_x, middle_y = solid.shape[1] * cell_m / 2, solid.shape[0] * cell_m / 2
    forward_x, forward_y = math.cos(heading_rad), math.sin(heading_rad)
    for i in range(width):
        # The forward component of each ray is 1, so that its length parameter is the depth that
        # the perspective projection needs.
        left = (width / 2 - i - 0.5) / focal_px
        if is_panoramic:  # the depth is the distance
            ray_x, ray_y = math.cos(heading_rad + left), math.sin(heading_rad + left)
            left = 0.0
        else:
            ray_x, ray_y = forward_x - left * forward_y, forward_y + left * forward_x
        depth_m, row, column, side = cast(solid, cell_m, x_m, y_m, ray_x, ray_y)
        hit_x, hit_y = x_m + depth_m * ray_x, y_m + depth_m * ray_y
        # Distance along the side of the cell, from its left end as seen by the camera.
        if side == WEST:
            along_m, slant = (row + 1) * cell_m - hit_y, abs(ray_x)
        elif side == EAST:
            along_m, slant = hit_y - row * cell_m, abs(ray_x)
        elif side == SOUTH:
            along_m, slant = hit_x - column * cell_m, abs(ray_y)
        else:
            along_m, slant = (column + 1) * cell_m - hit_x, abs(ray_y)
        along_m += panel_u_m[row, column, side]
        # Texels that an image column covers; the level blurs over about as many.
        covered = depth_m * (1.0 + left * left) / (focal_px * slant) * TEXELS_PER_M
        level = min(max(int(math.log2(covered) + 0.5), 0), n_levels - 1) if covered > 1.0 else 0
        u = min(max(along_m * TEXELS_PER_M - 0.5, 0.0), n_u - 1.001)
        iu = int(u)
        fu = u - iu
        near = textures[level, panel[row, column, side], iu]
        next_ = textures[level, panel[row, column, side], iu + 1]
        # Walls along x are slightly darker, which makes corners visible.
        wall_lit = 1.0 if side in (WEST, EAST) else 0.88
        wall_lit *= _light_at(light, hit_x / cell_m, hit_y / cell_m) / (1.0 + 0.03 * depth_m)
        person_m, person = cast_at_discs(people, PERSON_RADIUS_M, x_m, y_m, ray_x, ray_y)
        if person_m < depth_m:
            # The clothes texture wraps once around the body, with its centre in front.
            out_x = x_m + person_m * ray_x - people[person, 0]
            out_y = y_m + person_m * ray_y - people[person, 1]
            round_rad = (math.atan2(out_y, out_x) - people[person, 2]) % math.tau
            around = (round_rad / math.tau + 0.5) % 1.0
            cloth = textures[0, int(people[person, 3]), int(around * n_u)]
            person_lit = _light_at(light, people[person, 0] / cell_m, people[person, 1] / cell_m)
            # Shading of a cylinder: darker towards the outline.
            facing = -(out_x * ray_x + out_y * ray_y) / (
                PERSON_RADIUS_M * math.hypot(ray_x, ray_y)
            )
            person_lit *= (0.6 + 0.4 * facing) / (1.0 + 0.03 * person_m)
        for j in range(height):
            up = (height / 2 - j - 0.5) / focal_px
            z_m = camera_height_m + up * depth_m
            person_z_m = camera_height_m + up * person_m if person_m < depth_m else -1.0
            if 0.0 <= person_z_m < PERSON_HEIGHT_M:
                shade = cloth[int(person_z_m * TEXELS_PER_M)] * person_lit
            elif z_m < 0.0:
                floor_m = -camera_height_m / up
                floor_x, floor_y = x_m + floor_m * ray_x, y_m + floor_m * ray_y
                shade = 0.42 * _light_at(light, floor_x / cell_m, floor_y / cell_m)
                joint_x, joint_y = floor_x / FLOOR_TILE_M % 1.0, floor_y / FLOOR_TILE_M % 1.0
                if floor_m < 4.0 and (joint_x < 0.03 or joint_y < 0.03):
                    shade *= 0.95
                shade /= 1.0 + 0.06 * floor_m
            elif z_m >= WALL_HEIGHT_M:
                ceiling_m = (WALL_HEIGHT_M - camera_height_m) / up
                over_x, over_y = x_m + ceiling_m * ray_x, y_m + ceiling_m * ray_y
                shade = 0.66 * _light_at(light, over_x / cell_m, over_y / cell_m)
                lamp_x = ((over_x - middle_x) / LAMP_SPACING_M + 0.5) % 1.0 - 0.5
                lamp_y = ((over_y - middle_y) / LAMP_SPACING_M + 0.5) % 1.0 - 0.5
                if abs(lamp_x) * LAMP_SPACING_M < 0.6 and abs(lamp_y) * LAMP_SPACING_M < 0.6:
                    shade = 1.05
                shade /= 1.0 + 0.03 * ceiling_m
            else:
                v = min(max(z_m * TEXELS_PER_M - 0.5, 0.0), n_v - 1.001)
                iv = int(v)
                fv = v - iv
                low = near[iv] * (1.0 - fu) + next_[iv] * fu
                high = near[iv + 1] * (1.0 - fu) + next_[iv + 1] * fu
                shade = (low * (1.0 - fv) + high * fv) * wall_lit
            grey = 255.0 * shade * gain + noise_grey * _noise(key, j * width + i)
            image[j, i] = np.uint8(min(max(grey + 0.5, 0.0), 255.0))
