# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Compiled loops for the ends of walls: corners, edges, and the covariance of the landmarks.

`line_kernels` finds the walls.
"""

from __future__ import annotations

import math

import numpy as np

from ratslam_ros.core.common.angles import wrap
from ratslam_ros.core.common.compiled import compiled
from ratslam_ros.core.landmarks.line_kernels import (
    BREAK_INCIDENCE_RAD,
    SIGNIFICANT_SD,
    Array,
    Indices,
    offset_sd,
)

MIN_STEP_M = 0.1
"""Smallest depth behind the end of a wall that makes it an edge."""

MAX_CORNER_GAP_M = 0.3
"""Largest distance between a corner and the nearest points on its walls. Beyond it, the corner is
where the walls would meet if they continued."""

MIN_TURN_RAD = math.radians(30.0)
"""Smallest angle between the walls of a corner."""

UNKNOWN, CORNER, EDGE = 0, 1, 2
"""End of a wall: the field of view or an occlusion, another wall, or free space."""


@compiled
def find_ends(
    ranges: Array, angles: Array, is_full: bool, sd: float, wall_sd: float, spans: Indices,
    lines: Array,
) -> tuple[Indices, Array, Array]:
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
                )
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
) -> None:
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
        metres, deviations = offset_sd(
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
) -> tuple[Indices, Array, Array]:
    """Return corners and edges with their joint covariance.

    Args:
        lines, covariances: as ``find_walls`` returns them.
        kinds, at, sds: as ``find_ends`` returns them.
        wall_sd: standard deviation of the walls' surface.

    Returns:
        (f,) kinds: CORNER or EDGE; (4 f,) values; (4 f, 4 f) their covariance. Landmarks are in
        the order of their walls.
    """
    walls = len(lines)
    most = 2 * walls
    kind_of = np.zeros(most, np.int64)
    values, jacobian, variances = (
        np.zeros(4 * most), np.zeros((4 * most, 4 * walls)), np.zeros(4 * most)
    )
    f = d = 0
    for wall in range(walls):
        if kinds[wall, 0] == UNKNOWN and kinds[wall, 1] == UNKNOWN:
            continue  # The beams at its ends may not meet it: there is no length.
        length = math.hypot(at[wall, 1, 0] - at[wall, 0, 0], at[wall, 1, 1] - at[wall, 0, 1])
        direction_variance = 2.0 * (wall_sd / length) * (wall_sd / length)
        for side in range(2):
            kind = kinds[wall, side]
            if kind == UNKNOWN or (kind == CORNER and side == 0):
                continue
            kind_of[f] = kind
            values[d], values[d + 1] = at[wall, side]
            _position_jacobian(lines, kinds, at, wall, side, jacobian, d)
            variances[d] = variances[d + 1] = variances[d + 3] = wall_sd * wall_sd
            first = math.atan2(lines[wall, 1], lines[wall, 0])
            if kind == CORNER:
                following = wall + 1 if wall + 1 < walls else 0
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
                quarters = -0.5 if side == 1 else 0.5
                values[d + 2] = wrap(first + quarters * math.pi)
                _direction_jacobian(lines, wall, jacobian[d + 2], 1.0)
                variances[d + 2] = direction_variance
            f, d = f + 1, d + 4
    covariance = _joint_covariance(jacobian[:d], covariances, sds)
    for i in range(d):
        covariance[i, i] += variances[i]
    return kind_of[:f].copy(), values[:d].copy(), covariance


@compiled
def _position_jacobian(
    lines: Array, kinds: Indices, at: Array, wall: int, side: int, jacobian: Array, row: int
) -> None:
    """Add the derivative of an end of a wall by the lines and by its place between two beams."""
    walls = len(lines)
    x, y = at[wall, side]
    if kinds[wall, side] == EDGE:
        # On a fixed beam, dp = -p (p . dl).
        jacobian[row, 2 * wall] -= x * x
        jacobian[row, 2 * wall + 1] -= x * y
        jacobian[row + 1, 2 * wall] -= y * x
        jacobian[row + 1, 2 * wall + 1] -= y * y
        a, b = lines[wall]
        norm = math.sqrt(a * a + b * b)
        column = 2 * walls + 2 * wall + side
        jacobian[row, column] -= b / norm
        jacobian[row + 1, column] += a / norm
        return
    first, second = (wall, (wall + 1) % walls) if side == 1 else ((wall - 1) % walls, wall)
    a1, b1 = lines[first]
    a2, b2 = lines[second]
    determinant = a1 * b2 - b1 * a2
    # dp = -inverse((a1, b1), (a2, b2)) (p . dl1, p . dl2).
    for line, dx, dy in ((first, b2, -a2), (second, -b1, a1)):
        jacobian[row, 2 * line] -= dx * x / determinant
        jacobian[row, 2 * line + 1] -= dx * y / determinant
        jacobian[row + 1, 2 * line] -= dy * x / determinant
        jacobian[row + 1, 2 * line + 1] -= dy * y / determinant


@compiled
def _direction_jacobian(lines: Array, wall: int, row: Array, factor: float) -> None:
    """Add the derivative of a wall's direction."""
    a, b = lines[wall]
    row[2 * wall] -= factor * b / (a * a + b * b)
    row[2 * wall + 1] += factor * a / (a * a + b * b)


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
                )
    for i in range(rows):
        for j in range(i):
            covariance[j, i] = covariance[i, j]
    return covariance
