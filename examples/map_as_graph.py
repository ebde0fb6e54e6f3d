# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Load a map as a networkx graph, find the quickest route, and plot both.

usage: python examples/map_as_graph.py MAP.json [PLOT.png]    needs: pip install networkx
"""

import json
import sys

import matplotlib.pyplot as plt
import networkx as nx


def load(path: str) -> nx.Graph:
    """Return the experiences with their positions, and an edge for each linked pair."""
    with open(path, encoding='utf-8') as file:
        content = json.load(file)
    graph = nx.Graph()
    for place in content['experiences']:
        graph.add_node(place['id'], position=(place['x_m'], place['y_m']))
    for link in content['links']:
        graph.add_edge(link['source_id'], link['target_id'], duration_s=link['duration_s'])
    return graph


if __name__ == '__main__':
    places = load(sys.argv[1])
    first, last = min(places), max(places)
    route = nx.shortest_path(places, first, last, weight='duration_s')
    duration_s = nx.path_weight(places, route, 'duration_s')
    print(f'{first} to {last}: {len(route)} experiences, {duration_s:.1f} s')
    positions = nx.get_node_attributes(places, 'position')
    nx.draw(places, positions, node_size=5)
    nx.draw_networkx_edges(places, positions, list(nx.utils.pairwise(route)), edge_color='red')
    plt.gca().set_aspect('equal')
    plt.savefig(sys.argv[2] if len(sys.argv) > 2 else 'graph.png', dpi=150)
