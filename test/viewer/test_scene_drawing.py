# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The scene as it queues messages, without a browser."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from synthetic_runs import SyntheticRun

from ratslam_ros.history.records import RouteRecord, ScanRecord
from ratslam_ros.history.run_state import RunState
from ratslam_ros.viewer.scene import COLOURINGS, Pick, RunScene

viser = pytest.importorskip('viser')


class Drawing:
    """A scene on a server without browser, the messages it queues, and a clock."""

    def __init__(self, server: Any) -> None:
        self.now_s = 100.0
        self.messages: list[Any] = []
        self._server = server
        queue = server.scene._websock_interface.queue_message

        def recorded(message: Any) -> None:
            self.messages.append(message)
            queue(message)

        server.scene._websock_interface.queue_message = recorded
        self.scene = RunScene(server, clock=lambda: self.now_s)

    def update(self, state: Any, elapsed_s: float = 1.0) -> list[Any]:
        """Return the messages of an update."""
        self.now_s += elapsed_s
        self.messages.clear()
        self.scene.update(state)
        return list(self.messages)

    def settle(self, state: Any) -> None:
        for _ in range(3):
            self.update(state)


def names(messages: list[Any]) -> set[str]:
    return {name for message in messages if (name := getattr(message, 'name', None))}


def sent_bytes(messages: list[Any]) -> int:
    total = 0
    for message in messages:
        props = getattr(message, 'props', None) or getattr(message, 'updates', {})
        values = props.values() if isinstance(props, dict) else vars(props).values()
        total += sum(
            getattr(value, 'nbytes', len(value) if isinstance(value, bytes) else 0)
            for value in values
        )
    return total


@pytest.fixture(scope='module')
def server() -> Any:
    server = viser.ViserServer('127.0.0.1', 0, verbose=False)
    yield server
    server.stop()


@pytest.fixture
def drawing(server) -> Any:
    original = server.scene._websock_interface.queue_message
    server.scene.reset()
    yield Drawing(server)
    server.scene._websock_interface.queue_message = original


def test_unchanged_state_sends_nothing(drawing) -> None:
    run = SyntheticRun(300)
    state = run.state()
    for record in run.goals():
        state.apply(record)
    drawing.settle(state)
    assert drawing.update(state) == []


def test_all_layers_are_drawn(drawing) -> None:
    run = SyntheticRun(40)
    state = run.state()
    for record in [*run.goals(), run.reject()]:
        state.apply(record)
    drawing.scene.select(Pick('experience', (*run.poses[5, :2], 0.0), id=5))
    drawn = names(drawing.update(state))
    for layer in drawing.scene.layers:
        assert any(name.startswith('/' + layer.replace(' ', '_') + '/') for name in drawn), layer
    assert any(name.startswith('/selection/') for name in drawn)


def test_steady_driving_sends_few_chunks(drawing) -> None:
    run = SyntheticRun(3000)
    state = run.state()
    drawing.settle(state)
    for record in run.step():
        state.apply(record)
    messages = drawing.update(state)
    chunks = {name for name in names(messages) if name.split('/')[1] in ('experiences', 'links')}
    assert 1 <= len({tuple(name.split('/')[1:3]) for name in chunks}) <= 4
    assert sent_bytes(messages) < 80_000


def test_map_is_drawn_at_its_own_period(drawing) -> None:
    run = SyntheticRun(100)
    state = run.state()
    drawing.settle(state)
    for record in run.step():
        state.apply(record)
    drawing.update(state)
    for record in run.step():
        state.apply(record)
    early = names(drawing.update(state, 0.1))
    assert not any(name.startswith('/experiences/') for name in early)
    assert any(name.startswith('/experiences/') for name in names(drawing.update(state, 1.0)))


def test_closure_moves_every_chunk(drawing) -> None:
    run = SyntheticRun(1500)
    state = run.state()
    drawing.settle(state)
    for record in run.close():
        state.apply(record)
    moved = names(drawing.update(state))
    assert {f'/experiences/{k}' for k in range(3)} <= moved
    assert {name.rsplit('/', 1)[0] for name in moved if name.startswith('/links/')} >= {
        f'/links/{k}' for k in range(3)
    }


def test_seeking_back_removes_what_was_not_yet(drawing) -> None:
    drawing.settle(SyntheticRun(1500).state())
    earlier = SyntheticRun(100).state()
    drawing.settle(earlier)
    nodes = drawing._server.scene._handle_from_node_name
    assert len(nodes['/experiences/0'].points) == 100
    assert not nodes['/experiences/2'].visible
    assert not any(name.startswith('/links/2/') for name in nodes)


def test_replaced_lines_leave_one_node(drawing) -> None:
    run = SyntheticRun(60)
    state = run.state()
    for _ in range(20):
        for record in run.step():
            state.apply(record)
        drawing.update(state)
    drawing.update(state)
    nodes = drawing._server.scene._handle_from_node_name
    assert sum(name.startswith('/links/0/') for name in nodes) == 1


def test_large_map_is_thinned_and_says_so(drawing) -> None:
    state = SyntheticRun(500).state()
    assert drawing.scene.detail == ''
    drawing.scene.limit = 200
    drawing.settle(state)
    assert '1 of 3' in drawing.scene.detail
    nodes = drawing._server.scene._handle_from_node_name
    drawn = sum(
        len(node.points) for name, node in nodes.items()
        if name.startswith('/experiences/') and node.visible
    )
    assert drawn == 167


def test_colourings_change_colours(drawing) -> None:
    state = SyntheticRun(100).state()
    seen = set()
    for name in COLOURINGS:
        drawing.scene.colouring = name
        drawing.update(state, 0.01)
        cloud = drawing._server.scene._handle_from_node_name['/experiences/0']
        seen.add((name, cloud.colors.tobytes()))
    assert len({colours for _, colours in seen}) >= 5


def test_empty_run_draws_nothing_and_does_not_fail(drawing) -> None:
    drawing.settle(RunState())
    assert drawing.scene.legend()


def test_legend_names_scan_and_route_once_drawn(drawing) -> None:
    state = SyntheticRun(50).state()
    drawing.settle(state)
    before = [text for _, text in drawing.scene.legend()]
    state.apply(ScanRecord(state.stamp_ns, np.ones((3, 2))))
    state.apply(RouteRecord(state.stamp_ns, np.eye(2)))
    drawing.settle(state)
    texts = [text for _, text in drawing.scene.legend()]
    assert set(texts) - set(before) == {'laser scan', 'route and goal'}


def test_experiences_without_pose_are_left_out(drawing) -> None:
    state = SyntheticRun(50).state()
    state.map.poses[7] = np.nan
    drawing.settle(state)
    cloud = drawing._server.scene._handle_from_node_name['/experiences/0']
    assert len(cloud.points) == 49
