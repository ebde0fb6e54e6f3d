# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Relaxation: the most likely poses of the experiences, given the links between them.

Each link measures the pose of its target relative to its source, so this is nonlinear least
squares over positions and headings. Gauss-Newton steps are computed by ``block_elimination``.

``sweep`` and ``batch`` are the correction rule of the papers, equation (7) of Milford et al.
(2006). At its fixed point, headings depend on the headings of links only: the position error of a
loop closure does not correct them. The number of sweeps that the rule needs is quadratic in the
length of a loop.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from ratslam_ros.core.common.angles import wrap
from ratslam_ros.core.common.compiled import compiled
from ratslam_ros.core.mapping import block_elimination

Reals = NDArray[np.float64]
Indices = NDArray[np.int64]


STEP_SHARES = (1.0, 0.5, 0.25, 0.125)
"""Fractions of a Gauss-Newton step; the first that does not raise the cost is taken."""


def relax(
    poses: Reals, ends: Indices, shapes: Reals, weights: Reals
) -> tuple[int, float, float]:
    """Take a Gauss-Newton step towards the most likely poses.

    The experience with the lowest id of each connected component is held fixed.

    Args:
        poses: (n, 3) x, y in m and heading in rad; changed in place.
        ends: (links, 2) source and target.
        shapes: (links, 3) distance in m, heading and facing in rad.
        weights: (links, 2) inverse variances: position in 1/m^2, heading in 1/rad^2.

    Returns:
        Number of elimination steps, and ``cost`` before and after.
    """
    diagonal, linking, correction = _normal_equations(poses, ends, shapes, weights)
    work = block_elimination.solve(ends, diagonal, linking, correction)
    before = cost(poses, ends, shapes, weights)
    for share in STEP_SHARES:
        moved = poses + share * correction
        after = cost(moved, ends, shapes, weights)
        if after <= before:
            _replace(poses, moved)
            return work, before, after
    return work, before, before


@compiled
def link_residual(
    poses: Reals, ends: Indices, shapes: Reals, link: int
) -> tuple[int, int, float, float, float]:
    """Return source and target of a link, and its residual: x and y in m, heading in rad."""
    i, j = ends[link, 0], ends[link, 1]
    direction = poses[i, 2] + shapes[link, 1]
    x = poses[j, 0] - poses[i, 0] - shapes[link, 0] * math.cos(direction)
    y = poses[j, 1] - poses[i, 1] - shapes[link, 0] * math.sin(direction)
    return i, j, x, y, wrap(poses[j, 2] - poses[i, 2] - shapes[link, 2])


@compiled
def cost(poses: Reals, ends: Indices, shapes: Reals, weights: Reals) -> float:
    """Return the chi-square of the poses: the weighted sum of the squared residuals of all links.

    Arguments as for ``relax``.
    """
    total = 0.0
    for link in range(ends.shape[0]):
        _, _, x, y, turn = link_residual(poses, ends, shapes, link)
        total += weights[link, 0] * (x * x + y * y) + weights[link, 1] * turn * turn
    return total


@compiled
def _replace(poses: Reals, moved: Reals) -> None:
    """Replace poses by others, with headings within half a turn."""
    for i in range(poses.shape[0]):
        poses[i] = moved[i, 0], moved[i, 1], wrap(moved[i, 2])


@compiled
def _normal_equations(
    poses: Reals, ends: Indices, shapes: Reals, weights: Reals
) -> tuple[Reals, Reals, Reals]:
    """Return diagonal, linking and rhs of ``block_elimination.solve``; arguments as for ``relax``.

    A rotation of its source moves the predicted target of a link sideways.
    """
    count = poses.shape[0]
    diagonal, linking = np.zeros((count, 3, 3)), np.zeros((ends.shape[0], 3, 3))
    right = np.zeros((count, 3))
    for link in range(ends.shape[0]):
        i, j, x, y, turn = link_residual(poses, ends, shapes, link)
        if i == j:
            continue
        direction = poses[i, 2] + shapes[link, 1]
        u = shapes[link, 0] * math.sin(direction)
        v = -shapes[link, 0] * math.cos(direction)
        p, h = weights[link, 0], weights[link, 1]
        for k in (i, j):
            diagonal[k, 0, 0] += p
            diagonal[k, 1, 1] += p
            diagonal[k, 2, 2] += h
        diagonal[i, 0, 2] -= p * u
        diagonal[i, 2, 0] -= p * u
        diagonal[i, 1, 2] -= p * v
        diagonal[i, 2, 1] -= p * v
        diagonal[i, 2, 2] += p * (u * u + v * v)
        linking[link, 0, 0] = linking[link, 1, 1] = -p
        linking[link, 2, 0], linking[link, 2, 1], linking[link, 2, 2] = p * u, p * v, -h
        right[i, 0] += p * x
        right[i, 1] += p * y
        right[i, 2] += h * turn - p * (u * x + v * y)
        right[j, 0] -= p * x
        right[j, 1] -= p * y
        right[j, 2] -= h * turn
    return diagonal, linking, right


@compiled
def sweep(
    poses: Reals, ends: Indices, shapes: Reals, correction: float, sweeps: int
) -> None:
    """Correct both ends of each link by a fraction of its residual, in the order of creation.

    Milford, Wyeth and Prasser (2006), equation (7), with p_k - p_i + dp_ki in its second sum;
    experience 0 is held fixed.

    Args:
        poses: (n, 3) x, y in m and heading in rad; changed in place.
        ends: (links, 2) source and target.
        shapes: (links, 3) distance in m, heading and facing in rad.
        correction: fraction of the residual that each end is corrected by, 0 to 0.5.
        sweeps: number of sweeps over all links.
    """
    for _ in range(sweeps):
        for link in range(ends.shape[0]):
            i, j, x, y, turn = link_residual(poses, ends, shapes, link)
            if i > 0:
                poses[i, 0] += correction * x
                poses[i, 1] += correction * y
                poses[i, 2] = wrap(poses[i, 2] + correction * turn)
            if j > 0:
                poses[j, 0] -= correction * x
                poses[j, 1] -= correction * y
                poses[j, 2] = wrap(poses[j, 2] - correction * turn)


@compiled
def batch(
    poses: Reals, ends: Indices, shapes: Reals, correction: float, sweeps: int
) -> None:
    """Correct all experiences at once by a fraction of the sum of their links' residuals.

    Milford, Wyeth and Prasser (2006), equation (7), with the sign of ``sweep``. Experiences with
    more links than 1 / correction are corrected by the mean residual: with a larger fraction the
    poses diverge.

    Args:
        poses, ends, shapes, correction, sweeps: as for ``sweep``.
    """
    change = np.zeros(poses.shape)
    rates = np.zeros(len(poses))
    for link in range(ends.shape[0]):
        rates[ends[link, 0]] += 1.0
        rates[ends[link, 1]] += 1.0
    for i in range(len(poses)):
        rates[i] = min(correction, 1.0 / max(rates[i], 1.0))
    for _ in range(sweeps):
        change[:] = 0.0
        for link in range(ends.shape[0]):
            i, j, x, y, turn = link_residual(poses, ends, shapes, link)
            change[i, 0] += x
            change[i, 1] += y
            change[i, 2] += turn
            change[j, 0] -= x
            change[j, 1] -= y
            change[j, 2] -= turn
        for i in range(1, len(poses)):
            poses[i, 0] += rates[i] * change[i, 0]
            poses[i, 1] += rates[i] * change[i, 1]
            poses[i, 2] = wrap(poses[i, 2] + rates[i] * change[i, 2])
