# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Travel time from the robot to every experience over the links of the map."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ratslam_ros.core.mapping.map_changes import MapMirror

SHORTEST_S = 1e-3
"""Least duration of a link: SciPy takes an entry of 0 for a link that does not exist."""


def travel_times(graph: MapMirror) -> NDArray[np.float64]:
    """Return (n,) times in s from the current experience; infinite if there is no way.

    Links count in both directions, as the map shows which places are far, not which way to take.
    """
    from scipy.sparse import csr_array
    from scipy.sparse.csgraph import dijkstra

    n = len(graph)
    if not 0 <= graph.current_id < n:
        return np.full(n, np.inf)
    rows = graph.link_rows
    used = rows.ends[:, 0] >= 0
    ends, durations_s = rows.ends[used], np.maximum(rows.durations_s[used], SHORTEST_S)
    # Both links of a pair of experiences are kept apart: entries of one place would be added.
    pairs, first = np.unique(ends, axis=0, return_index=True)
    pairs = pairs.astype(np.int32)  # SciPy before 1.15 requires 32-bit indices
    matrix = csr_array((durations_s[first], (pairs[:, 0], pairs[:, 1])), shape=(n, n))
    times_s: NDArray[np.float64] = dijkstra(matrix, directed=False, indices=graph.current_id)
    return times_s
