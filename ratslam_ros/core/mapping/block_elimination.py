# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Block elimination: direct solution of the normal equations of a pose graph.

The matrix has a 3 x 3 block for each experience and for each link. Experiences are eliminated in
the order of their degree. Routes are chains with few crossings, so elimination adds few links and
its cost is linear in the number of links. The order is fixed, so every run has the same result.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from ratslam_ros.core.common.compiled import compiled

Reals = NDArray[np.float64]
Indices = NDArray[np.int64]

MAX_DEGREE = 60
"""Degree above which elimination stops; SciPy's sparse factorisation solves the remaining mesh.

It takes longer to order the mesh, but eliminates it faster.
"""

MESH_STEPS_PER_LINK = 50
"""Number of elimination steps that each link of the mesh counts as; measured on square grids."""


def solve(ends: Indices, diagonal: Reals, linking: Reals, rhs: Reals) -> int:
    """Solve the normal equations of a pose graph.

    The experience with the lowest id of each connected component is held fixed: its solution is 0.

    Args:
        ends: (links, 2) source and target.
        diagonal: (n, 3, 3) block of each experience; changed in place.
        linking: (links, 3, 3) block of each link: row of its source, column of its target.
        rhs: (n, 3, k) right-hand sides; replaced by the solutions.

    Returns:
        Number of elimination steps, a measure of the cost.
    """
    held = _lowest_of_component(ends, len(rhs))
    rhs[held] = 0.0
    factors, mesh, links, work = _eliminate(ends, diagonal, linking, held, rhs, MAX_DEGREE)
    if len(mesh) > 0:
        rhs[mesh] = _solved(mesh, *links, diagonal, rhs[mesh])
    _substitute_back(*factors, rhs)
    return work + MESH_STEPS_PER_LINK * len(links[0])


def _solved(
    mesh: Indices, sources: Indices, targets: Indices, blocks: Reals, diagonal: Reals,
    rhs: Reals,
) -> Reals:
    """Return the (m, 3, k) displacements of the experiences of the mesh.

    Args:
        mesh: (m,) experiences.
        sources, targets: (links,) ends of the links of the mesh, one entry per direction.
        blocks: (links, 3, 3) blocks of these links.
        diagonal: (n, 3, 3) blocks of all experiences.
        rhs: (m, 3, k) right-hand sides.
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
    size = 3 * len(mesh)
    matrix = bsr_array((values, columns, starts), shape=(size, size)).tocsc()
    factors = splu(
        matrix, permc_spec='MMD_AT_PLUS_A', diag_pivot_thresh=0.0,
        options={'SymmetricMode': True},
    )
    solution: Reals = factors.solve(rhs.reshape(size, -1))
    return solution.reshape(rhs.shape)


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
    ends: Indices, diagonal: Reals, linking: Reals, held: NDArray[np.bool_], rhs: Reals,
    mesh_degree: int,
) -> tuple[
    tuple[Indices, Indices, Indices, Reals, Reals], Indices, tuple[Indices, Indices, Reals], int
]:
    """Eliminate experiences by degree, up to a degree of ``mesh_degree``.

    Args:
        ends, diagonal, linking, rhs: as for ``solve``; diagonal and rhs are changed in place.
        held: (n,) whether an experience is held fixed.
        mesh_degree: largest degree.

    Returns:
        The factors: the (m,) experiences in the order of elimination; the (m + 1,) index of the
        first neighbour of each; all neighbours, and the (3, 3) factors of their rows; and the
        (m, 3, 3) inverse blocks of the experiences. Then the remaining experiences; sources,
        targets and blocks of their links, (links,) each; and the number of steps taken.
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
            for k in range(rhs.shape[2]):
                x, y, z = rhs[v, 0, k], rhs[v, 1, k], rhs[v, 2, k]
                for r in range(3):
                    rhs[i, r, k] -= (
                        factors[a, r, 0] * x + factors[a, r, 1] * y + factors[a, r, 2] * z
                    )
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
    by_step = (
        order[:done], starts[: done + 1], neighbours[:filled], factors[:filled], inverses[:done]
    )
    return by_step, mesh, _links_of(mesh, head, degree, other, block, after), work


@compiled
def _substitute_back(
    order: Indices, starts: Indices, neighbours: Indices, factors: Reals, inverses: Reals,
    rhs: Reals,
) -> None:
    """Back substitution: compute each displacement from those of its neighbours."""
    for step in range(order.shape[0] - 1, -1, -1):
        i = order[step]
        for k in range(rhs.shape[2]):
            x, y, z = rhs[i, 0, k], rhs[i, 1, k], rhs[i, 2, k]
            for r in range(3):
                rhs[i, r, k] = (
                    inverses[step, r, 0] * x + inverses[step, r, 1] * y
                    + inverses[step, r, 2] * z
                )
            for at in range(starts[step], starts[step + 1]):
                j = neighbours[at]
                x, y, z = rhs[j, 0, k], rhs[j, 1, k], rhs[j, 2, k]
                for r in range(3):
                    rhs[i, r, k] -= (
                        factors[at, 0, r] * x + factors[at, 1, r] * y + factors[at, 2, r] * z
                    )
