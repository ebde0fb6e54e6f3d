# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Export of the experience map as a graph for the Nav2 route server (GeoJSON).

The route server reads a FeatureCollection: Points are nodes with an `id`, LineStrings are edges
with `id`, `startid` and `endid`. An edge is driven in one direction only. Its time scorer reads
`abs_time_taken`, its penalty scorer `penalty`; both accept only numbers that the JSON parser reads
as floating point.
"""

from __future__ import annotations

import json
import math
from collections import Counter, defaultdict
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from ratslam_ros.core.mapping.experience_map import ExperienceMap
from ratslam_ros.core.mapping.link_learning import TIMED_OUT
from ratslam_ros.errors import UnusableInput

if TYPE_CHECKING:  # SciPy loads slowly
    from scipy.sparse import csr_array

MAX_IDS = 65_536
"""The route server of ROS 2 Jazzy has 16 bits for the ids of nodes and edges."""

LEAST_LENGTH_M = 1e-9
"""Length of a link between places at the same point, because SciPy drops edges of length 0."""


@dataclass(frozen=True, slots=True)
class _Edge:
    """A way in one direction: length, time, and time-outs since it was last driven."""

    length_m: float
    time_s: float
    failures: int

    def followed_by(self, other: _Edge) -> _Edge:
        return _Edge(
            self.length_m + other.length_m, self.time_s + other.time_s,
            self.failures + other.failures,
        )  # fmt: skip


_NOTHING = _Edge(0.0, 0.0, 0)
_Edges = dict[tuple[int, int], _Edge]


def route_graph_json(
    experience_map: ExperienceMap, spacing_m: float = 0.0
) -> tuple[str, list[str]]:
    """Return the graph for the Nav2 route server as GeoJSON, and notices for the user.

    Of a map with several components, whose relative poses are unknown, only the largest one is
    used.

    Args:
        experience_map: the map.
        spacing_m: least distance between two nodes along the links. 0 keeps all places.

    Raises:
        UnusableInput: the graph has no edge, or more nodes and edges than the server has ids.
    """
    nodes, notices = _largest_component(experience_map)
    edges = _edges(experience_map, set(nodes))
    if spacing_m > 0.0:
        nodes, edges = _thinned(nodes, edges, experience_map.poses[nodes, :2], spacing_m)
    if not edges:
        raise UnusableInput(
            f'the graph has {len(nodes)} nodes and no edge, and the route server refuses a graph '
            f'without edges: {"choose a smaller --spacing" if spacing_m > 0.0 else "map more"}'
        )
    count = len(nodes) + len(edges)
    if count > MAX_IDS:
        share = 2.0 * count / MAX_IDS
        mean_m = sum(edge.length_m for edge in edges.values()) / len(edges)
        raise UnusableInput(
            f'{len(nodes)} nodes and {len(edges)} edges need {count} ids; the route server has '
            f'{MAX_IDS}: thin the graph with --spacing, for example '
            f'{max(share * max(mean_m, spacing_m), 0.1):.1f}'
        )
    return _text(experience_map, nodes, edges), notices


def _largest_component(experience_map: ExperienceMap) -> tuple[list[int], list[str]]:
    """Return the places of the largest component, the earliest of equal ones, and a notice."""
    components = experience_map.components
    sizes = Counter(components)
    largest = min(sizes, key=lambda component: (-sizes[component], component))
    nodes = [number for number, component in enumerate(components) if component == largest]
    others = len(components) - len(nodes)
    if not others:
        return nodes, []
    parts = 'another part' if len(sizes) == 2 else f'{len(sizes) - 1} other parts'
    return nodes, [
        f'{others} places are left out: they are in {parts} of the map, whose position relative '
        'to the exported one is unknown'
    ]


def _edges(experience_map: ExperienceMap, nodes: set[int]) -> _Edges:
    """Return both directions of every link; one that was not driven takes the other one's time."""
    links = experience_map.link_table
    edges: _Edges = {}
    for (source, target), length_m, time_s, failures in zip(
        links.ends.tolist(), links.shapes[:, 0].tolist(), links.durations_s.tolist(),
        links.failures[:, TIMED_OUT].tolist(), strict=True,
    ):  # fmt: skip
        if source != target and source in nodes and target in nodes:
            edges[source, target] = _Edge(length_m, time_s, failures)
    for (source, target), edge in list(edges.items()):
        edges.setdefault((target, source), edge)
    return edges


def _thinned(
    nodes: list[int], edges: _Edges, points_m: NDArray[np.float64], spacing_m: float
) -> tuple[list[int], _Edges]:
    """Keep nodes that are at least a distance apart, and connect them as they were.

    Junctions are kept first, then ends of dead ends, then the others outwards from these. Every
    other node belongs to the kept node that is nearest along the links. Two kept nodes are
    connected if a link connects nodes that belong to them, so that all connections remain.

    Args:
        nodes: experiences.
        edges: between them.
        points_m: (n, 2) positions of the nodes.
        spacing_m: the distance, along the links.
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

    def keep(rows: list[int]) -> None:
        for row in rows:
            if not covered[row]:
                kept.append(row)
                # Nodes exactly at the spacing remain.
                limit_m = math.nextafter(spacing_m, 0.0)
                covered[np.isfinite(dijkstra(graph, indices=row, limit=limit_m))] = True

    degrees = np.bincount(ends[:, 0], minlength=len(nodes))
    branches = np.array([_branch_count(graph, row, spacing_m) for row in range(len(nodes))])
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
    nodes: list[int], edges: _Edges, previous: NDArray[np.int32], sources: NDArray[np.int32]
) -> _Edges:
    """Return the quickest edges between the kept nodes through the nodes that belong to them."""
    outward: dict[int, _Edge] = {}
    inward: dict[int, _Edge] = {}

    def ways(row: int) -> tuple[_Edge, _Edge]:
        """Return the ways from the kept node of a node to it, and back."""
        chain = []
        while row not in outward and previous[row] >= 0:
            chain.append(row)
            row = int(previous[row])
        outward.setdefault(row, _NOTHING)
        inward.setdefault(row, _NOTHING)
        for after in reversed(chain):
            a, b = nodes[row], nodes[after]
            outward[after] = outward[row].followed_by(edges[a, b])
            inward[after] = edges[b, a].followed_by(inward[row])
            row = after
        return outward[row], inward[row]

    row_of = {node: row for row, node in enumerate(nodes)}
    result: dict[tuple[int, int], _Edge] = {}
    for (a, b), edge in edges.items():
        here, there = int(sources[row_of[a]]), int(sources[row_of[b]])
        if here == there:
            continue
        way = ways(row_of[a])[0].followed_by(edge).followed_by(ways(row_of[b])[1])
        ends = nodes[here], nodes[there]
        if ends not in result or way.time_s < result[ends].time_s:
            result[ends] = way
    return result


def _text(experience_map: ExperienceMap, nodes: list[int], edges: _Edges) -> str:
    id_of = {node: number for number, node in enumerate(nodes)}
    poses = experience_map.poses.tolist()
    points = {node: [_rounded(value) for value in poses[node][:2]] for node in nodes}
    features: list[dict[str, object]] = [
        {
            'type': 'Feature',
            'properties': {
                'id': id_of[node], 'frame': experience_map.frame_id,
                'metadata': {
                    'experience_id': node, 'heading_rad': _rounded(poses[node][2]),
                },
            },
            'geometry': {'type': 'Point', 'coordinates': points[node]},
        }
        for node in nodes
    ]  # fmt: skip
    by_source: defaultdict[int, list[int]] = defaultdict(list)
    for source, target in edges:
        by_source[source].append(target)
    for source in nodes:
        for target in sorted(by_source[source]):
            edge = edges[source, target]
            features.append({
                'type': 'Feature',
                'properties': {
                    'id': len(features), 'startid': id_of[source], 'endid': id_of[target],
                    'metadata': {
                        'abs_time_taken': _rounded(edge.time_s),
                        'length_m': _rounded(edge.length_m),
                        'penalty': float(edge.failures),
                    },
                },
                'geometry': {
                    'type': 'LineString', 'coordinates': [points[source], points[target]],
                },
            })  # fmt: skip
    head = {'type': 'FeatureCollection', 'name': 'ratslam'}
    lines = ',\n'.join(json.dumps(feature, allow_nan=False) for feature in features)
    return f'{json.dumps(head)[:-1]}, "features": [\n{lines}\n]}}\n'


def _rounded(value: float) -> float:
    """Round to 1 mm, 1 ms and 1 mrad, which is always written with a decimal point."""
    return round(value, 3) + 0.0  # -0.0 becomes 0.0
