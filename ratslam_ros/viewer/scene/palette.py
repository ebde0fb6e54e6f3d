# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Colours of the scene: themes, categories and scales that colour-blind people can tell apart."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache

import numpy as np
from numpy.typing import NDArray

Rgb = tuple[int, int, int]
Bytes = NDArray[np.uint8]

LEVELS = 32
"""Number of colours of a scale. Few levels mean that slowly changing values change few colours,
so that few parts of the map are sent again; 32 steps cannot be told apart by eye."""


@dataclass(frozen=True)
class Theme:
    """Colours that are readable on one background.

    The categories are those of Okabe and Ito, some darker or lighter for contrast.
    ``scale_range`` is the part of viridis that stands out from the background; high values
    contrast most.
    """

    background: Rgb
    text: Rgb
    grid: Rgb
    driven: Rgb
    experience: Rgb
    recognised: Rgb
    closure: Rgb
    robot: Rgb
    trail: Rgb
    dead_reckoning: Rgb
    truth: Rgb
    route: Rgb
    goal: Rgb
    scan: Rgb
    rejected: Rgb
    selected: Rgb
    unknown: Rgb
    scale_range: tuple[float, float]


LIGHT = Theme(
    background=(255, 255, 255), text=(60, 60, 60), grid=(228, 230, 234),
    driven=(120, 132, 150), experience=(0, 92, 150), recognised=(40, 150, 205),
    closure=(213, 94, 0), robot=(180, 30, 90), trail=(238, 190, 214),
    dead_reckoning=(140, 140, 140), truth=(0, 138, 100), route=(204, 121, 0),
    goal=(204, 121, 0), scan=(0, 158, 115), rejected=(200, 40, 40), selected=(0, 0, 0),
    unknown=(185, 185, 185), scale_range=(0.86, 0.0),
)

DARK = Theme(
    background=(20, 20, 20), text=(215, 215, 215), grid=(44, 47, 52),
    driven=(104, 116, 134), experience=(86, 180, 233), recognised=(70, 140, 200),
    closure=(255, 140, 40), robot=(255, 120, 190), trail=(96, 48, 72),
    dead_reckoning=(150, 150, 150), truth=(0, 190, 140), route=(240, 228, 66),
    goal=(240, 228, 66), scan=(60, 220, 165), rejected=(255, 90, 90), selected=(255, 255, 255),
    unknown=(90, 90, 90), scale_range=(0.22, 1.0),
)


@cache
def scale_colours(theme: Theme) -> Bytes:
    """Return (LEVELS, 3) colours of the perceptually uniform scale, lowest value first."""
    from matplotlib import colormaps

    low, high = theme.scale_range
    table = colormaps['viridis'](np.linspace(low, high, LEVELS))[:, :3]
    return np.round(255 * table).astype(np.uint8)


def scaled(values: NDArray[np.float64], low: float, high: float, theme: Theme) -> Bytes:
    """Return the (n, 3) colours of values in a range; ``unknown`` if a value is not finite."""
    known = np.isfinite(values)
    share = np.clip((np.where(known, values, low) - low) / max(high - low, 1e-12), 0.0, 1.0)
    colours = scale_colours(theme)[np.minimum((share * LEVELS).astype(np.int64), LEVELS - 1)]
    colours[~known] = theme.unknown
    return colours


def mixed(a: Rgb, b: Rgb, share: float) -> Rgb:
    """Return the colour between two, ``share`` of the way from the first to the second."""
    red, green, blue = (round(p + share * (q - p)) for p, q in zip(a, b, strict=True))
    return red, green, blue
