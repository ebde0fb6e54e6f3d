# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The occupancy grid shows the stored scans at the present poses."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from ratslam_ros.core.common.pose import Pose
from ratslam_ros.core.mapping.occupancy import Picture
from ratslam_ros.core.mapping.occupancy_grid import LIMIT_CELLS, OccupancyGrid

Scans = dict[int, NDArray[np.float32]]


class Map:
    """What the grid uses of a map: poses and components."""

    def __init__(self, *poses: tuple[float, float, float]) -> None:
        self.poses = np.array(poses)
        self.current_id = 0
        self.components = [0] * len(poses)

    def __len__(self) -> int:
        return len(self.poses)

    def pose_of(self, number: int) -> Pose:
        return Pose(*self.poses[number].tolist())

    def component_of(self, number: int) -> int:
        return self.components[number]


class Matcher:
    """Scans of experiences."""

    def __init__(self, scans: Scans) -> None:
        self.scans = scans

    def reference(self, number: int) -> NDArray[np.float32] | None:
        return self.scans.get(number)


WALL = np.array([[2.0, y] for y in np.arange(-1.0, 1.0, 0.02)], np.float32)
"""Points on a wall 2 m ahead."""


def drawn(graph: Map, matcher: Matcher, grid: OccupancyGrid | None = None) -> Picture:
    grid = grid or OccupancyGrid(0.1)
    for _ in range(100):
        if grid.update(graph, matcher, 2) == 0:  # type: ignore[arg-type]
            break
    return list(grid.picture())[-1]


def value(picture: Picture, x_m: float, y_m: float) -> int:
    row = math.floor((y_m - picture.y_m) / picture.cell_m)
    column = math.floor((x_m - picture.x_m) / picture.cell_m)
    return int(picture.percent[row, column])


def test_wall_is_occupied_and_the_space_before_it_free() -> None:
    picture = drawn(Map((0.0, 0.0, 0.0)), Matcher({0: WALL}))
    assert value(picture, 2.05, 0.5) == 70
    assert value(picture, 1.0, 0.05) == 40
    assert value(picture, 0.5, 0.85) == -1  # outside of the beams


def test_pose_of_the_experience_turns_and_moves_the_scan() -> None:
    picture = drawn(Map((-3.0, 1.0, math.pi / 2)), Matcher({0: WALL}))
    assert value(picture, -3.0, 3.05) == 70
    assert value(picture, -2.95, 2.0) == 40


def test_agreeing_scans_add_up_to_the_bounds_of_octomap() -> None:
    graph, matcher = Map(*[(0.0, 0.0, 0.0)] * 20), Matcher(dict.fromkeys(range(20), WALL))
    picture = drawn(graph, matcher)
    assert (value(picture, 2.05, 0.5), value(picture, 1.0, 0.05)) == (97, 12)


def test_corrected_map_is_drawn_as_a_new_one() -> None:
    graph = Map(*[(0.5 * i, 0.0, 0.1 * i) for i in range(30)])
    matcher, grid = Matcher({i: WALL + 0.01 * i for i in range(30)}), OccupancyGrid(0.1)
    drawn(graph, matcher, grid)
    graph.poses[10:] += (0.3, -0.4, 0.05)
    corrected, new = drawn(graph, matcher, grid), drawn(graph, matcher)
    left, below = (round((a - b) / 0.1) for a, b in zip(new[:2], corrected[:2], strict=True))
    rows, columns = new.percent.shape
    assert np.array_equal(
        corrected.percent[below : below + rows, left : left + columns], new.percent
    )
    assert np.count_nonzero(corrected.percent >= 0) == np.count_nonzero(new.percent >= 0)


def test_few_scans_are_drawn_at_a_time() -> None:
    graph = Map(*[(0.5 * i, 0.0, 0.0) for i in range(30)])
    matcher, grid = Matcher(dict.fromkeys(range(30), WALL)), OccupancyGrid(0.1)
    left = [grid.update(graph, matcher, 4) for _ in range(9)]  # type: ignore[arg-type]
    assert left == [26, 22, 18, 14, 10, 6, 2, 0, 0]
    assert not grid.has_changed


def test_other_components_and_replaced_scans_are_not_shown() -> None:
    graph = Map((0.0, 0.0, 0.0), (20.0, 0.0, 0.0))
    matcher, grid = Matcher({0: WALL, 1: WALL}), OccupancyGrid(0.1)
    assert value(drawn(graph, matcher, grid), 22.05, 0.5) == 70
    graph.components[1] = 1
    assert value(drawn(graph, matcher, grid), 22.05, 0.5) == -1
    matcher.scans[0] = WALL + 1.0
    picture = drawn(graph, matcher, grid)
    assert (value(picture, 3.05, 1.5), value(picture, 2.05, -0.5)) == (70, -1)


def test_long_map_gets_coarser_cells_and_stays_bounded() -> None:
    graph = Map((0.0, 0.0, 0.0), (300.0, 0.0, 0.0), (-300.0, 5.0, 0.0))
    picture = drawn(graph, Matcher(dict.fromkeys(range(3), WALL)))
    assert picture.cell_m == 0.4
    assert max(picture.percent.shape) <= LIMIT_CELLS
    for x_m, y_m in ((2.1, 0.5), (302.1, 0.5), (-297.9, 5.5)):
        assert value(picture, x_m, y_m) > 50


def test_long_beams_are_cut_without_an_obstacle() -> None:
    far = np.array([[20.0, 0.0]], np.float32)
    picture = drawn(Map((0.0, 0.0, 0.0)), Matcher({0: far}))
    assert (picture.percent == 40).any()
    assert not (picture.percent > 50).any()
    assert picture.percent.shape[1] <= 82
