# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Relaxation: the most likely poses of the experiences, given the links between them.

Each link measures the pose of its target relative to its source, so this is nonlinear least
squares over positions and headings. The steps of Gauss and Newton are solved directly by
eliminating experiences in the order of their degree: block elimination of a sparse matrix. Routes
are chains with few crossings, so elimination adds few links and its cost is linear in the number
of links. The order is fixed, so the result is the same on every run.

The correction rule of the papers, equation (7) of Milford, Wyeth and Prasser (2006), distributes
the errors of headings first, then those of positions given the headings: where a loop ends says
nothing about the headings along it. ``sweep`` and ``batch`` are this rule. They need a number of
sweeps that is quadratic in the length of a loop.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ratslam_ros.core.common.angles import wrap
from ratslam_ros.core.common.compiled import compiled

Reals = NDArray[np.float64]
Indices = NDArray[np.int64]


MAX_DEGREE = 60
"""Degree above which elimination stops; SciPy's sparse factorisation solves the remaining mesh.

The factorisation takes longer to order the mesh, but eliminates it faster.
"""

MESH_STEPS_PER_LINK = 50
"""Number of elimination steps that each link of the mesh counts as; measured on square grids."""

STEP_SHARES = (1.0, 0.5, 0.25, 0.125)
"""Shares of a step of Gauss and Newton; the first that does not raise the cost is taken."""


def relax(
    poses: Reals, ends: Indices, shapes: Reals, weights: Reals
) -> tuple[int, float, float]:
    """Take a step of Gauss and Newton towards the most likely poses.

    The experience with the lowest id of each connected component is held fixed.

    Args:
        poses: (n, 3) x, y in m and heading in rad; changed in place.
        ends: (links, 2) source and target.
        shapes: (links, 3) distance in m, heading and facing in rad.
        weights: (links, 2) inverse variances: position in 1/m^2, heading in 1/rad^2.

    Returns:
        Number of elimination steps, and ``cost`` before and after.
    """
    held = _lowest_of_component(ends, len(poses))
    diagonal, linking, correction = _normal_equations(poses, ends, shapes, weights)
    plan, mesh, links, work = _eliminate(ends, diagonal, linking, held, MAX_DEGREE)
    correction[held] = 0.0
    _eliminate_forward(*plan, correction)
    if len(mesh) > 0:
        correction[mesh] = _solved(mesh, *links, diagonal, correction[mesh])
    _substitute_back(*plan, correction)
    work += MESH_STEPS_PER_LINK * len(links[0])
    before = cost(poses, ends, shapes, weights)
    for share in STEP_SHARES:
        moved = poses + share * correction
        after = cost(moved, ends, shapes, weights)
        if after <= before:
            _replace(poses, moved)
            return work, before, after
    return work, before, before


def _solved(
    mesh: Indices, sources: Indices, targets: Indices, blocks: Reals, diagonal: Reals,
    right: Reals,
) -> Reals:
    """Return the (m, 3) displacements of the experiences of the mesh.

    Args:
        mesh: (m,) experiences.
        sources, targets: (links,) ends of the links of the mesh, one entry per direction.
        blocks: (links, 3, 3) blocks of these links.
        diagonal: (n, 3, 3) blocks of all experiences.
        right: (m, 3) right sides.
    """
    from scipy.sparse import bsr_array  # loaded only if there is a mesh: the import is slow
    from scipy.sparse.linalg import splu

    number = np.full(len(diagonal), -1)
    number[mesh] = np.arange(len(mesh))
    rows = number[np.concatenate([mesh, sources])]
    order = np.argsort(rows, kind='stable')
    columns = number[np.concatenate([mesh, targets])[order]]
    values = np.concatenate([diagonal[mesh], blocks])[order]
    starts = np.searchsorted(rows[order], np.arange(len(mesh) + 1))
    matrix = bsr_array((values, columns, starts), shape=(right.size, right.size)).tocsc()
    factors = splu(
        matrix, permc_spec='MMD_AT_PLUS_A', diag_pivot_thresh=0.0,
        options={'SymmetricMode': True},
    )
    solution: Reals = factors.solve(right.ravel())
    return solution.reshape(-1, 3)


@compiled
def _lowest_of_component(ends: Indices, count: int) -> NDArray[np.bool_]:
    """Return (n,) whether an experience has the lowest id of its connected component."""
    lowest = np.arange(count)
    for link in range(ends.shape[0]):
        i = ends[link, 0]
        j = ends[link, 1]
        while lowest[i] != i:
            lowest[i] = lowest[lowest[i]]
            i = lowest[i]
        while lowest[j] != j:
            lowest[j] = lowest[lowest[j]]
            j = lowest[j]
        lowest[max(i, j)] = min(i, j)
    return lowest == np.arange(count)


@compiled
def _adjacency(
    ends: Indices, linking: Reals, held: NDArray[np.bool_]
) -> tuple[Indices, Indices, Indices, Reals, Indices, int]:
    """Return the neighbours of every experience, as linked lists in a pool of entries.

    Held experiences are left out: they do not move.

    Returns:
        (n,) first entry of each experience or -1, and number of its neighbours; neighbour and
        block of each entry, and the next entry of the list or -1, with room for more; number of
        entries.
    """
    count = held.shape[0]
    head, degree = np.full(count, -1), np.zeros(count, np.int64)
    size = 2 * ends.shape[0] + 16
    other, after = np.empty(size, np.int64), np.empty(size, np.int64)
    block = np.zeros((size, 3, 3))
    used = 0
    for link in range(ends.shape[0]):
        if ends[link, 0] == ends[link, 1] or held[ends[link, 0]] or held[ends[link, 1]]:
            continue
        for side in range(2):
            i = ends[link, side]
            j = ends[link, 1 - side]
            at = head[i]
            while at >= 0 and other[at] != j:
                at = after[at]
            if at < 0:
                at = used
                other[at], after[at], head[i] = j, head[i], at
                degree[i] += 1
                used += 1
            for r in range(3):
                for c in range(3):
                    block[at, r, c] += linking[link, r, c] if side == 0 else linking[link, c, r]
    return head, degree, other, block, after, used


@compiled
def _insert(i: int, degree: int, first: Indices, left: Indices, right: Indices) -> None:
    """Put an experience in front of those with a degree.

    Args:
        i: the experience.
        degree: its degree.
        first: first experience of each degree, or -1.
        left, right: the ones before and after each experience, or -1.
    """
    left[i], right[i] = -1, first[degree]
    if right[i] >= 0:
        left[right[i]] = i
    first[degree] = i


@compiled
def _remove(i: int, degree: int, first: Indices, left: Indices, right: Indices) -> None:
    """Take an experience out of those with a degree; the arguments are those of ``_insert``."""
    if left[i] >= 0:
        right[left[i]] = right[i]
    else:
        first[degree] = right[i]
    if right[i] >= 0:
        left[right[i]] = left[i]


@compiled
def _grown(entries: NDArray[Any]) -> NDArray[Any]:
    """Return an array of twice the size that begins with given entries."""
    return np.concatenate((entries, np.empty_like(entries)))


@compiled
def _index(
    i: int, v: int, head: Indices, other: Indices, after: Indices, entry: Indices,
    owner: Indices, number: int,
) -> int:
    """Index the list of an experience i by neighbour, and remove its neighbour v from it.

    Entries are valid if their owner is ``number``. Returns the removed entry.
    """
    at, before, removed = head[i], -1, -1
    while at >= 0:
        if other[at] != v:
            entry[other[at]] = before = at
            owner[other[at]] = number
        else:
            removed = at
            if before < 0:
                head[i] = after[at]
            else:
                after[before] = after[at]
        at = after[at]
    return removed


@compiled
def _links_of(
    mesh: Indices, head: Indices, degree: Indices, other: Indices, block: Reals, after: Indices
) -> tuple[Indices, Indices, Reals]:
    """Return sources, targets and blocks of the links of experiences, one entry per direction."""
    count = degree[mesh].sum()
    sources, targets = np.empty(count, np.int64), np.empty(count, np.int64)
    blocks = np.empty((count, 3, 3))
    filled = 0
    for i in mesh:
        at = head[i]
        while at >= 0:
            sources[filled], targets[filled], blocks[filled] = i, other[at], block[at]
            filled += 1
            at = after[at]
    return sources, targets, blocks


@compiled
def _inverse(block: Reals, inverse: Reals) -> None:
    """Invert a symmetric positive definite block."""
    a, b, c = block[0, 0], block[0, 1], block[0, 2]
    d, e, f = block[1, 1], block[1, 2], block[2, 2]
    x, y, z = d * f - e * e, c * e - b * f, b * e - c * d
    scale = 1.0 / (a * x + b * y + c * z)
    inverse[0, 0], inverse[0, 1], inverse[0, 2] = x * scale, y * scale, z * scale
    inverse[1, 0], inverse[1, 1] = y * scale, (a * f - c * c) * scale
    inverse[1, 2] = inverse[2, 1] = (b * c - a * e) * scale
    inverse[2, 0], inverse[2, 2] = z * scale, (a * d - b * b) * scale


@compiled
def _subtract_product(
    left: Reals, a: int, right: Reals, b: int, result: Reals, c: int
) -> None:
    """Subtract the product of two blocks, given by arrays and indices, from a third one.

    Unrolled by hand, as the compiler cannot know that the result is another array.
    """
    r00, r01, r02 = right[b, 0, 0], right[b, 0, 1], right[b, 0, 2]
    r10, r11, r12 = right[b, 1, 0], right[b, 1, 1], right[b, 1, 2]
    r20, r21, r22 = right[b, 2, 0], right[b, 2, 1], right[b, 2, 2]
    for i in range(3):
        x, y, z = left[a, i, 0], left[a, i, 1], left[a, i, 2]
        result[c, i, 0] -= x * r00 + y * r10 + z * r20
        result[c, i, 1] -= x * r01 + y * r11 + z * r21
        result[c, i, 2] -= x * r02 + y * r12 + z * r22


@compiled
def _eliminate(
    ends: Indices, diagonal: Reals, linking: Reals, held: NDArray[np.bool_], mesh_degree: int
) -> tuple[
    tuple[Indices, Indices, Indices, Reals, Reals], Indices, tuple[Indices, Indices, Reals], int
]:
    """Eliminate experiences by degree, up to a degree of ``mesh_degree``.

    Args:
        ends: (links, 2) source and target.
        diagonal, linking: from ``_normal_equations``; the first is changed in place.
        held: (n,) whether an experience is held fixed.
        mesh_degree: largest degree.

    Returns:
        The plan: the (m,) experiences in the order of elimination; the (m + 1,) index of the first
        neighbour of each; all neighbours, and the (3, 3) factors of their rows; and the (m, 3, 3)
        inverse blocks of the experiences. Then the remaining experiences; sources, targets and
        blocks of their links, (links,) each; and the number of steps taken.
    """
    count = held.shape[0]
    head, degree, other, block, after, used = _adjacency(ends, linking, held)
    first, left, right = np.full(count + 1, -1), np.full(count, -1), np.full(count, -1)
    for i in range(count - 1, -1, -1):
        if not held[i]:
            _insert(i, degree[i], first, left, right)
    total = count - held.sum()
    order, starts = np.empty(total, np.int64), np.zeros(total + 1, np.int64)
    inverses = np.empty((total, 3, 3))
    neighbours, entries = np.empty(2 * len(other), np.int64), np.empty(2 * len(other), np.int64)
    factors = np.empty((2 * len(other), 3, 3))
    filled, least, work, done, free = 0, 0, 0, 0, -1
    entry, owner = np.empty(count, np.int64), np.full(count, -1)
    remains = ~held
    for step in range(total):
        while first[least] < 0:
            least += 1
        if least > mesh_degree:
            break
        done += 1
        v = first[least]
        _remove(v, least, first, left, right)
        remains[v] = False
        begin, more = filled, degree[v]
        if filled + more > neighbours.shape[0]:
            neighbours, factors, entries = _grown(neighbours), _grown(factors), _grown(entries)
        while used + more * more > other.shape[0]:
            other, block, after = _grown(other), _grown(block), _grown(after)
        _inverse(diagonal[v], inverses[step])
        at = head[v]
        while at >= 0:
            neighbours[filled], entries[filled] = other[at], at
            for r in range(3):
                for c in range(3):
                    factors[filled, r, c] = (
                        block[at, 0, r] * inverses[step, 0, c]
                        + block[at, 1, r] * inverses[step, 1, c]
                        + block[at, 2, r] * inverses[step, 2, c]
                    )
            filled += 1
            at = after[at]
        order[step], starts[step + 1] = v, filled

        for a in range(begin, filled):
            i = neighbours[a]
            work += degree[i] + filled - begin
            new_degree = degree[i] - 1
            at = _index(i, v, head, other, after, entry, owner, a)
            after[at], free = free, at
            for b in range(begin, filled):
                j = neighbours[b]
                if a == b:
                    _subtract_product(factors, a, block, entries[b], diagonal, i)
                    continue
                if owner[j] != a:
                    if free < 0:
                        at, used = used, used + 1
                    else:
                        at, free = free, after[free]
                    other[at], after[at], block[at] = j, head[i], 0.0
                    head[i] = entry[j] = at
                    owner[j] = a
                    new_degree += 1
                _subtract_product(factors, a, block, entries[b], block, entry[j])
            if new_degree != degree[i]:
                _remove(i, degree[i], first, left, right)
                _insert(i, new_degree, first, left, right)
                least = min(least, new_degree)
            degree[i] = new_degree
        for a in range(begin, filled):
            after[entries[a]], free = free, entries[a]
    mesh = np.flatnonzero(remains)
    plan = (
        order[:done], starts[: done + 1], neighbours[:filled], factors[:filled], inverses[:done]
    )
    return plan, mesh, _links_of(mesh, head, degree, other, block, after), work


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
    """Return the sum of the squared residuals in standard deviations.

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
    """Return the linear equations for a step; arguments as for ``relax``.

    A rotation of its source moves the predicted target of a link sideways.

    Returns:
        (n, 3, 3) block of each experience; (links, 3, 3) block of each link, with the row of its
        source and the column of its target; (n, 3) right sides.
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
def _eliminate_forward(
    order: Indices, starts: Indices, neighbours: Indices, factors: Reals, inverses: Reals,
    right: Reals,
) -> None:
    """Forward elimination of (n, 3) right sides."""
    for step in range(order.shape[0]):
        x, y, z = right[order[step]]
        for at in range(starts[step], starts[step + 1]):
            for r in range(3):
                right[neighbours[at], r] -= (
                    factors[at, r, 0] * x + factors[at, r, 1] * y + factors[at, r, 2] * z
                )


@compiled
def _substitute_back(
    order: Indices, starts: Indices, neighbours: Indices, factors: Reals, inverses: Reals,
    right: Reals,
) -> None:
    """Back substitution: compute each displacement from those of its neighbours."""
    for step in range(order.shape[0] - 1, -1, -1):
        x, y, z = right[order[step]]
        for r in range(3):
            right[order[step], r] = (
                inverses[step, r, 0] * x + inverses[step, r, 1] * y + inverses[step, r, 2] * z
            )
        for at in range(starts[step], starts[step + 1]):
            x, y, z = right[neighbours[at]]
            for r in range(3):
                right[order[step], r] -= (
                    factors[at, 0, r] * x + factors[at, 1, r] * y + factors[at, 2, r] * z
                )


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
