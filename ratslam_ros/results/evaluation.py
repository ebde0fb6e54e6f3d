# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""How far a trajectory is from the truth, in the plane: absolute and relative errors.

The figures are those that evo (M. Grupp) gives for files in the TUM format with these options:

    ate                evo_ape tum TRUTH TRAJECTORY -a --t_max_diff 0.05 --project_to_plane xy
    rpe                evo_rpe tum TRUTH TRAJECTORY -d 1 -u m --pairs_from_reference ...
    rpe_heading_rad    the same with -r angle_rad; truth without headings: -r point_distance
    align='sim2'       -as in place of -a
    pairs='trajectory' without --pairs_from_reference

evo aligns in space, where a flat trajectory may also be turned over; here it only ever turns in
the plane. The two agree unless the mirror image of the trajectory fits better than itself.
"""

from __future__ import annotations

import json
import math
from array import array
from collections.abc import Iterable, Iterator
from dataclasses import asdict, dataclass
from decimal import Decimal, InvalidOperation
from pathlib import Path
from typing import Any, Literal, TypeVar

import numpy as np
from numpy.typing import NDArray

from ratslam_ros.errors import UnusableInput, UnusableParameter

Floats = NDArray[np.float64]
Stamps = NDArray[np.int64]
Index = NDArray[np.intp]
Alignment = Literal['se2', 'sim2', 'none']
Pairs = Literal['truth', 'trajectory']
Row = TypeVar('Row')

COLUMNS = 't x y z qx qy qz qw'
NS_PER_S = 1_000_000_000
LATEST_S = 2**63 // NS_PER_S  # in the year 2262


@dataclass(frozen=True)
class Trajectory:
    """Poses in the plane over time.

    stamp_ns: (n,) int64, strictly increasing; position_m: (n, 2); heading_rad: (n,) in
    (-pi, pi]; has_heading: False where every orientation is 0 0 0 1, which is how truth that
    measures positions only is written.
    """

    stamp_ns: Stamps
    position_m: Floats
    heading_rad: Floats
    has_heading: bool

    def __post_init__(self) -> None:
        if np.any(np.diff(self.stamp_ns) <= 0):
            raise ValueError('the stamps of a trajectory have to increase')

    def __len__(self) -> int:
        return len(self.stamp_ns)

    def at(self, index: Index) -> Trajectory:
        """Return the poses at these indices."""
        return Trajectory(self.stamp_ns[index], self.position_m[index],
                          self.heading_rad[index], self.has_heading)


@dataclass(frozen=True)
class Transform2D:
    """A turn, a scale and a shift of the plane: p -> scale R(heading) p + (x, y)."""

    x_m: float = 0.0
    y_m: float = 0.0
    heading_rad: float = 0.0
    scale: float = 1.0

    def apply(self, position_m: Floats) -> Floats:
        """Move points, (n, 2) -> (n, 2)."""
        c, s = math.cos(self.heading_rad), math.sin(self.heading_rad)
        x, y = position_m[:, 0], position_m[:, 1]
        return np.column_stack((self.scale * (c * x - s * y) + self.x_m,
                                self.scale * (s * x + c * y) + self.y_m))

    def inverse(self) -> Transform2D:
        """Return the transform that undoes this one."""
        shift = np.array([[self.x_m, self.y_m]])
        back = Transform2D(heading_rad=-self.heading_rad, scale=1.0 / self.scale)
        x_m, y_m = back.apply(shift)[0]
        return Transform2D(-float(x_m), -float(y_m), back.heading_rad, back.scale)


@dataclass(frozen=True)
class ErrorFigures:
    """What is usually said about a list of errors, in the unit of the errors."""

    rmse: float
    mean: float
    median: float
    std: float
    min: float
    max: float
    count: int


@dataclass(frozen=True)
class Evaluation:
    """A trajectory held against the truth.

    ate: m, distance of the aligned trajectory from the truth, over all matched poses.
    rpe: m, error over `delta_m` of path: of the relative pose (`rpe_of` 'pose'), or, where the
    truth knows no headings, of the length of the chord only ('chord'). None: path too short.
    rpe_heading_rad: error of the turn over the same pairs; None without headings.
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
        """Return the figures, without the poses, as a JSON object with a trailing newline."""
        arrays = ('stamp_ns', 'aligned_m', 'truth_m', 'error_m')
        payload: dict[str, Any] = {'schema_version': 1}
        payload |= {key: value for key, value in asdict(self).items() if key not in arrays}
        return json.dumps(payload, indent=2, allow_nan=False) + '\n'

    def format(self) -> str:
        """Return the figures as a few lines for a terminal."""
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
            lines.append('the truth has no headings: RPE compares how far apart each pair is')
        return '\n'.join(lines)


def evaluate(trajectory: Trajectory, truth: Trajectory, align: Alignment = 'se2',
             max_difference_s: float = 0.05, *, delta_m: float = 1.0,
             pairs: Pairs = 'truth') -> Evaluation:
    """Compare a trajectory with the truth.

    Every pose of the sparser of the two is matched to the nearest stamp of the denser one, at
    most `max_difference_s` away. `align` moves the trajectory onto the truth by least squares:
    turn and shift ('se2'), scale too ('sim2'), or not at all ('none'). RPE closes a pair
    whenever `delta_m` of the path of `pairs` have been covered; pairs do not overlap.
    Raises UnusableInput where too little matches.
    """
    if align not in ('se2', 'sim2', 'none'):
        raise UnusableParameter(f"align is '{align}', expected se2, sim2 or none")
    if not max_difference_s >= 0.0 or not delta_m > 0.0:
        raise UnusableParameter(f'max_difference_s is {max_difference_s} and delta_m {delta_m}, '
                                'expected at least 0 and more than 0')
    of_trajectory, of_truth = associate(trajectory.stamp_ns, truth.stamp_ns, max_difference_s)
    if len(of_truth) < 2:
        spans = [f'{t.stamp_ns[0] / NS_PER_S:.3f} to {t.stamp_ns[-1] / NS_PER_S:.3f} s'
                 for t in (trajectory, truth)]
        raise UnusableInput(
            f'{len(of_truth)} poses match within {max_difference_s:g} s, expected 2: trajectory '
            f'from {spans[0]}, truth from {spans[1]}; bring both to the same clock')
    estimate, reference = trajectory.at(of_trajectory), truth.at(of_truth)
    transform = Transform2D() if align == 'none' else fit(
        estimate.position_m, reference.position_m, scale=align == 'sim2')
    aligned_m = transform.apply(estimate.position_m)
    error_m = np.linalg.norm(aligned_m - reference.position_m, axis=1)

    first, last = _pairs_along(reference.position_m if pairs == 'truth' else aligned_m, delta_m)
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
        float(np.sum(_steps(reference.position_m))), delta_m, figures(error_m),
        'pose' if truth.has_heading else 'chord', rpe, rpe_heading,
        reference.stamp_ns, aligned_m, reference.position_m, error_m)


def figures(errors: Floats) -> ErrorFigures:
    """Sum up a list of errors, (n,) with n > 0."""
    return ErrorFigures(
        math.sqrt(float(np.mean(errors**2))), float(np.mean(errors)), float(np.median(errors)),
        float(np.std(errors)), float(np.min(errors)), float(np.max(errors)), len(errors))


def associate(stamp_ns: Stamps, truth_ns: Stamps,
              max_difference_s: float) -> tuple[Index, Index]:
    """Pair each stamp of the shorter list with the nearest of the longer, ties: the earlier."""
    if len(stamp_ns) > len(truth_ns):
        of_truth, of_trajectory = associate(truth_ns, stamp_ns, max_difference_s)
        return of_trajectory, of_truth
    halfway_ns = truth_ns[:-1] + np.diff(truth_ns) // 2
    nearest = np.searchsorted(halfway_ns, stamp_ns)
    near = np.abs(truth_ns[nearest] - stamp_ns) <= round(max_difference_s * NS_PER_S)
    return np.flatnonzero(near), nearest[near]


def fit(source_m: Floats, target_m: Floats, *, scale: bool = False) -> Transform2D:
    """Return the transform that moves points onto others with the least square error.

    Both are (n, 2). S. Umeyama, PAMI 13(4), 1991; in the plane the best turn is the angle of the
    summed products of the points as complex numbers. Raises UnusableInput where nothing moves.
    """
    source, target = ((p - p.mean(axis=0)) @ np.array([1.0, 1.0j]) for p in (source_m, target_m))
    product = complex(np.sum(np.conj(source) * target))
    spread = float(np.sum(np.abs(source) ** 2))
    if spread == 0.0 or product == 0.0:
        raise UnusableInput('the matched poses do not move, so nothing says how to turn one '
                            'onto the other: align with none')
    factor = abs(product) / spread if scale else 1.0
    turn = Transform2D(0.0, 0.0, math.atan2(product.imag, product.real), factor)
    x_m, y_m = target_m.mean(axis=0) - turn.apply(source_m.mean(axis=0)[np.newaxis])[0]
    return Transform2D(float(x_m), float(y_m), turn.heading_rad, factor)


def read_tum(path: str | Path, at_most: int | None = None) -> Trajectory:
    """Read a trajectory, a line a pose: `t x y z qx qy qz qw`, t in seconds, # for comments.

    z, roll and pitch are left out; `at_most` thins a long file evenly to that many poses.
    Raises UnusableInput naming the line that does not fit.
    """
    stamps, values, has_heading = array('q'), array('d'), False
    lines = _lines(Path(path))
    for number, line in lines if at_most is None else thinned(lines, at_most):
        where = f'{path}, line {number}'
        fields = line.split()
        if len(fields) != 8:
            hint = '; replace the commas by spaces' if ',' in line else ''
            raise UnusableInput(f'{where}: {len(fields)} columns, expected 8: {COLUMNS}{hint}')
        stamp_ns = parse_stamp_ns(fields[0], where)
        if stamps and stamp_ns <= stamps[-1]:
            raise UnusableInput(f'{where}: the stamp {fields[0]} is not after the one before it; '
                                "sort the file and drop duplicates ('sort -n -u -k1,1')")
        try:
            x, y, _, qx, qy, qz, qw = pose = [float(field) for field in fields[1:]]
        except ValueError:
            raise UnusableInput(f"{where}: '{line.strip()[:60]}' is not eight numbers, "
                                f'expected {COLUMNS}') from None
        if not all(map(math.isfinite, pose)):
            raise UnusableInput(f'{where}: NaN or infinity; remove the line')
        norm = qx * qx + qy * qy + qz * qz + qw * qw
        if not 0.5 < norm < 2.0:
            raise UnusableInput(f'{where}: the quaternion {qx:g} {qy:g} {qz:g} {qw:g} is not of '
                                'length 1; write 0 0 0 1 where the orientation is not known')
        stamps.append(stamp_ns)
        values.extend((x, y, math.atan2(2.0 * (qw * qz + qx * qy),
                                        norm - 2.0 * (qy * qy + qz * qz))))
        has_heading = has_heading or bool(qx or qy or qz)
    if not stamps:
        raise UnusableInput(f'{path}: no poses in it, expected lines of {COLUMNS}')
    poses = np.frombuffer(values, np.float64).reshape(-1, 3)
    return Trajectory(np.frombuffer(stamps, np.int64), poses[:, :2].copy(), poses[:, 2].copy(),
                      has_heading)


def parse_stamp_ns(text: str, where: str) -> int:
    """Return decimal seconds as integer nanoseconds, exactly; `where` names it in errors."""
    try:
        seconds = Decimal(text)
    except InvalidOperation:
        seconds = Decimal('nan')
    if not seconds.is_finite():
        raise UnusableInput(f"{where}: '{text[:40]}' is no time in seconds")
    if not -LATEST_S < seconds < LATEST_S:
        raise UnusableInput(f'{where}: the stamp {text[:40]} is too large for seconds; '
                            'if it is in nanoseconds, divide it by 1e9')
    return int((seconds * NS_PER_S).to_integral_value())


def thinned(rows: Iterable[Row], at_most: int) -> list[Row]:
    """Return every 2^k-th row, k the smallest that keeps no more than `at_most`.

    The rows are read once and no more than `at_most` + 1 of them are held.
    """
    kept: list[Row] = []
    stride = 1
    for index, row in enumerate(rows):
        if index % stride == 0:
            kept.append(row)
            if len(kept) > at_most:
                kept, stride = kept[::2], 2 * stride
    return kept


def _lines(path: Path) -> Iterator[tuple[int, str]]:
    """Yield the lines that are neither empty nor a comment, with their numbers from 1."""
    try:
        with path.open(encoding='utf-8') as file:
            for number, line in enumerate(file, start=1):
                if line.strip() and not line.lstrip().startswith('#'):
                    yield number, line
    except (OSError, UnicodeDecodeError) as error:
        seen = error.strerror if isinstance(error, OSError) else 'not a text file'
        raise UnusableInput(f'{path}: {seen}, expected lines of {COLUMNS}') from None


def _steps(position_m: Floats) -> Floats:
    return np.asarray(np.linalg.norm(np.diff(position_m, axis=0), axis=1))


def _rotate(vector_m: Floats, angle_rad: Floats) -> Floats:
    c, s = np.cos(angle_rad), np.sin(angle_rad)
    x, y = vector_m[:, 0], vector_m[:, 1]
    return np.column_stack((c * x - s * y, s * x + c * y))


def _pairs_along(position_m: Floats, delta_m: float) -> tuple[Index, Index]:
    """Return the first and last index of stretches of at least `delta_m` of path."""
    ends, covered_m = [0], 0.0
    for index, step_m in enumerate(_steps(position_m), start=1):
        covered_m += float(step_m)
        if covered_m >= delta_m:
            ends.append(index)
            covered_m = 0.0
    return np.array(ends[:-1]), np.array(ends[1:])
