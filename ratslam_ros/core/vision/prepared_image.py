# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Images with what can be computed from them ahead, in another thread."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ratslam_ros.core.vision.local_view import EncodedView
from ratslam_ros.core.vision.visual_odometry import Profiles


@dataclass(frozen=True, slots=True)
class PreparedImage:
    """An image, and what is computed from it alone; None: computed when it is processed."""

    pixels: NDArray[np.uint8]
    encoded: EncodedView | None = None
    profiles: Profiles | None = None
    has_all: bool = False
    """Whether nothing needs the pixels any more but their shape."""
    colour: NDArray[np.uint8] | None = None
    """(H, W, 3) uint8 in BGR order, if a stage wants it."""
