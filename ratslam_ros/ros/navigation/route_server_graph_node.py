# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Node that keeps the graph of the Nav2 route server up to date with the map."""

from __future__ import annotations

import shutil
import tempfile
import time
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

from ratslam_ros.core.config.nav2 import RouteServerGraphParameters
from ratslam_ros.core.mapping.map_changes import MapMirror
from ratslam_ros.core.navigation.graph_refresh import GraphNumbering, NumberedGraph
from ratslam_ros.errors import UnusableInput, UnusableParameter
from ratslam_ros.files.text import check_output, write_durably
from ratslam_ros.messages.map_changes import MapChangePayload
from ratslam_ros.messages.route_graph import encode_route_graph
from ratslam_ros.ros.mapping.followed_map import FollowedMap
from ratslam_ros.ros.plain_node import PlainNode
from ratslam_ros.ros.qos import LATCHED

CHECK_PERIOD_S = 1.0
"""Time between two looks at the map for lost edges: that of the route of a goal."""

ANSWER_S = 10.0
"""Time after which a request to the server counts as lost; it reads a full graph in about 1 s."""

MAX_LOAD_RATIO = 0.1
"""Largest share of a core for building graphs."""

ACTIVE = frozenset({1, 2, 3})
"""Statuses of a goal that has not ended: accepted, executing, cancelling (action_msgs)."""

ACTIONS = 'compute_route', 'compute_and_track_route'
"""Actions of the route server during which its graph must not be replaced."""


class RouteServerGraphNode(PlainNode):
    """Sends the map to the route server when it has changed, and closes edges that are lost."""

    SECTION = 'route_server_graph'
    PARAMETERS = RouteServerGraphParameters
    _folder: Path | None = None

    def __init__(self) -> None:
        try:
            from action_msgs.msg import GoalStatusArray
            from nav2_msgs.srv import DynamicEdges, SetRouteGraph
        except ImportError as error:
            raise UnusableInput(
                f'route_server_graph needs ROS 2 with nav2_msgs of at least 1.3.9 ({error}): '
                'sudo apt install ros-jazzy-navigation2'
            ) from None
        super().__init__()
        self._map, self._frame_id = MapMirror(), ''
        self._followed = FollowedMap(self, self._refuse, self._apply)
        self._graphs = GraphNumbering(self._p.spacing_m)
        self._graph_type, self._edges_type = SetRouteGraph, DynamicEdges
        server = self._p.route_server
        self._server = self.create_client(SetRouteGraph, f'{server}/set_route_graph')
        self._scorer: Any = None
        if self._p.edges_scorer:
            self._scorer = self.create_client(
                DynamicEdges, f'{server}/{self._p.edges_scorer}/adjust_edges'
            )
        above = server[: server.rfind('/') + 1]
        self._routing: dict[str, bool] = dict.fromkeys(ACTIONS, False)
        for name in ACTIONS:
            self.create_subscription(
                GoalStatusArray, f'{above}{name}/_action/status', partial(self._on_status, name),
                LATCHED,
            )
        self._sent: NumberedGraph | None = None
        self._closed: set[int] | None = None
        """Edges that the server has closed; None if that is not known."""
        self._request: Any = None
        """A request to the server that is not answered yet."""
        self._next_s = 0.0
        self._seen_version = self._checked_version = -1
        self._counts = {'graphs_sent': 0, 'graphs_refused': 0, 'edges_closed': 0}
        self._waits_for = ''
        self.create_timer(CHECK_PERIOD_S, self.update, clock=self.steady)

    def close(self) -> None:
        """Delete the temporary file; the server keeps its graph."""
        if self._folder is not None:
            shutil.rmtree(self._folder, ignore_errors=True)

    def _begin(self) -> None:
        super()._begin()
        given = self._p.graph_file
        if not given:
            self._folder = Path(tempfile.mkdtemp(prefix='ratslam-'))
            self._file = self._folder / 'route_graph.geojson'
            return
        self._file = Path(given)
        if not self._file.is_absolute():
            raise UnusableParameter(f'graph_file is {given!r}; expected an absolute path')
        check_output(self._file)

    def _apply(self, received: MapChangePayload) -> None:
        self._map.apply(received.change)
        self._frame_id = received.frame_id

    # Requests

    def update(self) -> None:
        """Send what the server lacks, if it is due; at most one request is under way."""
        self._waits_for = ''
        self._followed.request_if_needed()
        if not self._followed.is_complete:
            self._waits_for = 'the map'
            return
        if not self._is_server_ready():
            return
        if self._request is not None:
            if time.monotonic() < self._asked_s + ANSWER_S:
                return
            self._end_unanswered()
        if self._close_lost_edges():
            return
        self._refresh()

    def _is_server_ready(self) -> bool:
        name = self._server.srv_name
        if self._server.service_is_ready():
            self.diagnostics.missing.pop(name, None)
            return True
        # A server that starts again has no graph, closes no edge, and routes nothing.
        self._sent, self._closed, self._request = None, None, None
        self._next_s, self._seen_version = 0.0, -1
        self._routing = dict.fromkeys(ACTIONS, False)
        self.diagnostics.lacks(
            name, f'the service {name} is not served: is the route server of Nav2 configured?'
        )
        return False

    def _close_lost_edges(self) -> bool:
        """Close and open edges if needed; return whether a request was sent."""
        sent, known = self._sent, self._map
        if sent is None or self._scorer is None:
            return False
        if self._closed is not None and known.version == self._checked_version:
            return False
        version, lost = known.version, sent.lost_edges(known, self._p.spacing_m)
        if self._closed is None:  # The server may have closed edges of any number.
            closed, opened = lost, set(sent.edge_ids.values()) - lost
        else:
            closed, opened = lost - self._closed, self._closed - lost
        self._checked_version = version
        if not closed and not opened:
            return False
        if not self._scorer.service_is_ready():
            self._checked_version = -1
            self.diagnostics.missing['edges'] = (
                f'the service {self._scorer.srv_name} is not served: lost edges are not closed '
                '(set edges_scorer to the name of the DynamicEdgesScorer, or to an empty name)'
            )
            return False
        self.diagnostics.missing.pop('edges', None)
        if closed:
            self._counts['edges_closed'] += len(closed)
            self.get_logger().info(f'{len(closed)} edges of the route server are closed')

        def on_answer(response: Any) -> None:
            self._closed = lost if response.success else None

        self._closed = None  # unknown until the answer
        self._ask(
            self._scorer,
            self._edges_type.Request(closed_edges=sorted(closed), opened_edges=sorted(opened)),
            on_answer,
        )
        return True

    def _refresh(self) -> None:
        """Send a new graph if the map has changed enough."""
        now_s = time.monotonic()
        known = self._map
        if now_s < self._next_s or known.version == self._seen_version:
            return
        if known.pending and now_s < self._next_s + self._p.refresh_period_s:
            return  # A correction of the map arrives in parts; do not send half of it.
        if any(self._routing.values()):
            self._waits_for = 'the end of a route'
            return
        worked_s = time.thread_time()
        try:
            graph = self._graphs.graph(known)
        except ValueError as error:
            self.diagnostics.warn(
                f'the graph does not fit the route server ({error}): increase spacing_m, which '
                f'is {self._p.spacing_m}'
            )
            graph = None
        self._seen_version = known.version
        worked_s = time.thread_time() - worked_s
        self._next_s = now_s + max(self._p.refresh_period_s, worked_s / MAX_LOAD_RATIO)
        if graph is None or not graph.edge_ids:
            return  # The server refuses a graph without edges.
        reason = 'the route server has none'
        if self._sent is not None:
            reason = self._sent.difference(graph, self._p.spacing_m)
        if reason:
            self._send(graph, reason)

    def _send(self, graph: NumberedGraph, reason: str) -> None:
        text = encode_route_graph(
            graph.graph, self._frame_id, graph.node_ids, graph.edge_ids
        )
        try:
            write_durably(self._file, text)
        except UnusableInput as error:
            self._seen_version = -1
            self.diagnostics.warn(f'{error} (graph_file)')
            return
        self.get_logger().info(
            f'new graph for the route server: {len(graph.node_ids)} nodes, '
            f'{len(graph.edge_ids)} edges; {reason}'
        )

        def on_answer(response: Any) -> None:
            if response.success:
                self._sent = graph
                self._counts['graphs_sent'] += 1
                self.update()  # the states of all edges
                return
            self._seen_version = -1
            self._counts['graphs_refused'] += 1
            self.diagnostics.warn(
                f'the route server has refused {self._file}, and has no graph now; its log has '
                'the reason. It must be able to read the file (graph_file)'
            )

        # The server empties its graph first, whether it can read the new one or not.
        self._sent, self._closed = None, None
        request = self._graph_type.Request(graph_filepath=str(self._file))
        self._ask(self._server, request, on_answer)

    def _ask(self, client: Any, message: Any, on_answer: Callable[[Any], None]) -> None:
        request = self._request = client.call_async(message)
        self._asked, self._asked_s = client, time.monotonic()

        def answered(future: Any) -> None:
            if self._request is request:
                self._request = None
                on_answer(future.result())

        request.add_done_callback(answered)

    def _end_unanswered(self) -> None:
        self._asked.remove_pending_request(self._request)
        self._request, self._seen_version = None, -1
        self.diagnostics.warn(f'{self._asked.srv_name} has not answered within {ANSWER_S:.0f} s')

    def _on_status(self, name: str, message: Any) -> None:
        self._routing[name] = any(one.status in ACTIVE for one in message.status_list)

    def _publish_diagnostics(self) -> None:
        sent = self._sent
        values: dict[str, Any] = {
            **self._counts,
            'nodes': 0 if sent is None else len(sent.node_ids),
            'edges': 0 if sent is None else len(sent.edge_ids),
            'closed': len(self._closed or ()),
        }
        waits_for = self._waits_for or ('' if sent else 'a map with at least one link')
        self.diagnostics.publish(values, f'waiting for {waits_for}' if waits_for else 'running')
