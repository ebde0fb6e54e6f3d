# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Managed nodes: their states on ROS 2, and the refusal of the stand-in for rclpy."""

from __future__ import annotations

from functools import partial
from importlib.util import find_spec
from pathlib import Path
from typing import Any
from unittest.mock import MagicMock

import pytest
from ros_messages import MakeWorld
from test_host_map import actions, crash, drive, unsigned

from ratslam_ros.core.config import Config
from ratslam_ros.errors import UNUSABLE, UnusableInput
from ratslam_ros.maps import read_map
from ratslam_ros.maps.kept_log import kept_runs
from ratslam_ros.offline.replay_log import LogReplay
from ratslam_ros.ros import run as ros_run
from ratslam_ros.ros import single_process
from ratslam_ros.ros.managed import managed
from ratslam_ros.ros.pose_cells_node import PoseCellsNode
from ratslam_ros.ros.run import run

try:
    HAS_STATES = find_spec('rclpy.lifecycle') is not None
except (ImportError, ValueError):  # the stand-in is a module and not a package
    HAS_STATES = False
needs_states = pytest.mark.skipif(not HAS_STATES, reason='needs ROS 2: rclpy.lifecycle')
UNCONFIGURED, INACTIVE, ACTIVE, FINALIZED = 'unconfigured', 'inactive', 'active', 'finalized'


def pose_cells() -> Any:
    return managed(PoseCellsNode)(Config())


class Manager:
    """What a manager of the life cycle does, by the services of the node."""

    def __init__(self, made: Any) -> None:
        self._made = made

    def change(self, label: str) -> bool:
        from lifecycle_msgs.msg import Transition
        from lifecycle_msgs.srv import ChangeState

        transition = Transition(label=label)
        response = self._made.call(ChangeState, 'pose_cells/change_state', transition=transition)
        return bool(response.success)

    def state(self) -> str:
        from lifecycle_msgs.srv import GetState

        return str(self._made.call(GetState, 'pose_cells/get_state').current_state.label)


@pytest.mark.skipif(HAS_STATES, reason='ROS 2 has managed nodes')
def test_stand_in_reports_that_it_has_none(
    world: MakeWorld, capsys: pytest.CaptureFixture[str]
) -> None:
    assert run(PoseCellsNode, args=['--lifecycle']) == UNUSABLE
    assert 'the stand-in for rclpy has no managed nodes' in capsys.readouterr().err


def test_malformed_ros_argument_is_unusable_input(monkeypatch: pytest.MonkeyPatch) -> None:
    """rclpy raises errors of several types, also before it is initialised."""
    refuse = MagicMock(side_effect=RuntimeError("Couldn't parse remap rule: '-r image:=a b'"))
    monkeypatch.setattr(ros_run, 'remove_ros_args', refuse)
    for start in partial(run, PoseCellsNode), single_process.main:
        with pytest.raises(UnusableInput, match='image:=a b'):
            start(args=['--ros-args', '-r', 'image:=a b'])


def test_unknown_arguments_are_refused_and_help_starts_no_node(
    world: MakeWorld, capsys: pytest.CaptureFixture[str]
) -> None:
    for argument, code in (('--help', 0), ('--lifecylce', 2)):
        with pytest.raises(SystemExit) as raised:
            run(PoseCellsNode, args=[argument, '--ros-args', '-p', 'unknown:=1'])
        assert raised.value.code == code
    printed = capsys.readouterr()
    assert '--lifecycle' in printed.out
    assert 'unrecognized arguments: --lifecylce' in printed.err


@needs_states
def test_managed_node_maps_as_another_one(world: MakeWorld) -> None:
    made = world(PoseCellsNode)
    expected = actions(made)
    drive(made, 0, 40)
    made.until(lambda: len(expected) == 40)
    made.close()
    made.close = lambda: None
    again = world(pose_cells)
    again.nodes[0].start()
    assert Manager(again).state() == ACTIVE
    found = actions(again)
    drive(again, 0, 40)
    again.until(lambda: len(found) == 40)
    assert [unsigned(one.data) for one in found] == [unsigned(one.data) for one in expected]


@needs_states
def test_only_an_active_node_processes_messages(world: MakeWorld) -> None:
    made = world(pose_cells)
    manager, found = Manager(made), actions(made)
    node = made.nodes[0]
    assert manager.state() == UNCONFIGURED
    drive(made, 0, 5)
    made.until(lambda: node.diagnostics.counts['paused'] == 10)
    assert made.diagnostics()['pose_cells']['message'].startswith(UNCONFIGURED)
    assert manager.change('configure')
    assert manager.state() == INACTIVE
    assert manager.change('activate')
    drive(made, 5, 15)
    made.until(lambda: len(found) == 10)
    assert manager.change('deactivate')
    drive(made, 15, 20)
    made.until(lambda: node.diagnostics.counts['paused'] == 20)
    assert len(found) == 10
    assert len(node._core) > 0
    assert manager.change('cleanup')
    assert len(node._core) == 0
    assert manager.change('shutdown')
    assert manager.state() == FINALIZED


@needs_states
def test_map_is_saved_and_restored_by_the_states(world: MakeWorld, tmp_path: Path) -> None:
    path = tmp_path / 'office.ratslam'
    made = world(pose_cells, arguments=('-p', f'map:={path}'))
    manager, node = Manager(made), made.nodes[0]
    assert not path.exists()
    assert manager.change('configure')
    assert manager.change('activate')
    made.until(lambda: not node.host.map.recovery.is_catching_up)
    drive(made, 0, 20)
    assert manager.change('deactivate')
    assert node.host.map.store.flush(5.0)
    count = len(node._core)
    assert count > 0
    assert len(read_map(path).states['pose_cells']['core']['experiences']) == count
    assert manager.change('cleanup')
    assert len(node._core) == 0
    assert manager.change('configure')
    assert len(node._core) == count
    assert manager.change('shutdown')
    assert not path.with_name(f'{path.name}-wal').exists()


@needs_states
def test_replay_of_the_log_repeats_the_activation(world: MakeWorld, tmp_path: Path) -> None:
    path = tmp_path / 'office.ratslam'
    made = world(pose_cells, arguments=('-p', f'map:={path}', '-p', 'keep_log:=true'))
    [node] = made.nodes
    node.start()
    drive(made, 0, 20)
    made.until(lambda: len(node._core) > 0)
    node.close()
    [run] = kept_runs(path)
    replay = LogReplay(run)
    for _ in replay.repeat():
        pass
    saved, repeated = read_map(path).states['pose_cells'], replay.live.states()['pose_cells']
    assert saved.keys() == repeated.keys()
    assert saved['settings'] == repeated['settings']


@needs_states
def test_interrupted_managed_node_goes_on_where_it_was(world: MakeWorld, tmp_path: Path) -> None:
    path = tmp_path / 'office.ratslam'
    arguments = '-p', f'map:={path}', '-p', 'flush_after_s:=60.0'
    made = world(pose_cells, arguments=arguments)
    made.nodes[0].start()
    made.until(lambda: not made.nodes[0].host.map.recovery.is_catching_up)
    found = actions(made)
    drive(made, 0, 40)
    made.until(lambda: len(found) == 40)
    number = made.nodes[0]._stage.number
    crash(made)
    again = world(pose_cells, arguments=arguments)
    again.nodes[0].start()
    again.until(lambda: not again.nodes[0].host.map.recovery.is_catching_up)
    assert again.nodes[0].host.map.is_resumed
    assert again.nodes[0]._stage.number == number


@needs_states
def test_node_whose_map_cannot_be_used_stays_unconfigured(
    world: MakeWorld, tmp_path: Path
) -> None:
    path = tmp_path / 'office.ratslam'
    path.write_bytes(b'no map' * 1000)
    made = world(pose_cells, arguments=('-p', f'map:={path}'))
    manager = Manager(made)
    assert not manager.change('configure')
    assert manager.state() == UNCONFIGURED
    path.unlink()
    assert manager.change('configure')
    assert manager.state() == INACTIVE
