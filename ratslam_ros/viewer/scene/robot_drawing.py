# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The robot, its scan, route and goal, and recent closures."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ratslam_ros.core.pose_cells.map_action import NO_EXPERIENCE
from ratslam_ros.history.records import StatusRecord
from ratslam_ros.history.run_state import NS_PER_S, RunState
from ratslam_ros.messages.goals import GoalStatus
from ratslam_ros.messages.json_schema import MalformedMessage, decode
from ratslam_ros.viewer.scene.colouring import CLOSURE_IDS
from ratslam_ros.viewer.scene.nodes import Canvas, Cloud, Labels, Strokes, Triangles, ring
from ratslam_ros.viewer.scene.palette import Theme

ARROW = np.array([[1.0, 0.0], [-0.7, 0.65], [-0.35, 0.0], [-0.7, -0.65]])
"""Outline of the robot, pointing along x."""

ROUTE_LINES = 300
"""Largest number of lines of a route: thick lines are slow on software rendering."""

CHI_SQUARE_2 = 5.991
"""The true position is in the drawn ellipse with a probability of 95 %."""

DASHES = 12
"""Number of dashes of a rejected closure."""

ACCEPTED_NS = 3 * NS_PER_S
"""Run time for which an accepted closure is emphasised."""

REJECTED_NS = 5 * NS_PER_S
"""Run time for which a rejected closure is shown: enough to read the reason."""


def goal_of(status: StatusRecord | None) -> tuple[float, float, str] | None:
    """Return x and y in m and the text of the current goal, None if there is none.

    A status that cannot be read counts as none: it comes from another program.
    """
    if status is None:
        return None
    try:
        content = decode(GoalStatus, status.payload)
    except MalformedMessage:
        return None
    if content.goal is None:
        return None
    names = [task.goal for task in content.queue if task.status == 'active']
    text = f'goal: {names[0]}' if names and not names[0].startswith('(') else 'goal'
    if content.remaining_s is not None:
        text += f', {content.remaining_s:.0f} s left'
    return content.goal.x_m, content.goal.y_m, text


@dataclass(frozen=True, slots=True)
class ClosureEvent:
    """A closure between two points on the map, in m; ``reason`` is '' if it was accepted."""

    a: tuple[float, float]
    b: tuple[float, float]
    reason: str


def recent_closures(state: RunState) -> list[ClosureEvent]:
    """Return the closures to emphasise, oldest first; a repeated reason is shown once."""
    found: dict[object, ClosureEvent] = {}
    robot = None if state.pose is None else state.pose.pose[:2]
    places = state.map.poses[:, :2]

    def place_of(number: int) -> tuple[float, float] | None:
        if not 0 <= number < len(places) or not np.isfinite(places[number]).all():
            return None
        x, y = places[number].tolist()
        return x, y

    for view in reversed(state.recent):
        age_ns, key = state.stamp_ns - view.stamp_ns, (view.source_id, view.target_id)
        if age_ns > REJECTED_NS:
            break
        start, end = place_of(view.source_id), place_of(view.target_id)
        if view.reason:
            start = start or robot
            if view.recognised_id != NO_EXPERIENCE:
                end = place_of(view.recognised_id)
        elif (
            view.action != 'link' or age_ns > ACCEPTED_NS
            or abs(view.source_id - view.target_id) <= CLOSURE_IDS
        ):
            continue
        if start is not None and end is not None:
            found.setdefault(view.reason or key, ClosureEvent(start, end, view.reason))
    return list(reversed(found.values()))


class RobotDrawing:
    """Everything that moves with the robot."""

    def __init__(self, canvas: Canvas) -> None:
        self._canvas = canvas
        scan, route = canvas.layer('scan', 0.01), canvas.layer('route', 0.02)
        events, robot = canvas.layer('closures', 0.03), canvas.layer('robot', 0.05)
        self._scan = Cloud(canvas, f'{scan}/points', 0.08)
        self._route = Strokes(canvas, f'{route}/line', 3.0)
        self._goal = Triangles(canvas, f'{route}/goal')
        self._goal_text = Labels(canvas, f'{route}/text', 'bottom-center')
        self._events = Strokes(canvas, f'{events}/lines', 4.0)
        self._reasons = Labels(canvas, f'{events}/reasons')
        self._robot = Triangles(canvas, f'{robot}/arrow')
        self._ellipse = Strokes(canvas, f'{robot}/ellipse', 2.0)
        self.has_scan = self.has_route = self.has_ellipse = False
        """Whether a scan, a route or goal, and an ellipse has been drawn."""

    def draw(self, state: RunState, size_m: float) -> None:
        """Draw a state.

        Args:
            state: the state.
            size_m: length of the robot's arrow in m; the size of marks depends on it.
        """
        theme = self._canvas.theme
        if state.pose is not None:
            x, y, heading = state.pose.pose
            turn = (math.cos(heading / 2), 0.0, 0.0, math.sin(heading / 2))
            self._robot.draw(arrow_of(size_m), [theme.background] * 2 + [theme.robot] * 2)
            for name in ('robot', 'scan'):
                frame = self._canvas.layers[name]
                frame.position, frame.wxyz = (x, y, frame.position[2]), turn
            covariance = state.pose.covariance
            self.has_ellipse |= covariance is not None
            self._ellipse.draw(
                np.empty((0, 2, 3)) if covariance is None else ellipse(covariance, heading),
                theme.robot,
            )
        if state.scan is not None:
            self.has_scan = True
            points = state.scan.points_m
            self._scan.draw(np.pad(points, ((0, 0), (0, 1))), theme.scan)
        self._scan.resize(0.2 * size_m)
        self._draw_route(state, size_m, theme)
        self._draw_events(state, size_m, theme)

    def _draw_route(self, state: RunState, size_m: float, theme: Theme) -> None:
        points = np.empty((0, 2)) if state.route is None else state.route.points_m
        points = points[np.isfinite(points).all(axis=1)]
        every = max(1, math.ceil(len(points) / ROUTE_LINES))
        kept: NDArray[np.float64] = np.pad(points[::every], ((0, 0), (0, 1)))
        self._route.draw(np.stack([kept[:-1], kept[1:]], 1), theme.route)
        goal = goal_of(state.status)
        if goal is None and len(points):
            goal = (*points[-1].tolist(), 'goal')
        marks: list[NDArray[np.float64]] = []
        texts = []
        if goal is not None:
            self.has_route = True
            x, y, text = goal
            texts = [(text, (x, y + size_m, 0.0))]
            mark = np.concatenate([ring(0.8 * size_m), ring(0.3 * size_m, 0.0)])
            marks = [mark + np.array([x, y, 0.0])]
        self._goal_text.draw(texts)
        self._goal.draw(marks, theme.goal)

    def _draw_events(self, state: RunState, size_m: float, theme: Theme) -> None:
        lines, tints, texts = [], [], []
        for event in recent_closures(state):
            a, b = np.array([*event.a, 0.0]), np.array([*event.b, 0.0])
            if event.reason:
                cuts = np.linspace(0.0, 1.0, 2 * DASHES)[:, None]
                dashes = (a + cuts * (b - a)).reshape(-1, 2, 3)
                lines.append(dashes)
                tints += [theme.rejected] * len(dashes)
                text = f'closure rejected: {event.reason}'
            else:
                lines.append(np.stack([a, b])[None])
                tints.append(theme.closure)
                text = 'loop closed'
            # Beside the robot, because it is in view when the camera follows the robot.
            texts.append((text, (float(a[0]), float(a[1]) - 1.6 * size_m, 0.0)))
        flat = np.concatenate(lines) if lines else np.empty((0, 2, 3))
        self._events.draw(flat, np.reshape(tints, (-1, 3)))
        self._reasons.draw(texts)


def ellipse(
    covariance: tuple[float, float, float], heading_rad: float, corners: int = 48
) -> NDArray[np.float64]:
    """Return (corners, 2, 3) lines around the robot's position with a probability of 95 %.

    Args:
        covariance: see ``PoseRecord``.
        heading_rad: of the robot, in whose frame the lines are.
        corners: number of lines.
    """
    xx, xy, yy = covariance
    variances, axes = np.linalg.eigh(np.array([[xx, xy], [xy, yy]]))
    angles = np.linspace(0.0, 2.0 * np.pi, corners + 1)
    circle = np.stack([np.cos(angles), np.sin(angles)])
    lengths = np.sqrt(CHI_SQUARE_2 * np.maximum(variances, 0.0))
    c, s = math.cos(heading_rad), math.sin(heading_rad)
    points = np.array([[c, s], [-s, c]]) @ axes @ (lengths[:, None] * circle)
    flat = np.pad(points.T, ((0, 0), (0, 1)))
    return np.stack([flat[:-1], flat[1:]], 1)


def arrow_of(size_m: float) -> NDArray[np.float64]:
    """Return the robot's arrow of a size in m: two triangles of its outline, and two inside."""
    flat = np.pad(ARROW, ((0, 0), (0, 1))) * size_m
    faces = [[0, 1, 2], [0, 2, 3]]
    outline = flat * [1.45, 1.45, 1.0] - [0.08 * size_m, 0.0, 0.01]
    return np.concatenate([outline[faces], flat[faces]])
