# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Messages that wait for others, as part of a saved state."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from ratslam_ros.core.common.odometry import Odometry, odometry_from_state, odometry_state
from ratslam_ros.core.common.scan import Scan, scan_from_state, scan_state
from ratslam_ros.core.common.state import State
from ratslam_ros.core.vision.local_view import ViewMatch, match_from_state, match_state
from ratslam_ros.core.vision.prepared_image import PreparedImage


def item_state(item: Odometry | Scan | ViewMatch | PreparedImage | None) -> State:
    """Return a held message for a saved state."""
    if isinstance(item, Odometry):
        return {'odometry': odometry_state(item)}
    if isinstance(item, Scan):
        return {'scan': scan_state(item)}
    if isinstance(item, ViewMatch):
        return {'match': match_state(item)}
    return {'image': image_state(item)}


def item_from_state(state: State) -> Any:
    """Return a held message from ``item_state``."""
    ((kind, value),) = state.items()
    decode: dict[str, Callable[[Any], Any]] = {
        'odometry': odometry_from_state, 'scan': scan_from_state, 'match': match_from_state,
        'image': image_from_state,
    }  # fmt: skip
    return decode[kind](value)


def image_state(image: PreparedImage | None) -> Any:
    """Return an image for a saved state."""
    return None if image is None else np.array(image.pixels)


def image_from_state(value: Any) -> PreparedImage | None:
    """Return an image from ``image_state``."""
    return None if value is None else PreparedImage(np.asarray(value, np.uint8))
