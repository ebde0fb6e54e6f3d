# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Link learning: which links are unlearned, by the numbers of their successes and failures.

Milford, Wyeth and Prasser (2006), section III.D. Two events count as a failed attempt of a link:

- Its behaviour led from its source to another experience. This is frequent if several experiences
  represent one place, so it is weak evidence: a link is unlearned only after its behaviour led
  elsewhere MIN_TRIES times in a row, and only if other links form a short detour.
- A behaviour timed out in front of it, because an obstacle blocks it. Old successes are weak
  evidence against that, so at most ``exp_recent_tries`` of them count.

Both counts are reset when the link is driven. With ``exp_unlearning: equation``, the first event
counts each time and for every link, as printed, and the second one never.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from ratslam_ros.core.common.compiled import compiled
from ratslam_ros.core.common.pose import Pose
from ratslam_ros.core.config import ExperienceMapParameters
from ratslam_ros.core.mapping.links import Links

ELSEWHERE, TIMED_OUT = 0, 1
"""Columns of the failure counts: the behaviour led elsewhere, or it timed out."""

LEAST_AHEAD_M = 0.2
"""Least distance ahead of the robot of a link's far end, for a time-out to count against it."""

MIN_TRIES = 8
"""Number of times that the behaviour of a link must have led elsewhere, since its transition was
last made, before the link can be removed: links between neighbours of one place stay."""

DETOUR_RATIO = 8.0
"""Longest duration of a detour that replaces an unlearned link, relative to that link's."""


def count_other_transitions(links: Links, source: int, target: int, behaviour: str) -> None:
    """Count a failed attempt of every other link from a source by the same behaviour.

    Args:
        links: all links; their failure counts are changed.
        source, target: ids of the experiences of the transition that was made.
        behaviour: name of the behaviour that made it.
    """
    rows = links.rows_by(source, behaviour)
    links.failures[rows[links.ends[rows, 1] != target], ELSEWHERE] += 1


def count_time_out(
    links: Links, poses: NDArray[np.float64], here: Pose, ahead_rad: float,
    p: ExperienceMapParameters,
) -> list[int]:
    """Count a time-out of every link that leads ahead; return the rows to be unlearned.

    Equation (9) knows no time-outs: with ``exp_unlearning: equation`` nothing is counted.

    Args:
        links: all links; their failure counts are changed.
        poses: (n, 3) x, y in m and heading in rad of the experiences.
        here: pose of the robot on the map.
        ahead_rad: direction in which the robot could not drive on, in the map frame.
        p: ``exp_try_radius_m``, ``exp_recent_tries`` and ``exp_confidence_threshold`` are used.
    """
    if p.exp_unlearning == 'equation':
        return []
    rows = leading_ahead(
        poses, links.ends, here.x_m, here.y_m, math.cos(ahead_rad), math.sin(ahead_rad),
        p.exp_try_radius_m,
    )
    links.failures[rows, TIMED_OUT] += 1
    recent = np.minimum(links.counts[rows], p.exp_recent_tries)
    confidences = recent / (recent + links.failures[rows, TIMED_OUT])
    blocked: list[int] = rows[confidences < p.exp_confidence_threshold].tolist()
    return blocked


def least_confident(
    links: Links, source: int, behaviour: str, p: ExperienceMapParameters, count: int
) -> int | None:
    """Return the row of the least confident link that may be unlearned, None if there is none.

    Args:
        links: all links.
        source, behaviour: the links considered start there and were made by that behaviour.
        p: ``exp_confidence_threshold`` and ``exp_unlearning`` are used.
        count: number of experiences.
    """
    rows = links.rows_by(source, behaviour)
    counts, elsewhere = links.counts[rows], links.failures[rows, ELSEWHERE]
    confidences = counts / (counts.sum() + links.failures[rows, TIMED_OUT])  # equation (9)
    least = 0 if p.exp_unlearning == 'equation' else MIN_TRIES
    doubtful = (confidences < p.exp_confidence_threshold) & (elsewhere >= least)
    order = np.argsort(confidences, kind='stable')
    for row in rows[order[doubtful[order]]].tolist():
        # Without a detour the link is the only connection, however seldom it is driven.
        if p.exp_unlearning == 'equation' or has_detour(
            links.ends, links.durations_s, row, count
        ):
            return int(row)
    return None


def link_confidences(links: Links) -> NDArray[np.float64]:
    """Return the confidence of every link, (links,).

    c_ij = n_ij / n_i,beta (Milford, Wyeth and Prasser 2006, equation 9). n_i,beta is the number of
    attempts of the behaviour: its transitions to any experience, and its time-outs in front of
    the link. Without a behaviour the other attempts are unknown, and only its own time-outs count
    against a link.
    """
    behaviours, counts = links.behaviours, links.counts
    groups = links.ends[:, 0] * len(links.behaviour_names) + behaviours
    is_named = np.array([name != '' for name in links.behaviour_names], np.bool_)[behaviours]
    totals = np.bincount(groups, counts)[groups]
    return counts / (np.where(is_named, totals, counts) + links.failures[:, TIMED_OUT])


@compiled
def leading_ahead(
    poses: NDArray[np.float64], ends: NDArray[np.int64], x_m: float, y_m: float,
    ahead_x: float, ahead_y: float, radius_m: float,
) -> NDArray[np.int64]:
    """Return the rows of the links that lead ahead of the robot, in either direction.

    Such a link passes within ``radius_m`` of the robot. From its nearer to its farther end it
    points within 60 degrees of the direction ahead. Seen from the robot, its farther end is within
    60 degrees of that direction, and more than ``LEAST_AHEAD_M`` ahead.

    Args:
        poses: (n, 3) x, y in m and heading in rad of the experiences.
        ends: (links, 2) source and target.
        x_m, y_m: position of the robot.
        ahead_x, ahead_y: unit vector of the direction ahead.
        radius_m: largest distance of a link from the robot.
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
        if i_ahead > j_ahead:  # i is the nearer end
            i_x, i_y, i_ahead, j_x, j_y, j_ahead = j_x, j_y, j_ahead, i_x, i_y, i_ahead
        way_x = j_x - i_x
        way_y = j_y - i_y
        square = way_x * way_x + way_y * way_y
        if j_ahead <= LEAST_AHEAD_M or 4.0 * j_ahead * j_ahead < j_x * j_x + j_y * j_y:
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
    """Return whether other links connect a link's ends in at most ``DETOUR_RATIO`` its duration.

    Args:
        ends: (links, 2) source and target; a detour may use links in both directions.
        durations_s: (links,) duration of each link in s.
        link: row of the link.
        count: number of experiences.
    """
    most_s = DETOUR_RATIO * durations_s[link]
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
