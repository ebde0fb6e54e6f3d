# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Picking: what a ray from the camera hits on the map."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ratslam_ros.history.run_state import RunState
from ratslam_ros.viewer.scene.colouring import is_closure

TOLERANCE = 0.015
"""Largest distance of a hit from the ray, as a share of the distance from the camera: about 10
pixels of a view 720 pixels high."""

LEAST_SLOPE = 1e-3
"""Least downward part of a ray's direction; flatter rays hit the ground nowhere near the map."""


@dataclass(frozen=True, slots=True)
class Pick:
    """What was clicked.

    Attributes:
        kind: an experience, a loop closure, or the ground.
        point: x, y and z in m of the hit on the ground.
        id: the experience, -1 if it is none.
        ends: source and target of the closure, -1 if it is none.
    """

    kind: Literal['experience', 'closure', 'ground']
    point: tuple[float, float, float]
    id: int = -1
    ends: tuple[int, int] = (-1, -1)


def pick(origin: ArrayLike, direction: ArrayLike, state: RunState) -> Pick | None:
    """Return what a ray hits first on the map: an experience, a closure, or the ground.

    Args:
        origin: (3,) position of the camera in m.
        direction: (3,) direction of the ray.
        state: the state that is drawn.

    Returns:
        None if the ray does not hit the ground in front of the camera.
    """
    start, along = np.asarray(origin, float), np.asarray(direction, float)
    length = float(np.linalg.norm(along))
    if not np.isfinite(start).all() or not np.isfinite(length) or length == 0.0:
        return None
    along = along / length
    if abs(along[2]) < LEAST_SLOPE or (far_m := -start[2] / along[2]) <= 0.0:
        return None
    x, y = (start + far_m * along)[:2].tolist()
    point = (x, y, 0.0)
    tolerance_m = TOLERANCE * far_m
    places = state.map.poses[:, :2]
    if len(places):
        gaps = np.hypot(places[:, 0] - x, places[:, 1] - y)
        gaps[~np.isfinite(gaps)] = np.inf
        nearest = int(np.argmin(gaps))
        if gaps[nearest] <= tolerance_m:
            return Pick('experience', point, id=nearest)
        rows = state.map.link_rows
        closing = np.flatnonzero(is_closure(rows))
        ends = rows.ends[closing]
        gaps = _line_gaps(np.array([x, y]), places[ends[:, 0]], places[ends[:, 1]])
        if len(gaps) and gaps[nearest := int(np.argmin(gaps))] <= tolerance_m:
            source, target = ends[nearest].tolist()
            return Pick('closure', point, ends=(source, target))
    return Pick('ground', point)


def _line_gaps(
    point: NDArray[np.float64], a: NDArray[np.float64], b: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Return the distances of a point from the (n, 2) lines between a and b."""
    along = b - a
    square = np.maximum((along**2).sum(axis=1), 1e-12)
    share = np.clip(((point - a) * along).sum(axis=1) / square, 0.0, 1.0)
    gaps: NDArray[np.float64] = np.hypot(*(a + share[:, None] * along - point).T)
    gaps[~np.isfinite(gaps)] = np.inf
    return gaps
