# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The graph that routes are planned on."""

from __future__ import annotations

from collections.abc import Collection
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from ratslam_ros.core.mapping.experience_map import ExperienceMap

if TYPE_CHECKING:  # SciPy takes long to load: it is loaded where the first route is asked for
    from scipy.sparse import csr_array

SHORTEST_S = 1e-9
"""A link's least duration: a graph's edge of length 0 would be no edge."""

NEWEST = 10
"""Experiences made so soon one after the other are not joined beside their links."""

TILE_M = 4.0
"""Places are joined where links lead from one to the other within squares of this width: over so
short a way the map is right, whatever it does to loops that are not closed yet."""

SLOWEST_MPS = 0.01

TURN_RADPS = 1.0
"""How fast a robot turns where ways are joined."""


def route_graph(
    experience_map: ExperienceMap, ahead: float = 1.0, back: float = 1.0, join_m: float = 0.0,
    rejected_shortcuts: Collection[int] = (),
) -> csr_array:  # fmt: skip
    """Return (n, n) seconds between linked experiences, the quickest link for both directions.

    It is as SciPy computes on it, which then converts nothing: float64 and int32, rows in order.
    ``ahead``, ``back``: factors for the links in their own direction and in the other one.
    ``join_m``: experiences no further apart on the map count as linked, except for
    ``rejected_shortcuts``.
    """
    count = len(experience_map)
    sources, targets = experience_map.link_ends.T
    once = np.maximum(experience_map.link_durations_s, SHORTEST_S)
    rows, columns = [sources, targets], [targets, sources]
    seconds = [ahead * once, back * once]
    if join_m > 0.0 and len(once):
        a, b, between_s = _shortcuts(experience_map, join_m, rejected_shortcuts)
        rows, columns = [*rows, a, b], [*columns, b, a]
        seconds += [between_s, between_s]
    column = np.concatenate(columns)
    places = np.concatenate(rows) * count + column
    order = np.argsort(places, kind='stable')  # the quick one where most is in order already
    places = places[order]
    first = np.flatnonzero(np.diff(places, prepend=-1))
    row_ends = np.cumsum(np.bincount(places[first] // count, minlength=count))
    from scipy.sparse import csr_array

    return csr_array(
        (
            np.minimum.reduceat(np.concatenate(seconds)[order], first),
            column[order[first]].astype(np.int32),
            np.concatenate([[0], row_ends]).astype(np.int32),
        ),
        shape=(count, count),
    )


def _shortcuts(
    experience_map: ExperienceMap, join_m: float, rejected_shortcuts: Collection[int]
) -> tuple[NDArray[np.int64], NDArray[np.int64], NDArray[np.float64]]:
    """Return pairs of experiences that lie close together on the map, and s from one to the other.

    Only of those that have links: what was unlearned altogether is no place to go through. The
    robot goes there as fast as over the links, and turns on the spot.
    """
    from scipy.spatial import cKDTree

    linked = np.unique(experience_map.link_ends)
    if rejected_shortcuts:
        linked = np.setdiff1d(linked, np.fromiter(rejected_shortcuts, np.int64))
    poses = experience_map.poses[linked]
    pairs = cKDTree(poses[:, :2]).query_pairs(join_m, output_type='ndarray')
    # Neighbours in time are linked already.
    apart = linked[pairs[:, 1]] - linked[pairs[:, 0]]
    pairs = pairs[apart > NEWEST]
    unlearned = np.sort(experience_map.unlearned_ends, axis=1) @ (len(experience_map), 1)
    numbers = np.sort(linked[pairs], axis=1) @ (len(experience_map), 1)
    pairs = pairs[~np.isin(numbers, unlearned)]  # no way leads from one to the other any more
    pairs = pairs[_near_over_links(experience_map, linked[pairs])]
    step = poses[pairs[:, 1]] - poses[pairs[:, 0]]
    shapes = experience_map.link_shapes
    driven_m, driven_s = shapes[:, 0].sum(), experience_map.link_durations_s.sum()
    speed_mps = max(driven_m / driven_s, SLOWEST_MPS) if driven_s > 0.0 else SLOWEST_MPS
    turn_rad = np.abs((step[:, 2] + np.pi) % (2.0 * np.pi) - np.pi)
    seconds = np.hypot(step[:, 0], step[:, 1]) / speed_mps + turn_rad / TURN_RADPS + SHORTEST_S
    return linked[pairs[:, 0]], linked[pairs[:, 1]], seconds


def _near_over_links(
    experience_map: ExperienceMap, pairs: NDArray[np.int64]
) -> NDArray[np.bool_]:
    """Return (n,) whether links lead from one of a pair to the other without going far away.

    Also such as were unlearned: where something stands now they still say how the places lie.
    """
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import connected_components

    count = len(experience_map)
    ends = np.concatenate([experience_map.link_ends, experience_map.unlearned_ends])
    places = experience_map.poses[:, :2] / TILE_M
    found = np.zeros(len(pairs), np.bool_)
    for shift in ((0.0, 0.0), (0.0, 0.5), (0.5, 0.0), (0.5, 0.5)):
        tiles = np.floor(places + shift)
        inside = ends[(tiles[ends[:, 0]] == tiles[ends[:, 1]]).all(axis=1)]
        graph = coo_array((np.ones(len(inside)), inside.T), shape=(count, count))
        _, part = connected_components(graph, directed=False)
        found |= part[pairs[:, 0]] == part[pairs[:, 1]]
    return found
