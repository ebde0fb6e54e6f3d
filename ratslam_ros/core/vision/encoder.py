# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Interface of the encoders, which reduce an image to the bytes that are compared."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

Image = NDArray[np.uint8]
View = NDArray[np.uint8]
"""Encoded image, (height, width) uint8. Views are compared by their sum of absolute differences,
at the shifts of a ``Layout``."""


@dataclass(frozen=True, slots=True)
class Layout:
    """Shape of the views of an encoder, and the shifts at which they are compared."""

    width: int
    height: int
    """Height of a view, with all planes."""
    planes: int = 1
    """Number of planes of equal height that a view consists of, one above the other. They are
    shifted together."""
    shift_x: int = 0
    """Largest horizontal shift to either side, in columns."""
    shift_y: int = 0
    """Largest vertical shift up and down, in rows."""
    step: int = 1
    """Step between the horizontal shifts, in columns."""
    panoramic: bool = False
    """Whether all rotations are compared instead of shifts up to ``shift_x``."""
    signed: bool = False
    """Whether values are deviations from the centre of the range, and most are close to it."""
    typical: float = 0.1
    """Typical mean difference between views of unrelated places, from 0 to 1, with which an
    automatic threshold starts."""


class Encoder(Protocol):
    """Reduces images to views of one layout."""

    @property
    def layout(self) -> Layout:
        """Shape and shifts of the views."""
        ...

    @property
    def wants_colour(self) -> bool:
        """Whether ``encode`` takes (H, W, 3) uint8 in BGR order as well."""
        ...

    def encode(self, image: Image) -> View | None:
        """Return the view of an image, (H, W) uint8 grey; None if it has too little structure.

        Raises:
            UnusableParameter: the crop or the size of a view does not fit the image.
        """
        ...
