# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Adaptation: how often transitions were made and failed -> the links to be unlearned.

Seed 000, section III.D. Two things are a failed try of the transition that a link stands for:

- Its behaviour led from its source to another experience. Places that take turns do so all the
  time, so this counts for little: a link is in question only once its behaviour has led elsewhere
  ``exp_min_tries`` times on end, and stays where no other links soon lead round it.
- A behaviour timed out before it: something stands there. Here what was long ago says little, so
  a link that was made many times counts as made ``exp_recent_tries`` times.

Both are counted from when the link was last made: a transition that is made again is possible.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from ratslam_ros.core.common.compiled import compiled
from ratslam_ros.core.config import ExperienceMapParameters

ELSEWHERE, TIMED_OUT = 0, 1
"""Columns of a link's failures."""

AHEAD_M = 0.2
"""What a blocked transition leads to lies at least this far ahead of the robot."""

DETOUR = 8.0
"""A way round that takes at most so many times as long stands in for a link that is unlearned."""


def confidences(
    counts: Sequence[int], failures: NDArray[np.int64]
) -> list[float]:
    """Return c_ij = n_ij / n_i,beta, equation (9), of all links of one source and behaviour.

    n_i,beta is how often the behaviour was tried: the transitions by it to any experience, and
    its time-outs before the link in question.

    Args:
        counts: (links,) how often each transition was made.
        failures: (links, 2) ``ELSEWHERE``, ``TIMED_OUT``.
    """
    total = sum(counts)
    return [
        made / (total + time_outs)
        for made, time_outs in zip(counts, failures[:, TIMED_OUT].tolist(), strict=True)
    ]


def in_question(
    counts: Sequence[int], failures: NDArray[np.int64], p: ExperienceMapParameters
) -> list[int]:
    """Return which links of one source and behaviour may be unlearned, the least confident first.

    Arguments as for ``confidences``.
    """
    c = confidences(counts, failures)
    elsewhere = failures[:, ELSEWHERE].tolist()
    return sorted(
        (
            link for link in range(len(c))
            if c[link] < p.exp_confidence_threshold and elsewhere[link] >= p.exp_min_tries
        ),
        key=lambda link: (c[link], link),
    )  # fmt: skip


def is_blocked(count: int, time_outs: int, p: ExperienceMapParameters) -> bool:
    """Return whether a link that was made so many times is unlearned after so many time-outs."""
    made = min(count, p.exp_recent_tries)
    return made / (made + time_outs) < p.exp_confidence_threshold


@compiled
def leading_ahead(
    poses: NDArray[np.float64], ends: NDArray[np.int64], x_m: float, y_m: float,
    ahead_x: float, ahead_y: float, radius_m: float,
) -> NDArray[np.int64]:  # fmt: skip
    """Return the links by which a robot should have gone ahead, whichever way they point.

    They pass within ``radius_m`` of (x_m, y_m) and lead, within 60 degrees of the unit vector
    (ahead_x, ahead_y), to what lies within 60 degrees ahead, further than ``AHEAD_M``.
    """
    rows = np.empty(ends.shape[0], np.int64)
    count = 0
    for row in range(ends.shape[0]):
        i = ends[row, 0]
        j = ends[row, 1]
        i_x = poses[i, 0] - x_m
        i_y = poses[i, 1] - y_m
        j_x = poses[j, 0] - x_m
        j_y = poses[j, 1] - y_m
        i_ahead = i_x * ahead_x + i_y * ahead_y
        j_ahead = j_x * ahead_x + j_y * ahead_y
        if i_ahead > j_ahead:  # from here on i is the nearer end
            i_x, i_y, i_ahead, j_x, j_y, j_ahead = j_x, j_y, j_ahead, i_x, i_y, i_ahead
        way_x = j_x - i_x
        way_y = j_y - i_y
        square = way_x * way_x + way_y * way_y
        if j_ahead <= AHEAD_M or 4.0 * j_ahead * j_ahead < j_x * j_x + j_y * j_y:
            continue
        if square == 0.0 or 4.0 * (j_ahead - i_ahead) * (j_ahead - i_ahead) < square:
            continue
        part = min(max(-(i_x * way_x + i_y * way_y) / square, 0.0), 1.0)
        near_x = i_x + part * way_x
        near_y = i_y + part * way_y
        if near_x * near_x + near_y * near_y <= radius_m * radius_m:
            rows[count] = row
            count += 1
    return rows[:count]


@compiled
def has_detour(
    ends: NDArray[np.int64], durations_s: NDArray[np.float64], link: int, count: int
) -> bool:
    """Return whether other links join the ends of one in at most ``DETOUR`` times its duration.

    Args:
        ends: (links, 2) source and target; links are ways in both directions.
        durations_s: (links,).
        link: which of them is looked at.
        count: number of experiences.
    """
    most_s = DETOUR * durations_s[link]
    reached_s = np.full(count, np.inf)
    reached_s[ends[link, 0]] = 0.0
    nearer = True
    while nearer and reached_s[ends[link, 1]] > most_s:
        nearer = False
        for row in range(ends.shape[0]):
            if row == link:
                continue
            for side in range(2):
                through_s = reached_s[ends[row, side]] + durations_s[row]
                if through_s <= most_s and through_s < reached_s[ends[row, 1 - side]]:
                    reached_s[ends[row, 1 - side]] = through_s
                    nearer = True
    return reached_s[ends[link, 1]] <= most_s
