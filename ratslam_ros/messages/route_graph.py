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

from ratslam_ros.core.navigation.server_graph import ServerGraph


def encode_route_graph(
    graph: ServerGraph, frame_id: str, node_ids: Mapping[int, int] | None = None,
    edge_ids: Mapping[tuple[int, int], int] | None = None,
) -> str:  # fmt: skip
    """Return a graph as GeoJSON.

    Args:
        graph: the graph.
        frame_id: name of the frame of its poses.
        node_ids, edge_ids: id of each node and edge; without them, they are numbered from 0,
            nodes first.
    """
    points = {
        node: [_rounded(x), _rounded(y)]
        for node, (x, y, _) in zip(graph.nodes, graph.poses.tolist(), strict=True)
    }
    id_of = node_ids or {node: number for number, node in enumerate(graph.nodes)}
    features: list[dict[str, object]] = [
        {
            'type': 'Feature',
            'properties': {
                'id': id_of[node], 'frame': frame_id,
                'metadata': {'experience_id': node, 'heading_rad': _rounded(heading_rad)},
            },
            'geometry': {'type': 'Point', 'coordinates': points[node]},
        }
        for node, heading_rad in zip(graph.nodes, graph.poses[:, 2].tolist(), strict=True)
    ]  # fmt: skip
    by_source: defaultdict[int, list[int]] = defaultdict(list)
    for source, target in graph.edges:
        by_source[source].append(target)
    for source in graph.nodes:
        for target in sorted(by_source[source]):
            edge = graph.edges[source, target]
            features.append({
                'type': 'Feature',
                'properties': {
                    'id': len(features) if edge_ids is None else edge_ids[source, target],
                    'startid': id_of[source], 'endid': id_of[target],
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
