# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Interface of the encoders, which reduce an image to the bytes that are compared."""

from __future__ import annotations

from typing import Protocol

import numpy as np
from numpy.typing import NDArray

Image = NDArray[np.uint8]
View = NDArray[np.uint8]
"""Encoded image, (rows, columns) uint8. Views are compared by their sum of absolute differences,
at shifts of whole columns and rows."""


class Encoder(Protocol):
    """Reduces images to views of one size."""

    @property
    def rows(self) -> int:
        """Height of a view."""
        ...

    @property
    def columns(self) -> int:
        """Width of a view."""
        ...

    @property
    def signed(self) -> bool:
        """Whether values are deviations from the centre of the range; see `TemplateMemory`."""
        ...

    @property
    def typical(self) -> float:
        """Typical mean difference between views of unrelated places, from 0 to 1."""
        ...

    def encode(self, image: Image) -> View | None:
        """Return the view of an image, (H, W) uint8 grey; None if it has too little structure.

        Raises:
            UnusableParameter: the crop or the size of a view does not fit the image.
        """
        ...
