# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Rectangles of an image that are given by parameters."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ratslam_ros.errors import UnusableParameter


class Window(NamedTuple):
    """A rectangle in px; the upper bounds are exclusive."""

    x_min: int
    x_max: int
    y_min: int
    y_max: int


def plain(image: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """Return the image as one writable stretch of memory, copied only where it is not.

    Compiled code is made anew for each kind of array; so there is one kind.
    """
    if image.flags.c_contiguous and image.flags.writeable:
        return image
    return image.copy(order='C')


def window_of(
    image: NDArray[np.uint8],
    name: str,
    x: tuple[int, int],
    y: tuple[int, int],
    least: tuple[int, int] = (1, 1),
) -> Window:
    """Return the window that a pair of parameter bounds names in an image.

    Args:
        image: (H, W) uint8.
        name: what the four parameters' names begin with, for the error.
        x: (min, max) px; a max of -1 means the whole width.
        y: (min, max) px; a max of -1 means the whole height.
        least: smallest width and height that will do, px.

    Raises:
        UnusableParameter: the window is outside the image or too small.
    """
    height, width = image.shape
    window = Window(
        x[0], width if x[1] < 0 else x[1],
        y[0], height if y[1] < 0 else y[1],
    )  # fmt: skip
    for axis, low, high, size, need in (
        ('x', window.x_min, window.x_max, width, least[0]),
        ('y', window.y_min, window.y_max, height, least[1]),
    ):
        if high > size or high - low < need:
            raise UnusableParameter(
                f'{name}_{axis}_min and _max are {low} and {high}; expected at least {need} px '
                f'within the image, which is {width} x {height} px'
            )
    return window
