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

from ratslam_ros.core.common.angles import wrap
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

MIN_STEP_M = 0.1
"""Smallest depth behind the end of a wall that makes it an edge."""

MAX_OCCLUDED_M = 1.0
"""Longest occluded part of a wall."""

MAX_CORNER_GAP_M = 0.3
"""Largest distance between a corner and the nearest points on its walls. Beyond it, the corner is
where the walls would meet if they continued."""

MIN_TURN_RAD = math.radians(30.0)
"""Smallest angle between the walls of a corner."""

UNKNOWN, CORNER, EDGE, WALL = 0, 1, 2, 3
"""End of a wall: the field of view or an occlusion, another wall, or free space; and a wall with
two real ends."""

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
) -> float:  # fmt: skip
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
def _offset_sd(
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
    )  # fmt: skip
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
                    )  # fmt: skip
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
) -> int:  # fmt: skip
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
                    )  # fmt: skip
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
) -> bool:  # fmt: skip
    """Return whether the beams between two walls are on the line or nearer, over a short gap."""
    i, j = spans[wall, 1], spans[other, 0]
    if other == 0:
        j += n
    missing = 0
    for beam in range(i + 1, j):
        k = beam % n
        if ranges[k] == 0.0:
            missing += 1
        elif _offset_sd(ranges[k], u[k], v[k], lines[wall], sd, wall_sd)[1] > SIGNIFICANT_SD:
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
) -> float:  # fmt: skip
    """Return the sum of the squared residuals of the beams on a wall, by the laser noise."""
    total = 0.0
    for beam in range(span[0], span[1] + 1):
        k = beam % len(ranges)
        if owner[k] == wall and ranges[k] > 0.0:
            r = ranges[k]
            residual = (1.0 - r * (line[0] * u[k] + line[1] * v[k])) * r / sd
            total += residual * residual
    return total


@compiled
def find_ends(
    ranges: Array, angles: Array, is_full: bool, sd: float, wall_sd: float, spans: Indices,
    lines: Array,
) -> tuple[Indices, Array, Array]:  # fmt: skip
    """Return what ends each wall at its start and at its end, and where.

    Returns:
        (w, 2) UNKNOWN, CORNER (the end of one wall and the start of the next) or EDGE; (w, 2, 2)
        positions, for UNKNOWN those of the last point that is seen; (w, 2) standard deviation of
        an edge along the wall, because it lies between two beams.
    """
    n, walls = len(ranges), len(spans)
    kinds, at, sds = np.zeros((walls, 2), np.int64), np.zeros((walls, 2, 2)), np.zeros((walls, 2))
    for wall in range(walls):
        for side in range(2):
            k = spans[wall, side] % n
            _meet(angles[k], lines[wall], at[wall, side])
    for wall in range(walls):
        following = wall + 1
        if following == walls:
            following = 0
        is_seam = following == 0
        if (not is_seam or is_full) and walls > 1:
            last, first = spans[wall, 1], spans[following, 0] + (n if is_seam else 0)
            if first - last <= 3:
                at_last = at[wall, 1].copy()
                found = _corner(lines[wall], lines[following], at[wall, 1])
                if found:
                    x, y = at[wall, 1]
                    bearing = math.atan2(y, x)
                    step = abs(wrap(angles[1] - angles[0]))
                    after = wrap(bearing - angles[last % n])
                    ahead = wrap(angles[first % n] - bearing)
                    gap = max(
                        math.hypot(x - at_last[0], y - at_last[1]),
                        math.hypot(x - at[following, 0, 0], y - at[following, 0, 1]),
                    )
                    if after >= -step and ahead >= -step and gap <= MAX_CORNER_GAP_M:
                        kinds[wall, 1] = kinds[following, 0] = CORNER
                        at[following, 0] = at[wall, 1].copy()
                        continue
                at[wall, 1] = at_last
    for wall in range(walls):
        for side in range(2):
            if kinds[wall, side] == UNKNOWN:
                _find_edge(
                    ranges, angles, is_full, sd, wall_sd, spans[wall, side],
                    1 if side == 1 else -1, lines[wall], kinds[wall], at[wall], sds[wall], side,
                )  # fmt: skip
    return kinds, at, sds


@compiled
def _meet(angle: float, line: Array, at: Array) -> bool:
    """Write the point of a line on a beam; return whether the beam meets it."""
    u, v = math.cos(angle), math.sin(angle)
    inverse = line[0] * u + line[1] * v
    cosine = inverse / math.sqrt(line[0] * line[0] + line[1] * line[1])
    if cosine < 0.5 * math.sin(BREAK_INCIDENCE_RAD):
        return False
    at[0], at[1] = u / inverse, v / inverse
    return True


@compiled
def _corner(line: Array, other: Array, at: Array) -> bool:
    """Write the intersection of two lines; return whether they meet at a sufficient angle."""
    determinant = line[0] * other[1] - line[1] * other[0]
    turn = math.atan2(determinant, line[0] * other[0] + line[1] * other[1])
    if abs(turn) < MIN_TURN_RAD or abs(turn) > math.pi - MIN_TURN_RAD:
        return False
    at[0], at[1] = (other[1] - line[1]) / determinant, (line[0] - other[0]) / determinant
    return True


@compiled
def _find_edge(
    ranges: Array, angles: Array, is_full: bool, sd: float, wall_sd: float, last: int, step: int,
    line: Array, kinds: Indices, at: Array, sds: Array, side: int,
) -> None:  # fmt: skip
    """Mark an end of a wall as an edge if the next beams pass it and hit something behind."""
    n = len(ranges)
    behind, first = 0, 0
    for distance in range(1, 4):
        beam = last + step * distance
        if not is_full and not 0 <= beam < n:
            return
        k = beam % n
        if ranges[k] == 0.0:
            return
        metres, deviations = _offset_sd(
            ranges[k], math.cos(angles[k]), math.sin(angles[k]), line, sd, wall_sd
        )
        if deviations > SIGNIFICANT_SD and metres > MIN_STEP_M:
            behind += 1
            if behind == 1:
                first = k
            if behind == 2:
                break
        elif behind > 0 or distance > 1 or deviations < -SIGNIFICANT_SD:
            return
    near, far = np.zeros(2), np.zeros(2)
    if not (_meet(angles[last % n], line, near) and _meet(angles[first], line, far)):
        return
    kinds[side] = EDGE
    at[side] = 0.5 * (near + far)
    # An edge is equally probable everywhere between the two beams.
    sds[side] = math.hypot(far[0] - near[0], far[1] - near[1]) / math.sqrt(12.0)


@compiled
def landmarks_of(
    lines: Array, covariances: Array, kinds: Indices, at: Array, sds: Array, wall_sd: float
) -> tuple[Indices, Indices, Indices, Array, Array]:
    """Return corners, edges and complete walls with their joint covariance.

    Args:
        lines, covariances: as ``find_walls`` returns them.
        kinds, at, sds: as ``find_ends`` returns them.
        wall_sd: standard deviation of the walls' surface.

    Returns:
        (f,) kinds: CORNER, EDGE or WALL; (f,) index of the wall (for a corner, the first of two);
        (f + 1,) offsets within the values; (d,) values; (d, d) their covariance. Landmarks are in
        the order of their walls.
    """
    walls = len(lines)
    most = 3 * walls
    kind_of, wall_of, offsets = (
        np.zeros(most, np.int64), np.zeros(most, np.int64), np.zeros(most + 1, np.int64)
    )  # fmt: skip
    values, jacobian, variances = (
        np.zeros(4 * most), np.zeros((4 * most, 4 * walls)), np.zeros(4 * most)
    )  # fmt: skip
    f = d = 0
    for wall in range(walls):
        length = math.hypot(at[wall, 1, 0] - at[wall, 0, 0], at[wall, 1, 1] - at[wall, 0, 1])
        direction_variance = 2.0 * (wall_sd / length) * (wall_sd / length)
        for part in range(3):  # The start, the wall itself, and the end.
            side = 0 if part < 2 else 1
            kind = kinds[wall, side]
            if part == 1:
                if kinds[wall, 0] == UNKNOWN or kinds[wall, 1] == UNKNOWN:
                    continue
                kind = WALL
            elif kind == UNKNOWN or (kind == CORNER and side == 0):
                continue
            following = wall + 1 if wall + 1 < walls else 0
            kind_of[f], wall_of[f], offsets[f] = kind, wall, d
            values[d], values[d + 1] = at[wall, side]
            _position_jacobian(lines, kinds, at, wall, side, jacobian, d, 1.0)
            variances[d] = variances[d + 1] = wall_sd * wall_sd
            first = math.atan2(lines[wall, 1], lines[wall, 0])
            variances[d + 3] = wall_sd * wall_sd
            if kind == CORNER:
                turn = wrap(math.atan2(lines[following, 1], lines[following, 0]) - first)
                # The normals point away from the robot; the corner opens the other way.
                values[d + 2] = wrap(first + 0.5 * turn + math.pi)
                _direction_jacobian(lines, wall, jacobian[d + 2], 0.5)
                _direction_jacobian(lines, following, jacobian[d + 2], 0.5)
                other = math.hypot(
                    at[following, 1, 0] - at[following, 0, 0],
                    at[following, 1, 1] - at[following, 0, 1],
                )
                other_variance = 2.0 * (wall_sd / other) * (wall_sd / other)
                variances[d + 2] = 0.25 * (direction_variance + other_variance)
            else:
                # From the start along the wall; an edge at the end looks back along the wall.
                quarters = -0.5 if kind == EDGE and side == 1 else 0.5
                values[d + 2] = wrap(first + quarters * math.pi)
                _direction_jacobian(lines, wall, jacobian[d + 2], 1.0)
                variances[d + 2] = direction_variance
            if kind == WALL:
                values[d + 3] = length
                _length_jacobian(lines, kinds, at, wall, jacobian, d)
                variances[d + 3] = 2.0 * wall_sd * wall_sd
            f, d = f + 1, d + 4
    offsets[f] = d
    covariance = _joint_covariance(jacobian[:d], covariances, sds)
    for i in range(d):
        covariance[i, i] += variances[i]
    return (
        kind_of[:f].copy(), wall_of[:f].copy(), offsets[: f + 1].copy(), values[:d].copy(),
        covariance,
    )  # fmt: skip


@compiled
def _position_jacobian(
    lines: Array, kinds: Indices, at: Array, wall: int, side: int, jacobian: Array, row: int,
    factor: float,
) -> None:  # fmt: skip
    """Add the derivative of an end of a wall by the lines and by its place between two beams."""
    walls = len(lines)
    x, y = at[wall, side]
    if kinds[wall, side] == EDGE:
        # On a fixed beam, dp = -p (p . dl).
        jacobian[row, 2 * wall] -= factor * x * x
        jacobian[row, 2 * wall + 1] -= factor * x * y
        jacobian[row + 1, 2 * wall] -= factor * y * x
        jacobian[row + 1, 2 * wall + 1] -= factor * y * y
        a, b = lines[wall]
        norm = math.sqrt(a * a + b * b)
        column = 2 * walls + 2 * wall + side
        jacobian[row, column] -= factor * b / norm
        jacobian[row + 1, column] += factor * a / norm
        return
    first, second = (wall, (wall + 1) % walls) if side == 1 else ((wall - 1) % walls, wall)
    a1, b1 = lines[first]
    a2, b2 = lines[second]
    determinant = a1 * b2 - b1 * a2
    # dp = -inverse((a1, b1), (a2, b2)) (p . dl1, p . dl2).
    for line, dx, dy in ((first, b2, -a2), (second, -b1, a1)):
        jacobian[row, 2 * line] -= factor * dx * x / determinant
        jacobian[row, 2 * line + 1] -= factor * dx * y / determinant
        jacobian[row + 1, 2 * line] -= factor * dy * x / determinant
        jacobian[row + 1, 2 * line + 1] -= factor * dy * y / determinant


@compiled
def _direction_jacobian(lines: Array, wall: int, row: Array, factor: float) -> None:
    """Add the derivative of a wall's direction."""
    a, b = lines[wall]
    row[2 * wall] -= factor * b / (a * a + b * b)
    row[2 * wall + 1] += factor * a / (a * a + b * b)


@compiled
def _length_jacobian(
    lines: Array, kinds: Indices, at: Array, wall: int, jacobian: Array, row: int
) -> None:
    """Write the derivative of a wall's length: that of its ends, along the wall."""
    ends = np.zeros((2, jacobian.shape[1]))
    _position_jacobian(lines, kinds, at, wall, 1, ends, 0, 1.0)
    _position_jacobian(lines, kinds, at, wall, 0, ends, 0, -1.0)
    a, b = lines[wall]
    norm = math.sqrt(a * a + b * b)
    for column in range(jacobian.shape[1]):
        jacobian[row + 3, column] = (a * ends[1, column] - b * ends[0, column]) / norm


@compiled
def _joint_covariance(jacobian: Array, covariances: Array, sds: Array) -> Array:
    """Return J C J' for independent lines and independent places of edges."""
    rows, walls = len(jacobian), len(covariances)
    covariance = np.zeros((rows, rows))
    for wall in range(walls):
        c, e = 2 * wall, 2 * walls + 2 * wall
        start, end = sds[wall, 0] * sds[wall, 0], sds[wall, 1] * sds[wall, 1]
        for i in range(rows):
            j0, j1 = jacobian[i, c], jacobian[i, c + 1]
            if j0 == 0.0 and j1 == 0.0:
                continue
            p0 = j0 * covariances[wall, 0, 0] + j1 * covariances[wall, 1, 0]
            p1 = j0 * covariances[wall, 0, 1] + j1 * covariances[wall, 1, 1]
            e0, e1 = jacobian[i, e] * start, jacobian[i, e + 1] * end
            for j in range(i + 1):
                covariance[i, j] += (
                    p0 * jacobian[j, c] + p1 * jacobian[j, c + 1]
                    + e0 * jacobian[j, e] + e1 * jacobian[j, e + 1]
                )  # fmt: skip
    for i in range(rows):
        for j in range(i):
            covariance[j, i] = covariance[i, j]
    return covariance
