# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Relaxation: direct solution for the fixed point of the experience map's correction rule.

The fixed point of equation (7) of Milford, Wyeth and Prasser (2006) is a linear least-squares
problem: first the headings, then the positions given the headings. Both have the same matrix, the
Laplacian of the graph, in which links may have weights. It is solved by eliminating experiences in
the order of their degree. This is the star-mesh transform of resistor networks: a node is removed,
and its neighbours are linked by weights that represent the paths through it. All terms are
positive, so there is no cancellation, and the order is fixed, so the result is the same on every
run. Routes are chains with few crossings, so elimination adds few links and its cost is linear in
the number of links. Iterative sweeps, in contrast, need a number of sweeps that is quadratic in
the length of a loop.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ratslam_ros.core.common.angles import wrap
from ratslam_ros.core.common.compiled import compiled

Reals = NDArray[np.float64]
Indices = NDArray[np.int64]


MAX_DEGREE = 8
"""Degree above which elimination stops; SciPy's sparse factorisation solves the remaining mesh.

The factorisation takes longer to order the mesh, but eliminates it faster.
"""

MESH_STEPS_PER_LINK = 50
"""Number of planning steps that each link of the mesh counts as; measured on square grids."""


class Relaxation:
    """Elimination plan of a graph; stays valid while links are added only to new experiences.

    The experience with the lowest id of each connected component is held fixed.
    """

    def __init__(self, ends: Indices, count: int, weights: Reals | None = None) -> None:
        """Plan the elimination.

        Args:
            ends: (links, 2) source and target.
            count: number of experiences.
            weights: (links,) weights above 0; None: all are 1.
        """
        held = _lowest_of_component(ends, count)
        weights = np.ones(len(ends)) if weights is None else weights
        self._plan, mesh, (sources, targets, weights), work = _eliminate(
            ends, weights, count, held, MAX_DEGREE
        )
        self._held = held
        self.links = len(ends)
        """Number of planned links."""
        self.work = int(work) + MESH_STEPS_PER_LINK * len(sources)
        """Number of planning steps; each takes about a third of the time to relax one link."""
        self._mesh: Indices = mesh
        self._mesh_solve = None
        if len(mesh) > 0:
            self._mesh_solve = _factorised(mesh, held, sources, targets, weights)

    def relax(
        self, poses: Reals, ends: Indices, shapes: Reals, weights: Reals | None = None
    ) -> None:
        """Move all experiences to the fixed point.

        The heading residuals of the present poses are wrapped to ±half a turn.

        Args:
            poses: (n, 3) x, y in m and heading in rad; changed in place.
            ends: (links, 2) source and target. The planned links, followed by the links that were
                added since; each of those has a target that was new.
            shapes: (links, 3) distance in m, heading and facing in rad.
            weights: (links,) weights, those of the plan for the planned links; None: all are 1.
        """
        weights = np.ones(len(ends)) if weights is None else weights
        correction = np.zeros((len(poses), 1))
        _heading_residuals(poses, ends, shapes, weights, correction)
        self._solve(ends, weights, correction)
        _rotate(poses, correction)
        correction = np.zeros((len(poses), 2))
        _position_residuals(poses, ends, shapes, weights, correction)
        self._solve(ends, weights, correction)
        poses[:, :2] += correction

    def _solve(self, ends: Indices, weights: Reals, correction: Reals) -> None:
        """Solve for the displacements.

        Args:
            ends, weights: as for ``relax``.
            correction: (n, k) weighted sums of the residuals; replaced by the displacements.
        """
        tail = ends[self.links :]
        held = np.ones(len(correction), np.bool_)
        held[: len(self._held)] = self._held
        held[tail[:, 1]] = False
        _eliminate_forward(*self._plan, tail, correction)
        correction[held] = 0.0
        if self._mesh_solve is not None:
            correction[self._mesh] = self._mesh_solve(correction[self._mesh])
        _substitute_back(*self._plan, tail, weights[self.links :], correction)


def _factorised(
    mesh: Indices, held: NDArray[np.bool_], sources: Indices, targets: Indices, weights: Reals
) -> Callable[[Reals], Reals]:
    """Return a solver for the experiences of the mesh.

    Args:
        mesh: (m,) experiences.
        held: (n,) whether an experience is held fixed.
        sources, targets: (links,) ends of the links of the mesh, one entry per direction.
        weights: (links,) weights of these links.
    """
    from scipy.sparse import csc_array  # loaded only if there is a mesh: the import is slow
    from scipy.sparse.linalg import splu

    number = np.full(len(held), -1)
    number[mesh] = np.arange(len(mesh))
    total = np.bincount(number[sources], weights, len(mesh))
    inner = ~held[targets]
    rows = np.concatenate([number[mesh], number[sources[inner]]])
    columns = np.concatenate([number[mesh], number[targets[inner]]])
    values = np.concatenate([total, -weights[inner]])
    laplacian = csc_array((values, (rows, columns)), shape=(len(mesh), len(mesh)))
    solve: Callable[[Reals], Reals] = splu(
        laplacian, permc_spec='MMD_AT_PLUS_A', diag_pivot_thresh=0.0,
        options={'SymmetricMode': True},
    ).solve
    return solve


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
    ends: Indices, link_weights: Reals, count: int
) -> tuple[Indices, Indices, Indices, Reals, Indices, int]:
    """Return the neighbours of every experience, as linked lists in a pool of entries.

    Returns:
        (count,) first entry of each experience or -1, and number of its neighbours; neighbour and
        weight of each entry, and the next entry of the list or -1, with room for more; number of
        entries.
    """
    head, degree = np.full(count, -1), np.zeros(count, np.int64)
    size = 2 * ends.shape[0] + 16
    other, weight, after = np.empty(size, np.int64), np.empty(size), np.empty(size, np.int64)
    used = 0
    for link in range(ends.shape[0]):
        for side in range(2):
            i = ends[link, side]
            j = ends[link, 1 - side]
            if i == j:
                continue
            at = head[i]
            while at >= 0 and other[at] != j:
                at = after[at]
            if at >= 0:
                weight[at] += link_weights[link]
                continue
            other[used], weight[used], after[used] = j, link_weights[link], head[i]
            head[i] = used
            degree[i] += 1
            used += 1
    return head, degree, other, weight, after, used


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
    i: int, v: int, head: Indices, other: Indices, after: Indices, entry: Indices
) -> None:
    """Index the list of an experience i by neighbour, and remove its neighbour v from it."""
    at, before = head[i], -1
    while at >= 0:
        if other[at] != v:
            entry[other[at]] = before = at
        elif before < 0:
            head[i] = after[at]
        else:
            after[before] = after[at]
        at = after[at]


@compiled
def _links_of(
    mesh: Indices, head: Indices, degree: Indices, other: Indices, weight: Reals, after: Indices
) -> tuple[Indices, Indices, Reals]:
    """Return sources, targets and weights of the links of experiences, one entry per direction."""
    count = degree[mesh].sum()
    sources, targets = np.empty(count, np.int64), np.empty(count, np.int64)
    weights = np.empty(count)
    filled = 0
    for i in mesh:
        at = head[i]
        while at >= 0:
            sources[filled], targets[filled], weights[filled] = i, other[at], weight[at]
            filled += 1
            at = after[at]
    return sources, targets, weights


@compiled
def _eliminate(
    ends: Indices, link_weights: Reals, count: int, held: NDArray[np.bool_], mesh_degree: int
) -> tuple[
    tuple[Indices, Indices, Indices, Reals, Reals], Indices, tuple[Indices, Indices, Reals], int
]:
    """Eliminate experiences by degree, up to a degree of ``mesh_degree``.

    Returns:
        The plan: the (m,) experiences in the order of elimination; the (m + 1,) index of the first
        neighbour of each; all neighbours, and their shares, which sum to 1 for each experience;
        and the (m,) sums of the weights of the links of each. Then the remaining experiences;
        sources, targets and weights of their links, (links,) each; and the number of steps taken.
    """
    head, degree, other, weight, after, used = _adjacency(ends, link_weights, count)
    first, left, right = np.full(count + 1, -1), np.full(count, -1), np.full(count, -1)
    for i in range(count - 1, -1, -1):
        if not held[i]:
            _insert(i, degree[i], first, left, right)
    total = count - held.sum()
    order, starts = np.empty(total, np.int64), np.zeros(total + 1, np.int64)
    weights = np.empty(total)
    neighbours, shares = np.empty(len(other), np.int64), np.empty(len(other))
    filled, least, work, done = 0, 0, 0, 0
    entry = np.full(count, -1)
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
            neighbours, shares = _grown(neighbours), _grown(shares)
        while used + more * more > other.shape[0]:
            other, weight, after = _grown(other), _grown(weight), _grown(after)
        sum_of_weights = 0.0
        at = head[v]
        while at >= 0:
            neighbours[filled], shares[filled] = other[at], weight[at]
            sum_of_weights += weight[at]
            filled += 1
            at = after[at]
        order[step], starts[step + 1], weights[step] = v, filled, sum_of_weights

        for a in range(begin, filled):
            i = neighbours[a]
            work += degree[i] + filled - begin
            before = used
            _index(i, v, head, other, after, entry)
            for b in range(begin, filled):
                j = neighbours[b]
                if a == b:
                    continue
                led = shares[a] * shares[b] / sum_of_weights
                if entry[j] >= 0:
                    weight[entry[j]] += led
                else:
                    other[used], weight[used], after[used] = j, led, head[i]
                    head[i] = used
                    used += 1
            at = head[i]
            while at >= 0:
                entry[other[at]] = -1
                at = after[at]
            new_degree = degree[i] - 1 + used - before
            if new_degree != degree[i] and not held[i]:
                _remove(i, degree[i], first, left, right)
                _insert(i, new_degree, first, left, right)
                least = min(least, new_degree)
            degree[i] = new_degree
        shares[begin:filled] /= sum_of_weights
    mesh = np.flatnonzero(remains)
    plan = (
        order[:done].copy(), starts[: done + 1].copy(), neighbours[:filled].copy(),
        shares[:filled].copy(), weights[:done].copy(),
    )
    return plan, mesh, _links_of(mesh, head, degree, other, weight, after), work


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
def _heading_residuals(
    poses: Reals, ends: Indices, shapes: Reals, weights: Reals, correction: Reals
) -> None:
    """Sum the weighted heading residuals of the links at each experience, (n, 1)."""
    for link in range(ends.shape[0]):
        i, j, _, _, turn = link_residual(poses, ends, shapes, link)
        correction[i, 0] += weights[link] * turn
        correction[j, 0] -= weights[link] * turn


@compiled
def _rotate(poses: Reals, correction: Reals) -> None:
    """Add (n, 1) corrections to the headings."""
    for i in range(poses.shape[0]):
        poses[i, 2] = wrap(poses[i, 2] + correction[i, 0])


@compiled
def _position_residuals(
    poses: Reals, ends: Indices, shapes: Reals, weights: Reals, correction: Reals
) -> None:
    """Sum the weighted position residuals of the links at each experience, (n, 2)."""
    for link in range(ends.shape[0]):
        i, j, x, y, _ = link_residual(poses, ends, shapes, link)
        correction[i, 0] += weights[link] * x
        correction[i, 1] += weights[link] * y
        correction[j, 0] -= weights[link] * x
        correction[j, 1] -= weights[link] * y


@compiled
def _eliminate_forward(
    order: Indices, starts: Indices, neighbours: Indices, shares: Reals, weights: Reals,
    tail: Indices, correction: Reals,
) -> None:
    """Forward elimination: add each residual to those of its neighbours, the newest first."""
    for axis in range(correction.shape[1]):
        for link in range(tail.shape[0] - 1, -1, -1):
            correction[tail[link, 0], axis] += correction[tail[link, 1], axis]
        for step in range(order.shape[0]):
            pull = correction[order[step], axis]
            for at in range(starts[step], starts[step + 1]):
                correction[neighbours[at], axis] += shares[at] * pull


@compiled
def _substitute_back(
    order: Indices, starts: Indices, neighbours: Indices, shares: Reals, weights: Reals,
    tail: Indices, tail_weights: Reals, correction: Reals,
) -> None:
    """Back substitution: compute each displacement from those of its neighbours."""
    for axis in range(correction.shape[1]):
        for step in range(order.shape[0] - 1, -1, -1):
            moved = correction[order[step], axis] / weights[step]
            for at in range(starts[step], starts[step + 1]):
                moved += shares[at] * correction[neighbours[at], axis]
            correction[order[step], axis] = moved
        for link in range(tail.shape[0]):
            displaced = correction[tail[link, 1], axis] / tail_weights[link]
            correction[tail[link, 1], axis] = displaced + correction[tail[link, 0], axis]


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
