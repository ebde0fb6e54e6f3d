# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Nodes of the scene whose data is replaced without flicker, and sent only if it differs."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator
from typing import Any, ClassVar, TypeVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ratslam_ros.viewer.scene import glb
from ratslam_ros.viewer.scene.palette import Bytes, Rgb, Theme

Points = NDArray[np.float32]
Node = TypeVar('Node')


class Canvas:
    """The scene of viser with layers that can be hidden, in the colours of a theme."""

    def __init__(self, server: Any, theme: Theme) -> None:
        self.scene, self.theme = server.scene, theme
        self.layers: dict[str, Any] = {}
        """Frames of the layers by their names."""
        self._old: list[Any] = []

    def layer(self, name: str, height_m: float = 0.0) -> str:
        """Add a layer and return the path below which its nodes belong."""
        path = '/' + name.replace(' ', '_')
        self.layers[name] = self.scene.add_frame(
            path, show_axes=False, position=(0.0, 0.0, height_m)
        )
        return path

    def retire(self, handle: Any) -> None:
        """Remove a node at the next update, when its successor has been drawn."""
        self._old.append(handle)

    def begin_update(self) -> None:
        """Remove retired nodes."""
        for handle in self._old:
            handle.remove()
        self._old.clear()


class _Node(ABC):
    """Points with colours, which are sent only if they differ from what is drawn."""

    SHAPE: ClassVar[tuple[int, ...]]
    """Shape of the points of one item."""

    def __init__(self, canvas: Canvas, path: str) -> None:
        self._canvas, self._path = canvas, path
        self._handle: Any = None

    def draw(self, points: ArrayLike, colours: ArrayLike) -> None:
        """Draw (n, *SHAPE) points.

        Args:
            points: the points.
            colours: one colour, (n, 3) colours of the items, or one for every point.
        """
        places = np.asarray(points, np.float32).reshape(-1, *self.SHAPE)
        tints = np.asarray(colours, np.uint8)
        if tints.ndim == 2 and len(self.SHAPE) == 2:
            tints = tints[:, None]
        self._show(places, np.ascontiguousarray(np.broadcast_to(tints, places.shape)))

    @abstractmethod
    def _show(self, points: Points, colours: Bytes) -> None:
        """Draw points, (n, *SHAPE), with a colour for each."""


class _Kept(_Node):
    """A node of viser that gets other points."""

    def _show(self, points: Points, colours: Bytes) -> None:
        if self._handle is not None:
            self._handle.visible = len(points) > 0
        if not len(points):
            return
        if self._handle is None:
            self._handle = self._added(points, colours)
        else:  # viser compares
            self._handle.points, self._handle.colors = points, colours

    @abstractmethod
    def _added(self, points: Points, colours: Bytes) -> Any:
        """Return a new node."""


class Lines(_Node):
    """Thin lines, as a binary glTF that is replaced as a whole.

    A browser needs a moment to decode glTF and draws nothing until then. So new data makes a new
    node, and the old one is removed an update later.
    """

    SHAPE = (2, 3)

    def __init__(self, canvas: Canvas, path: str) -> None:
        super().__init__(canvas, path)
        self._drawn: tuple[Points, Bytes] | None = None
        self._turn = 0

    def _show(self, points: Points, colours: Bytes) -> None:
        if self._drawn is not None and (
            np.array_equal(self._drawn[0], points) and np.array_equal(self._drawn[1], colours)
        ):
            return
        self._drawn = points, colours
        if self._handle is not None:
            self._canvas.retire(self._handle)
            self._handle = None
        if len(points):
            self._turn += 1
            self._handle = self._canvas.scene.add_glb(
                f'{self._path}/{self._turn % 4}', glb.encoded(points, colours),
                cast_shadow=False, receive_shadow=False,
            )


class Triangles(Lines):
    """Flat shapes of triangles, as ``Lines``."""

    SHAPE = (3, 3)


class Cloud(_Kept):
    """Flat round points."""

    SHAPE = (3,)

    def __init__(self, canvas: Canvas, path: str, size_m: float, shading: str = 'flat') -> None:
        super().__init__(canvas, path)
        self._size_m, self._shading = size_m, shading

    def _added(self, points: Points, colours: Bytes) -> Any:
        return self._canvas.scene.add_point_cloud(
            self._path, points, colours, point_size=self._size_m, point_shape='circle',
            point_shading=self._shading, precision='float32',
        )

    def resize(self, size_m: float) -> None:
        """Change the diameter of the points."""
        self._size_m = size_m
        if self._handle is not None:
            self._handle.point_size = size_m


class Strokes(_Kept):
    """A few thick lines."""

    SHAPE = (2, 3)

    def __init__(self, canvas: Canvas, path: str, thickness_px: float) -> None:
        super().__init__(canvas, path)
        self._thickness_px = thickness_px

    def _added(self, points: Points, colours: Bytes) -> Any:
        return self._canvas.scene.add_line_segments(
            self._path, points, colours, thickness=self._thickness_px, thickness_units='screen'
        )


class Labels:
    """Texts at points; the nodes are reused."""

    def __init__(self, canvas: Canvas, path: str, anchor: str = 'center-center') -> None:
        self._canvas, self._path, self._anchor = canvas, path, anchor
        self._handles: list[Any] = []

    def draw(self, texts: list[tuple[str, tuple[float, float, float]]]) -> None:
        """Draw texts at points."""
        for k, (text, position) in enumerate(texts):
            if k < len(self._handles):
                handle = self._handles[k]
                handle.text, handle.position, handle.visible = text, position, True
            else:
                self._handles.append(self._canvas.scene.add_label(
                    f'{self._path}/{k}', text, position=position, anchor=self._anchor,
                ))
        for handle in self._handles[len(texts) :]:
            handle.visible = False


def chunks(
    nodes: list[Node], new: Callable[[int], Node], count: int, size: int
) -> Iterator[tuple[Node, slice]]:
    """Yield the node and the part of each chunk of items; a node beyond them gets an empty part.

    Args:
        nodes: the nodes of earlier drawings; new ones are appended.
        new: returns the node of a chunk.
        count: number of items.
        size: number of items of a chunk.
    """
    for k in range(max(-(-count // size), len(nodes))):
        if k == len(nodes):
            nodes.append(new(k))
        yield nodes[k], slice(k * size, (k + 1) * size)


def ring(radius_m: float, inner: float = 0.75, corners: int = 32) -> Points:
    """Return the (n, 3, 3) triangles of a flat ring around the origin."""
    angles = np.linspace(0.0, 2.0 * np.pi, corners + 1)
    circle = np.stack([np.cos(angles), np.sin(angles), np.zeros(corners + 1)], 1) * radius_m
    a, b = circle[:-1], circle[1:]
    return np.concatenate([
        np.stack([a, b, b * inner], 1), np.stack([a, b * inner, a * inner], 1),
    ]).astype(np.float32)


def faded(colour: Rgb, background: Rgb, count: int) -> Bytes:
    """Return (count, 3) colours from the background to a colour."""
    return np.round(np.linspace(background, colour, count)).astype(np.uint8)
