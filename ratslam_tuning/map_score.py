# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Quality of a map without ground truth, judged by the revisits that sequences of images show.

The revisits (`ratslam_tuning.revisits`) are computed from the images alone, and do not depend
on the configuration that built the map. A map is good if its templates recognise the revisits and
nothing else, and if the final trajectory passes the same point again at each revisit, but not at
frames that show different places.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ratslam_ros.messages.json_schema import NS_PER_S
from ratslam_ros.results.trajectory import Trajectory
from ratslam_tuning.revisits import Evidence
from ratslam_tuning.trials import Trial

Floats = NDArray[np.float64]
Rows = NDArray[np.intp]

PRECISION_WEIGHT = 0.5
"""Beta of the F-measure: a precision below 1 costs more than an equally lower recall."""

NEAR_SHARE = 0.05
"""Distance on the map at which a revisit counts as half joined, as a share of the diameter of the
map; different places nearer than this are folded onto each other."""

ENDS = 0.02, 0.98
"""Quantiles of the coordinates between which the diameter of the map is measured."""

SAME_HEADING_RAD = math.pi / 4.0
MAX_STAMP_DIFFERENCE_S = 0.5
"""Largest difference between the stamps of a frame and of a processed view."""


@dataclass(frozen=True)
class MapScore:
    """Agreement of a map with the revisits.

    Attributes:
        precision: share of the recognitions of older templates that show the same place.
        recall: share of the revisits that are recognised as such.
        joined: mean closeness of the two poses of a revisit on the final map: 1 for equal
            positions, 0.5 at 5 % of the diameter of the map.
        folded: share of the frames with the same heading but different places that are within 5 %
            of the diameter.
    """

    precision: float
    recall: float
    joined: float
    folded: float

    @property
    def total(self) -> float:
        """0 to 1: F-measure of the recognitions, times `joined`, times 1 - `folded`."""
        measure = f_measure(self.precision, self.recall, PRECISION_WEIGHT)
        return measure * self.joined * (1.0 - self.folded)


def f_measure(precision: float, recall: float, beta: float) -> float:
    """Return the weighted harmonic mean of precision and recall; recall counts `beta` times."""
    denominator = beta * beta * precision + recall
    return (1.0 + beta * beta) * precision * recall / denominator if denominator > 0.0 else 0.0


def score_map(trial: Trial, evidence: Evidence, rows: Rows | None = None) -> MapScore:
    """Compute the score of a map.

    Args:
        trial: the map.
        evidence: the revisits of the recording.
        rows: indices of the frames of `evidence` to judge, None for all. The map is that of the
            whole trial in any case.
    """
    rows = np.arange(len(evidence.stamp_ns)) if rows is None else rows
    # A trial may cover only a part of the recording.
    path = trial.map.stamp_ns
    if len(path) < 2 or not len(trial.view_ns):
        return MapScore(0.0, 0.0, 0.0, 0.0)
    begin = np.searchsorted(evidence.stamp_ns, path[0])
    end = np.searchsorted(evidence.stamp_ns, path[-1], side='right')
    rows = rows[(rows >= begin) & (rows < end)]
    known = evidence.is_supported[rows] | evidence.is_unsupported[rows]
    precision, recall = _recognition(trial, evidence, rows[known], int(begin))
    joined, folded = _geometry(trial.map, evidence, rows[known], slice(int(begin), int(end)))
    return MapScore(precision, recall, joined, folded)


def _recognition(trial: Trial, evidence: Evidence, rows: Rows, begin: int) -> tuple[float, float]:
    """Return precision and recall of the recognitions of templates older than the gap."""
    stamps = evidence.stamp_ns
    view = _nearest(trial.view_ns, stamps[rows])
    first = _nearest(stamps, trial.view_ns[trial.first_seen[view]])
    recognised = ((trial.template_id[view] >= 0) & (rows - first >= evidence.gap)
                  & (np.abs(trial.view_ns[view] - stamps[rows])
                     <= MAX_STAMP_DIFFERENCE_S * NS_PER_S))
    same = np.where(recognised, evidence.same_place[rows, first], np.nan)
    supported = evidence.is_supported[rows]
    right = float(np.nansum(same[supported]))
    wrong = float(np.nansum(1.0 - same))
    # Revisits of frames before the start of a partial trial cannot be recognised.
    possible = int(np.sum(supported & (evidence.match[rows] >= begin)))
    return right / max(right + wrong, 1e-9), min(right / max(possible, 1), 1.0)


def _geometry(path: Trajectory, evidence: Evidence, rows: Rows,
              covered: slice) -> tuple[float, float]:
    """Return how closely revisits are joined, and the share of different places folded."""
    position_m, heading_rad = poses_at(path, evidence.stamp_ns[covered])
    # Without the ends, as a single long link may lead far away.
    diameter_m = float(np.linalg.norm(np.diff(np.quantile(position_m, ENDS, axis=0), axis=0)))
    near_m = max(NEAR_SHARE * diameter_m, 1e-9)
    here = rows - covered.start
    there = evidence.match[rows] - covered.start
    again = evidence.is_supported[rows] & (there >= 0)
    apart_m = np.linalg.norm(position_m[here[again]] - position_m[there[again]], axis=1)
    joined = float(np.mean(1.0 / (1.0 + (apart_m / near_m) ** 2))) if len(apart_m) else 0.0

    different = evidence.same_place[rows, covered] <= 0.0
    turn_rad = heading_rad[here][:, np.newaxis] - heading_rad
    different &= np.abs(np.remainder(turn_rad + math.pi, math.tau) - math.pi) < SAME_HEADING_RAD
    x_m, y_m = position_m.T
    distance_m = np.hypot(x_m[here][:, np.newaxis] - x_m, y_m[here][:, np.newaxis] - y_m)
    folded = np.sum(different & (distance_m <= near_m)) / max(int(different.sum()), 1)
    return joined, float(folded)


def poses_at(path: Trajectory, stamp_ns: NDArray[np.int64]) -> tuple[Floats, Floats]:
    """Interpolate a trajectory: positions (n, 2) in m, and unwrapped headings (n,) in rad."""
    since = path.stamp_ns[0]
    times, known = (stamp_ns - since).astype(float), (path.stamp_ns - since).astype(float)
    position_m = np.stack([np.interp(times, known, path.position_m[:, i]) for i in (0, 1)], 1)
    return position_m, np.interp(times, known, np.unwrap(path.heading_rad))


def _nearest(stamps: NDArray[np.int64], wanted: NDArray[np.int64]) -> Rows:
    """Return the indices of the nearest stamps."""
    after = np.clip(np.searchsorted(stamps, wanted), 1, max(len(stamps) - 1, 1))
    if len(stamps) < 2:
        return np.zeros(len(wanted), np.intp)
    nearer = wanted - stamps[after - 1] <= stamps[after] - wanted
    return np.where(nearer, after - 1, after)
