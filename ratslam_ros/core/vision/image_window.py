# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Image windows given by parameters, and their reduction by block means."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ratslam_ros.core.common.compiled import compiled_without_gil
from ratslam_ros.core.config import LocalViewParameters
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
        image: (H, W) or (H, W, channels) uint8.
        name: common prefix of the four parameters' names, for the error message.
        x: (min, max) in px; a max of -1 stands for the image width.
        y: (min, max) in px; a max of -1 stands for the image height.
        min_size: smallest valid width and height, in px.

    Raises:
        UnusableParameter: the window exceeds the image or is too small.
    """
    height, width = image.shape[:2]
    window = Window(
        x[0], width if x[1] < 0 else x[1],
        y[0], height if y[1] < 0 else y[1],
    )
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


def cropped(
    image: NDArray[np.uint8], p: LocalViewParameters, min_size: tuple[int, int] = (1, 1)
) -> Window:
    """Return the crop of an image that is compared.

    Args:
        image: (H, W) or (H, W, channels) uint8.
        p: crop.
        min_size: smallest valid width and height, in px.

    Raises:
        UnusableParameter: the crop exceeds the image or is too small.
    """
    return window_of(
        image,
        'local_view.image_crop',
        (p.image_crop_x_min, p.image_crop_x_max),
        (p.image_crop_y_min, p.image_crop_y_max),
        min_size,
    )


@compiled_without_gil
def block_means(
    image: NDArray[np.uint8], x_min: int, x_max: int, y_min: int, y_max: int,
    value: NDArray[np.float64],
) -> None:
    """Fill ``value`` (h, w) with the mean brightness of blocks of a window, from 0 to 1.

    Block borders are rounded down. The sums are integers, so the result is exact to the last
    rounding.
    """
    height, width = y_max - y_min, x_max - x_min
    rows, columns = value.shape
    sums = np.empty(width, np.int64)
    edges = np.array([column * width // columns for column in range(columns + 1)])
    for row in range(rows):
        top = row * height // rows
        bottom = (row + 1) * height // rows
        for x in range(width):
            sums[x] = 0
        for y in range(top, bottom):
            line = image[y_min + y, x_min:x_max]
            for x in range(width):
                sums[x] += line[x]
        for column in range(columns):
            total = 0
            for x in range(edges[column], edges[column + 1]):
                total += sums[x]
            count = (bottom - top) * (edges[column + 1] - edges[column])
            value[row, column] = total / (count * 255.0)
