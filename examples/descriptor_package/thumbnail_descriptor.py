# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""A descriptor for ratslam_ros: the contrast of a thumbnail, in 32 x 24 px."""

from collections.abc import Sequence

import cv2
import numpy as np
from numpy.typing import NDArray


class Thumbnail:
    """Grey values of a thumbnail minus those of its blurred copy."""

    def compute(self, images: Sequence[NDArray[np.uint8]]) -> NDArray[np.float32]:
        """Return (n, 768) descriptors of n images, (H, W) uint8 grey."""
        return np.stack([self._one(image) for image in images])

    def _one(self, image: NDArray[np.uint8]) -> NDArray[np.float32]:
        small = cv2.resize(image, (32, 24), interpolation=cv2.INTER_AREA).astype(np.float32)
        return (small - cv2.GaussianBlur(small, (0, 0), 3.0)).reshape(-1)
