# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Relaxation: the most likely poses of the experiences, given the links between them.

Each link measures the pose of its target relative to its source, so this is nonlinear least
squares over positions and headings. Gauss-Newton steps are computed by ``block_elimination``.

The turns of odometry have two systematic errors, Borenstein and Feng (1996): a wrong wheel base
scales all turns, and unequal wheel diameters add a turn to every metre. Both bend the whole map.
They are two more unknowns of the same least squares, with a prior.

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
from ratslam_ros.core.common.turn_correction import UNCORRECTED, TurnCorrection
from ratslam_ros.core.mapping import block_elimination

Reals = NDArray[np.float64]
Indices = NDArray[np.int64]
Flags = NDArray[np.bool_]

GAIN_SD, PER_SPACING_SD_RAD = 0.03, 0.0025
"""Standard deviations of the systematic errors of odometry in general, as prior: of the gain of
turns, and of the turn for each view spacing. With views half a metre apart, 0.0025 rad are 0.2 %
difference between wheels that are 0.4 m apart."""

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
    none = np.zeros(len(ends), np.bool_)
    return relax_with_turns(poses, ends, shapes, weights, none, UNCORRECTED, 1.0)[:3]


def relax_with_turns(
    poses: Reals, ends: Indices, shapes: Reals, weights: Reals, driven: Flags,
    turns: TurnCorrection, view_spacing_m: float,
) -> tuple[int, float, float, TurnCorrection]:
    """Take a step as ``relax`` does, towards the most likely systematic errors of turns as well.

    Args:
        poses, ends, shapes, weights: as for ``relax``; shapes as measured.
        driven: (links,) whether odometry measured a link, so that its turn has these errors.
        turns: correction of these turns.
        view_spacing_m: view spacing, the scale of the prior.

    Returns:
        As ``relax``, whose costs contain that of the correction, and the correction after.
    """
    diagonal, linking, columns, border, right = _normal_equations(
        poses, ends, corrected_turns(shapes, driven, *turns), weights, shapes, driven
    )
    solved = columns.copy()
    work = block_elimination.solve(ends, diagonal, linking, solved)
    per_m_sd_rad = PER_SPACING_SD_RAD / view_spacing_m
    gain, per_m_rad = _turns(columns, solved, border, right, *turns, per_m_sd_rad)
    step = solved[:, :, 0] - solved[:, :, 1] * gain - solved[:, :, 2] * per_m_rad

    def total(poses: Reals, turns: TurnCorrection) -> float:
        prior = ((turns.gain - 1.0) / GAIN_SD) ** 2 + (turns.per_m_rad / per_m_sd_rad) ** 2
        return prior + cost(poses, ends, corrected_turns(shapes, driven, *turns), weights)

    before = total(poses, turns)
    for share in STEP_SHARES:
        moved = poses + share * step
        now = TurnCorrection(turns.gain + share * gain, turns.per_m_rad + share * per_m_rad)
        after = total(moved, now)
        if after <= before:
            _replace(poses, moved)
            return work, before, after, now
    return work, before, before, turns


@compiled
def corrected_turns(shapes: Reals, which: Flags, gain: float, per_m_rad: float) -> Reals:
    """Return the shapes of links with the turns of some of them corrected.

    Links are arcs, whose heading is half of their turn.

    Args:
        shapes: (links, 3) distance in m, heading and facing in rad.
        which: (links,) whether to correct a link.
        gain, per_m_rad: see ``TurnCorrection``.
    """
    corrected = shapes.copy()
    for link in range(shapes.shape[0]):
        if which[link]:
            change = (gain - 1.0) * shapes[link, 2] + per_m_rad * shapes[link, 0]
            corrected[link, 1] = wrap(corrected[link, 1] + 0.5 * change)
            corrected[link, 2] = wrap(corrected[link, 2] + change)
    return corrected


@compiled
def _turns(
    columns: Reals, solved: Reals, border: Reals, right: Reals, gain: float, per_m_rad: float,
    per_m_sd_rad: float,
) -> tuple[float, float]:
    """Return the change of the correction of turns that the normal equations result in.

    Args:
        columns, border, right: from ``_normal_equations``.
        solved: ``columns``, solved for the poses.
        gain, per_m_rad: the correction, whose prior has the standard deviations GAIN_SD and
            ``per_m_sd_rad``.
    """
    for i in range(columns.shape[0]):
        for r in range(3):
            for a in range(2):
                right[a] -= columns[i, r, 1 + a] * solved[i, r, 0]
                for b in range(2):
                    border[a, b] -= columns[i, r, 1 + a] * solved[i, r, 1 + b]
    border[0, 0] += 1.0 / (GAIN_SD * GAIN_SD)
    border[1, 1] += 1.0 / (per_m_sd_rad * per_m_sd_rad)
    right[0] -= (gain - 1.0) / (GAIN_SD * GAIN_SD)
    right[1] -= per_m_rad / (per_m_sd_rad * per_m_sd_rad)
    determinant = border[0, 0] * border[1, 1] - border[0, 1] * border[1, 0]
    return (
        (border[1, 1] * right[0] - border[0, 1] * right[1]) / determinant,
        (border[0, 0] * right[1] - border[1, 0] * right[0]) / determinant,
    )


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
    poses: Reals, ends: Indices, shapes: Reals, weights: Reals, measured: Reals, driven: Flags
) -> tuple[Reals, Reals, Reals, Reals, Reals]:
    """Return the normal equations of poses and errors of turns; arguments as for ``relax``.

    A rotation of its source moves the predicted target of a link sideways; so does half of an
    error of its turn.

    Returns:
        diagonal and linking of ``block_elimination.solve``; (n, 3, 3) right-hand side of each
        experience and its blocks with the two errors; the (2, 2) block and the (2,) right-hand
        side of the errors.
    """
    count = poses.shape[0]
    diagonal, linking = np.zeros((count, 3, 3)), np.zeros((ends.shape[0], 3, 3))
    columns, border, right = np.zeros((count, 3, 3)), np.zeros((2, 2)), np.zeros(2)
    by = np.zeros(2)
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
        columns[i, 0, 0] += p * x
        columns[i, 1, 0] += p * y
        columns[i, 2, 0] += h * turn - p * (u * x + v * y)
        columns[j, 0, 0] -= p * x
        columns[j, 1, 0] -= p * y
        columns[j, 2, 0] -= h * turn
        if not driven[link]:
            continue
        by[0], by[1] = measured[link, 2], measured[link, 0]
        for a in range(2):
            columns[i, 0, 1 + a] -= 0.5 * by[a] * p * u
            columns[i, 1, 1 + a] -= 0.5 * by[a] * p * v
            columns[i, 2, 1 + a] += by[a] * (0.5 * p * (u * u + v * v) + h)
            columns[j, 0, 1 + a] += 0.5 * by[a] * p * u
            columns[j, 1, 1 + a] += 0.5 * by[a] * p * v
            columns[j, 2, 1 + a] -= by[a] * h
            right[a] -= by[a] * (0.5 * p * (u * x + v * y) - h * turn)
            for b in range(2):
                border[a, b] += by[a] * by[b] * (0.25 * p * (u * u + v * v) + h)
    return diagonal, linking, columns, border, right


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
