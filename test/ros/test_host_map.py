# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Nodes with a map file in this process: restart, repetitions and the exact state of each."""

from __future__ import annotations

import json
import time
from pathlib import Path
from typing import Any
from unittest.mock import MagicMock, patch

import pytest
from diagnostic_msgs.msg import DiagnosticStatus
from helpers import START_NS, S
from ros_messages import MakeWorld, image, odometry, template
from std_msgs.msg import String
from std_srvs.srv import SetBool

from ratslam_ros.chain import ALONE, Chain
from ratslam_ros.errors import UnusableInput, UnusableParameter
from ratslam_ros.maps import Cut, MapMeta, MapStore, read_map
from ratslam_ros.maps.cut_grid import CUT_PERIOD_NS, NUMBERS_PER_POINT
from ratslam_ros.maps.input_log import Base
from ratslam_ros.ros import host_map
from ratslam_ros.ros.diagnostics import Diagnostics
from ratslam_ros.ros.host_map import HostMap
from ratslam_ros.ros.local_view_node import LocalViewNode
from ratslam_ros.ros.pose_cells_node import PoseCellsNode

FAR_NS = 2_000_000_000 * S


def drive(made: Any, first: int, last: int) -> None:
    """Send odometry and templates to the pose cells, and one message of a wrong stamp."""
    for n in range(first, last):
        stamp_ns = START_NS + n * S // 5
        for odometry_ns in (stamp_ns, FAR_NS) if n == 20 else (stamp_ns,):
            made.send('odom', odometry(odometry_ns, 1.0))
        is_new = n < 15
        seen = template(stamp_ns, n if is_new else n - 15, error=0.5, is_new=is_new)
        made.send('local_view/template', seen)
        made.spin(0.01)


def actions(made: Any) -> list[Any]:
    found: list[Any] = made.listen(String, 'pose_cells/action')
    return found


def unsigned(payload: str) -> str:
    """Return an action without the number of its sender, which differs after a restart."""
    fields = json.loads(payload)
    assert fields.pop('sender') > 0
    return json.dumps(fields)


def crash(made: Any) -> None:
    """End a node as if it had been killed."""
    [node] = made.nodes
    store, node.host.map.store = node.host.map.store, None
    node.host.map.recovery.close()
    store.flush(5.0)
    store.abandon()
    made.close()
    made.close = lambda: None


def test_restarted_node_repeats_the_last_action_of_the_first_run(
    world: MakeWorld, tmp_path: Path
) -> None:
    """It gets what it missed from the log; the last action may not have been published."""
    file = ('-p', f'map:={tmp_path / "office.ratslam"}', '-p', 'flush_after_s:=60.0')
    made = world(PoseCellsNode, arguments=file)
    made.nodes[0].host.map.open()
    made.until(lambda: made.nodes[0].host.map.recovery.is_catching_up is False)
    whole = actions(made)
    drive(made, 0, 40)
    made.until(lambda: len(whole) == 40)
    expected = [unsigned(message.data) for message in whole]
    assert made.nodes[0].diagnostics.counts['refused'] == 1
    inputs = made.nodes[0].host.pipeline.inputs_state()
    made.nodes[0].host.map.store.flush(5.0)
    saved = made.nodes[0].host.map.store.acknowledged
    assert saved is not None
    # Another node of the session is running, so that the killed one joins it again.
    other = MapStore(
        tmp_path / 'office.ratslam', ['experience_map'], MapMeta(), lambda text: None
    )
    try:
        crash(made)
        again = world(PoseCellsNode, arguments=file)
        node = again.nodes[0]
        repeated = actions(again)
        node.host.map.open()
        assert node.host.map.store.file.joins and node.host.map.is_resumed
        again.until(lambda: node.host.map.recovery.is_catching_up is False)
        again.until(lambda: bool(repeated))
        again.spin(0.2)  # others have been published before
        assert [unsigned(message.data) for message in repeated] == expected[-1:]
        assert saved.stamp_ns < START_NS + 39 * S // 5
        found = node.host.pipeline.inputs_state()
        assert found == inputs
    finally:
        other.close()


def test_settings_of_a_session_end_with_it(world: MakeWorld, tmp_path: Path) -> None:
    """Otherwise a restart within the next session would switch learning off again."""
    path = tmp_path / 'office.ratslam'
    for mapping in (False, True):
        made = world(PoseCellsNode, arguments=('-p', f'map:={path}'))
        made.nodes[0].host.map.open()
        made.until(lambda made=made: made.nodes[0].host.map.recovery.is_catching_up is False)
        if not mapping:
            assert made.call(SetBool, 'pose_cells/mapping', data=False).success
        drive(made, 0, 3)
        made.close()
        made.close = lambda: None
        assert ('settings' in read_map(path).states['pose_cells']) != mapping


def test_start_with_other_sizes_leaves_the_map_as_it_was(
    world: MakeWorld, tmp_path: Path
) -> None:
    """The next start with the right ones would otherwise report that messages may be lost."""
    path = tmp_path / 'office.ratslam'
    file = ('-p', f'map:={path}')
    for sizes in ((), ('-p', 'pc_dim_x:=12'), ()):
        made = world(PoseCellsNode, arguments=(*file, *sizes))
        if sizes:
            with pytest.raises(UnusableInput, match='pc_dim_x'):
                made.nodes[0].host.map.open()
        else:
            made.nodes[0].host.map.open()
            assert not made.nodes[0].host.map.recovery.is_catching_up
            drive(made, 0, 3)
        made.close()
        made.close = lambda: None
        assert [*tmp_path.iterdir()] == [path]


@pytest.mark.parametrize('name', ['localize', 'keep_log'])
def test_options_of_a_map_file_are_refused_without_it(world: MakeWorld, name: str) -> None:
    made = world(PoseCellsNode, arguments=('-p', f'{name}:=true'))
    with pytest.raises(UnusableParameter, match=f'{name} is true.*set map'):
        made.nodes[0].host.map.open()


def saving(part: str, store: Any, chain: Chain = ALONE) -> Any:
    """Return a HostMap that saves a stage without content."""
    node, live = MagicMock(), MagicMock()
    node.config.memory.configure_mock(map='a', localize=False, keep_log=False)
    live.pipeline.stages, live.states.return_value = {part: None}, {part: {}}
    made = HostMap([node], MagicMock(), chain, MagicMock(), lambda cut: made.write(cut))
    made.live = live
    with patch.multiple(host_map, MapStore=lambda *_: store, own_yaml=lambda *_: ''):
        made.restore()
    return made


def numbers(chain: Chain, tmp_path: Path) -> tuple[list[int], list[int]]:
    """Return the cuts of a process that pauses, and the numbers that it sends to others.

    While it pauses, others save cut 5.
    """
    store = MagicMock(path=tmp_path / 'a', file=MagicMock(
        restored=None, number=None, common=None, is_interrupted=False, joins=False,
        base=Base(1, 0, 0), base_of=lambda number: Base(1, 1, number),
    ))
    keeper = saving('pose_cells', store, chain)

    def receive(stamp_ns: int) -> None:
        if (cut := keeper.grid.before(stamp_ns)) is not None and not chain.follows:
            keeper.write(cut)
        keeper.has_changed = True

    receive(3 * S)
    keeper._on_cut(MagicMock(data=5 * NUMBERS_PER_POINT))
    keeper.pause()
    receive(5 * S)  # the grid has cut 2 here, but a later one is saved already
    keeper.pause()
    receive(13 * S)
    keeper.pause()
    keeper.pause()  # nothing has changed since
    keeper.log('relocation', 0, bytes)  # an answer to the last message changes the state too
    keeper.pause()
    keeper._on_cut(MagicMock(data=7 * NUMBERS_PER_POINT))
    keeper.pause()
    return (
        [call.args[0].number for call in store.cut.call_args_list],
        [call.args[0].data for call in keeper._cuts.publish.call_args_list],
    )


def test_cut_after_messages_that_came_late_has_a_new_number(tmp_path: Path) -> None:
    """It may have the number that others have saved before."""
    at_5, at_6, at_7 = (n * NUMBERS_PER_POINT for n in (5, 6, 7))
    saved = [at_5, at_5 + 1, at_6, at_6 + 1, at_6 + 2, at_7]
    assert numbers(ALONE, tmp_path) == (saved, saved)


def test_first_process_of_a_split_alone_begins_cuts(tmp_path: Path) -> None:
    """The others may not have got what it has passed on before, or the reverse."""
    at_5, at_6, at_7 = (n * NUMBERS_PER_POINT for n in (5, 6, 7))
    saved = [at_5 + 1, at_5 + 2, at_6, at_6 + 1, at_6 + 2, at_7 + 1]
    assert numbers(Chain(is_followed=True), tmp_path) == (saved, saved)
    # A follower which has got no cut in its stream asks for one.
    assert numbers(Chain('local_view'), tmp_path) == ([], [at_5 + 1])


def test_local_view_ends_at_the_same_cut_as_its_neighbours(
    world: MakeWorld, tmp_path: Path
) -> None:
    """It processes odometry later than they do, but has not seen more of the drive."""
    path = tmp_path / 'office.ratslam'
    given = {
        'map': path, 'flush_after_s': 60.0, 'vt_match_threshold': -1.0, 'vt_match_ratio': -1.0,
    }
    arguments = [word for name, value in given.items() for word in ('-p', f'{name}:={value}')]
    made = world(LocalViewNode, arguments=arguments)
    node = made.nodes[0]
    node.host.map.open()
    made.until(lambda: node.host.map.recovery.is_catching_up is False)
    for n in range(8):
        stamp_ns = START_NS + n * S // 5
        made.send('odom', odometry(stamp_ns, 1.0))
        made.send('image', image(stamp_ns, n))
    made.until(lambda: node.host.pipeline.order.newest_of('image') == stamp_ns)
    made.until(lambda: node.host.pipeline.order.newest_of('odometry') == stamp_ns)
    node.close()
    cut = read_map(path).cut
    assert cut is not None
    last_point = stamp_ns // CUT_PERIOD_NS * NUMBERS_PER_POINT
    assert cut == Cut(last_point + 1, stamp_ns)


def test_map_that_is_not_saved_while_mapping_is_an_error(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Another node of the session maps, and its states never fit."""
    parts = 'pose_cells', 'local_view'
    own, other = (
        MapStore(tmp_path / 'map', [part], MapMeta(), lambda text: None) for part in parts
    )
    node = MagicMock()
    node.get_clock().now().nanoseconds = 0
    keeper = saving(parts[0], own)
    diagnostics = keeper._nodes[0].diagnostics = Diagnostics(node)
    levels, start_s = [], time.monotonic()
    for number, run in enumerate([0] * 4 + [2**40] * 6):
        now_s = start_s + 2.0 * number
        monkeypatch.setattr(host_map, 'time', MagicMock(monotonic=lambda now_s=now_s: now_s))
        other.cut(Cut(run + number * NUMBERS_PER_POINT, 0), {parts[1]: {}})
        assert other.flush(5.0)
        if (cut := keeper.grid.before(2 * S * number + 1)) is not None:
            keeper.write(cut)
        assert own.flush(5.0)
        diagnostics.publish(keeper.diagnostic_values(), 'running')
        levels.append(diagnostics._publisher.publish.call_args.args[0].status[0].level)
    for store in (own, other):
        store.close()
    assert levels[:7] == [DiagnosticStatus.OK] * 7
    assert levels[-2:] == [DiagnosticStatus.ERROR] * 2
