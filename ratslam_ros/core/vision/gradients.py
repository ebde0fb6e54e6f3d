# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Views of gradient orientations, which change little with the light.

See docs/descriptors.md, "Gradients".
"""

from __future__ import annotations

import math
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from ratslam_ros.core.common.compiled import compiled_without_gil
from ratslam_ros.core.config import LocalViewParameters
from ratslam_ros.core.vision.encoder import Image, Layout, View
from ratslam_ros.core.vision.image_window import block_means, contiguous, cropped

Values = NDArray[np.float64]

ORIENTATIONS = 6
"""Number of gradient directions that are distinguished, over 360 degrees."""

CELL_PX = 4
"""Largest width and height of a cell, in pixels of the reduced image."""

OUTSIDE = 32
"""Byte of cells beyond the left and right edge, about 0.4 of the mean. It is the cost of a shift:
with 0, cells that only one of two views shows would differ by their whole content."""

_ANGLES = [2.0 * math.pi * k / ORIENTATIONS for k in range(ORIENTATIONS)]
_DIRECTIONS = np.array([(math.cos(a), math.sin(a)) for a in _ANGLES])


class Gradients:
    """Encoder of gradient orientations in cells (``vt_descriptor: gradients``).

    A view has ``template_x_size`` x ``template_y_size`` cells and one plane per orientation.
    Shifts are in cells. Empty cells on both sides allow comparing the full width at every
    horizontal shift, unless the view is panoramic.
    """

    wants_colour: ClassVar[bool] = False

    def __init__(self, parameters: LocalViewParameters) -> None:
        p = self._p = parameters
        self._margin = 0 if p.vt_panoramic else p.vt_shift_match
        self.layout = Layout(
            p.template_x_size + 2 * self._margin, ORIENTATIONS * p.template_y_size, ORIENTATIONS,
            p.vt_shift_match, p.vt_shift_match_y, p.vt_step_match, p.vt_panoramic,
        )

    def encode(self, image: Image) -> View | None:
        """Return the view of an image, or None if its contrast is too low.

        Raises:
            UnusableParameter: the crop exceeds the image, or has less than 2 px per cell.
        """
        p = self._p
        columns, rows = p.template_x_size, p.template_y_size
        window = cropped(image, p, (2 * columns, 2 * rows))
        cell_width = min((window.x_max - window.x_min) // columns, CELL_PX)
        cell_height = min((window.y_max - window.y_min) // rows, CELL_PX)
        value = np.empty((rows * cell_height, columns * cell_width))
        block_means(contiguous(image), *window, value)
        view = np.full((ORIENTATIONS, rows, self.layout.width), OUTSIDE, np.uint8)
        contrast = _encode(value, p.vt_panoramic, columns, self._margin, view)
        return view.reshape(self.layout.height, -1) if contrast > 0.0 else None


@compiled_without_gil
def _encode(
    value: Values, cyclic: bool, columns: int, margin: int, view: NDArray[np.uint8]
) -> float:
    """Fill ``columns`` of ``view`` (orientations, rows, width), from column ``margin`` on.

    Args:
        value: (h, w) reduced image.
        cyclic: whether the left edge of the image continues the right one.
        columns, margin: number of columns to fill, and the first one.
        view: output.

    Returns:
        Root mean square over the cells of the gradient strength, in brightness (0 to 1) per
        pixel. The view is not filled if it is 0.
    """
    orientations, rows, _ = view.shape
    height, width = value.shape
    cell_height, cell_width = height // rows, width // columns
    energy = np.zeros((orientations, rows, columns))
    response = np.empty(orientations)
    for y in range(height):
        # Each pixel contributes to the two nearest cells of each axis, by linear interpolation.
        y_place = (y + 0.5) / cell_height - 0.5
        top = math.floor(y_place)
        for x in range(width):
            if cyclic:
                dx = value[y, (x + 1) % width] - value[y, (x - 1) % width]
            else:
                dx = value[y, min(x + 1, width - 1)] - value[y, max(x - 1, 0)]
            dy = value[min(y + 1, height - 1), x] - value[max(y - 1, 0), x]
            strength = math.sqrt(dx * dx + dy * dy)
            if strength == 0.0:
                continue
            for k in range(orientations):
                c = max((dx * _DIRECTIONS[k, 0] + dy * _DIRECTIONS[k, 1]) / strength, 0.0)
                response[k] = strength * (c * c) * (c * c)
            x_place = (x + 0.5) / cell_width - 0.5
            left = math.floor(x_place)
            for row in range(max(top, 0), min(top + 2, rows)):
                y_weight = 1.0 - abs(y_place - row)
                for i in range(left, left + 2):
                    column = i % columns if cyclic else i
                    if column < 0 or column >= columns:
                        continue
                    weight = y_weight * (1.0 - abs(x_place - i))
                    for k in range(orientations):
                        energy[k, row, column] += weight * response[k]

    total = 0.0
    cell = np.zeros((rows, columns))
    area = cell_height * cell_width
    for row in range(rows):
        for column in range(columns):
            square = 0.0
            for k in range(orientations):
                energy[k, row, column] /= area
                square += energy[k, row, column] * energy[k, row, column]
            cell[row, column] = math.sqrt(square)
            total += square
    contrast = math.sqrt(total / (rows * columns))
    if contrast == 0.0:
        return contrast

    # The square root of the share of an orientation in the strength of its cell, where cells that
    # are weak in comparison with the view count less.
    for k in range(orientations):
        for row in range(rows):
            for column in range(columns):
                share = energy[k, row, column] / (cell[row, column] + contrast)
                view[k, row, margin + column] = math.floor(255.0 * math.sqrt(share) + 0.5)
    return contrast
