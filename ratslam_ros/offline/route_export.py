# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Export of the experience map as a graph for the Nav2 route server (GeoJSON)."""

from __future__ import annotations

from ratslam_ros.core.mapping.experience_map import ExperienceMap
from ratslam_ros.core.mapping.link_learning import TIMED_OUT
from ratslam_ros.core.navigation.server_graph import MAX_IDS, server_graph
from ratslam_ros.errors import UnusableInput
from ratslam_ros.messages.route_graph import encode_route_graph


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
    links = experience_map.link_table
    graph = server_graph(
        experience_map.poses, experience_map.components, links.ends, links.shapes[:, 0],
        links.durations_s, links.failures[:, TIMED_OUT], spacing_m,
    )
    if not graph.edges:
        raise UnusableInput(
            f'the graph has {len(graph.nodes)} nodes and no edge, and the route server refuses a '
            'graph without edges: '
            f'{"choose a smaller --spacing" if spacing_m > 0.0 else "map more"}'
        )
    count = graph.feature_count
    if count > MAX_IDS:
        share = 2.0 * count / MAX_IDS
        mean_m = sum(edge.length_m for edge in graph.edges.values()) / len(graph.edges)
        raise UnusableInput(
            f'{len(graph.nodes)} nodes and {len(graph.edges)} edges need {count} ids; the route '
            f'server has {MAX_IDS}: thin the graph with --spacing, for example '
            f'{max(share * max(mean_m, spacing_m), 0.1):.1f}'
        )
    notices = []
    if graph.left_out:
        parts = 'another part' if graph.others == 1 else f'{graph.others} other parts'
        notices.append(
            f'{graph.left_out} places are left out: they are in {parts} of the map, whose '
            'position relative to the exported one is unknown'
        )
    return encode_route_graph(graph, experience_map.frame_id), notices
