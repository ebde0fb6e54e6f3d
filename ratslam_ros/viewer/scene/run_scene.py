# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The scene of a run: the map, the robot, and the pose cells."""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ratslam_ros.history.run_state import RunState
from ratslam_ros.viewer.scene import picking
from ratslam_ros.viewer.scene.cell_drawing import CellDrawing
from ratslam_ros.viewer.scene.colouring import Colours, Legend, map_colours
from ratslam_ros.viewer.scene.map_drawing import LIMIT, MapDrawing
from ratslam_ros.viewer.scene.nodes import Canvas, Lines, Triangles, ring
from ratslam_ros.viewer.scene.palette import DARK, LIGHT, Rgb
from ratslam_ros.viewer.scene.picking import Pick
from ratslam_ros.viewer.scene.robot_drawing import RobotDrawing
from ratslam_ros.viewer.scene.surroundings import Bounds, Cameras, GridDrawing
from ratslam_ros.viewer.scene.trails import TrailDrawing

LAYERS = (
    'experiences', 'links', 'headings', 'robot', 'trail', 'dead reckoning', 'ground truth',
    'route', 'scan', 'closures', 'cells', 'grid',
)

MAP_PERIOD_S = 0.5
"""Least time between two drawings of the map; the robot and its trail move at every update."""

CELLS_PERIOD_S = 0.2
"""Least time between two drawings of the pose cells; packets move less than a cell meanwhile."""

COLOUR_PERIOD_S = 1.0
"""Time between two computations of colours that change although the map does not."""

ROBOT_SIZE = 0.022
"""Size of the robot as a share of the camera's distance: about 20 pixels of 720."""

LARGEST_ROBOT_M = 30.0

POINT_SIZES = 0.003, 0.007
"""Least and largest diameter of experiences as shares of the camera's distance."""

POINT_SHARE = 0.45
"""Diameter of experiences as a share of the median length of links, between these sizes."""

TICKS = 400
"""Largest number of headings that are drawn, those nearest to the robot or the selection."""

TICK_DISTANCES = 80.0
"""Headings are drawn if the camera is nearer than this many median lengths of links."""

LABELS_SHARE = 1.4
"""Side of what is framed relative to that of the map, so that the labels of the grid are seen;
beside the pose cells, there is more room than that."""

CELLS_SIDE = 0.42
"""Side of the box of the pose cells as a share of the side of the map."""

CELLS_GAP = 0.42
"""Distance of the box's centre from the edge of the map, as a share of the side of the map."""


class RunScene:
    """Draws states of a run; only differences to what has been drawn are sent."""

    layers = LAYERS

    def __init__(
        self, server: Any, map_period_s: float = MAP_PERIOD_S, aims: bool = True,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        """Add the scene's nodes.

        Args:
            server: a ``viser.ViserServer``.
            map_period_s: least time between two drawings of the map in s; 0 draws it always.
            aims: whether the camera shows the whole map until the user moves it.
            clock: clock in s.
        """
        self.colouring = 'plain'
        """One of ``COLOURINGS``."""
        self.dark = False
        """Whether the background is dark."""
        self.limit = LIMIT
        """Number of experiences above which the map is thinned."""
        server.scene.set_up_direction('+z')
        # Everything is drawn without shading, so that colours are those of the legend.
        server.scene.configure_default_lights(enabled=False, cast_shadow=False)
        self._canvas = canvas = Canvas(server, LIGHT)
        self._period_s, self._aims, self._clock = map_period_s, aims, clock
        self._grid = GridDrawing(canvas)
        self._truth = TrailDrawing(canvas, 'ground truth', -0.03)
        self._reckoned = TrailDrawing(canvas, 'dead reckoning', -0.02)
        self._map = MapDrawing(canvas)
        self._headings = Lines(canvas, canvas.layer('headings', 0.005))
        self._trail = TrailDrawing(canvas, 'trail', -0.01, has_tail=True)
        self._robot = RobotDrawing(canvas)
        self._selection = Triangles(canvas, '/selection')
        self._cells = CellDrawing(canvas)
        self._cameras = Cameras(server)
        self._bounds = Bounds()
        self._map_key: object = None
        self._style: object = None
        self._map_due_s = self._colours_due_s = self._cells_due_s = -math.inf
        self._state_key: object = None
        self._selected: Pick | None = None
        self._legend: Legend = map_colours('plain', RunState(), LIGHT).legend
        self._cells_known = False
        self._link_m = 0.25

    @property
    def background(self) -> Rgb:
        """Colour behind everything."""
        return (DARK if self.dark else LIGHT).background

    @property
    def detail(self) -> str:
        """How the detail is reduced; '' if it is not."""
        every = self._map.every
        return '' if every == 1 else (
            f'Map of more than {self.limit} experiences: 1 of {every} is drawn.'
        )

    def legend(self) -> Legend:
        """Return the colours of the map and what they stand for."""
        theme = self._canvas.theme
        ellipse = ', and 95 % ellipse of its position' if self._robot.has_ellipse else ''
        return [
            *self._legend, (theme.robot, f'robot{ellipse}'),
            (theme.trail, 'path, as estimated at the time'),
            *((colour, text) for colour, text, known in (
                (theme.dead_reckoning, 'odometry alone', self._reckoned.is_drawn),
                (theme.truth, 'ground truth', self._truth.is_drawn),
                (theme.scan, 'laser scan', self._robot.has_scan),
                (theme.route, 'route and goal', self._robot.has_route),
            ) if known),
        ]

    def show(self, layer: str, on: bool) -> None:
        """Show or hide a layer.

        Raises:
            KeyError: if there is no such layer.
        """
        self._canvas.layers[layer].visible = on

    def pick(self, origin: ArrayLike, direction: ArrayLike, state: RunState) -> Pick | None:
        """Return what a ray from the camera hits, see ``picking.pick``."""
        return picking.pick(origin, direction, state)

    def select(self, pick: Pick | None) -> None:
        """Mark what is selected; None marks nothing."""
        self._selected = pick

    def look_at_all(self) -> None:
        """Show the whole map and the pose cells in all browsers."""
        self._cameras.aim_again()

    def update(self, state: RunState) -> None:
        """Draw a state."""
        canvas, now_s = self._canvas, self._clock()
        canvas.theme = theme = DARK if self.dark else LIGHT
        canvas.begin_update()
        is_other = self._state_key is not None and self._state_key != id(state)
        self._state_key = id(state)
        if is_other or now_s >= self._map_due_s:
            self._bounds.include(state)
        distance_m = self._cameras.distance_m(1.4 * self._bounds.side_m)
        self._draw_map(state, now_s, is_other, distance_m)
        low, high = POINT_SIZES
        size_m = float(np.clip(POINT_SHARE * self._link_m, low * distance_m, high * distance_m))
        self._map.resize(size_m)
        self._robot.draw(state, min(ROBOT_SIZE * distance_m, LARGEST_ROBOT_M))
        self._trail.draw_tail(state.trail, theme.robot)
        self._grid.draw(self._bounds)
        if is_other or now_s >= self._cells_due_s:
            self._cells_due_s = now_s + min(CELLS_PERIOD_S, self._period_s)
            self._draw_cells(state)
        self._mark_selection(state, distance_m)
        if self._aims:
            self._cameras.watch(*self.area())

    def area(self) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Return the lower and upper corner of all that has been drawn, in m."""
        half, centre = 0.5 * self._bounds.side_m, self._bounds.centre
        if not self._cells_known:
            half *= LABELS_SHARE
        low, high = centre - half, centre + half
        if self._cells_known:
            low = low - np.array([2.0 * CELLS_GAP * self._bounds.side_m, 0.0])
        return low, high

    def _draw_cells(self, state: RunState) -> None:
        if state.cells is not None:
            self._cells_known = True
            x, y = self._bounds.centre.tolist()
            side_m = self._bounds.side_m
            centre = x - (0.5 + CELLS_GAP) * side_m, y
            self._cells.draw(state.cells, centre, CELLS_SIDE * side_m)

    def _draw_map(self, state: RunState, now_s: float, is_other: bool, distance_m: float) -> None:
        graph, theme = state.map, self._canvas.theme
        is_near = distance_m <= TICK_DISTANCES * self._link_m
        headings = is_near, self._selected if is_near else None
        style = self.colouring, theme.background, self.limit, headings
        key = (id(graph), graph.version)
        is_due = now_s >= self._map_due_s
        is_changed = self._map_key != key or (
            self.colouring != 'plain' and now_s >= self._colours_due_s
        )
        if is_other or self._style != style or (is_due and is_changed):
            self._map_key, self._style = key, style
            self._colours_due_s = now_s + COLOUR_PERIOD_S
            self._draw_graph(state, distance_m)
        elif not is_due:
            return
        self._draw_trails(state, now_s)

    def _draw_graph(self, state: RunState, distance_m: float) -> None:
        graph = state.map
        colours = map_colours(self.colouring, state, self._canvas.theme)
        self._legend = colours.legend
        rows = graph.link_rows
        self._link_m = _median_length(rows.shapes[rows.ends[:, 0] >= 0, 0], self._link_m)
        self._map.draw(graph.poses, rows, colours, self.limit)
        self._draw_headings(state, colours, distance_m)

    def _draw_trails(self, state: RunState, now_s: float) -> None:
        theme, side_m = self._canvas.theme, self._bounds.side_m
        self._trail.draw(state.trail, theme.trail, side_m)
        self._reckoned.draw(state.dead_reckoning, theme.dead_reckoning, side_m)
        self._truth.draw(state.truth, theme.truth, side_m)
        self._map_due_s = now_s + self._period_s

    def _draw_headings(self, state: RunState, colours: Colours, distance_m: float) -> None:
        poses = state.map.poses
        chosen = np.flatnonzero(np.isfinite(poses).all(axis=1))
        if distance_m > TICK_DISTANCES * self._link_m or state.pose is None:
            chosen = chosen[:0]
        else:
            centre = state.pose.pose[:2] if self._selected is None else self._selected.point[:2]
            gaps = np.hypot(*(poses[chosen, :2] - centre).T)
            chosen = chosen[np.argsort(gaps, kind='stable')[:TICKS]]
        starts = np.pad(poses[chosen, :2], ((0, 0), (0, 1)))
        along = np.stack([np.cos(poses[chosen, 2]), np.sin(poses[chosen, 2])], 1)
        ends = starts + np.pad(0.9 * self._link_m * along, ((0, 0), (0, 1)))
        self._headings.draw(np.stack([starts, ends], 1), colours.experiences[chosen])

    def _mark_selection(self, state: RunState, distance_m: float) -> None:
        chosen, radius_m = self._selected, 0.016 * distance_m
        places, tint = state.map.poses, self._canvas.theme.selected
        points: list[ArrayLike] = []
        if chosen is not None and chosen.kind == 'ground':
            points = [chosen.point[:2]]
        elif chosen is not None:
            ids = (chosen.id,) if chosen.kind == 'experience' else chosen.ends
            shown = places[[k for k in ids if 0 <= k < len(places)], :2]
            points = [*shown[np.isfinite(shown).all(axis=1)]]
        mark = ring(radius_m, 0.8)
        self._selection.draw([mark + np.append(point, 0.04) for point in points], tint)


def _median_length(lengths_m: NDArray[np.float64], default_m: float) -> float:
    """Return the median of the lengths of links above 0 in m, in steps of 1.4."""
    lengths_m = lengths_m[lengths_m > 0.0]
    if not len(lengths_m):
        return default_m
    return float(2.0 ** (round(2.0 * math.log2(float(np.median(lengths_m)))) / 2.0))
