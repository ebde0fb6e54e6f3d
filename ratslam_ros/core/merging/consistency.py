# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Consistency: the largest set of correspondences between two parts that agree with each other.

A correspondence is true or a chance match. Two true ones give the same relative pose of two
places in both maps, within the error of the matches and the drift of both maps between the places.
The set of correspondences that are consistent with one of them, and with most of each other, is
the hypothesis that the parts share places. After Mangelson et al. (2018), with the drift bounds of
this map in place of covariances.

Look-alikes are consistent by chance too. Under the hypothesis that matches are chance matches, a
match leads to any place of the other map, so the probability that it is consistent is the share of
the places that would be. The expected number of sets that are as large by chance (the number of
false alarms of Moisan and Stival, 2004) has to be small.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ratslam_ros.core.common.pose import composed, inverse
from ratslam_ros.core.mapping.link_weights import reach_m
from ratslam_ros.core.merging.joint_map import FREE_ROTATION_RAD, Correspondence, JointMap

Reals = NDArray[np.float64]
Ints = NDArray[np.int64]
Flags = NDArray[np.bool_]

MAX_COUNT = 1000
"""Number of correspondences that are compared with each other; of more, evenly spaced ones."""

MAX_FALSE_ALARMS = 0.01
"""Largest expected number of equally large sets of chance matches: that of false matches of a view
(``FALSE_MATCH_RATE``)."""


@dataclass(frozen=True)
class Hypothesis:
    """A set of consistent correspondences between two parts.

    Attributes:
        supporting: the consistent correspondences.
        place_count: number of different places of the seen part among them.
        is_by_chance: whether chance explains the set.
    """

    supporting: tuple[Correspondence, ...]
    place_count: int
    is_by_chance: bool


def best_hypothesis(
    joint: JointMap, correspondences: Sequence[Correspondence], spacing_m: float, drift: float,
    known_places: Ints,
) -> Hypothesis | None:
    """Return the largest consistent set; None if there are fewer than two correspondences.

    Args:
        joint: the maps; each of the two parts in its own frame.
        correspondences: those between two parts.
        spacing_m: view spacing.
        drift: largest error of a relative pose on a map, in m per m of path.
        known_places: experiences of the known part at which templates were learned.
    """
    if len(correspondences) < 2:
        return None
    step = -(-len(correspondences) // MAX_COUNT)
    compared = list(correspondences)[::step]
    table = _Table(joint, compared, spacing_m, drift)
    consistent = table.consistent()
    degrees = consistent.sum(axis=1)
    seed = int(np.argmax(degrees))
    members = consistent[seed].copy()
    while members.sum() > 1:
        agreeing = consistent[:, members].sum(axis=1)
        outliers = members & (2 * agreeing <= members.sum())
        if not outliers.any():
            break
        members[outliers & (agreeing == agreeing[outliers].min())] = False
    supporting = [one for one, is_member in zip(compared, members, strict=True) if is_member]
    places = distinct_places(joint.poses, [one.seen for one in supporting], spacing_m)
    all_places = distinct_places(joint.poses, [one.seen for one in compared], spacing_m)
    share = table.chance(seed, joint.poses[known_places])
    log_false_alarms = math.log(len(compared)) + _log_tail(
        max(all_places - 1, 0), places - 1, share
    )
    return Hypothesis(
        tuple(supporting), places, log_false_alarms > math.log(MAX_FALSE_ALARMS)
    )


def distinct_places(poses: Reals, experiences: Sequence[int], spacing_m: float) -> int:
    """Return the number of experiences that are at least a view spacing from each other."""
    kept: list[tuple[float, float]] = []
    for number in experiences:
        x_m, y_m, _ = poses[number].tolist()
        if all(math.dist((x_m, y_m), other) >= spacing_m for other in kept):
            kept.append((x_m, y_m))
    return len(kept)


class _Table:
    """Relative poses of the places of correspondences, in both parts."""

    def __init__(
        self, joint: JointMap, compared: Sequence[Correspondence], spacing_m: float, drift: float
    ) -> None:
        self._free_m, self._drift = reach_m(0.0, 0.0, spacing_m), drift
        self._known: Reals = joint.poses[[one.known for one in compared]]
        # The frame of the known experience, on the map of the seen part.
        self._seen: Reals = np.array([
            composed(joint.pose_of(one.seen), inverse(one.pose)) for one in compared
        ])
        self._paths_m = np.minimum(
            _paths_m(joint, [one.known for one in compared]),
            _paths_m(joint, [one.seen for one in compared]),
        )

    def consistent(self) -> Flags:
        """Return (n, n) whether two correspondences agree; symmetric, each with itself."""
        known, seen = _relative(self._known, self._known), _relative(self._seen, self._seen)
        error_m = np.hypot(known[..., 0] - seen[..., 0], known[..., 1] - seen[..., 1])
        turned = np.abs(wrapped(known[..., 2] - seen[..., 2]))
        error_m = np.maximum(error_m, error_m.T)
        agree: Flags = error_m <= self._free_m + self._drift * self._paths_m
        return agree & (turned <= FREE_ROTATION_RAD)

    def chance(self, seed: int, places: Reals) -> float:
        """Return the mean share of places at which a match would be consistent with the seed."""
        ahead = _relative(self._seen[seed : seed + 1], self._seen)[0]
        candidates = _relative(self._known[seed : seed + 1], places)[0]
        shares = []
        for number, (x_m, y_m, turn_rad) in enumerate(ahead.tolist()):
            if number == seed:
                continue
            limit_m = self._free_m + self._drift * self._paths_m[seed, number]
            fits = np.hypot(candidates[:, 0] - x_m, candidates[:, 1] - y_m) <= limit_m
            turned = np.abs(wrapped(candidates[:, 2] - turn_rad))
            fits &= turned <= FREE_ROTATION_RAD
            shares.append(float(np.mean(fits)))
        return float(np.mean(shares)) if shares else 1.0


def _relative(frames: Reals, poses: Reals) -> Reals:
    """Return (n, m, 3) the m poses in the n frames."""
    ahead = poses[None, :, :2] - frames[:, None, :2]
    cosine = np.array([math.cos(angle) for angle in frames[:, 2].tolist()])[:, None]
    sine = np.array([math.sin(angle) for angle in frames[:, 2].tolist()])[:, None]
    return np.stack(
        [
            cosine * ahead[..., 0] + sine * ahead[..., 1],
            cosine * ahead[..., 1] - sine * ahead[..., 0],
            wrapped(poses[None, :, 2] - frames[:, None, 2]),
        ],
        axis=-1,
    )


def wrapped(angles: Reals) -> Reals:
    """Return angles in rad, wrapped to [-pi, pi)."""
    return (angles + math.pi) % math.tau - math.pi


def _paths_m(joint: JointMap, experiences: Sequence[int]) -> Reals:
    """Return (n, n) lengths of the shortest paths over links, inf if there is none."""
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import dijkstra

    ends = np.array([[link.source_id, link.target_id] for link in joint.links], np.int32)
    lengths_m = np.array([max(link.distance_m, 1e-9) for link in joint.links])
    n = len(joint)
    graph = coo_array((lengths_m, ends.reshape(-1, 2).T), shape=(n, n)).tocsr()
    sources, rows = np.unique(experiences, return_inverse=True)
    reached_m = dijkstra(graph, directed=False, indices=sources)[:, sources]
    paths_m: Reals = reached_m[np.ix_(rows.ravel(), rows.ravel())]
    return paths_m


def _log_tail(count: int, least: int, probability: float) -> float:
    """Return the logarithm of a bound on the probability of at least ``least`` of ``count``.

    Hoeffding's bound for the binomial distribution, which is tight for rare events.
    """
    if count == 0 or least <= probability * count:
        return 0.0
    share = least / count
    p = max(probability, 1e-12)
    divergence = share * math.log(share / p)
    if share < 1.0:
        divergence += (1.0 - share) * math.log((1.0 - share) / (1.0 - p))
    return -count * divergence
