# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""A node with a map file that is interrupted, or started again, at inconvenient moments."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest
from rclpy.parameter import Parameter
from ros_messages import MakeWorld
from std_msgs.msg import String
from std_srvs.srv import SetBool, Trigger
from test_host_map import actions, crash, drive

from ratslam_ros.core.pose_cells.pose_cells import PoseCells
from ratslam_ros.errors import UnusableInput
from ratslam_ros.maps import MapMeta, MapStore
from ratslam_ros.ros.pose_cells_node import PoseCellsNode
from ratslam_ros.ros.qos import INPUT, history
from ratslam_ros.ros.restart.history import history_topic

HOUR = 18_000
"""Number of steps of ``drive`` in an hour."""


class Node:
    """The pose cells with a map file, and the commands that they obey."""

    def __init__(self, world: MakeWorld, path: Path, *arguments: str) -> None:
        self.made = world(
            PoseCellsNode,
            arguments=('-p', f'map:={path}', '-p', 'flush_after_s:=60.0', *arguments),
        )
        self.node = self.made.nodes[0]
        self.commands: list[str] = []
        self.node.host.pipeline.observe('command', self._obeyed)
        self.noted: list[str] = []
        self.node.diagnostics.note = self.noted.append
        self.actions = actions(self.made)

    def open(self) -> Node:
        self.node.host.map.open()
        return self

    def _obeyed(self, stamp_ns: int, command: Any) -> None:
        self.commands.append(type(command).__name__)

    def ready(self) -> Node:
        if self.node.host.map.store is None:
            self.open()
        self.made.until(lambda: self.node.host.map.recovery.is_catching_up is False)
        return self

    def drive(self, first: int, last: int) -> Node:
        number = self.number
        drive(self.made, first, last)
        self.made.until(lambda: self.number == number + last - first)
        return self

    @property
    def number(self) -> int:
        """Number of the actions so far."""
        return int(self.node._stage.number)

    @property
    def notes(self) -> str:
        return '\n'.join(self.noted)

    def crash(self) -> None:
        crash(self.made)

    def close(self) -> None:
        self.made.close()
        self.made.close = lambda: None


@pytest.fixture
def path(tmp_path: Path) -> Path:
    return tmp_path / 'office.ratslam'


def test_session_that_is_killed_before_its_first_cut_stays_another_session(
    world: MakeWorld, path: Path
) -> None:
    Node(world, path).ready().drive(0, 15).close()
    second = Node(world, path).ready().drive(1, 5)  # the same recording again
    assert second.commands == ['NewSession']
    peak = second.node._core.peak
    second.crash()
    again = Node(world, path).ready()
    assert again.commands == ['NewSession']
    assert (again.number, again.node._core.peak) == (19, peak)
    assert 'lost' not in again.notes


def test_start_that_fails_after_a_crash_loses_nothing(world: MakeWorld, path: Path) -> None:
    first = Node(world, path).ready().drive(0, 15)
    peak = first.node._core.peak
    first.crash()
    other = Node(world, path, '-p', 'pc_dim_x:=50')
    with pytest.raises(UnusableInput, match='pc_dim_x'):
        other.open()
    other.close()
    again = Node(world, path).ready()
    assert (again.number, again.node._core.peak) == (15, peak)


@pytest.mark.parametrize('call', ['load', 'pause', 'reset', 'set', 'close'])
def test_request_during_the_restart_acts_after_what_was_received(
    world: MakeWorld, path: Path, call: str
) -> None:
    energy = 'pc_vt_inject_energy'
    arguments = '-p', f'memory_folder:={path.parent}'
    first = Node(world, path, *arguments).ready().drive(0, 5)
    assert first.made.call(Trigger, 'pose_cells/save').success
    first.node.set_parameters([Parameter(energy, value=0.3)])
    first.drive(5, 15)
    first.crash()
    again = Node(world, path, *arguments).open()
    if call == 'pause':
        assert again.made.call(SetBool, 'pose_cells/pause', data=True).success
        assert again.made.call(SetBool, 'pose_cells/pause', data=False).success
    elif call == 'set':
        assert again.node.set_parameters([Parameter(energy, value=0.6)])[0].successful
    elif call == 'close':
        again.close()
        again = Node(world, path, *arguments).open()
    else:
        assert again.made.call(Trigger, f'pose_cells/{call}').success
    again.ready()
    assert again.number == {'load': 5, 'reset': 0}.get(call, 15)
    if call == 'set':
        assert again.node.config.pose_cells.pc_vt_inject_energy == 0.6
        assert again.node._stage._config.pose_cells.pc_vt_inject_energy == 0.6


def test_input_that_ends_the_process_is_left_out_at_last(
    world: MakeWorld, path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    first = Node(world, path).ready().drive(0, 12)
    view = PoseCells.view

    def faulty(cells: Any, match: Any, *arguments: Any) -> Any:
        if match.template_id == 12:
            raise RuntimeError('a defect')
        return view(cells, match, *arguments)

    monkeypatch.setattr(PoseCells, 'view', faulty)
    with pytest.raises(RuntimeError, match='a defect'):
        first.drive(12, 14)
    first.crash()
    for _ in range(2):
        again = Node(world, path).open()
        with pytest.raises(RuntimeError, match='a defect'):
            again.ready()
        again.crash()
    last = Node(world, path).ready()
    assert last.number == 12
    assert 'it is left out, as this process has ended 2 times' in last.notes
    last.drive(14, 15)


def test_log_that_cannot_be_written_is_reported_after_an_interruption(
    world: MakeWorld, path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    first = Node(world, path).ready().drive(0, 12)
    with monkeypatch.context() as patch:
        patch.setattr('ratslam_ros.maps.input_log.write', lambda file, data: 0)
        first.drive(12, 14)
    first.node.host.map.store.flush(5.0)
    first.crash()
    again = Node(world, path).ready()
    assert again.number < 14
    assert 'may be lost' in again.notes


@pytest.mark.parametrize('is_alone', [True, False])
def test_node_that_is_started_again_maps_nothing_twice(
    world: MakeWorld, path: Path, is_alone: bool
) -> None:
    """What its sources have kept is what it had received before its clean end."""
    first = Node(world, path).ready()
    received: list[Any] = []
    first.made.tester.create_subscription(String, 'local_view/template', received.append, INPUT)
    other = MapStore(path, ['experience_map'], MapMeta(), print)
    first.drive(0, 15)
    first.made.until(lambda: len(received) == 15)
    store = first.node.host.map.store
    first.close()
    other.cut(store.acknowledged, {'experience_map': {}})
    assert other.flush(5.0)
    if is_alone:
        other.close()
    again = Node(world, path).open()
    kept = again.made.tester.create_publisher(
        String, history_topic('local_view/template'), history(100)
    )
    for message in received:
        kept.publish(message)
    again.ready()
    again.made.spin(0.2)
    assert again.number == 15
    again.drive(HOUR, HOUR + 2)
    assert again.commands == (['NewSession'] if is_alone else [])
    other.close()
