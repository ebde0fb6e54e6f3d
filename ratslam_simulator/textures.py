# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Textures of wall panels, obstacles and clothes, painted at random."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

PANEL_WIDTH_M = 1.4
"""Width of a panel, which is as high as the wall."""

WALL_HEIGHT_M = 2.5
"""Height of the walls."""

TEXELS_PER_M = 40
"""Resolution of the textures."""

BLUR_LEVELS = 7
"""Number of blur levels of each texture, a horizontal mipmap."""

_CLOTHES_COUNT = 6
"""Number of different clothes."""

Panel = NDArray[np.float32]


@dataclass(frozen=True)
class PanelLibrary:
    """Painted panels and their uses.

    textures: (BLUR_LEVELS, n_panels, n_u, n_v) float32, 0 to 1; u runs from left to right as seen
        by a viewer facing the wall, v from the floor up; level k averages 2^k texels along u
    house_style: indices of the panels that repeat along walls in the house style
    on_walls: number of panels for walls, which come first
    cardboard: index of the panel of obstacles
    clothes: indices of the panels of people, which wrap once around the body
    """

    textures: NDArray[np.float32]
    house_style: tuple[int, ...]
    on_walls: int = 1
    cardboard: int = 0
    clothes: tuple[int, ...] = (0,)


def paint_library(rng: np.random.Generator, variety: int = 1) -> PanelLibrary:
    """Paint all panels, with random shades, posters, books and papers.

    Args:
        rng: generator of the random parts.
        variety: number of sets of unique panels.
    """
    wall_shade = rng.uniform(0.62, 0.74)
    door_shade = rng.uniform(0.26, 0.42)
    panels = [
        _wall(wall_shade),
        _door(wall_shade, door_shade),
        _window(wall_shade),
        _wall(wall_shade * 0.55),
        _door(wall_shade, 0.9),
        _double_door(wall_shade),
        _whiteboard(rng, wall_shade),
        _pillar(wall_shade),
        _radiator(wall_shade),
    ]
    house_style = (0, 1, 0, 2)
    panels += [_poster(rng, wall_shade) for _ in range(6 * variety)]
    panels += [_notice_board(rng, wall_shade) for _ in range(3 * variety)]
    panels += [_bookshelf(rng, wall_shade) for _ in range(3 * variety)]
    panels += [_cabinets(rng, wall_shade) for _ in range(3 * variety)]
    panels += [_plant(rng, wall_shade) for _ in range(2 * variety)]
    on_walls = len(panels)
    # Clothes have their own stream, so that they do not affect the walls.
    (clothes_rng,) = rng.spawn(1)
    panels += [_cardboard()]
    panels += [_clothes(clothes_rng) for _ in range(_CLOTHES_COUNT)]
    sharp = np.stack([np.clip(panel, 0.0, 1.0) for panel in panels])
    textures = np.stack([_blur(sharp, level) for level in range(BLUR_LEVELS)])
    clothes = tuple(range(on_walls + 1, len(panels)))
    return PanelLibrary(textures, house_style, on_walls, on_walls, clothes)


def _blur(panels: NDArray[np.float32], level: int) -> NDArray[np.float32]:
    """Average over 2^level texels along u, against aliasing of distant or slanted walls."""
    reach = 2**level
    padded = np.pad(panels, ((0, 0), (reach // 2, reach - 1 - reach // 2), (0, 0)), mode='edge')
    windows = np.lib.stride_tricks.sliding_window_view(padded, reach, axis=1)
    return np.ascontiguousarray(windows.mean(axis=-1, dtype=np.float64), dtype=np.float32)


def _fill(
    panel: Panel, left_m: float, right_m: float, low_m: float, high_m: float, shade: float
) -> None:
    """Paint a rectangle, clipped to the panel."""
    edges = (np.array([left_m, right_m, low_m, high_m]) * TEXELS_PER_M + 0.5).astype(int)
    left, right, low, high = np.maximum(edges, 0)
    panel[left:right, low:high] = shade


def _wall(shade: float) -> Panel:
    panel = np.full(
        (round(PANEL_WIDTH_M * TEXELS_PER_M), round(WALL_HEIGHT_M * TEXELS_PER_M)),
        shade,
        np.float32,
    )
    _fill(panel, 0.0, PANEL_WIDTH_M, 0.0, 0.1, 0.25)
    return panel


def _door(wall_shade: float, shade: float) -> Panel:
    panel = _wall(wall_shade)
    _fill(panel, 0.2, 1.3, 0.0, 2.15, shade * 0.55)
    _fill(panel, 0.27, 1.23, 0.0, 2.08, shade)
    _fill(panel, 0.35, 0.45, 0.98, 1.04, 0.9)
    _fill(panel, 1.35, 1.48, 1.45, 1.6, 0.95)
    return panel


def _double_door(wall_shade: float) -> Panel:
    panel = _wall(wall_shade)
    _fill(panel, 0.05, 1.45, 0.0, 2.2, 0.2)
    for left_m in (0.1, 0.77):
        _fill(panel, left_m, left_m + 0.63, 0.0, 2.12, 0.5)
        _fill(panel, left_m + 0.12, left_m + 0.51, 1.0, 1.95, 0.85)
    return panel


def _window(wall_shade: float) -> Panel:
    panel = _wall(wall_shade)
    _fill(panel, 0.1, 1.4, 0.85, 2.2, 0.45)
    for left_m in (0.16, 0.79):
        _fill(panel, left_m, left_m + 0.55, 0.92, 2.13, 1.0)
    return panel


def _radiator(wall_shade: float) -> Panel:
    panel = _window(wall_shade)
    for left_m in np.arange(0.2, 1.3, 0.12):
        _fill(panel, left_m, left_m + 0.06, 0.15, 0.75, 0.95)
    return panel


def _pillar(wall_shade: float) -> Panel:
    panel = _wall(wall_shade)
    _fill(panel, 0.45, 1.05, 0.0, WALL_HEIGHT_M, 0.92)
    _fill(panel, 0.95, 1.05, 0.0, WALL_HEIGHT_M, 0.4)
    return panel


def _whiteboard(rng: np.random.Generator, wall_shade: float) -> Panel:
    panel = _wall(wall_shade)
    _fill(panel, 0.06, 1.44, 0.8, 2.0, 0.3)
    _fill(panel, 0.1, 1.4, 0.85, 1.95, 0.97)
    for high_m in np.arange(1.1, 1.85, 0.14):
        _fill(panel, 0.2, 0.3 + rng.uniform(0.1, 0.9), high_m, high_m + 0.03, 0.35)
    return panel


def _poster(rng: np.random.Generator, wall_shade: float) -> Panel:
    panel = _wall(wall_shade)
    left_m, width_m = rng.uniform(0.1, 0.5), rng.uniform(0.7, 0.9)
    low_m, high_m = rng.uniform(0.7, 1.0), rng.uniform(1.8, 2.1)
    _fill(panel, left_m, left_m + width_m, low_m, high_m, rng.choice([0.05, 0.15, 0.95, 1.0]))
    for _ in range(4):
        x_m, y_m = rng.uniform(0.05, 0.6) * width_m, rng.uniform(0.05, 0.6) * (high_m - low_m)
        _fill(
            panel,
            left_m + x_m,
            left_m + x_m + rng.uniform(0.1, 0.35) * width_m,
            low_m + y_m,
            low_m + y_m + rng.uniform(0.1, 0.35) * (high_m - low_m),
            rng.uniform(0.1, 0.9),
        )
    return panel


def _notice_board(rng: np.random.Generator, wall_shade: float) -> Panel:
    panel = _wall(wall_shade)
    _fill(panel, 0.1, 1.4, 0.9, 1.95, rng.uniform(0.3, 0.5))
    for _ in range(9):
        x_m, y_m = rng.uniform(0.15, 1.15), rng.uniform(0.95, 1.6)
        _fill(panel, x_m, x_m + 0.21, y_m, y_m + 0.3, rng.uniform(0.75, 1.0))
    return panel


def _bookshelf(rng: np.random.Generator, wall_shade: float) -> Panel:
    panel = _wall(wall_shade)
    high_m = rng.uniform(1.6, 2.2)
    _fill(panel, 0.0, PANEL_WIDTH_M, 0.0, high_m, 0.18)
    for low_m in np.arange(0.1, high_m - 0.3, 0.36):
        x_m = 0.06
        while x_m < 1.36:
            _fill(panel, x_m, x_m + 0.06, low_m, low_m + rng.uniform(0.2, 0.3), rng.uniform(0, 1))
            x_m += rng.choice([0.07, 0.07, 0.2])
    return panel


def _cabinets(rng: np.random.Generator, wall_shade: float) -> Panel:
    panel = _wall(wall_shade)
    high_m, shade = rng.uniform(1.0, 1.9), rng.uniform(0.2, 0.9)
    for left_m in (0.05, 0.78):
        _fill(panel, left_m, left_m + 0.67, 0.05, high_m, shade)
        for low_m in np.arange(0.35, high_m, 0.35):
            _fill(panel, left_m, left_m + 0.67, low_m, low_m + 0.03, shade * 0.4)
    return panel


def _plant(rng: np.random.Generator, wall_shade: float) -> Panel:
    panel = _wall(wall_shade)
    _fill(panel, 0.55, 0.95, 0.0, 0.45, rng.uniform(0.5, 0.95))
    for _ in range(60):
        x_m, y_m = rng.normal(0.72, 0.17), rng.normal(1.05, 0.25)
        _fill(panel, x_m, x_m + 0.1, y_m, y_m + 0.12, rng.uniform(0.08, 0.4))
    return panel


def _cardboard() -> Panel:
    """Paint two stacked boxes with tape and labels."""
    panel = _wall(0.55)
    for low_m in (0.0, 1.25):
        _fill(panel, 0.0, PANEL_WIDTH_M, low_m, low_m + 0.03, 0.25)
        _fill(panel, 0.0, PANEL_WIDTH_M, low_m + 0.58, low_m + 0.66, 0.75)
        _fill(panel, 0.2, 0.55, low_m + 0.2, low_m + 0.42, 0.95)
        _fill(panel, 0.8, 1.1, low_m + 0.8, low_m + 1.1, 0.3)
    _fill(panel, 0.0, 0.03, 0.0, WALL_HEIGHT_M, 0.25)
    return panel


def _clothes(rng: np.random.Generator) -> Panel:
    """Paint shoes, trousers, shirt, open jacket and head; the front is at the centre."""
    panel = _wall(rng.uniform(0.1, 0.9))
    trousers, jacket, hair = rng.uniform(0.05, 0.6), rng.uniform(0.1, 0.9), rng.uniform(0.05, 0.5)
    _fill(panel, 0.0, PANEL_WIDTH_M, 0.0, 0.1, 0.05)
    _fill(panel, 0.0, PANEL_WIDTH_M, 0.1, 0.9, trousers)
    for seam_m in (0.0, PANEL_WIDTH_M / 2):
        _fill(panel, seam_m, seam_m + 0.05, 0.1, 0.8, trousers * 0.4)
    open_m = rng.uniform(0.0, 0.2)
    _fill(panel, 0.0, PANEL_WIDTH_M / 2 - open_m, 0.85, 1.45, jacket)
    _fill(panel, PANEL_WIDTH_M / 2 + open_m, PANEL_WIDTH_M, 0.85, 1.45, jacket)
    _fill(panel, 0.0, PANEL_WIDTH_M, 1.45, WALL_HEIGHT_M, hair)
    _fill(panel, 0.4, 1.0, 1.48, 1.68, rng.uniform(0.5, 0.8))
    return panel
