# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Joint compatibility branch and bound (JCBB): the largest set of jointly compatible pairs.

The search assigns the observations one after another, each to a feature or to none. A set of pairs
is continued only if it passes the joint test. Three searches are available:

- ``CORRECT``: a branch is pruned unless pairs(H) + remaining observations > pairs(B), for the
  present set H and the best set B (Neira and Tardós 2001).
- ``PRINTED``: as in Kahn and Mazor (2002), section III.B. An observation is left out only if no
  feature fits it and pairs(H) > pairs(B). This prunes branches that would still win; it exists
  for comparison (benchmarks/published_relocalisation.py).
- ``EXHAUSTIVE``: no pruning apart from the joint test.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ratslam_ros.core.common.compiled import compiled
from ratslam_ros.core.landmarks.compatibility import Fit, Geometry, add_pair, freedom

CORRECT, PRINTED, EXHAUSTIVE = range(3)


@compiled
def search(
    seen: Geometry,
    known: Geometry,
    fit: Fit,
    level: int,
    order: NDArray[np.int64],
    starts: NDArray[np.int64],
    features: NDArray[np.int64],
    limits: NDArray[np.float64],
    used: NDArray[np.bool_],
    bound: int,
    least: int,
    max_nodes: int,
    best: Fit,
) -> tuple[int, int]:
    """Extend the first ``level`` pairs of a fit to the largest set; return its size and the nodes.

    Args:
        seen, known: the features.
        fit: the joint test; its first ``level`` pairs stay.
        level: number of given pairs.
        order: (k,) observations to assign, in this order.
        starts: (k + 1,) places of the candidates of each observation within ``features``.
        features: candidates, known features that pass the unary test, best first.
        limits: chi-square quantiles by degrees of freedom.
        used: (n_known,) features of the given pairs; restored on return.
        bound: CORRECT, PRINTED or EXHAUSTIVE, see the module.
        least: sets with at most this many pairs are not of interest.
        max_nodes: largest number of joint tests.
        best: receives the best set in ``seen`` and ``known``; unchanged if the size is ``least``.
    """
    count = len(order)
    place = np.zeros(count + 1, np.int64)
    took = np.full(count + 1, -1, np.int64)
    was_mapped = np.zeros(count + 1, np.bool_)
    depth, nodes, most = 0, 0, least
    place[0] = starts[0]
    while depth >= 0:
        if depth == count:
            if level > most:
                most = level
                for k in range(level):
                    best.seen[k], best.known[k] = fit.seen[k], fit.known[k]
        else:
            remaining = count - depth - 1
            descends = False
            # Another pair of this observation may win only if all others together exceed B.
            if bound != CORRECT or level + 1 + remaining > most:
                while place[depth] < starts[depth + 1] and nodes < max_nodes:
                    j = features[place[depth]]
                    place[depth] += 1
                    if used[j]:
                        continue
                    nodes += 1
                    distance2 = add_pair(seen, known, fit, level, order[depth], j)
                    if distance2 <= limits[freedom(fit, level + 1)]:
                        used[j] = True
                        took[depth] = j
                        was_mapped[depth] = True
                        level += 1
                        descends = True
                        break
            else:
                place[depth] = starts[depth + 1]
            if not descends and place[depth] <= starts[depth + 1]:
                place[depth] = starts[depth + 1] + 1  # The branch without a pair is next.
                took[depth] = -1
                if bound == CORRECT:
                    descends = level + remaining > most
                elif bound == PRINTED:
                    descends = not was_mapped[depth] and level > most
                else:
                    descends = True
                descends = descends and nodes < max_nodes
            if descends:
                depth += 1
                took[depth] = -1
                if depth < count:
                    place[depth] = starts[depth]
                    was_mapped[depth] = False
                continue
        depth -= 1
        if depth >= 0 and took[depth] >= 0:
            used[took[depth]] = False
            took[depth] = -1
            level -= 1
    return most, nodes
