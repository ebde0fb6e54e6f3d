# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Relaxation: links, poses -> the poses at which the links pull equally from all sides.

The fixed point of seed 000 equation (7) is a least squares problem, headings first, then positions
given the headings; both have one matrix, the graph's Laplacian. It is solved by eliminating one
experience after the other, the one with the fewest neighbours first. In a network of resistors
that is the star-mesh transform: an experience is taken out, and its neighbours are linked by what
led through it. All terms are positive, so nothing cancels, and the order is fixed, so the result
is the same at every run. Routes are chains with few crossings; hardly any links are added on the
way, and the cost grows with the number of links, where sweeps from link to link need a number of
sweeps that itself grows with the square of a loop's length.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ratslam_ros.core.common.angles import wrap
from ratslam_ros.core.common.compiled import compiled

Reals = NDArray[np.float64]
Indices = NDArray[np.int64]


MESH = 8
"""An experience with more neighbours than this, when no other has fewer, is in a mesh: the rest is
left to SciPy's sparse factorisation, which orders a mesh slower and eliminates it faster."""


MESH_WORK = 50
"""Steps that a link of a mesh counts for; measured on square grids."""


class Elimination(NamedTuple):
    """An order in which experiences are eliminated, and what goes from each to its neighbours.

    ``order``: (m,) experiences; ``starts``: (m + 1,) where the neighbours of each begin in
    ``neighbours`` and ``shares``, the latter summing to 1; ``weights``: (m,) the sum of links.
    """

    order: Indices
    starts: Indices
    neighbours: Indices
    shares: Reals
    weights: Reals


class Relaxation:
    """The elimination of a graph, for as long as no link is added to it but to new experiences.

    The experience with the lowest id of each connected part stays where it is.
    """

    def __init__(self, ends: Indices, count: int) -> None:
        """Plan.

        Args:
            ends: (links, 2) source and target.
            count: number of experiences.
        """
        held = _lowest_of_part(ends, count)
        plan, mesh, (sources, targets, weights), work = _eliminate(ends, count, held, MESH)
        self._plan = Elimination(*plan)
        self._held = held
        self.links = len(ends)
        self.work = int(work) + MESH_WORK * len(sources)
        """Steps that planning took, about a third of what relaxing one link takes each."""
        self._mesh: Indices = mesh
        self._mesh_solve = None
        if len(mesh) > 0:
            self._mesh_solve = _factorised(mesh, held, sources, targets, weights)

    def relax(self, poses: Reals, ends: Indices, shapes: Reals) -> None:
        """Move all experiences to the fixed point.

        Headings are unwrapped as the present poses have them: of a link's error in heading, the
        turn of less than half a circle counts.

        Args:
            poses: (n, 3) x, y, heading; changed.
            ends: (links, 2) source and target: those that were planned, and others that each led
                to an experience that was new then.
            shapes: (links, 3) distance, heading, facing.
        """
        way = np.zeros((len(poses), 1))
        _pull_of_headings(poses, ends, shapes, way)
        self._solve(ends, way)
        _turn(poses, way)
        way = np.zeros((len(poses), 2))
        _pull_of_positions(poses, ends, shapes, way)
        self._solve(ends, way)
        poses[:, :2] += way

    def _solve(self, ends: Indices, way: Reals) -> None:
        """Turn what pulls at each experience, (n, k), into the way that it goes."""
        tail = ends[self.links :]
        held = np.ones(len(way), np.bool_)
        held[: len(self._held)] = self._held
        held[tail[:, 1]] = False
        _pass_on(*self._plan, tail, way)
        way[held] = 0.0
        if self._mesh_solve is not None:
            way[self._mesh] = self._mesh_solve(way[self._mesh])
        _follow(*self._plan, tail, way)


def _factorised(
    mesh: Indices, held: NDArray[np.bool_], sources: Indices, targets: Indices, weights: Reals
) -> Callable[[Reals], Reals]:
    """Return what solves for the experiences of the mesh."""
    from scipy.sparse import csc_array  # only a mesh needs it, and it takes a while to load
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
    ).solve  # fmt: skip
    return solve


@compiled
def _lowest_of_part(ends: Indices, count: int) -> NDArray[np.bool_]:
    """Return (n,) whether an experience has the lowest id of its connected part."""
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
def _eliminate(
    ends: Indices, count: int, held: NDArray[np.bool_], mesh_degree: int
) -> tuple[
    tuple[Indices, Indices, Indices, Reals, Reals], Indices, tuple[Indices, Indices, Reals], int
]:
    """Return an ``Elimination``, the experiences it leaves, their links, and the work it took."""
    # Neighbours and weights of every experience, as linked lists in a pool that grows.
    head = np.full(count, -1)
    degree = np.zeros(count, np.int64)
    size = 2 * ends.shape[0] + 16
    other = np.empty(size, np.int64)
    weight = np.empty(size)
    after = np.empty(size, np.int64)
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
                weight[at] += 1.0
                continue
            other[used] = j
            weight[used] = 1.0
            after[used] = head[i]
            head[i] = used
            degree[i] += 1
            used += 1

    # Experiences by degree, as doubly linked lists.
    first = np.full(count + 1, -1)
    left = np.full(count, -1)
    right = np.full(count, -1)
    for i in range(count - 1, -1, -1):
        if not held[i]:
            right[i] = first[degree[i]]
            if right[i] >= 0:
                left[right[i]] = i
            first[degree[i]] = i

    total = 0
    for i in range(count):
        total += not held[i]
    order = np.empty(total, np.int64)
    starts = np.empty(total + 1, np.int64)
    weights = np.empty(total)
    neighbours = np.empty(size, np.int64)
    shares = np.empty(size)
    starts[0] = 0
    filled = 0
    entry = np.full(count, -1)
    least = 0
    work = 0
    done = 0
    held_or_done = held.copy()
    for step in range(total):
        while first[least] < 0:
            least += 1
        if least > mesh_degree:
            break
        done += 1
        v = first[least]
        first[least] = right[v]
        if right[v] >= 0:
            left[right[v]] = -1

        if filled + degree[v] > neighbours.shape[0]:
            neighbours = np.concatenate((neighbours, np.empty_like(neighbours)))
            shares = np.concatenate((shares, np.empty_like(shares)))
        held_or_done[v] = True
        begin = filled
        sum_of_weights = 0.0
        at = head[v]
        while at >= 0:
            neighbours[filled] = other[at]
            shares[filled] = weight[at]
            sum_of_weights += weight[at]
            filled += 1
            at = after[at]
        order[step] = v
        starts[step + 1] = filled
        weights[step] = sum_of_weights

        for a in range(begin, filled):
            i = neighbours[a]
            # Where in i's list everyone is; v is taken out of it.
            at = head[i]
            before = -1
            while at >= 0:
                if other[at] == v:
                    if before < 0:
                        head[i] = after[at]
                    else:
                        after[before] = after[at]
                else:
                    entry[other[at]] = at
                    before = at
                at = after[at]
            new_degree = degree[i] - 1
            work += degree[i] + filled - begin
            for b in range(begin, filled):
                j = neighbours[b]
                if a == b:
                    continue
                led = shares[a] * shares[b] / sum_of_weights
                if entry[j] >= 0:
                    weight[entry[j]] += led
                    continue
                if used == other.shape[0]:
                    other = np.concatenate((other, np.empty_like(other)))
                    weight = np.concatenate((weight, np.empty_like(weight)))
                    after = np.concatenate((after, np.empty_like(after)))
                other[used] = j
                weight[used] = led
                after[used] = head[i]
                head[i] = used
                used += 1
                new_degree += 1
            at = head[i]
            while at >= 0:
                entry[other[at]] = -1
                at = after[at]
            if new_degree != degree[i] and not held[i]:
                if left[i] >= 0:
                    right[left[i]] = right[i]
                else:
                    first[degree[i]] = right[i]
                if right[i] >= 0:
                    left[right[i]] = left[i]
                left[i] = -1
                right[i] = first[new_degree]
                if right[i] >= 0:
                    left[right[i]] = i
                first[new_degree] = i
                least = min(least, new_degree)
            degree[i] = new_degree
        for a in range(begin, filled):
            shares[a] /= sum_of_weights
    mesh = np.flatnonzero(~held_or_done)
    rest = 0
    for i in mesh:
        rest += degree[i]
    sources = np.empty(rest, np.int64)
    targets = np.empty(rest, np.int64)
    between = np.empty(rest)
    rest = 0
    for i in mesh:
        at = head[i]
        while at >= 0:
            sources[rest] = i
            targets[rest] = other[at]
            between[rest] = weight[at]
            rest += 1
            at = after[at]
    plan = (
        order[:done].copy(), starts[: done + 1].copy(), neighbours[:filled].copy(),
        shares[:filled].copy(), weights[:done].copy(),
    )  # fmt: skip
    return plan, mesh, (sources, targets, between), work


@compiled
def _pull_of_headings(poses: Reals, ends: Indices, shapes: Reals, way: Reals) -> None:
    """Add up how far the links would turn each experience, (n, 1)."""
    for link in range(ends.shape[0]):
        i = ends[link, 0]
        j = ends[link, 1]
        error = wrap(poses[j, 2] - poses[i, 2] - shapes[link, 2])
        way[i, 0] += error
        way[j, 0] -= error


@compiled
def _turn(poses: Reals, way: Reals) -> None:
    for i in range(poses.shape[0]):
        poses[i, 2] = wrap(poses[i, 2] + way[i, 0])


@compiled
def _pull_of_positions(poses: Reals, ends: Indices, shapes: Reals, way: Reals) -> None:
    """Add up how far the links would move each experience, (n, 2)."""
    for link in range(ends.shape[0]):
        i = ends[link, 0]
        j = ends[link, 1]
        direction = poses[i, 2] + shapes[link, 1]
        error_x = poses[j, 0] - poses[i, 0] - shapes[link, 0] * math.cos(direction)
        error_y = poses[j, 1] - poses[i, 1] - shapes[link, 0] * math.sin(direction)
        way[i, 0] += error_x
        way[i, 1] += error_y
        way[j, 0] -= error_x
        way[j, 1] -= error_y


@compiled
def _pass_on(
    order: Indices, starts: Indices, neighbours: Indices, shares: Reals, weights: Reals,
    tail: Indices, way: Reals,
) -> None:  # fmt: skip
    """Let each experience pass what pulls at it on to its neighbours, the newest first."""
    for axis in range(way.shape[1]):
        for link in range(tail.shape[0] - 1, -1, -1):
            way[tail[link, 0], axis] += way[tail[link, 1], axis]
        for step in range(order.shape[0]):
            pull = way[order[step], axis]
            for at in range(starts[step], starts[step + 1]):
                way[neighbours[at], axis] += shares[at] * pull


@compiled
def _follow(
    order: Indices, starts: Indices, neighbours: Indices, shares: Reals, weights: Reals,
    tail: Indices, way: Reals,
) -> None:  # fmt: skip
    """Let each experience follow its neighbours, in the opposite order."""
    for axis in range(way.shape[1]):
        for step in range(order.shape[0] - 1, -1, -1):
            moved = way[order[step], axis] / weights[step]
            for at in range(starts[step], starts[step + 1]):
                moved += shares[at] * way[neighbours[at], axis]
            way[order[step], axis] = moved
        for link in range(tail.shape[0]):
            way[tail[link, 1], axis] += way[tail[link, 0], axis]


@compiled
def sweep(
    poses: NDArray[np.float64], ends: NDArray[np.int64], shapes: NDArray[np.float64],
    links: int, correction: float, sweeps: int,
) -> None:  # fmt: skip
    """Move both ends of each link towards what it says, in the order the links were made.

    Seed 000 equation (7), with p_k - p_i + dp_ki in its second sum; experience 0 is held fixed.
    """
    for _ in range(sweeps):
        for row in range(links):
            i = ends[row, 0]
            j = ends[row, 1]
            direction = poses[i, 2] + shapes[row, 1]
            e_x = correction * (poses[j, 0] - poses[i, 0] - shapes[row, 0] * math.cos(direction))
            e_y = correction * (poses[j, 1] - poses[i, 1] - shapes[row, 0] * math.sin(direction))
            e_t = correction * wrap(poses[j, 2] - poses[i, 2] - shapes[row, 2])
            if i > 0:
                poses[i, 0] += e_x
                poses[i, 1] += e_y
                poses[i, 2] = wrap(poses[i, 2] + e_t)
            if j > 0:
                poses[j, 0] -= e_x
                poses[j, 1] -= e_y
                poses[j, 2] = wrap(poses[j, 2] - e_t)
