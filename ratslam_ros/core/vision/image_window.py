# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Image windows given by parameters."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ratslam_ros.errors import UnusableParameter


class Window(NamedTuple):
    """A rectangle in pixels; the upper bounds are exclusive."""

    x_min: int
    x_max: int
    y_min: int
    y_max: int


def contiguous(image: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """Return the image as a C-contiguous, writable array, copied only if necessary.

    Numba compiles a function again for each array layout, so only one layout is passed on.
    """
    if image.flags.c_contiguous and image.flags.writeable:
        return image
    return image.copy(order='C')


def window_of(
    image: NDArray[np.uint8],
    name: str,
    x: tuple[int, int],
    y: tuple[int, int],
    min_size: tuple[int, int] = (1, 1),
) -> Window:
    """Return the window of an image that parameter bounds define.

    Args:
        image: (H, W) uint8.
        name: common prefix of the four parameters' names, for the error message.
        x: (min, max) in px; a max of -1 stands for the image width.
        y: (min, max) in px; a max of -1 stands for the image height.
        min_size: smallest valid width and height, in px.

    Raises:
        UnusableParameter: the window exceeds the image or is too small.
    """
    height, width = image.shape
    window = Window(
        x[0], width if x[1] < 0 else x[1],
        y[0], height if y[1] < 0 else y[1],
    )  # fmt: skip
    for axis, low, high, size, min_length in (
        ('x', window.x_min, window.x_max, width, min_size[0]),
        ('y', window.y_min, window.y_max, height, min_size[1]),
    ):
        if high > size or high - low < min_length:
            raise UnusableParameter(
                f'{name}_{axis}_min and _max are {low} and {high}; expected at least '
                f'{min_length} px within the image, which is {width} x {height} px'
            )
    return window
