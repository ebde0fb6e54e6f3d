# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Errors of a planar trajectory against the truth: absolute (ATE) and relative (RPE).

The figures are those that evo (M. Grupp) prints for TUM files with these options:

    ate                evo_ape tum TRUTH TRAJECTORY -a --t_max_diff 0.05 --project_to_plane xy
    rpe                evo_rpe tum TRUTH TRAJECTORY -d 1 -u m --pairs_from_reference ...
    rpe_heading_rad    the same with -r angle_rad; for a truth without headings -r point_distance
    align='sim2'       -as in place of -a

evo aligns in three dimensions, where a planar trajectory may be flipped; this module aligns in the
plane only. The results agree unless the mirror image of the trajectory fits better.
"""

from __future__ import annotations

import json
import math
from dataclasses import asdict, dataclass
from typing import Any, Literal

import numpy as np

from ratslam_ros.errors import UnusableInput, UnusableParameter
from ratslam_ros.messages.json_schema import NS_PER_S
from ratslam_ros.results.trajectory import Floats, Index, Stamps, Trajectory

Alignment = Literal['se2', 'sim2', 'none']

DELTA_M = 1.0
"""Path length over which relative errors are computed. The pairs do not overlap."""


@dataclass(frozen=True)
class Transform2D:
    """A similarity transform of the plane: p -> scale R(heading) p + (x, y)."""

    x_m: float = 0.0
    y_m: float = 0.0
    heading_rad: float = 0.0
    scale: float = 1.0

    def apply(self, position_m: Floats) -> Floats:
        """Transform points, (n, 2) -> (n, 2)."""
        c, s = math.cos(self.heading_rad), math.sin(self.heading_rad)
        x, y = position_m[:, 0], position_m[:, 1]
        return np.column_stack((self.scale * (c * x - s * y) + self.x_m,
                                self.scale * (s * x + c * y) + self.y_m))


@dataclass(frozen=True)
class ErrorFigures:
    """Statistics of a list of errors, in the unit of the errors."""

    rmse: float
    mean: float
    median: float
    std: float
    min: float
    max: float
    count: int


@dataclass(frozen=True)
class Evaluation:
    """Result of comparing a trajectory with the truth.

    transform: applied to the trajectory before the comparison.
    matched, unmatched: number of poses of the sparser trajectory with and without a counterpart.
    path_m: length of the matched part of the truth.
    ate: in m, distances between the aligned trajectory and the truth at all matched poses.
    rpe: in m, errors over `delta_m` of path: of the translation of the relative pose (`rpe_of`
    is 'pose'), or, for a truth without headings, of the distance only ('chord'). None if the
    path is too short.
    rpe_heading_rad: errors of the rotation over the same pairs; None without headings.
    stamp_ns, aligned_m, truth_m, error_m: the matched poses, (n,), (n, 2), (n, 2), (n,).
    """

    align: Alignment
    transform: Transform2D
    matched: int
    unmatched: int
    path_m: float
    delta_m: float
    ate: ErrorFigures
    rpe_of: Literal['pose', 'chord']
    rpe: ErrorFigures | None
    rpe_heading_rad: ErrorFigures | None
    stamp_ns: Stamps
    aligned_m: Floats
    truth_m: Floats
    error_m: Floats

    def to_json(self) -> str:
        """Format the figures, without the poses, as a JSON object with a trailing newline."""
        arrays = ('stamp_ns', 'aligned_m', 'truth_m', 'error_m')
        payload: dict[str, Any] = {'schema_version': 1}
        payload |= {key: value for key, value in asdict(self).items() if key not in arrays}
        return json.dumps(payload, indent=2, allow_nan=False) + '\n'

    def format(self) -> str:
        """Format the figures as a table for a terminal, at most 80 columns wide."""
        scale = f', scale {self.transform.scale:.4f}' if self.align == 'sim2' else ''
        rows = [(f'ATE ({self.align}{scale})', 'm', self.ate, 1.0)]
        if self.rpe is not None:
            of = '' if self.rpe_of == 'pose' else ', chord only'
            rows.append((f'RPE over {self.delta_m:g} m{of}', 'm', self.rpe, 1.0))
        if self.rpe_heading_rad is not None:
            rows.append(('    heading', 'deg', self.rpe_heading_rad, math.degrees(1.0)))
        lines = [f'{self.matched} poses matched, {self.unmatched} not; path {self.path_m:.1f} m',
                 f'{"":28}{"rmse":>9}{"mean":>9}{"median":>9}{"max":>9}{"count":>8}']
        for name, unit, f, factor in rows:
            numbers = ''.join(f'{factor * v:9.3f}' for v in (f.rmse, f.mean, f.median, f.max))
            lines.append(f'{name:<24}{unit:>4}{numbers}{f.count:>8}')
        if self.rpe is None:
            lines.append(f'no RPE: the path is shorter than {self.delta_m:g} m')
        elif self.rpe_of == 'chord':
            lines.append('the truth has no headings: RPE compares the distances of the pairs')
        return '\n'.join(lines)


def evaluate(trajectory: Trajectory, truth: Trajectory, align: Alignment = 'se2',
             max_difference_s: float = 0.05) -> Evaluation:
    """Compare a trajectory with the truth.

    Args:
        trajectory: the estimate.
        truth: the reference.
        align: how the trajectory is fitted to the truth by least squares: rotation and
            translation ('se2'), also scale ('sim2'), or not at all ('none').
        max_difference_s: largest difference of matched stamps. Each pose of the sparser
            trajectory is matched to the nearest one of the denser trajectory.

    Raises:
        UnusableInput: fewer than two poses match, or the alignment is undetermined.
        UnusableParameter: an argument is out of range.
    """
    if align not in ('se2', 'sim2', 'none'):
        raise UnusableParameter(f"align is '{align}', expected se2, sim2 or none")
    if not max_difference_s >= 0.0:
        raise UnusableParameter(f'max_difference_s is {max_difference_s}, expected at least 0')
    of_trajectory, of_truth = associate(trajectory.stamp_ns, truth.stamp_ns, max_difference_s)
    if len(of_truth) < 2:
        spans = [f'{t.stamp_ns[0] / NS_PER_S:.3f} to {t.stamp_ns[-1] / NS_PER_S:.3f} s'
                 for t in (trajectory, truth)]
        raise UnusableInput(
            f'{len(of_truth)} poses match within {max_difference_s:g} s, expected 2: trajectory '
            f'from {spans[0]}, truth from {spans[1]}; convert both to the same clock')
    estimate, reference = trajectory.at(of_trajectory), truth.at(of_truth)
    transform = Transform2D() if align == 'none' else fit(
        estimate.position_m, reference.position_m, scale=align == 'sim2')
    aligned_m = transform.apply(estimate.position_m)
    error_m = np.linalg.norm(aligned_m - reference.position_m, axis=1)

    first, last = _pairs_along(reference.position_m)
    rpe, rpe_heading = None, None
    if len(first):
        done_m = aligned_m[last] - aligned_m[first]
        true_m = reference.position_m[last] - reference.position_m[first]
        if truth.has_heading:
            done_rad, true_rad = estimate.heading_rad, reference.heading_rad
            rpe = figures(np.linalg.norm(
                _rotate(done_m, -done_rad[first] - transform.heading_rad)
                - _rotate(true_m, -true_rad[first]), axis=1))
            turn = done_rad[last] - done_rad[first] - true_rad[last] + true_rad[first]
            rpe_heading = figures(np.abs(np.arctan2(np.sin(turn), np.cos(turn))))
        else:
            rpe = figures(np.abs(np.linalg.norm(done_m, axis=1) - np.linalg.norm(true_m, axis=1)))
    return Evaluation(
        align, transform, len(of_truth), min(len(trajectory), len(truth)) - len(of_truth),
        float(np.sum(_steps(reference.position_m))), DELTA_M, figures(error_m),
        'pose' if truth.has_heading else 'chord', rpe, rpe_heading,
        reference.stamp_ns, aligned_m, reference.position_m, error_m)


def figures(errors: Floats) -> ErrorFigures:
    """Compute the statistics of errors, (n,) with n > 0."""
    return ErrorFigures(
        math.sqrt(float(np.mean(errors**2))), float(np.mean(errors)), float(np.median(errors)),
        float(np.std(errors)), float(np.min(errors)), float(np.max(errors)), len(errors))


def associate(stamp_ns: Stamps, truth_ns: Stamps,
              max_difference_s: float) -> tuple[Index, Index]:
    """Match each stamp of the shorter list to the nearest one of the longer list.

    Of two equally near stamps, the earlier one is chosen.

    Args:
        stamp_ns: (n,) increasing.
        truth_ns: (m,) increasing.
        max_difference_s: largest difference of matched stamps.

    Returns:
        Indices into `stamp_ns` and into `truth_ns` of the matched pairs, (k,) each.
    """
    if len(stamp_ns) > len(truth_ns):
        of_truth, of_trajectory = associate(truth_ns, stamp_ns, max_difference_s)
        return of_trajectory, of_truth
    halfway_ns = truth_ns[:-1] + np.diff(truth_ns) // 2
    nearest = np.searchsorted(halfway_ns, stamp_ns)
    near = np.abs(truth_ns[nearest] - stamp_ns) <= round(max_difference_s * NS_PER_S)
    return np.flatnonzero(near), nearest[near]


def fit(source_m: Floats, target_m: Floats, *, scale: bool = False) -> Transform2D:
    """Compute the least-squares transform of points onto others, Umeyama (1991).

    In the plane, with points as complex numbers, the optimal rotation is the angle of the sum of
    the products of conjugate source and target.

    Args:
        source_m: (n, 2) points to transform.
        target_m: (n, 2) corresponding points.
        scale: estimate the scale too, otherwise it is 1.

    Raises:
        UnusableInput: all points of one side are equal, so that the rotation is undetermined.
    """
    source, target = ((p - p.mean(axis=0)) @ np.array([1.0, 1.0j]) for p in (source_m, target_m))
    product = complex(np.sum(np.conj(source) * target))
    spread = float(np.sum(np.abs(source) ** 2))
    if spread == 0.0 or product == 0.0:
        raise UnusableInput('the matched poses do not move, so that the rotation between '
                            'trajectory and truth is undetermined: align with none')
    factor = abs(product) / spread if scale else 1.0
    turn = Transform2D(0.0, 0.0, math.atan2(product.imag, product.real), factor)
    x_m, y_m = target_m.mean(axis=0) - turn.apply(source_m.mean(axis=0)[np.newaxis])[0]
    return Transform2D(float(x_m), float(y_m), turn.heading_rad, factor)


def _steps(position_m: Floats) -> Floats:
    return np.asarray(np.linalg.norm(np.diff(position_m, axis=0), axis=1))


def _rotate(vector_m: Floats, angle_rad: Floats) -> Floats:
    c, s = np.cos(angle_rad), np.sin(angle_rad)
    x, y = vector_m[:, 0], vector_m[:, 1]
    return np.column_stack((c * x - s * y, s * x + c * y))


def _pairs_along(position_m: Floats) -> tuple[Index, Index]:
    """Divide a path into consecutive parts of at least `delta_m`.

    Returns:
        First and last index of each part, (k,) each; k = 0 if the path is too short.
    """
    ends, covered_m = [0], 0.0
    for index, step_m in enumerate(_steps(position_m), start=1):
        covered_m += float(step_m)
        if covered_m >= DELTA_M:
            ends.append(index)
            covered_m = 0.0
    return np.array(ends[:-1]), np.array(ends[1:])
