# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The experience map as a graph for a route server: thinned, with directed edges.

A node is an experience. An edge is a way in one direction, along one or several links.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Collection, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

if TYPE_CHECKING:  # SciPy loads slowly
    from scipy.sparse import csr_array

MAX_IDS = 65_536
"""The route server of ROS 2 Jazzy has 16 bits for the ids of nodes and edges together."""

KEPT_RATIO = 0.5
"""Distance of preferred nodes below which one is dropped, relative to the spacing. Without this
hysteresis, every correction of the map would exchange nodes whose distance is near the spacing."""

LEAST_LENGTH_M = 1e-9
"""Length of a link between places at the same point, because SciPy drops edges of length 0."""


@dataclass(frozen=True, slots=True)
class RouteEdge:
    """A way in one direction.

    Attributes:
        length_m: its length in m.
        time_s: its duration in s.
        failures: number of time-outs since it was last driven.
        way: the experiences that it leads through, from the first to the last one.
    """

    length_m: float
    time_s: float
    failures: int
    way: tuple[int, ...]

    def followed_by(self, other: RouteEdge) -> RouteEdge:
        """Return both ways as one; the other one begins where this one ends."""
        return RouteEdge(
            self.length_m + other.length_m, self.time_s + other.time_s,
            self.failures + other.failures, self.way + other.way[1:],
        )


RouteEdges = dict[tuple[int, int], RouteEdge]
"""Edges by their first and last experience."""


@dataclass(frozen=True, slots=True)
class ServerGraph:
    """A graph for the route server.

    Attributes:
        nodes: experiences, in ascending order.
        poses: (nodes, 3) x, y in m and heading in rad of the nodes on the map.
        edges: between the nodes.
        left_out: number of experiences in other components.
        others: number of other components.
    """

    nodes: list[int]
    poses: NDArray[np.float64]
    edges: RouteEdges
    left_out: int = 0
    others: int = 0

    @property
    def feature_count(self) -> int:
        """Number of nodes and edges."""
        return len(self.nodes) + len(self.edges)


def server_graph(
    poses: NDArray[np.float64], components: Sequence[int], ends: NDArray[np.int64],
    lengths_m: NDArray[np.float64], durations_s: NDArray[np.float64],
    failures: NDArray[np.int64], spacing_m: float = 0.0, preferred: Collection[int] = (),
) -> ServerGraph:
    """Return the graph of a map.

    Of a map with several components, whose relative poses are unknown, only the largest one is
    used. Every link can be driven in both directions; one that was not driven takes the time of
    the other one.

    Args:
        poses: (n, 3) x, y in m and heading in rad of all experiences.
        components: (n,) component of each.
        ends: (links, 2) source and target.
        lengths_m, durations_s: (links,) length and duration of each.
        failures: (links,) time-outs of each since it was last driven.
        spacing_m: least distance between two nodes along the links. 0 keeps all experiences.
        preferred: experiences to keep as nodes; see ``thinned``.
    """
    sizes = Counter(components)
    largest = min(sizes, key=lambda component: (-sizes[component], component), default=0)
    nodes = [number for number, component in enumerate(components) if component == largest]
    edges = _edges(set(nodes), ends, lengths_m, durations_s, failures)
    if spacing_m > 0.0 and edges:
        nodes, edges = thinned(nodes, edges, poses[nodes, :2], spacing_m, preferred)
    return ServerGraph(
        nodes, poses[nodes].copy(), edges, len(poses) - sizes[largest], max(len(sizes) - 1, 0)
    )


def _edges(
    nodes: set[int], ends: NDArray[np.int64], lengths_m: NDArray[np.float64],
    durations_s: NDArray[np.float64], failures: NDArray[np.int64],
) -> RouteEdges:
    """Return both directions of every link between some nodes."""
    edges: RouteEdges = {}
    for (source, target), length_m, time_s, count in zip(
        ends.tolist(), lengths_m.tolist(), durations_s.tolist(), failures.tolist(), strict=True
    ):
        if source != target and source in nodes and target in nodes:
            edges[source, target] = RouteEdge(length_m, time_s, count, (source, target))
    for (source, target), edge in list(edges.items()):
        edges.setdefault((target, source), replace(edge, way=(target, source)))
    return edges


def thinned(
    nodes: list[int], edges: RouteEdges, points_m: NDArray[np.float64], spacing_m: float,
    preferred: Collection[int] = (),
) -> tuple[list[int], RouteEdges]:
    """Keep nodes that are at least a distance apart, and connect them as they were.

    Preferred nodes are kept first, even if their distance has shrunk to ``KEPT_RATIO`` of the
    spacing; then junctions, ends of dead ends, and the others outwards from these. Every
    other node belongs to the kept node that is nearest along the links. Two kept nodes are
    connected if a link connects nodes that belong to them, so that all connections remain.

    Args:
        nodes: experiences.
        edges: between them.
        points_m: (n, 2) positions of the nodes.
        spacing_m: the distance, along the links.
        preferred: nodes of an earlier graph, so that the new one resembles it.
    """
    from scipy.sparse import csr_array
    from scipy.sparse.csgraph import dijkstra

    row_of = {node: row for row, node in enumerate(nodes)}
    ends = np.array([(row_of[a], row_of[b]) for a, b in edges], np.int32).reshape(-1, 2)
    # On the map, because a recognised view links places at a distance as if they were the same.
    steps_m = np.hypot(*(points_m[ends[:, 0]] - points_m[ends[:, 1]]).T)
    lengths_m = np.maximum(steps_m, LEAST_LENGTH_M)
    graph = csr_array((lengths_m, (ends[:, 0], ends[:, 1])), shape=(len(nodes),) * 2)
    kept: list[int] = []
    covered = np.zeros(len(nodes), np.bool_)

    def keep(rows: list[int], distance_m: float = spacing_m) -> None:
        for row in rows:
            if not covered[row]:
                kept.append(row)
                # Nodes exactly at the distance remain.
                limit_m = math.nextafter(distance_m, 0.0)
                covered[np.isfinite(dijkstra(graph, indices=row, limit=limit_m))] = True

    keep(sorted(row_of[node] for node in preferred if node in row_of), KEPT_RATIO * spacing_m)
    if kept:
        limit_m = math.nextafter(spacing_m, 0.0)
        covered |= np.isfinite(dijkstra(graph, indices=kept, limit=limit_m, min_only=True))
    degrees = np.bincount(ends[:, 0], minlength=len(nodes))
    branches = np.zeros(len(nodes), np.int64)
    for row in np.flatnonzero(~covered).tolist():
        branches[row] = _branch_count(graph, row, spacing_m)
    order = np.lexsort((-degrees, -branches))
    keep([row for row in order.tolist() if branches[row] >= 3])
    keep(np.flatnonzero(degrees == 1).tolist())
    from_m = dijkstra(graph, indices=kept or [0], min_only=True)
    keep(np.argsort(from_m, kind='stable').tolist())
    kept.sort()
    _, previous, sources = dijkstra(
        graph, indices=kept, min_only=True, return_predecessors=True
    )
    return [nodes[row] for row in kept], _quotient(nodes, edges, previous, sources)


def _branch_count(graph: csr_array, row: int, spacing_m: float) -> int:
    """Return into how many branches the map continues around a node: 3 or more at a junction.

    Branches are the connected parts of what is one to two spacings away. At smaller distances,
    views that were recognised several times look like junctions.
    """
    from scipy.sparse.csgraph import connected_components, dijkstra

    distances_m = dijkstra(graph, indices=row, limit=2.0 * spacing_m)
    ring = np.flatnonzero(np.isfinite(distances_m) & (distances_m >= spacing_m))
    if len(ring) < 3:
        return len(ring)
    return int(connected_components(graph[ring][:, ring], directed=False)[0])


def _quotient(
    nodes: list[int], edges: RouteEdges, previous: NDArray[np.int32], sources: NDArray[np.int32]
) -> RouteEdges:
    """Return the quickest edges between the kept nodes through the nodes that belong to them."""
    outward: dict[int, RouteEdge] = {}
    inward: dict[int, RouteEdge] = {}

    def ways(row: int) -> tuple[RouteEdge, RouteEdge]:
        """Return the ways from the kept node of a node to it, and back."""
        chain = []
        while row not in outward and previous[row] >= 0:
            chain.append(row)
            row = int(previous[row])
        nothing = RouteEdge(0.0, 0.0, 0, (nodes[row],))
        outward.setdefault(row, nothing)
        inward.setdefault(row, nothing)
        for after in reversed(chain):
            a, b = nodes[row], nodes[after]
            outward[after] = outward[row].followed_by(edges[a, b])
            inward[after] = edges[b, a].followed_by(inward[row])
            row = after
        return outward[row], inward[row]

    row_of = {node: row for row, node in enumerate(nodes)}
    result: RouteEdges = {}
    for (a, b), edge in edges.items():
        here, there = int(sources[row_of[a]]), int(sources[row_of[b]])
        if here == there:
            continue
        way = ways(row_of[a])[0].followed_by(edge).followed_by(ways(row_of[b])[1])
        ends = nodes[here], nodes[there]
        if ends not in result or way.time_s < result[ends].time_s:
            result[ends] = way
    return result
