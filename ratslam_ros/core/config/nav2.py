# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Parameters of the nodes that serve Nav2."""

from __future__ import annotations

from dataclasses import dataclass

from ratslam_ros.core.config.parameter import Section, parameter


@dataclass(frozen=True)
class RouteToNav2Parameters(Section):
    """Nav2 drives along the routes of the map, node `route_to_nav2`."""

    controller_id: str = parameter(
        '', 'Name of the controller of Nav2; empty: the only one that it has.',
        raise_if='the controller server has several controllers', lower_if='it has one',
    )
    goal_checker_id: str = parameter(
        '', 'Name of the goal checker of Nav2; empty: the only one that it has.',
        raise_if='the controller server has several goal checkers', lower_if='it has one',
    )
    progress_checker_id: str = parameter(
        '', 'Name of the progress checker of Nav2; empty: the only one that it has.',
        raise_if='the controller server has several progress checkers', lower_if='it has one',
    )


@dataclass(frozen=True)
class RouteServerGraphParameters(Section):
    """Live graph of the Nav2 route server, node `route_server_graph`."""

    route_server: str = parameter(
        'route_server', 'Name of the route server, with its namespace if it has another one.',
        raise_if='the server has another name', lower_if='the server has another name',
    )
    edges_scorer: str = parameter(
        'DynamicEdgesScorer',
        'Name of the DynamicEdgesScorer in the parameters of the route server; empty: lost edges '
        'are not closed, and stay until the next graph.',
        raise_if='the server names it otherwise', lower_if='the server has none',
    )
    graph_file: str = parameter(
        '',
        'Absolute path of the GeoJSON file that the route server reads; empty: a temporary file.',
        raise_if='the server runs as another user or in a container, or shall start with the '
        'last graph',
        lower_if='it runs as the same user',
    )
    spacing_m: float = parameter(
        1.0,
        'Least distance between two nodes of the graph along the links. The route server drives '
        'straight from node to node.',
        unit='m', low=0.1, high=100.0,
        raise_if='the map has more nodes and edges than the 65536 ids of the server',
        lower_if='paths cut corners',
    )
    refresh_period_s: float = parameter(
        10.0,
        'Shortest time between two graphs. The server answers no requests while it reads one.',
        unit='s', low=1.0, high=3600.0,
        raise_if='the log of the server is too full',
        lower_if='new places must be reachable sooner',
    )
