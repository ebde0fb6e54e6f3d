# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Compiled loops of the line extraction; see ``line_extraction``.

A wall is the line ``a x + b y = 1`` in the robot's frame, so that a beam of direction (u, v) has
the range r with ``1 / r = a u + b v``. Without noise of the angles, this is linear regression.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from ratslam_ros.core.common.compiled import compiled

Array = NDArray[np.float64]
Indices = NDArray[np.int64]

SPLIT_CHI2 = 25.9
"""Reduction of the squared residuals at which two lines replace one: the chi-square quantile
of three degrees of freedom (a line and the place of the split) at a level of 1e-5."""

MAX_MEAN_CHI2 = 3.0
"""Largest mean squared residual of a wall, in units of the variance of the laser. Curved surfaces
exceed it."""

MIN_BEAMS = 6
"""Fewest beams on a wall. A person beyond 3 m covers fewer with each side."""

BREAK_INCIDENCE_RAD = math.radians(8.0)
"""Smallest angle between a beam and a wall at which neighbouring points are connected: adaptive
breakpoints, Borges and Aldon (2004), "Line extraction in 2D range images for mobile robotics"."""

SIGNIFICANT_SD = 4.0
"""Distance from a line, in standard deviations, beyond which a point is off the line."""

MAX_OCCLUDED_M = 1.0
"""Longest occluded part of a wall."""

_PASSES = 2
"""Passes over all splits that move each to its best place."""


@compiled
def ordered_beams(
    ranges_m: Array, angle_min_rad: float, increment_rad: float, max_range_m: float
) -> tuple[Array, Array, bool]:
    """Return ranges and angles counter-clockwise, and whether the beams cover a full turn.

    Beams without a usable range have the range 0. A full turn starts at the largest step of the
    range, and contains no direction twice.
    """
    n = len(ranges_m)
    step = abs(increment_rad)
    is_full = n > 2 and n * step > 2.0 * math.pi - 0.5 * step
    if is_full and (n - 0.5) * step > 2.0 * math.pi:
        n -= 1
    ranges, angles = np.empty(n), np.empty(n)
    for k in range(n):
        beam = k if increment_rad > 0.0 else n - 1 - k
        r = ranges_m[beam]
        ranges[k] = r if 0.0 < r <= max_range_m else 0.0
        angles[k] = angle_min_rad + beam * increment_rad
    if not is_full:
        return ranges, angles, False
    first, largest = 0, -1.0
    for k in range(n):
        jump = abs(ranges[k] - ranges[k - 1])
        if jump > largest:
            first, largest = k, jump
    turned, turned_angles = np.empty(n), np.empty(n)
    for k in range(n):
        beam = (first + k) % n
        turned[k], turned_angles[k] = ranges[beam], angles[beam]
    return turned, turned_angles, True


@compiled
def _fill_sums(
    ranges: Array, u: Array, v: Array, lo: int, hi: int, sd: float, sums: Array
) -> None:
    """Write the prefix sums of the regression over beams lo to hi into ``sums[lo : hi + 1]``."""
    sums[lo] = 0.0
    for k in range(lo, hi):
        r = ranges[k]
        for c in range(7):
            sums[k + 1, c] = sums[k, c]
        if r > 0.0:
            w = r / sd * (r / sd)
            sums[k + 1, 0] += 1.0
            sums[k + 1, 1] += w * r * r * u[k] * u[k]
            sums[k + 1, 2] += w * r * r * u[k] * v[k]
            sums[k + 1, 3] += w * r * r * v[k] * v[k]
            sums[k + 1, 4] += w * r * u[k]
            sums[k + 1, 5] += w * r * v[k]
            sums[k + 1, 6] += w


@compiled
def _cost(sums: Array, i: int, j: int) -> float:
    """Return the chi-square of the line through beams i to j."""
    if sums[j, 0] - sums[i, 0] < 2.5:
        return 0.0
    uu, uv, vv = sums[j, 1] - sums[i, 1], sums[j, 2] - sums[i, 2], sums[j, 3] - sums[i, 3]
    uy, vy = sums[j, 4] - sums[i, 4], sums[j, 5] - sums[i, 5]
    determinant = uu * vv - uv * uv
    if determinant <= 0.0:
        return 0.0
    a, b = (vv * uy - uv * vy) / determinant, (uu * vy - uv * uy) / determinant
    return max(sums[j, 6] - sums[i, 6] - a * uy - b * vy, 0.0)


@compiled
def _best_split(sums: Array, i: int, j: int) -> tuple[int, float]:
    """Return where beams i to j are best split in two, and the chi-square of both parts."""
    at, least = i + 1, math.inf
    for k in range(i + 1, j):
        cost = _cost(sums, i, k) + _cost(sums, k, j)
        if cost < least:
            at, least = k, cost
    return at, least


@compiled
def _segment_cluster(sums: Array, lo: int, hi: int, ends: Indices, count: int) -> int:
    """Split beams lo to hi into lines; append the end of each to ``ends``, return their number."""
    first = count
    ends[count] = hi
    count += 1
    # Always split the first part that is not known to be straight.
    start, part = lo, first
    while part < count:
        end = ends[part]
        at, least = _best_split(sums, start, end)
        if end - start > 2 and _cost(sums, start, end) - least > SPLIT_CHI2:
            for k in range(count, part, -1):
                ends[k] = ends[k - 1]
            ends[part] = at
            count += 1
        else:
            start = end
            part += 1
    for _ in range(_PASSES):
        start = lo
        for part in range(first, count - 1):
            at, _ = _best_split(sums, start, ends[part + 1])
            ends[part] = at
            start = at
    part, start = first, lo
    while part < count - 1:
        middle, end = ends[part], ends[part + 1]
        parts = _cost(sums, start, middle) + _cost(sums, middle, end)
        if _cost(sums, start, end) - parts < SPLIT_CHI2:
            for k in range(part, count - 1):
                ends[k] = ends[k + 1]
            count -= 1
            # The longer line may continue the one before it.
            if part > first:
                part -= 1
                start = lo if part == first else ends[part - 1]
        else:
            start = middle
            part += 1
    return count


@compiled
def _fit(
    ranges: Array, u: Array, v: Array, owner: Indices, wall: int, i: int, j: int, sd: float,
    wall_sd: float, line: Array, covariance: Array,
) -> float:
    """Fit the line of a wall, with weights by incidence; return its mean squared residual.

    A wall that is rough by ``wall_sd`` changes the range most where the beam grazes it.
    """
    n = len(ranges)
    a, b, cost, count = 0.0, 0.0, 0.0, 0
    for attempt in range(2):
        uu = uv = vv = uy = vy = 0.0
        for beam in range(i, j):
            k = beam % n
            r = ranges[k]
            if owner[k] != wall or r <= 0.0:
                continue
            variance, expected = sd * sd, r
            if attempt > 0:
                # Weights by the measured range would favour beams whose noise is positive.
                inverse = a * u[k] + b * v[k]
                if inverse <= 0.0:
                    return math.inf
                expected = 1.0 / inverse
                cosine = inverse / math.sqrt(a * a + b * b)
                variance += wall_sd * wall_sd / max(cosine * cosine, 1e-4)
            w = expected * expected * expected * expected / variance
            uu += w * u[k] * u[k]
            uv += w * u[k] * v[k]
            vv += w * v[k] * v[k]
            uy += w * u[k] / r
            vy += w * v[k] / r
        determinant = uu * vv - uv * uv
        if not determinant > 0.0:
            return math.inf
        a, b = (vv * uy - uv * vy) / determinant, (uu * vy - uv * uy) / determinant
        if attempt == 0:
            for beam in range(i, j):
                k = beam % n
                r = ranges[k]
                if owner[k] == wall and r > 0.0:
                    residual = (1.0 - r * (a * u[k] + b * v[k])) * r / sd
                    cost += residual * residual
                    count += 1
        covariance[0, 0], covariance[1, 1] = vv / determinant, uu / determinant
        covariance[0, 1] = covariance[1, 0] = -uv / determinant
    line[0], line[1] = a, b
    return cost / max(count - 2, 1)


@compiled
def offset_sd(
    r: float, u: float, v: float, line: Array, sd: float, wall_sd: float
) -> tuple[float, float]:
    """Return a range minus that of the line on the same beam, in m and in standard deviations.

    The difference is -inf if the beam does not meet the line at a usable angle.
    """
    a, b = line[0], line[1]
    inverse = a * u + b * v
    cosine = inverse / math.sqrt(a * a + b * b)
    if cosine < math.sin(BREAK_INCIDENCE_RAD):
        return -math.inf, -math.inf
    difference = r - 1.0 / inverse
    return difference, difference / math.sqrt(sd * sd + (wall_sd / cosine) * (wall_sd / cosine))


@compiled
def find_walls(
    ranges: Array, angles: Array, is_full: bool, sd: float, wall_sd: float, min_length_m: float
) -> tuple[Indices, Array, Array]:
    """Return the walls of a scan by split and merge.

    Nguyen et al. (2007), "A comparison of line extraction algorithms using 2D range data for
    indoor mobile robotics".

    Args:
        ranges, angles: (n,) as ``ordered_beams`` returns them.
        is_full: whether the last beam is next to the first.
        sd, wall_sd: standard deviations of a range and of the wall's surface.
        min_length_m: length of the shortest wall.

    Returns:
        (w, 2) first and last beam of each wall, counter-clockwise and modulo n; (w, 2) lines a, b;
        (w, 2, 2) their covariance.
    """
    n = len(ranges)
    u, v = np.empty(n), np.empty(n)
    for k in range(n):
        u[k], v[k] = math.cos(angles[k]), math.sin(angles[k])
    sums, ends, owner = np.zeros((n + 1, 7)), np.zeros(n + 1, np.int64), np.full(n, -1)
    spans, lines, covariances = (
        np.zeros((n, 2), np.int64), np.zeros((n, 2)), np.zeros((n, 2, 2))
    )
    walls = 0
    lo = 0
    while lo < n:
        hi = lo + 1
        while hi < n and _are_connected(ranges, angles, hi, sd):
            hi += 1
        _fill_sums(ranges, u, v, lo, hi, sd, sums)
        if sums[hi, 0] >= MIN_BEAMS:
            count = _segment_cluster(sums, lo, hi, ends, 0)
            start = lo
            for part in range(count):
                end = ends[part]
                if sums[end, 0] - sums[start, 0] >= MIN_BEAMS:
                    i, j = start, end
                    while ranges[i] == 0.0:
                        i += 1
                    while ranges[j - 1] == 0.0:
                        j -= 1
                    for k in range(i, j):
                        owner[k] = walls
                    mean = _fit(
                        ranges, u, v, owner, walls, i, j, sd, wall_sd, lines[walls],
                        covariances[walls],
                    )
                    length = math.hypot(
                        ranges[i] * u[i] - ranges[j - 1] * u[j - 1],
                        ranges[i] * v[i] - ranges[j - 1] * v[j - 1],
                    )
                    if mean <= MAX_MEAN_CHI2 and length >= min_length_m:
                        spans[walls, 0], spans[walls, 1] = i, j - 1
                        walls += 1
                    else:
                        for k in range(i, j):
                            owner[k] = -1
                start = end
        lo = hi
    walls = _join_occluded(
        ranges, u, v, owner, is_full, sd, wall_sd, spans, lines, covariances, walls
    )
    return spans[:walls].copy(), lines[:walls].copy(), covariances[:walls].copy()


@compiled
def _are_connected(ranges: Array, angles: Array, k: int, sd: float) -> bool:
    """Return whether a beam may lie on the same wall as the beam before it."""
    before = k - 1
    if ranges[k] == 0.0 or ranges[before] == 0.0:
        # A single beam without a range does not end a wall.
        if ranges[k] == 0.0:
            return ranges[before] > 0.0
        before = k - 2
        if before < 0 or ranges[before] == 0.0:
            return False
    r, other = ranges[k], ranges[before]
    angle = angles[k] - angles[before]
    # The seam of a full turn.
    angle -= 2.0 * math.pi * math.floor(angle / (2.0 * math.pi))
    gap = math.sqrt(max(r * r + other * other - 2.0 * r * other * math.cos(angle), 0.0))
    if angle >= BREAK_INCIDENCE_RAD:
        return False
    limit = min(r, other) * math.sin(angle) / math.sin(BREAK_INCIDENCE_RAD - angle)
    return gap < limit + 2.0 * SIGNIFICANT_SD * sd


@compiled
def _join_occluded(
    ranges: Array, u: Array, v: Array, owner: Indices, is_full: bool, sd: float, wall_sd: float,
    spans: Indices, lines: Array, covariances: Array, walls: int,
) -> int:
    """Join neighbouring walls on one line if nothing but nearer objects lies between them."""
    n = len(ranges)
    line, covariance = np.zeros(2), np.zeros((2, 2))
    wall = 0
    while wall < walls:
        other = wall + 1
        if other == walls:
            if not is_full or walls < 2 or spans[0, 1] >= n or spans[wall, 1] >= n:
                break
            other = 0
        if _may_join(ranges, u, v, n, sd, wall_sd, spans, lines, wall, other):
            i, j = spans[wall, 0], spans[other, 1]
            if other == 0:
                j += n
            before = _squared(ranges, u, v, owner, wall, spans[wall], lines[wall], sd) + _squared(
                ranges, u, v, owner, other, spans[other], lines[other], sd
            )
            for beam in range(spans[other, 0], spans[other, 1] + 1):
                if owner[beam % n] == other:
                    owner[beam % n] = wall
            mean = _fit(ranges, u, v, owner, wall, i, j + 1, sd, wall_sd, line, covariance)
            count = 0
            for beam in range(i, j + 1):
                count += owner[beam % n] == wall
            if mean * max(count - 2, 1) - before < SPLIT_CHI2:
                spans[wall, 1] = j
                lines[wall], covariances[wall] = line.copy(), covariance.copy()
                for later in range(other, walls - 1):
                    spans[later], lines[later], covariances[later] = (
                        spans[later + 1].copy(), lines[later + 1].copy(),
                        covariances[later + 1].copy(),
                    )
                for k in range(n):
                    if owner[k] > other:
                        owner[k] -= 1
                walls -= 1
                if other == 0:
                    break
                continue
            for beam in range(spans[other, 0], spans[other, 1] + 1):
                if owner[beam % n] == wall:
                    owner[beam % n] = other
        wall += 1
    return walls


@compiled
def _may_join(
    ranges: Array, u: Array, v: Array, n: int, sd: float, wall_sd: float, spans: Indices,
    lines: Array, wall: int, other: int,
) -> bool:
    """Return whether the beams between two walls are on the line or nearer, over a short gap."""
    i, j = spans[wall, 1], spans[other, 0]
    if other == 0:
        j += n
    missing = 0
    for beam in range(i + 1, j):
        k = beam % n
        if ranges[k] == 0.0:
            missing += 1
        elif offset_sd(ranges[k], u[k], v[k], lines[wall], sd, wall_sd)[1] > SIGNIFICANT_SD:
            return False
    first, last = i % n, j % n
    gap = math.hypot(
        ranges[first] * u[first] - ranges[last] * u[last],
        ranges[first] * v[first] - ranges[last] * v[last],
    )
    return missing <= 2 and gap <= MAX_OCCLUDED_M


@compiled
def _squared(
    ranges: Array, u: Array, v: Array, owner: Indices, wall: int, span: Indices, line: Array,
    sd: float,
) -> float:
    """Return the sum of the squared residuals of the beams on a wall, by the laser noise."""
    total = 0.0
    for beam in range(span[0], span[1] + 1):
        k = beam % len(ranges)
        if owner[k] == wall and ranges[k] > 0.0:
            r = ranges[k]
            residual = (1.0 - r * (line[0] * u[k] + line[1] * v[k])) * r / sd
            total += residual * residual
    return total
