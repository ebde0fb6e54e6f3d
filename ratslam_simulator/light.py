# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Drift of the lighting over minutes, as by clouds, lamps and blinds."""

from __future__ import annotations

import math

import numpy as np

from ratslam_simulator.world import World

_WAVES_COUNT = 4
"""Waves in the sum: one is uniform over the floor, the others vary from place to place."""

_MIN_BRIGHTNESS = 0.2
"""Lower limit of the relative brightness."""


class LightDrift:
    """Changes the light of a world by a sum of slow waves in time and space."""

    def __init__(self, world: World, rng: np.random.Generator, spread: float) -> None:
        n_y, n_x = world.plan.solid.shape
        x_m = (np.arange(n_x) + 0.5)[None, :] * world.plan.cell_m
        y_m = (np.arange(n_y) + 0.5)[:, None] * world.plan.cell_m
        shapes = [np.ones((n_y, n_x))]
        for _ in range(_WAVES_COUNT - 1):
            direction_rad, phase_rad = rng.uniform(0.0, math.tau, 2)
            along_m = x_m * np.cos(direction_rad) + y_m * np.sin(direction_rad)
            length_m = rng.uniform(15.0, 40.0)
            shapes.append(math.sqrt(2.0) * np.sin(math.tau * along_m / length_m + phase_rad))
        self._world = world
        self._base = world.light.astype(np.float64)
        self._shapes = np.stack(shapes)
        self._period_s = rng.uniform(600.0, 1200.0, _WAVES_COUNT)
        self._phase_rad = rng.uniform(0.0, math.tau, _WAVES_COUNT)
        # All waves together have the standard deviation `spread` over time.
        self._height = spread * math.sqrt(2.0 / _WAVES_COUNT)

    def update(self, elapsed_s: float) -> None:
        """Set the light of the world for a time after the start."""
        swing = np.sin(math.tau * elapsed_s / self._period_s + self._phase_rad)
        light = self._base + np.tensordot(self._height * swing, self._shapes, axes=1)
        self._world.light[:] = np.maximum(light, _MIN_BRIGHTNESS)
