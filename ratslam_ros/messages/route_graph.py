# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""A graph for the Nav2 route server as GeoJSON.

The route server reads a FeatureCollection: Points are nodes with an `id`, LineStrings are edges
with `id`, `startid` and `endid`. An edge is driven in one direction only. Its time scorer reads
`abs_time_taken`, its penalty scorer `penalty`; both accept only numbers that the JSON parser reads
as floating point.
"""

from __future__ import annotations

import json
from collections import defaultdict
from collections.abc import Mapping

from msgspec import Struct, to_builtins

from ratslam_ros.core.navigation.server_graph import ServerGraph

_Coordinates = list[float]
"""x and y in m."""


class _Place(Struct):
    experience_id: int
    heading_rad: float


class _Node(Struct):
    id: int
    frame: str
    metadata: _Place


class _Drive(Struct):
    abs_time_taken: float
    length_m: float
    penalty: float


class _Edge(Struct):
    id: int
    startid: int
    endid: int
    metadata: _Drive


class _Point(Struct, tag_field='type', tag='Point'):
    coordinates: _Coordinates


class _Line(Struct, tag_field='type', tag='LineString'):
    coordinates: list[_Coordinates]


class _Feature(Struct, tag_field='type', tag='Feature'):
    properties: _Node | _Edge
    geometry: _Point | _Line


def encode_route_graph(
    graph: ServerGraph, frame_id: str, node_ids: Mapping[int, int] | None = None,
    edge_ids: Mapping[tuple[int, int], int] | None = None,
) -> str:  # fmt: skip
    """Return a graph as GeoJSON, a feature a line.

    Args:
        graph: the graph.
        frame_id: name of the frame of its poses.
        node_ids, edge_ids: id of each node and edge; without them, they are numbered from 0,
            nodes first.
    """
    id_of = node_ids or {node: number for number, node in enumerate(graph.nodes)}
    points, features = {}, []
    for node, pose in zip(graph.nodes, graph.poses.tolist(), strict=True):
        *points[node], heading_rad = map(_rounded, pose)
        properties = _Node(id_of[node], frame_id, _Place(node, heading_rad))
        features.append(_Feature(properties, _Point(points[node])))
    by_source: defaultdict[int, list[int]] = defaultdict(list)
    for source, target in graph.edges:
        by_source[source].append(target)
    for source in graph.nodes:
        for target in sorted(by_source[source]):
            edge = graph.edges[source, target]
            number = len(features) if edge_ids is None else edge_ids[source, target]
            drive = _Drive(_rounded(edge.time_s), _rounded(edge.length_m), float(edge.failures))
            features.append(_Feature(
                _Edge(number, id_of[source], id_of[target], drive),
                _Line([points[source], points[target]]),
            ))  # fmt: skip
    lines = ',\n'.join(json.dumps(to_builtins(one), allow_nan=False) for one in features)
    return f'{{"type": "FeatureCollection", "name": "ratslam", "features": [\n{lines}\n]}}\n'


def _rounded(value: float) -> float:
    """Round to 1 mm, 1 ms and 1 mrad, which is always written with a decimal point."""
    return round(value, 3) + 0.0  # -0.0 becomes 0.0
