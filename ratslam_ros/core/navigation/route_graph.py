# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The weighted graph for route planning: links, and shortcuts between close experiences."""

from __future__ import annotations

from collections.abc import Collection
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from ratslam_ros.core.mapping.experience_map import ExperienceMap

if TYPE_CHECKING:  # SciPy loads slowly, so it is imported with the first route
    from scipy.sparse import csr_array

MIN_EDGE_S = 1e-9
"""Least duration of an edge, because SciPy drops edges of weight 0, in s."""

MIN_SHORTCUT_ID_GAP = 10
"""A shortcut connects experiences whose ids differ by more than this. Closer ones are already
linked."""

MIN_SPEED_MPS = 0.01
"""Lower limit of the assumed speed along a shortcut, in m/s."""

SHORTCUT_TURN_RADPS = 1.0
"""Assumed turn rate on a shortcut, in rad/s."""


def route_graph(
    experience_map: ExperienceMap, ahead: float = 1.0, back: float = 1.0, join_m: float = 0.0,
    rejected_shortcuts: Collection[int] = (), blocked: bool = False,
) -> csr_array:
    """Return the adjacency matrix of the map, weighted by durations.

    Args:
        experience_map: the map with n experiences.
        ahead: factor on the duration of a link in its own direction, infinite for never.
        back: factor on the duration of a link in the opposite direction, likewise.
        join_m: maximum length of shortcuts in m, 0 for no shortcuts.
        rejected_shortcuts: experiences without shortcuts.
        blocked: include unlearned links.

    Returns:
        (n, n) durations in s of the fastest edge from row to column. The dtypes are float64 and
        int32 and the rows are sorted, so that SciPy need not convert the matrix.
    """
    count = len(experience_map)
    ends, once = experience_map.link_ends, experience_map.link_table.durations_s
    if blocked:
        unlearned = experience_map.unlearned_ends
        ends = np.concatenate([ends, unlearned])
        once = np.concatenate([once, _crossing_s(experience_map, *unlearned.T)])
    sources, targets = ends.T
    once = np.maximum(once, MIN_EDGE_S)
    ways = (sources, targets, ahead), (targets, sources, back)
    edges = [(start, end, factor * once) for start, end, factor in ways if factor < np.inf]
    if join_m > 0.0 and len(once):
        a, b, between_s = _shortcuts(experience_map, join_m, rejected_shortcuts)
        edges += [(a, b, between_s), (b, a, between_s)]
    row, column, seconds = map(np.concatenate, zip(*edges, strict=True))
    places = row * count + column
    order = np.argsort(places)
    places = places[order]
    first = np.flatnonzero(np.diff(places, prepend=-1))
    row_ends = np.cumsum(np.bincount(places[first] // count, minlength=count))
    from scipy.sparse import csr_array

    return csr_array(
        (
            np.minimum.reduceat(seconds[order], first),
            column[order[first]].astype(np.int32),
            np.concatenate([[0], row_ends]).astype(np.int32),
        ),
        shape=(count, count),
    )


def _shortcuts(
    experience_map: ExperienceMap, join_m: float, rejected_shortcuts: Collection[int]
) -> tuple[NDArray[np.int64], NDArray[np.int64], NDArray[np.float64]]:
    """Return (k,) first ends, (k,) second ends and (k,) durations in s of all shortcuts.

    Experiences without links get no shortcuts.
    """
    from scipy.spatial import cKDTree

    count, poses = len(experience_map), experience_map.poses
    is_linked = np.bincount(experience_map.link_ends.ravel(), minlength=count) > 0
    is_linked[[*rejected_shortcuts]] = False
    linked = np.flatnonzero(is_linked)
    # Building a balanced tree takes longer than it saves.
    tree = cKDTree(poses[linked, :2], balanced_tree=False, compact_nodes=False)
    a, b = linked[tree.query_pairs(join_m, output_type='ndarray')].T  # a < b, as linked ascends
    numbers = a * count + b
    unlearned = np.sort(experience_map.unlearned_ends, axis=1) @ (count, 1)  # blocked
    kept = np.flatnonzero((b - a > MIN_SHORTCUT_ID_GAP) & ~np.isin(numbers, unlearned))
    a, b = a[kept], b[kept]
    return a, b, _crossing_s(experience_map, a, b) + MIN_EDGE_S


def _crossing_s(
    experience_map: ExperienceMap, a: NDArray[np.int64], b: NDArray[np.int64]
) -> NDArray[np.float64]:
    """Return the durations in s from some experiences to others, without a link.

    They assume the mean speed over the links of the map, and a turn on the spot.
    """
    step = experience_map.poses[b] - experience_map.poses[a]
    shapes = experience_map.link_table.shapes
    driven_m, driven_s = shapes[:, 0].sum(), experience_map.link_table.durations_s.sum()
    speed_mps = max(driven_m / driven_s, MIN_SPEED_MPS) if driven_s > 0.0 else MIN_SPEED_MPS
    turn_rad = np.abs((step[:, 2] + np.pi) % (2.0 * np.pi) - np.pi)
    durations_s: NDArray[np.float64] = (
        np.hypot(step[:, 0], step[:, 1]) / speed_mps + turn_rad / SHORTCUT_TURN_RADPS
    )
    return durations_s
