# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Structure of an image: whether it shows enough to be recognised.

An image of a blank wall or of darkness resembles many places, and its normalised view consists of
noise. The measure depends neither on the descriptor nor on the size of templates.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from ratslam_ros.core.common.compiled import compiled
from ratslam_ros.core.vision.image_window import Window, block_means, contiguous

WIDTH_PX, HEIGHT_PX = 48, 36
"""Size to which images are reduced first, which averages most of the sensor noise."""


def structure(image: NDArray[np.uint8], window: Window) -> float:
    """Return the root mean square of the brightness gradient in a window of an image.

    Args:
        image: (H, W) uint8, greyscale.
        window: compared part of the image; windows smaller than 48 x 36 px are not reduced.

    Returns:
        Norm of the central differences, in brightness (0 to 1): between 0, for a uniform image,
        and 1.
    """
    width = min(window.x_max - window.x_min, WIDTH_PX)
    height = min(window.y_max - window.y_min, HEIGHT_PX)
    value = np.empty((height, width))
    block_means(contiguous(image), *window, value)
    return _gradient_rms(value)


@compiled
def _gradient_rms(value: NDArray[np.float64]) -> float:
    height, width = value.shape
    total = 0.0
    for y in range(height):
        for x in range(width):
            dx = value[y, min(x + 1, width - 1)] - value[y, max(x - 1, 0)]
            dy = value[min(y + 1, height - 1), x] - value[max(y - 1, 0), x]
            total += dx * dx + dy * dy
    return math.sqrt(total / (height * width))
