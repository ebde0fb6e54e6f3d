# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Node that keeps the graph of the route server up to date, with a fake route server."""

from __future__ import annotations

import json
from collections.abc import Iterator
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import pytest
from action_msgs.msg import GoalStatus, GoalStatusArray
from graphs import corridor, go
from ros_messages import MakeWorld
from std_msgs.msg import String

from ratslam_ros.core.common.odometry import Motion
from ratslam_ros.core.common.pose import Pose
from ratslam_ros.core.mapping.map_changes import MapChangeTracker
from ratslam_ros.errors import UnusableInput
from ratslam_ros.messages.json_schema import encode
from ratslam_ros.messages.map_changes import MapChangePayload
from ratslam_ros.ros.navigation.route_server_graph_node import RouteServerGraphNode
from ratslam_ros.ros.qos import LATCHED, STATE

HAS_NAV2 = find_spec('nav2_msgs') is not None
needs_nav2 = pytest.mark.skipif(not HAS_NAV2, reason='needs ROS 2 with nav2_msgs')
EXECUTING, SUCCEEDED = 2, 4


class RouteServer:
    """Has the services of the route server, and loses its graph as that does."""

    def __init__(self, world: MakeWorld, *arguments: str) -> None:
        self.world = world(
            RouteServerGraphNode, arguments=('-p', 'refresh_period_s:=1.0', *arguments)
        )
        [self.node] = self.world.nodes
        self.accepts = True
        self.graphs: list[dict[str, Any]] = []
        self.paths: list[Path] = []
        self.closed: set[int] = set()
        self.changes = 0
        self.services: list[Any] = []
        self.status_type = GoalStatusArray
        self.map = corridor(6, 'left', exp_loops=0)
        self._tracker = MapChangeTracker()
        self._sequence = 0
        self._changed: Any = None
        self.start()

    def start(self) -> None:
        from nav2_msgs.srv import DynamicEdges, SetRouteGraph

        make = self.world.tester.create_service
        self.services = [
            make(SetRouteGraph, 'route_server/set_route_graph', self._on_graph),
            make(DynamicEdges, 'route_server/DynamicEdgesScorer/adjust_edges', self._on_edges),
        ]

    def stop(self) -> None:
        self.closed.clear()
        while self.services:
            self.world.tester.destroy_service(self.services.pop())

    def send_map(self) -> None:
        change = self._tracker.next_change(self.map, self._sequence)
        text = encode(MapChangePayload.of(change, self._sequence, 1, 'map'))
        self._sequence += 1
        self.world.send(MapChangePayload.TOPIC, String(data=text), STATE)

    def set_status(self, *statuses: int) -> None:
        self.world.send(
            'compute_and_track_route/_action/status',
            self.status_type(status_list=[GoalStatus(status=one) for one in statuses]), LATCHED,
        )
        self.world.until(
            lambda: self.node._routing['compute_and_track_route'] == (EXECUTING in statuses)
        )

    def until_graphs(self, count: int) -> dict[str, Any]:
        self.world.until(lambda: len(self.graphs) >= count)
        self.world.until(lambda: self.node._sent is not None and self.node._closed is not None)
        return self.graphs[-1]

    def edge_ids(self, graph: dict[str, Any]) -> dict[tuple[int, int], int]:
        """Return the id of each edge of a graph by the experiences that it connects."""
        places, edges = {}, {}
        for feature in graph['features']:
            properties = feature['properties']
            if feature['geometry']['type'] == 'Point':
                places[properties['id']] = properties['metadata']['experience_id']
        for feature in graph['features']:
            properties = feature['properties']
            if feature['geometry']['type'] == 'LineString':
                ends = places[properties['startid']], places[properties['endid']]
                edges[ends] = properties['id']
        return edges

    def _on_graph(self, request: Any, response: Any) -> Any:
        self.paths.append(Path(request.graph_filepath))
        response.success = self.accepts
        if self.accepts:
            self.graphs.append(json.loads(self.paths[-1].read_text()))
        return response

    def _on_edges(self, request: Any, response: Any) -> Any:
        self.changes += 1
        self.closed |= set(request.closed_edges)
        self.closed -= set(request.opened_edges)
        response.success = True
        return response


@pytest.fixture
def server(world: MakeWorld) -> Iterator[RouteServer]:
    made = RouteServer(world)
    yield made
    made.stop()


@needs_nav2
def test_graph_is_sent_once_and_again_when_the_map_grows(server: RouteServer) -> None:
    server.send_map()
    first = server.edge_ids(server.until_graphs(1))
    assert len(first) == 10
    server.send_map()
    server.world.spin(2.5)
    assert len(server.graphs) == 1  # nothing has changed
    go(server.map, 6, Motion(2.0, 1.0, 0.0), behaviour='left')
    server.send_map()
    second = server.edge_ids(server.until_graphs(2))
    assert set(second) - set(first) == {(5, 6), (6, 5)}
    assert first.items() <= second.items()  # the ids of all others stay


@needs_nav2
def test_unlearned_link_is_closed_until_the_graph_is_replaced(server: RouteServer) -> None:
    server.closed = {8, 40_000}  # of an earlier run; only ids in use can be known
    server.send_map()
    edges = server.edge_ids(server.until_graphs(1))
    assert server.closed == {40_000}
    server.set_status(EXECUTING)  # so that the graph stays
    while not server.map.unlearn_blocked('left', 0.0, Pose(2.6, 0.0, 0.0)):
        pass
    left = {tuple(ends) for ends in server.map.link_ends.tolist()}
    gone = {ends for ends in edges if ends not in left and ends[::-1] not in left}
    assert gone
    server.send_map()
    server.world.until(lambda: server.closed == {40_000, *(edges[ends] for ends in gone)})
    assert len(server.graphs) == 1
    server.set_status(SUCCEEDED)
    after = server.edge_ids(server.until_graphs(2))
    assert not gone & set(after)


@needs_nav2
def test_graph_is_not_replaced_while_a_route_is_tracked(server: RouteServer) -> None:
    server.set_status(EXECUTING)
    server.send_map()
    server.world.until(lambda: server.node._waits_for == 'the end of a route')
    server.world.spin(1.5)
    assert server.graphs == []
    server.set_status(SUCCEEDED)
    server.until_graphs(1)


@needs_nav2
def test_restarted_server_gets_graph_and_closed_edges(server: RouteServer) -> None:
    server.send_map()
    server.until_graphs(1)
    server.stop()
    server.world.until(lambda: server.node.diagnostics.missing)
    server.start()
    server.until_graphs(2)
    assert not server.node.diagnostics.missing
    assert server.graphs[0] == server.graphs[1]


@needs_nav2
def test_refused_graph_is_sent_again(server: RouteServer) -> None:
    server.accepts = False
    server.send_map()
    server.world.until(lambda: server.node._counts['graphs_refused'] == 1)
    shown = server.world.diagnostics()['route_server_graph']
    assert shown['nodes'] == '0'
    assert 'graph_file' in shown['message']
    server.accepts = True
    server.until_graphs(1)


@needs_nav2
def test_missing_scorer_is_named_and_prevents_no_graph(world: MakeWorld) -> None:
    server = RouteServer(world, '-p', 'edges_scorer:=Other')
    server.send_map()
    server.world.until(lambda: server.graphs)
    server.world.until(lambda: 'edges' in server.node.diagnostics.missing)
    assert 'Other/adjust_edges' in server.node.diagnostics.missing['edges']
    server.stop()


@needs_nav2
def test_given_file_stays(world: MakeWorld, tmp_path: Path) -> None:
    given = tmp_path / 'office.geojson'
    server = RouteServer(world, '-p', f'graph_file:={given}')
    server.send_map()
    server.until_graphs(1)
    server.stop()
    assert server.paths == [given]
    server.node.close()
    assert given.is_file()


@needs_nav2
def test_temporary_file_is_deleted(world: MakeWorld) -> None:
    [node] = world(RouteServerGraphNode).nodes
    assert node._file.parent.is_dir()
    node.close()
    assert not node._file.parent.exists()


@needs_nav2
def test_file_in_a_missing_folder_is_refused(world: MakeWorld, tmp_path: Path) -> None:
    with pytest.raises(UnusableInput, match='missing does not exist'):
        RouteServer(world, '-p', f'graph_file:={tmp_path / "missing" / "map.geojson"}')


def test_without_nav2_the_error_names_the_package(world: MakeWorld) -> None:
    if HAS_NAV2:
        pytest.skip('nav2_msgs is installed')
    with pytest.raises(UnusableInput, match='nav2_msgs'):
        world(RouteServerGraphNode)
