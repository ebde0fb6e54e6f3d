# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""People who walk about the floor, keep to the right and stop for the robot, but not for ever."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np
from numba import njit
from numpy.typing import NDArray

from ratslam_ros.core.odometry import Pose
from ratslam_ros.errors import UnusableInput
from ratslam_ros.simulator.bodies import fits, room_for, slide
from ratslam_ros.simulator.world import PERSON_RADIUS_M, World

if TYPE_CHECKING:
    from scipy.sparse import csr_array

_DESTINATIONS = 16
_SPEED_MPS, _SPEED_SPREAD_MPS = 1.0, 0.15
_PATIENCE_S = 3.0, 6.0
# Elbow room that people like to have; where there is less they go only if they must.
_ELBOW_M = 0.1
_WALL_FACTOR, _TIGHT_FACTOR = 2.0, 1000.0
# How far ahead they look for their way, and how far to the right of it they keep.
_LOOK_AHEAD_M, _KEEP_RIGHT_M, _ARRIVED_M = 0.9, 0.45, 0.3
# They stop this far from what stands in their way, between the outlines, and never come closer
# than the second; somebody this far to the side is not in the way.
_STOP_M, _NEAREST_M, _PASSING_M = 0.5, 0.05, 0.08
# At the beginning nobody is closer to the robot than this.
_FIRST_DISTANCE_M = 2.0
_TRIES = 8

# Columns of the walkers' array.
_SPEED, _WAITED, _PATIENCE, _TARGET, _GOES, _COLUMNS = 0, 1, 2, 3, 4, 5


class People:
    """Moves the people of a world; the generator decides where to and how patiently.

    Raises UnusableInput where there is no room for so many.
    """

    def __init__(
        self,
        world: World,
        count: int,
        rng: np.random.Generator,
        robot: Pose,
        robot_radius_m: float,
    ) -> None:
        self._world = world
        self._rng = rng
        self._robot_radius_m = robot_radius_m
        self._walkers = np.zeros((count, _COLUMNS))
        self._walkers[:, _SPEED] = _SPEED_MPS + _SPEED_SPREAD_MPS * rng.standard_normal(count)
        self._walkers[:, _SPEED] = np.maximum(self._walkers[:, _SPEED], _SPEED_MPS / 2)
        roomy = self._roomy_cells()
        chosen = rng.choice(len(roomy), min(_DESTINATIONS, len(roomy)), replace=False)
        self._destinations = roomy[chosen]
        world.people = np.empty((0, 4))
        for index in rng.permutation(len(roomy)):
            if len(world.people) == count:
                break
            x_m, y_m = self._middle(roomy[index])
            from_robot_m = math.hypot(x_m - robot.x_m, y_m - robot.y_m)
            if from_robot_m >= _FIRST_DISTANCE_M and self._nearest_m(x_m, y_m) >= 1.0:
                clothes = float(rng.choice(world.library.clothes))
                facing_rad = rng.uniform(-math.pi, math.pi)
                world.people = np.vstack([world.people, (x_m, y_m, facing_rad, clothes)])
        if len(world.people) < count:
            raise UnusableInput(
                f'there is room for {len(world.people)} people on this floor, not for {count}: '
                'choose fewer'
            )
        self.floor_changed()

    def floor_changed(self) -> None:
        """Find new ways, because something was put up or taken away."""
        cells = self._world.solid.size
        # The next cell on the way to each destination, from every cell; filled when first used.
        self._next = np.full((len(self._destinations), cells), -1, np.int32)
        self._known = np.zeros(len(self._destinations), bool)
        self._graph: csr_array | None = None
        self._walkers[:, _GOES] = 0.0

    def walk(self, robot: Pose, duration_s: float) -> None:
        """Let everybody walk on for a moment."""
        world = self._world
        undecided = _walk(
            world.solid,
            world.plan.cell_m,
            world.people,
            self._walkers,
            self._next,
            robot.x_m,
            robot.y_m,
            self._robot_radius_m,
            duration_s,
        )
        if undecided:
            for person in np.flatnonzero(self._walkers[:, _GOES] == 0.0).tolist():
                self._decide(person)

    def make_way(self, robot: Pose) -> None:
        """Move whoever stands inside something that was set down, or inside the robot, aside."""
        world, cell_m = self._world, self._world.plan.cell_m
        apart_m = self._robot_radius_m + PERSON_RADIUS_M + _NEAREST_M
        for person, (x_m, y_m, _, _) in enumerate(world.people.tolist()):
            clear_m = math.hypot(x_m - robot.x_m, y_m - robot.y_m)
            if clear_m >= apart_m and fits(world.solid, cell_m, x_m, y_m, PERSON_RADIUS_M):
                continue
            cells = np.flatnonzero(room_for(world.solid, cell_m, PERSON_RADIUS_M))
            middles = np.array([self._middle(cell) for cell in cells.tolist()])
            others = np.delete(world.people, person, axis=0)[:, :2]
            away = np.hypot(*(middles - (robot.x_m, robot.y_m)).T) >= apart_m
            for other in others:
                away &= np.hypot(*(middles - other).T) >= 2 * PERSON_RADIUS_M + _NEAREST_M
            aside = np.where(away, np.hypot(*(middles - (x_m, y_m)).T), np.inf)
            world.people[person, :2] = middles[int(np.argmin(aside))]

    def _decide(self, person: int) -> None:
        """Choose where to go, rather not where it was blocked, and how long to wait if it is."""
        x_m, y_m, facing_rad, _ = self._world.people[person].tolist()
        walker = self._walkers[person]
        cell_m, columns = self._world.plan.cell_m, self._world.solid.shape[1]
        cell = int(y_m / cell_m) * columns + int(x_m / cell_m)
        for _ in range(_TRIES):
            target = int(self._rng.integers(len(self._destinations)))
            next_cell = self._way_to(target)[cell]
            if next_cell < 0:
                continue
            to_x_m, to_y_m = self._middle(next_cell)
            ahead = (to_x_m - x_m) * math.cos(facing_rad) + (to_y_m - y_m) * math.sin(facing_rad)
            walker[_TARGET], walker[_GOES] = target, 1.0
            if walker[_WAITED] == 0.0 or ahead < 0.0:
                break
        walker[_WAITED] = 0.0
        walker[_PATIENCE] = self._rng.uniform(*_PATIENCE_S)

    def _way_to(self, target: int) -> NDArray[np.int32]:
        if not self._known[target]:
            from scipy.sparse.csgraph import dijkstra  # takes a while to load

            if self._graph is None:
                self._graph = _graph(self._world.solid, self._world.plan.cell_m)
            _, before = dijkstra(
                self._graph, indices=self._destinations[target], return_predecessors=True
            )
            self._next[target] = np.maximum(before, -1)
            self._known[target] = True
        way: NDArray[np.int32] = self._next[target]
        return way

    def _roomy_cells(self) -> NDArray[np.intp]:
        """List the cells of the largest part of the floor with elbow room, row by row."""
        from scipy.ndimage import label

        room = room_for(self._world.solid, self._world.plan.cell_m, PERSON_RADIUS_M + _ELBOW_M)
        areas, count = label(room)
        if not count:
            return np.empty(0, np.intp)
        return np.flatnonzero(areas == 1 + np.argmax(np.bincount(areas.ravel())[1:]))

    def _middle(self, cell: int) -> tuple[float, float]:
        row, column = divmod(int(cell), self._world.solid.shape[1])
        return (column + 0.5) * self._world.plan.cell_m, (row + 0.5) * self._world.plan.cell_m

    def _nearest_m(self, x_m: float, y_m: float) -> float:
        people = self._world.people
        return float(np.hypot(people[:, 0] - x_m, people[:, 1] - y_m).min(initial=math.inf))


def _graph(solid: NDArray[np.bool_], cell_m: float) -> csr_array:
    """Join free cells to their eight neighbours; near walls it is as if the way were longer."""
    from scipy.sparse import csr_array

    factor = np.where(room_for(solid, cell_m, PERSON_RADIUS_M), _WALL_FACTOR, _TIGHT_FACTOR)
    factor[room_for(solid, cell_m, PERSON_RADIUS_M + _ELBOW_M)] = 1.0
    number = np.arange(solid.size).reshape(solid.shape)
    sources, targets, lengths = [], [], []
    for step_y, step_x in ((0, 1), (1, 0), (1, 1), (1, -1)):
        n_y, n_x = solid.shape
        here = (slice(0, n_y - step_y), slice(max(-step_x, 0), n_x - max(step_x, 0)))
        there = (slice(step_y, n_y), slice(max(step_x, 0), n_x + min(step_x, 0)))
        free = ~solid[here] & ~solid[there]
        sources.append(number[here][free])
        targets.append(number[there][free])
        step_m = cell_m * math.hypot(step_x, step_y)
        lengths.append(step_m * np.maximum(factor[here], factor[there])[free])
    source, target = np.concatenate(sources), np.concatenate(targets)
    length = np.concatenate(lengths)
    both = (np.concatenate([source, target]), np.concatenate([target, source]))
    return csr_array((np.concatenate([length, length]), both), (solid.size, solid.size))


@njit(cache=True)
def _walk(  # type: ignore[no-untyped-def]
    solid, cell_m, people, walkers, next_cell, robot_x_m, robot_y_m, robot_radius_m, duration_s,
):  # fmt: skip
    """Move everybody who knows where to; returns how many do not."""
    undecided = 0
    nobody = people[:0]
    for person in range(len(people)):
        walker = walkers[person]
        if walker[_GOES] == 0.0:
            undecided += 1
            continue
        x_m, y_m = people[person, 0], people[person, 1]
        aim_x, aim_y, left_m = _aim(solid, cell_m, next_cell[int(walker[_TARGET])], x_m, y_m)
        distance_m = math.hypot(aim_x - x_m, aim_y - y_m)
        if left_m < _ARRIVED_M:
            walker[_GOES] = 0.0
            undecided += 1
            continue
        ahead_x, ahead_y = (aim_x - x_m) / distance_m, (aim_y - y_m) / distance_m
        people[person, 2] = math.atan2(ahead_y, ahead_x)
        step_m = min(walker[_SPEED] * duration_s, distance_m)
        to_x, to_y, _ = slide(
            solid, cell_m, nobody, 0.0, x_m, y_m, x_m + step_m * ahead_x, y_m + step_m * ahead_y,
            PERSON_RADIUS_M,
        )  # fmt: skip
        blocked = _in_the_way(
            x_m, y_m, to_x, to_y, ahead_x, ahead_y, robot_x_m, robot_y_m, robot_radius_m
        )
        for other in range(len(people)):
            blocked |= other != person and _in_the_way(
                x_m, y_m, to_x, to_y, ahead_x, ahead_y, people[other, 0], people[other, 1],
                PERSON_RADIUS_M,
            )  # fmt: skip
        if not blocked:
            people[person, 0], people[person, 1] = to_x, to_y
        if blocked or math.hypot(to_x - x_m, to_y - y_m) < step_m / 4:
            walker[_WAITED] += duration_s
            if walker[_WAITED] > walker[_PATIENCE]:
                walker[_GOES] = 0.0
                undecided += 1
        else:
            walker[_WAITED] = 0.0
    return undecided


@njit(cache=True)
def _aim(solid, cell_m, next_cell, x_m, y_m):  # type: ignore[no-untyped-def]
    """Choose the point to walk to: as far along the way as can be seen, and right of it.

    Returns x_m, y_m and how far the way goes on, up to the look-ahead
    """
    n_x = solid.shape[1]
    cell = int(y_m / cell_m) * n_x + int(x_m / cell_m)
    aim_x, aim_y = x_m, y_m
    way_m = 0.0
    seen = True
    while way_m < _LOOK_AHEAD_M:
        following = next_cell[cell]
        if following < 0:
            break
        cell = following
        to_x, to_y = (cell % n_x + 0.5) * cell_m, (cell // n_x + 0.5) * cell_m
        # The first point is taken on trust: from it the way goes on.
        seen = seen and (way_m == 0.0 or _straight(solid, cell_m, x_m, y_m, to_x, to_y))
        if seen:
            aim_x, aim_y = to_x, to_y
        way_m += cell_m
    distance_m = math.hypot(aim_x - x_m, aim_y - y_m)
    if way_m >= _LOOK_AHEAD_M and distance_m > _KEEP_RIGHT_M:
        right_x, right_y = (aim_y - y_m) / distance_m, -(aim_x - x_m) / distance_m
        kept_x, kept_y = aim_x + _KEEP_RIGHT_M * right_x, aim_y + _KEEP_RIGHT_M * right_y
        if _straight(solid, cell_m, x_m, y_m, kept_x, kept_y):
            aim_x, aim_y = kept_x, kept_y
    return aim_x, aim_y, min(way_m, math.hypot(aim_x - x_m, aim_y - y_m))


@njit(cache=True)
def _straight(solid, cell_m, x_m, y_m, to_x, to_y):  # type: ignore[no-untyped-def]
    """Say whether a person gets somewhere in a straight line."""
    pieces = int(math.hypot(to_x - x_m, to_y - y_m) / PERSON_RADIUS_M) + 1
    for piece in range(1, pieces + 1):
        share = piece / pieces
        if not fits(
            solid, cell_m, x_m + share * (to_x - x_m), y_m + share * (to_y - y_m), PERSON_RADIUS_M
        ):
            return False
    return True


@njit(cache=True)
def _in_the_way(  # type: ignore[no-untyped-def]
    x_m, y_m, to_x, to_y, ahead_x, ahead_y, other_x, other_y, other_radius_m,
):  # fmt: skip
    """Say whether a body is just ahead, or the step would come too close to it."""
    touching_m = PERSON_RADIUS_M + other_radius_m
    dx, dy = other_x - x_m, other_y - y_m
    before_m, after_m = math.hypot(dx, dy), math.hypot(other_x - to_x, other_y - to_y)
    if after_m < touching_m + _NEAREST_M and after_m < before_m:
        return True
    along_m, aside_m = dx * ahead_x + dy * ahead_y, abs(dy * ahead_x - dx * ahead_y)
    return 0.0 < along_m < touching_m + _STOP_M and aside_m < touching_m + _PASSING_M
