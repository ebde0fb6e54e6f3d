# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Views of grey values: block means of an image, optionally normalised.

See docs/algorithm.md, "Local view".
"""

from __future__ import annotations

import math
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from ratslam_ros.core.common.compiled import compiled, compiled_without_gil
from ratslam_ros.core.config import LocalViewParameters
from ratslam_ros.core.vision.encoder import Image, Layout, View
from ratslam_ros.core.vision.image_window import Window, block_means, contiguous, cropped

Values = NDArray[np.float64]


class Intensity:
    """Encoder of views of grey values (``vt_descriptor: intensity``)."""

    wants_colour: ClassVar[bool] = False

    def __init__(self, parameters: LocalViewParameters) -> None:
        p = self._p = parameters
        self.layout = Layout(
            p.template_x_size, p.template_y_size, shift_x=p.vt_shift_match,
            shift_y=p.vt_shift_match_y, step=p.vt_step_match, panoramic=p.vt_panoramic,
            signed=p.vt_patch_normalise > 0,
            # Grey values differ little in scenes of low contrast; too low only costs templates.
            typical=0.18 if p.vt_patch_normalise > 0 else 0.05,
        )

    def encode(self, image: Image) -> View | None:
        """Return the view of an image; see ``make_view``."""
        return make_view(image, self._p)


def make_view(image: Image, p: LocalViewParameters) -> Image:
    """Reduce a greyscale image to a view: crop, downsample by block means, and normalise.

    Args:
        image: (H, W) uint8, greyscale.
        p: crop, template size and normalisation.

    Returns:
        (template_y_size, template_x_size) uint8.

    Raises:
        UnusableParameter: the crop exceeds the image or is smaller than the template.
    """
    window = crop_window(image, p)
    view = np.empty((p.template_y_size, p.template_x_size), np.uint8)
    _make_view(
        contiguous(image), *window, p.vt_normalisation, p.vt_normalise_range,
        p.vt_patch_normalise, p.vt_min_patch_normalisation_std, view,
    )
    return view


def crop_window(image: Image, p: LocalViewParameters) -> Window:
    """Return the crop of an image that is compared.

    Raises:
        UnusableParameter: the crop exceeds the image or is smaller than the template.
    """
    return cropped(image, p, (p.template_x_size, p.template_y_size))


@compiled_without_gil
def _make_view(
    image: Image, x_min: int, x_max: int, y_min: int, y_max: int,
    normalise_to: float, by_range: bool, patch_radius: int, min_std: float, view: Image,
) -> None:
    """Fill ``view`` (h, w) from a window of an image; sums are exact or in a fixed order."""
    rows, columns = view.shape
    value = np.empty((rows, columns), np.float64)
    block_means(image, x_min, x_max, y_min, y_max, value)
    if by_range or normalise_to > 0.0:
        _normalise(value, normalise_to, by_range)
    if patch_radius > 0:
        _normalise_patches(value, patch_radius, min_std, view)
        return
    for row in range(rows):
        for column in range(columns):
            view[row, column] = math.floor(255.0 * value[row, column] + 0.5)


@compiled
def _normalise(value: Values, mean_to: float, by_range: bool) -> None:
    """Normalise ``value`` (h, w) by its mean, its range or both; see ``vt_normalise_range``."""
    rows, columns = value.shape
    total_value = 0.0
    low = high = value[0, 0]
    for row in range(rows):
        for column in range(columns):
            v = value[row, column]
            total_value += v
            low, high = min(low, v), max(high, v)
    mean = total_value / (rows * columns)
    if not by_range and mean == 0.0:
        return  # A black view stays black.
    for row in range(rows):
        for column in range(columns):
            v = value[row, column]
            if not by_range:
                v = v * mean_to / mean
            elif high == low:
                v = mean_to
            elif mean_to > 0.0:
                v = mean_to + (v - mean) / (high - low)
            else:
                v = (v - low) / (high - low)
            value[row, column] = min(max(v, 0.0), 1.0)


@compiled
def _normalise_patches(value: Values, n: int, min_std: float, view: Image) -> None:
    """Fill ``view`` from ``value`` (h, w), normalised by mean and deviation of each patch."""
    rows, columns = value.shape
    area = (2 * n + 1) * (2 * n + 1)
    # Separable box sums, columns first, with replicated edges. The mean of the view is subtracted
    # first, to reduce cancellation in the sums of squares.
    middle = 0.0
    for row in range(rows):
        for column in range(columns):
            middle += value[row, column]
    middle /= rows * columns
    sums = np.zeros((rows, columns))
    squares = np.zeros((rows, columns))
    for row in range(rows):
        for dx in range(-n, n + 1):
            for column in range(columns):
                v = value[row, min(max(column + dx, 0), columns - 1)] - middle
                sums[row, column] += v
                squares[row, column] += v * v
    total = np.empty(columns)
    total_square = np.empty(columns)
    for row in range(rows):
        total[:] = 0.0
        total_square[:] = 0.0
        for dy in range(-n, n + 1):
            y = min(max(row + dy, 0), rows - 1)
            for column in range(columns):
                total[column] += sums[y, column]
                total_square[column] += squares[y, column]
        for column in range(columns):
            mean = middle + total[column] / area
            variance = total_square[column] / area - (mean - middle) * (mean - middle)
            if variance < 1e-8:
                # Rounding errors dominate so small a variance: compute it by the definition. A
                # uniform patch then has a deviation of at most 1e-12.
                variance = 0.0
                for dy in range(-n, n + 1):
                    y = min(max(row + dy, 0), rows - 1)
                    for dx in range(-n, n + 1):
                        d = value[y, min(max(column + dx, 0), columns - 1)] - mean
                        variance += d * d
                variance /= area
            std = math.sqrt(variance)
            if std <= 1e-12 or std < min_std:
                v = 0.5
            else:
                v = min(max(((value[row, column] - mean) / std + 3.0) / 6.0, 0.0), 1.0)
            view[row, column] = math.floor(255.0 * v + 0.5)
