# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Small experience maps, and reference computations on their links."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ratslam_ros.core.common.angles import wrap
from ratslam_ros.core.common.odometry import Motion
from ratslam_ros.core.common.pose import Pose
from ratslam_ros.core.config import ExperienceMapParameters
from ratslam_ros.core.mapping.experience_map import ExperienceMap
from ratslam_ros.core.pose_cells.map_action import Action, MapAction
from ratslam_ros.core.pose_cells.torus import Place

Reals = NDArray[np.float64]
Indices = NDArray[np.int64]

NONE = MapAction('none', 0, 0, 0, 0.0, Place(0.0, 0.0, 0.0))
"""Action that leaves the links and the current experience unchanged."""


def new_map(**parameters: Any) -> ExperienceMap:
    """Return an empty map with an initial heading of 0, unless ``parameters`` sets another."""
    return ExperienceMap(ExperienceMapParameters(**{'exp_initial_em_deg': 0.0, **parameters}))


def place_of(experience_id: int) -> Place:
    return Place(float(experience_id), 0.0, 0.0)


def arrive(
    graph: ExperienceMap, target: int, relative_rad: float = 0.0, behaviour: str = ''
) -> None:
    """Apply the action that creates the target if it is new, or links to it."""
    kind: Action = 'create' if target == len(graph) else 'link'
    action = MapAction(
        kind, graph.current_id, target, 10 + target, relative_rad, place_of(target)
    )
    graph.apply(action, behaviour)


def set_current(graph: ExperienceMap, target: int) -> None:
    """Make an experience the current one without adding a link."""
    graph.apply(MapAction('set', -1, target, target, 0.0, place_of(target)))


def drive(graph: ExperienceMap, *motions: Motion) -> None:
    for motion in motions:
        graph.integrate(motion)


def go(
    graph: ExperienceMap, target: int, *motions: Motion, relative_rad: float = 0.0,
    behaviour: str = '',
) -> None:
    """Drive, and arrive at an experience."""
    drive(graph, *motions)
    arrive(graph, target, relative_rad, behaviour)


def corridor(
    count: int = 13, behaviour: str = '', beyond_m: float = 0.0, **parameters: Any
) -> ExperienceMap:
    """Return a map with an experience every metre along x, and the robot beyond the last one."""
    graph = new_map(**parameters)
    arrive(graph, 0)
    for target in range(1, count):
        go(graph, target, Motion(2.0, 1.0, 0.0), behaviour=behaviour)
    drive(graph, Motion(2.0, beyond_m, 0.0))
    return graph


def pose_is_near(
    pose: Pose, x_m: float, y_m: float, heading_rad: float, tolerance: float = 1e-12
) -> bool:
    return (
        math.hypot(pose.x_m - x_m, pose.y_m - y_m) < tolerance
        and abs(wrap(pose.heading_rad - heading_rad)) < tolerance
    )


def max_difference(a: Reals, b: Reals) -> float:
    """Return the largest difference of (n, 3) poses in any coordinate, in m or rad."""
    turn = np.array([wrap(float(t)) for t in (a - b)[:, 2]])
    return float(max(np.abs((a - b)[:, :2]).max(), np.abs(turn).max()))


def residuals(poses: Reals, ends: Indices, shapes: Reals) -> Reals:
    """Return the (links, 3) residuals of the links: x, y in m and heading in rad."""
    i, j = ends.T
    direction = poses[i, 2] + shapes[:, 1]
    x = poses[j, 0] - poses[i, 0] - shapes[:, 0] * np.cos(direction)
    y = poses[j, 1] - poses[i, 1] - shapes[:, 0] * np.sin(direction)
    turn = [wrap(float(a)) for a in poses[j, 2] - poses[i, 2] - shapes[:, 2]]
    return np.stack([x, y, turn], 1)


def residuals_of(graph: ExperienceMap) -> Reals:
    return residuals(graph.poses, graph.link_ends, graph.link_table.shapes)


def jacobian(poses: Reals, ends: Indices, shapes: Reals) -> Reals:
    """Return the (links, 3, n, 3) derivatives of the residuals of the links."""
    (i, j), links = ends.T, np.arange(len(ends))
    out = np.zeros((len(ends), 3, len(poses), 3))
    direction = poses[i, 2] + shapes[:, 1]
    for axis in range(3):
        np.add.at(out, (links, axis, j, axis), 1.0)
        np.add.at(out, (links, axis, i, axis), -1.0)
    np.add.at(out, (links, 0, i, 2), shapes[:, 0] * np.sin(direction))
    np.add.at(out, (links, 1, i, 2), -shapes[:, 0] * np.cos(direction))
    return out


def dense_step(poses: Reals, ends: Indices, shapes: Reals, weights: Reals) -> Reals:
    """Return (n, 3) displacements: a Gauss-Newton step, by dense least squares.

    The lowest id of each connected component is held fixed.
    """
    count = len(poses)
    component = np.arange(count)
    for _ in range(count):
        for i, j in ends:
            component[i] = component[j] = min(component[i], component[j])
    free = component != np.arange(count)
    roots = np.sqrt(weights[:, [0, 0, 1]])
    a = jacobian(poses, ends, shapes)[:, :, free] * roots[:, :, None, None]
    e = residuals(poses, ends, shapes) * roots
    step = np.zeros_like(poses)
    solution = np.linalg.lstsq(a.reshape(e.size, 3 * free.sum()), -e.ravel(), rcond=None)[0]
    step[free] = solution.reshape(-1, 3)
    return step
