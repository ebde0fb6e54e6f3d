# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Planar trajectories, and the TUM files that store them."""

from __future__ import annotations

import math
from array import array
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from decimal import Decimal, InvalidOperation
from functools import partial
from pathlib import Path
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from ratslam_ros.core.common.pose import Pose, quaternion_of
from ratslam_ros.errors import UnusableInput
from ratslam_ros.limits import MAX_COORDINATE_M
from ratslam_ros.limits import MAX_LINE_CHARACTERS as MAX_LINE
from ratslam_ros.messages.json_schema import NS_PER_S

Floats = NDArray[np.float64]
Stamps = NDArray[np.int64]
Index = NDArray[np.intp]
Row = TypeVar('Row')

COLUMNS = 't x y z qx qy qz qw'
MAX_STAMP_S = 2**63 // NS_PER_S
"""Largest stamp that fits into 64-bit nanoseconds: a time in the year 2262."""


@dataclass(frozen=True)
class Trajectory:
    """Planar poses over time.

    stamp_ns: (n,) int64, strictly increasing. position_m: (n, 2). heading_rad: (n,) in (-pi, pi].
    has_heading: False if all orientations are 0 0 0 1, which is how a truth with positions only
    is written.
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
        """Return the poses with these indices, (m,) and increasing."""
        return Trajectory(self.stamp_ns[index], self.position_m[index],
                          self.heading_rad[index], self.has_heading)

    def pose(self, row: int) -> Pose:
        """Return one pose."""
        x_m, y_m = self.position_m[row].tolist()
        return Pose(x_m, y_m, float(self.heading_rad[row]))


def read_tum(path: str | Path, at_most: int | None = None) -> Trajectory:
    """Read a TUM file: lines of `t x y z qx qy qz qw`, t in seconds; `#` starts a comment.

    z, roll and pitch are ignored.

    Args:
        path: the file.
        at_most: number of poses to which a longer file is thinned evenly; None for all.

    Raises:
        UnusableInput: the file cannot be read; the message names the first invalid line.
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
        if max(abs(x), abs(y)) > MAX_COORDINATE_M:
            raise UnusableInput(f'{where}: the position ({x:g}, {y:g}) is farther than '
                                f'{MAX_COORDINATE_M:g} m from the origin; expected metres')
        norm = qx * qx + qy * qy + qz * qz + qw * qw
        if not 0.5 < norm < 2.0:
            raise UnusableInput(f'{where}: the quaternion {qx:g} {qy:g} {qz:g} {qw:g} is not of '
                                'length 1; write 0 0 0 1 if the orientation is unknown')
        stamps.append(stamp_ns)
        values.extend((x, y, math.atan2(2.0 * (qw * qz + qx * qy),
                                        norm - 2.0 * (qy * qy + qz * qz))))
        has_heading = has_heading or bool(qx or qy or qz)
    if not stamps:
        raise UnusableInput(f'{path}: no poses in it, expected lines of {COLUMNS}')
    poses = np.frombuffer(values, np.float64).reshape(-1, 3)
    return Trajectory(np.frombuffer(stamps, np.int64), poses[:, :2].copy(), poses[:, 2].copy(),
                      has_heading)


def tum_line(stamp_ns: int, pose: Pose) -> str:
    """Format a pose as a line of a TUM file, with nine decimals."""
    sec, nanosec = divmod(stamp_ns, NS_PER_S)
    qz, qw = quaternion_of(pose.heading_rad)
    return f'{sec}.{nanosec:09d} {pose.x_m:.9f} {pose.y_m:.9f} 0 0 0 {qz:.9f} {qw:.9f}\n'


def parse_stamp_ns(text: str, where: str) -> int:
    """Convert decimal seconds to integer nanoseconds without rounding through a float.

    Args:
        text: the number of seconds.
        where: file and line, for error messages.

    Raises:
        UnusableInput: the text is not a finite number, or too large.
    """
    try:
        seconds = Decimal(text)
    except InvalidOperation:
        seconds = Decimal('nan')
    if not seconds.is_finite():
        raise UnusableInput(f"{where}: '{text[:40]}' is not a time in seconds")
    if not -MAX_STAMP_S < seconds < MAX_STAMP_S:
        raise UnusableInput(f'{where}: the stamp {text[:40]} is too large for seconds; '
                            'if it is in nanoseconds, divide it by 1e9')
    return int((seconds * NS_PER_S).to_integral_value())


def thinned(rows: Iterable[Row], at_most: int) -> list[Row]:
    """Return every 2^k-th row, with the smallest k that keeps at most `at_most` rows.

    The rows are read once, and at most `at_most` + 1 of them are held.
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
    """Yield number, counted from 1, and text of the lines that are not empty or a comment."""
    try:
        with path.open(encoding='utf-8-sig') as file:
            for number, line in enumerate(iter(partial(file.readline, MAX_LINE), ''), start=1):
                if len(line) == MAX_LINE:
                    raise UnusableInput(f'{path}, line {number}: longer than {MAX_LINE} '
                                        f'characters, expected {COLUMNS}')
                if line.strip() and not line.lstrip().startswith('#'):
                    yield number, line
    except (OSError, UnicodeDecodeError) as error:
        seen = error.strerror if isinstance(error, OSError) else 'not a text file'
        raise UnusableInput(f'{path}: {seen}, expected lines of {COLUMNS}') from None
