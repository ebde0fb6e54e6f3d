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
from typing import Any

from ratslam_ros.core.navigation.server_graph import ServerGraph


def encode_route_graph(
    graph: ServerGraph, frame_id: str, node_ids: Mapping[int, int] | None = None,
    edge_ids: Mapping[tuple[int, int], int] | None = None,
) -> str:
    """Return a graph as GeoJSON, a feature a line.

    Args:
        graph: the graph.
        frame_id: name of the frame of its poses.
        node_ids, edge_ids: id of each node and edge; without them, they are numbered from 0,
            nodes first.
    """
    id_of = node_ids or {node: number for number, node in enumerate(graph.nodes)}
    points: dict[int, list[float]] = {}
    features: list[dict[str, Any]] = []
    for node, pose in zip(graph.nodes, graph.poses.tolist(), strict=True):
        *points[node], heading_rad = map(_rounded, pose)
        features.append(_feature('Point', points[node], {
            'id': id_of[node], 'frame': frame_id,
            'metadata': {'experience_id': node, 'heading_rad': heading_rad},
        }))
    by_source: defaultdict[int, list[int]] = defaultdict(list)
    for source, target in graph.edges:
        by_source[source].append(target)
    for source in graph.nodes:
        for target in sorted(by_source[source]):
            edge = graph.edges[source, target]
            number = len(features) if edge_ids is None else edge_ids[source, target]
            features.append(_feature('LineString', [points[source], points[target]], {
                'id': number, 'startid': id_of[source], 'endid': id_of[target],
                'metadata': {
                    'abs_time_taken': _rounded(edge.time_s), 'length_m': _rounded(edge.length_m),
                    'penalty': float(edge.failures),
                },
            }))
    lines = ',\n'.join(json.dumps(one, allow_nan=False) for one in features)
    return f'{{"type": "FeatureCollection", "name": "ratslam", "features": [\n{lines}\n]}}\n'


def _feature(
    kind: str, coordinates: list[Any], properties: dict[str, Any]
) -> dict[str, Any]:
    geometry = {'type': kind, 'coordinates': coordinates}
    return {'type': 'Feature', 'properties': properties, 'geometry': geometry}


def _rounded(value: float) -> float:
    """Round to 1 mm, 1 ms and 1 mrad, which is always written with a decimal point."""
    return round(value, 3) + 0.0  # -0.0 becomes 0.0
