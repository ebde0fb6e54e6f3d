# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""People who walk between random destinations or along given routes, and turn when blocked."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ratslam_ros.core.common.pose import Pose
from ratslam_ros.errors import UnusableInput
from ratslam_simulator.bodies import fits, room_for
from ratslam_simulator.people_kernels import (
    COLUMNS,
    HAS_TARGET,
    MIN_GAP_M,
    PATIENCE,
    SPEED,
    TARGET,
    WAITED,
    walk,
)
from ratslam_simulator.people_routes import COMFORT_MARGIN_M, PeopleRoutes
from ratslam_simulator.world import PERSON_RADIUS_M, World

DESTINATIONS_COUNT = 16
"""Number of cells that people choose their destinations from."""

SPEED_MPS, SPEED_SPREAD_MPS = 1.0, 0.15
"""Mean and standard deviation of the walking speed."""

PATIENCE_S = 3.0, 6.0
"""Range of the time for which a blocked person waits before choosing another destination."""

MIN_START_DISTANCE_M = 2.0
"""Minimum distance of people from the robot at the start, centre to centre."""

MIN_START_SPACING_M = 1.0
"""Minimum distance between people at the start, centre to centre."""

TARGET_DRAWS_COUNT = 8
"""Draws of a destination that is reachable and, after a blockage, lies behind the person."""


@dataclass(frozen=True)
class Walk:
    """A person who comes, walks along points, back and forth, and goes; at one point, who stands.

    points_m: x and y of each point; from_s, to_s: times after the start of the simulation
    """

    points_m: Sequence[tuple[float, float]]
    from_s: float
    to_s: float = math.inf


@dataclass
class _Script:
    """A person's walk: when it ends, its destinations, the present one and the next step."""

    to_s: float
    destinations: range
    at: int = 0
    step: int = 1

    def next_destination(self, is_blocked: bool) -> int:
        """Return the destination that follows; a blocked person turns round."""
        last = len(self.destinations) - 1
        if is_blocked or not 0 <= self.at + self.step <= last:
            self.step = -self.step
        self.at = min(max(self.at + self.step, 0), last)
        return self.destinations[self.at]


class People:
    """The people of a world, placed at random or by their walks, and moved in steps."""

    def __init__(
        self,
        world: World,
        count: int,
        rng: np.random.Generator,
        robot: Pose,
        robot_radius_m: float,
    ) -> None:
        """Place people on the floor.

        Args:
            world: their world, whose `people` are replaced and then changed in place.
            count: number of people at random places.
            rng: generator of places, destinations and patience.
            robot: pose of the robot at the start.
            robot_radius_m: radius of the robot's body.

        Raises:
            UnusableInput: the people do not all fit.
        """
        self._world = world
        self._rng = rng
        self._robot_radius_m = robot_radius_m
        self._walkers = np.zeros((count, COLUMNS))
        self._walkers[:, SPEED] = SPEED_MPS + SPEED_SPREAD_MPS * rng.standard_normal(count)
        self._walkers[:, SPEED] = np.maximum(self._walkers[:, SPEED], SPEED_MPS / 2)
        self._scripts: list[_Script | None] = [None] * count
        self._destinations, self._random_count = np.empty(0, np.intp), 0
        world.people = np.empty((0, 4))
        if count:
            self._place(count, robot)
        self.floor_changed()

    def _place(self, count: int, robot: Pose) -> None:
        """Place people at random, and draw their destinations."""
        world, rng = self._world, self._rng
        roomy = self._roomy_cells()
        chosen = rng.choice(len(roomy), min(DESTINATIONS_COUNT, len(roomy)), replace=False)
        self._destinations, self._random_count = roomy[chosen], len(chosen)
        for index in rng.permutation(len(roomy)):
            if len(world.people) == count:
                break
            x_m, y_m = self._centre(roomy[index])
            from_robot_m = math.hypot(x_m - robot.x_m, y_m - robot.y_m)
            if (
                from_robot_m >= MIN_START_DISTANCE_M
                and self._nearest_m(x_m, y_m) >= MIN_START_SPACING_M
            ):
                clothes = float(rng.choice(world.library.clothes))
                facing_rad = rng.uniform(-math.pi, math.pi)
                world.people = np.vstack([world.people, (x_m, y_m, facing_rad, clothes)])
        if len(world.people) < count:
            raise UnusableInput(
                f'there is room for {len(world.people)} people on this floor, not for {count}: '
                'choose fewer'
            )

    def check(self, walk: Walk) -> None:
        """Raise UnusableInput if a person does not fit at one of the points of a walk now."""
        for x_m, y_m in walk.points_m:
            self._world.require_room('a person', x_m, y_m, PERSON_RADIUS_M)

    def add(self, walk: Walk, robot: Pose) -> None:
        """Place a person at the first point of a walk, or beside the robot if it is there.

        Raises:
            UnusableInput: a person does not fit at one of the points.
        """
        world = self._world
        self.check(walk)
        cells = [self._cell(*point_m) for point_m in walk.points_m]
        first = len(self._destinations)
        self._destinations = np.concatenate([self._destinations, np.array(cells, np.intp)])
        self._scripts.append(_Script(walk.to_s, range(first, len(self._destinations))))
        walker = np.zeros(COLUMNS)
        walker[[SPEED, TARGET, HAS_TARGET]] = SPEED_MPS, first, 1.0
        self._walkers = np.vstack([self._walkers, walker])
        clothes = world.library.clothes[len(world.people) % len(world.library.clothes)]
        world.people = np.vstack([world.people, (*walk.points_m[0], 0.0, clothes)])
        self.make_way(robot)
        self.floor_changed()

    def remove_until(self, elapsed_s: float) -> None:
        """Remove those whose walks are over."""
        stays = [script is None or script.to_s > elapsed_s for script in self._scripts]
        if all(stays):
            return
        self._scripts = [one for one, stay in zip(self._scripts, stays, strict=True) if stay]
        self._walkers, self._world.people = self._walkers[stays], self._world.people[stays]

    def floor_changed(self) -> None:
        """Discard all routes, and destinations drawn, after obstacles or people were added."""
        self._routes = PeopleRoutes(
            self._world.solid, self._world.plan.cell_m, self._destinations
        )
        for walker, script in zip(self._walkers, self._scripts, strict=True):
            if script is None:
                walker[HAS_TARGET] = 0.0
            else:
                self._routes.to(int(walker[TARGET]))

    def walk(self, robot: Pose, duration_s: float) -> None:
        """Move everyone for a short time."""
        world = self._world
        undecided = walk(
            world.solid,
            world.plan.cell_m,
            world.people,
            self._walkers,
            self._routes.next_cell,
            robot.x_m,
            robot.y_m,
            self._robot_radius_m,
            duration_s,
        )
        if undecided:
            for person in np.flatnonzero(self._walkers[:, HAS_TARGET] == 0.0).tolist():
                self._choose_target(person)

    def make_way(self, robot: Pose) -> None:
        """Move people who overlap the robot or solid cells to the nearest free cell."""
        world, cell_m = self._world, self._world.plan.cell_m
        apart_m = self._robot_radius_m + PERSON_RADIUS_M + MIN_GAP_M
        for person, (x_m, y_m, _, _) in enumerate(world.people.tolist()):
            clear_m = math.hypot(x_m - robot.x_m, y_m - robot.y_m)
            if clear_m >= apart_m and fits(world.solid, cell_m, x_m, y_m, PERSON_RADIUS_M):
                continue
            cells = np.flatnonzero(room_for(world.solid, cell_m, PERSON_RADIUS_M))
            centres = np.array([self._centre(cell) for cell in cells.tolist()])
            others = np.delete(world.people, person, axis=0)[:, :2]
            free = np.hypot(*(centres - (robot.x_m, robot.y_m)).T) >= apart_m
            for other in others:
                free &= np.hypot(*(centres - other).T) >= 2 * PERSON_RADIUS_M + MIN_GAP_M
            distance_m = np.where(free, np.hypot(*(centres - (x_m, y_m)).T), np.inf)
            world.people[person, :2] = centres[int(np.argmin(distance_m))]

    def _choose_target(self, person: int) -> None:
        """Choose a destination and a patience; after a blockage prefer a route that turns back."""
        x_m, y_m, facing_rad, _ = self._world.people[person].tolist()
        walker, script = self._walkers[person], self._scripts[person]
        cell = self._cell(x_m, y_m)
        for _ in range(TARGET_DRAWS_COUNT if script is None else 0):
            target = int(self._rng.integers(self._random_count))
            next_cell = self._routes.to(target)[cell]
            if next_cell < 0:
                continue
            to_x_m, to_y_m = self._centre(next_cell)
            ahead = (to_x_m - x_m) * math.cos(facing_rad) + (to_y_m - y_m) * math.sin(facing_rad)
            walker[TARGET], walker[HAS_TARGET] = target, 1.0
            if walker[WAITED] == 0.0 or ahead < 0.0:
                break
        if script is not None:
            target = script.next_destination(walker[WAITED] > walker[PATIENCE])
            self._routes.to(target)
            walker[TARGET], walker[HAS_TARGET] = target, 1.0
        walker[WAITED] = 0.0
        walker[PATIENCE] = self._rng.uniform(*PATIENCE_S)

    def _roomy_cells(self) -> NDArray[np.intp]:
        """Return the cells of the largest connected area with the comfort margin, row by row."""
        from scipy.ndimage import label

        margin_m = PERSON_RADIUS_M + COMFORT_MARGIN_M
        room = room_for(self._world.solid, self._world.plan.cell_m, margin_m)
        areas, count = label(room)
        if not count:
            return np.empty(0, np.intp)
        return np.flatnonzero(areas == 1 + np.argmax(np.bincount(areas.ravel())[1:]))

    def _cell(self, x_m: float, y_m: float) -> int:
        cell_m = self._world.plan.cell_m
        columns: int = self._world.solid.shape[1]
        return int(y_m / cell_m) * columns + int(x_m / cell_m)

    def _centre(self, cell: int) -> tuple[float, float]:
        row, column = divmod(int(cell), self._world.solid.shape[1])
        return (column + 0.5) * self._world.plan.cell_m, (row + 0.5) * self._world.plan.cell_m

    def _nearest_m(self, x_m: float, y_m: float) -> float:
        people = self._world.people
        return float(np.hypot(people[:, 0] - x_m, people[:, 1] - y_m).min(initial=math.inf))
