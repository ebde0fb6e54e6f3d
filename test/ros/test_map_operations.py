# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Saving and loading the map of all nodes in one operation, and nodes that use a map file."""

from __future__ import annotations

import hashlib
import json
import threading
import time
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
import rclpy
from helpers import START_NS
from ros_messages import MakeWorld, image, odometry, string
from std_msgs.msg import String
from std_srvs.srv import SetBool, Trigger

from ratslam_ros.errors import UnusableInput
from ratslam_ros.files.config import stored_config
from ratslam_ros.maps import MapMeta, SavedMap, read_map, save_map
from ratslam_ros.maps.cut_grid import CutGrid
from ratslam_ros.messages.json_schema import MalformedMessage, decode, encode
from ratslam_ros.messages.map_commands import (
    LOAD,
    SAVE,
    MapCommand,
    MapRequest,
    MapResult,
    map_path,
)
from ratslam_ros.ros.experience_map_node import ExperienceMapNode
from ratslam_ros.ros.local_view_node import LocalViewNode
from ratslam_ros.ros.mapping.map_operations import MapCoordinator
from ratslam_ros.ros.pose_cells_node import PoseCellsNode
from ratslam_ros.ros.qos import GOAL, LATCHED
from ratslam_ros.version import __version__

PERIOD_NS = 200_000_000
SMALL = (
    '-p', 'template_x_size:=16', '-p', 'template_y_size:=8', '-p', 'vt_shift_match:=2',
    '-p', 'pc_cell_x_size:=0.5', '-p', 'flush_after_s:=0.3', '-p', 'map_period_s:=0.0',
)


class Nodes:
    """The three mapping nodes and a robot in front of them."""

    def __init__(self, world: MakeWorld, *arguments: str, local_view: type | None = None) -> None:
        self.world = world(
            local_view or LocalViewNode, PoseCellsNode, ExperienceMapNode,
            arguments=(*SMALL, *arguments),
        )
        for node in self.world.nodes:
            node.host.map.open()
        self.maps = self.world.listen(String, 'experience_map/map', LATCHED)
        self.statuses = self.world.listen(String, 'ratslam/map_status', LATCHED)
        self.count = 0

    def send(self) -> None:
        """Send odometry and a new view."""
        stamp_ns = START_NS + self.count * PERIOD_NS
        self.world.send('odom', odometry(stamp_ns, 1.0))
        self.world.send('image', image(stamp_ns, self.count))
        self.count += 1

    def drive(self, images: int) -> None:
        """Drive past new views."""
        for _ in range(images):
            self.send()
            self.world.spin(0.02)

    def experiences(self) -> int:
        return len(json.loads(self.maps[-1].data)['experiences']) if self.maps else 0

    def until_mapped(self) -> int:
        """Wait until the map includes the last image; return its number of experiences."""
        last_ns = START_NS + (self.count - 1) * PERIOD_NS

        def is_mapped() -> bool:
            stamp = json.loads(self.maps[-1].data)['stamp'] if self.maps else {'sec': 0}
            return bool(stamp['sec'] * 10**9 + stamp.get('nanosec', 0) == last_ns)

        self.world.until(is_mapped)
        return self.experiences()

    def ask(self, operation: str, name: str) -> dict[str, Any]:
        """Request an operation; return its result."""
        count = len(self.statuses)
        text = encode(MapRequest(operation, name))
        self.world.send('ratslam/map_request', string(text), GOAL)

        def is_done() -> bool:
            new = [json.loads(message.data) for message in self.statuses[count:]]
            return bool(new) and new[-1]['state'] != 'running'

        self.world.until(is_done)
        result: dict[str, Any] = json.loads(self.statuses[-1].data)
        return result


def check_configuration(saved: SavedMap) -> None:
    """Check that the sections of all nodes are those with which they run."""
    config, notices = stored_config(saved.meta.configuration, 'the map')
    assert (config.local_view.template_x_size, config.pose_cells.pc_cell_x_size) == (16, 0.5)
    assert (config.experience_map.map_period_s, notices) == (0.0, [])
    assert saved.meta.ratslam_version == __version__ != ''


def test_map_of_all_nodes_is_saved_and_loaded_as_one(world: MakeWorld, tmp_path: Path) -> None:
    nodes = Nodes(world, '-p', f'memory_folder:={tmp_path}')
    nodes.drive(12)
    count = nodes.until_mapped()
    assert count > 3
    saved = nodes.ask('save', 'first floor')
    assert saved['state'] == 'done', saved
    assert saved['done'] == ['experience_map', 'local_view', 'pose_cells']
    [file] = tmp_path.iterdir()
    assert file.name == 'first floor.ratslam'
    map_file = read_map(file)
    assert map_file.states.keys() == {'experience_map', 'local_view', 'pose_cells'}
    check_configuration(map_file)
    before = nodes.maps[-1].data
    nodes.drive(12)
    assert nodes.until_mapped() > count
    loaded = nodes.ask('load', 'first floor')
    assert loaded['state'] == 'done', loaded
    nodes.world.until(lambda: nodes.maps[-1].data == before)


def save_damaged(path: Path, damaged: Path) -> None:
    """Save a map again, without what the pose cells need."""
    states = dict(read_map(path).states)
    del states['pose_cells']['core']
    save_map(damaged, states, MapMeta())


def test_map_that_one_node_cannot_load_changes_none(world: MakeWorld, tmp_path: Path) -> None:
    nodes = Nodes(world, '-p', f'memory_folder:={tmp_path}')
    nodes.drive(6)
    nodes.until_mapped()
    assert nodes.ask('save', 'good')['state'] == 'done'
    save_damaged(tmp_path / 'good.ratslam', tmp_path / 'bad.ratslam')
    nodes.drive(6)
    nodes.until_mapped()
    assert nodes.ask('load', 'good')['state'] == 'done'  # one that was loaded is kept, too
    cells = nodes.world.nodes[1]._core
    before = len(cells)
    nodes.drive(6)
    count = nodes.until_mapped()
    assert len(cells) > before
    before = len(cells)
    answer = nodes.ask('load', 'bad')
    assert answer['state'] == 'failed'
    assert 'pose_cells' in answer['message']
    assert 'keep the map' in answer['message']
    nodes.world.spin(0.3)
    assert nodes.experiences() == count
    assert len(nodes.world.nodes[1]._core) == before
    nodes.drive(6)
    assert nodes.until_mapped() > count


def test_map_of_paused_nodes_is_saved_while_messages_arrive(
    world: MakeWorld, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr('ratslam_ros.ros.mapping.map_operations.TIMEOUT_S', 8.0)
    nodes = Nodes(world, '-p', f'memory_folder:={tmp_path}')
    nodes.drive(6)
    nodes.until_mapped()
    for node in nodes.world.nodes:
        assert nodes.world.call(SetBool, f'{node.SECTION}/pause', data=True).success
    nodes.world.tester.create_timer(0.05, nodes.send)
    assert nodes.ask('save', 'paused')['state'] == 'done'


def test_missing_map_is_refused_at_once(world: MakeWorld, tmp_path: Path) -> None:
    nodes = Nodes(world, '-p', f'memory_folder:={tmp_path}')
    answer = nodes.world.call(Trigger, 'ratslam/load_map')
    assert not answer.success
    assert 'does not exist' in answer.message


class Coordinated:
    """A coordinator of which one node takes part, and what it has published."""

    def __init__(self, folder: Path, on_report: Callable[[Coordinated], None]) -> None:
        self.sent: list[Any] = []
        publisher = SimpleNamespace(publish=self.sent.append)
        node = SimpleNamespace(
            create_payload_publisher=lambda *_: publisher,
            create_payload_subscription=lambda *_: None, offer=lambda *_: None,
            resolve_topic_name=str,
            get_publishers_info_by_topic=lambda _: [SimpleNamespace(node_name='a')],
            report=lambda *_: on_report(self),
        )
        (folder / 'floor.ratslam').touch()
        host = SimpleNamespace(map=SimpleNamespace(grid=CutGrid()))
        self.coordinator = MapCoordinator(SimpleNamespace(  # type: ignore[arg-type]
            node=node, host=host, path_of=lambda name: folder / f'{name}.ratslam'
        ))

    def load(self) -> MapResult:
        """Begin to load; return the result of the node."""
        self.coordinator._begin(MapRequest(LOAD, 'floor'))
        number = next(one.number for one in self.sent if isinstance(one, MapCommand))
        return MapResult(number, 'a', True, 'done')

    def meanwhile(self, function: Callable[..., object], *values: object) -> None:
        """Call a function in another thread, and wait for a while."""
        thread = threading.Thread(target=function, args=values)
        thread.start()
        thread.join(0.2)


def test_late_result_does_not_follow_the_end(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr('ratslam_ros.ros.mapping.map_operations.TIMEOUT_S', 0.1)
    results: list[MapResult] = []
    made = Coordinated(
        tmp_path, lambda own: own.meanwhile(own.coordinator._on_result, *results)
    )
    results.append(made.load())
    made.coordinator._finishing.join()  # type: ignore[union-attr]
    time.sleep(0.1)
    assert made.sent[-1].state == 'failed'


@pytest.mark.filterwarnings('ignore::pytest.PytestUnhandledThreadExceptionWarning')
def test_fault_of_the_program_ends_the_operation(tmp_path: Path) -> None:
    made = Coordinated(tmp_path, lambda _: None)
    made.coordinator._write = lambda *_: 1 / 0  # type: ignore[method-assign, assignment]
    made.coordinator._begin(MapRequest(SAVE, 'floor'))
    made.coordinator.close()
    assert made.sent[-1].state == 'failed'
    assert made.coordinator._begin(MapRequest(LOAD, 'floor'))  # it is not refused as busy
    made.coordinator.close()


def test_operation_may_follow_the_end_of_another_at_once(tmp_path: Path) -> None:
    texts: list[object] = []

    def request(own: Coordinated) -> None:
        if not texts:
            own.meanwhile(
                lambda: texts.append(own.coordinator._begin(MapRequest(LOAD, 'floor')))
            )

    made = Coordinated(tmp_path, request)
    made.coordinator._on_result(made.load())
    until_s = time.monotonic() + 10.0
    while not texts and time.monotonic() < until_s:
        time.sleep(0.01)
    assert texts  # it was not refused as busy
    made.coordinator.close()


def test_localising_nodes_never_change_the_map(world: MakeWorld, tmp_path: Path) -> None:
    file = tmp_path / 'office.ratslam'
    nodes = Nodes(world, '-p', f'map:={file}')
    nodes.drive(12)
    count = nodes.until_mapped()
    nodes.world.close()
    assert [path.name for path in tmp_path.iterdir()] == ['office.ratslam']
    check_configuration(read_map(file))
    digest = hashlib.sha256(file.read_bytes()).hexdigest()
    rclpy.try_shutdown()
    nodes.world.close = lambda: None
    again = Nodes(world, '-p', f'map:={file}', '-p', 'localize:=true')
    again.drive(20)
    again.world.spin(0.5)
    assert again.experiences() == count
    assert hashlib.sha256(file.read_bytes()).hexdigest() == digest
    assert [path.name for path in tmp_path.iterdir()] == ['office.ratslam']


def test_closed_node_has_written_its_part(
    world: MakeWorld, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    nodes = Nodes(world, '-p', f'memory_folder:={tmp_path}')
    nodes.drive(3)
    begun, written = [], []

    def write(path: Path, *_: Any) -> None:
        begun.append(path.stem)
        time.sleep(0.5)
        written.append(path.stem)

    monkeypatch.setattr('ratslam_ros.ros.mapping.map_operations.save_map', write)
    nodes.world.send(MapCommand.TOPIC, string(encode(MapCommand(1, SAVE, 'office', 0))), GOAL)
    nodes.world.until(lambda: len(begun) == 3)
    for node in nodes.world.nodes:
        node.close()
    assert sorted(written) == ['experience_map', 'local_view', 'pose_cells']


def test_file_that_is_no_map_is_refused_unchanged(world: MakeWorld, tmp_path: Path) -> None:
    file = tmp_path / 'notes.txt'
    file.write_text('no map')
    made = world(PoseCellsNode, arguments=('-p', f'map:={file}'))
    with pytest.raises(UnusableInput, match=r'notes\.txt'):
        made.nodes[0].host.map.open()
    assert file.read_text() == 'no map'


@pytest.mark.parametrize('name', [
    '', '../map', '/etc/passwd', 'a/b', '..', '.hidden', 'a\x00b', 'x' * 200, 'a..b', 'a\\b',
])
def test_name_from_the_network_stays_in_the_map_folder(name: str) -> None:
    with pytest.raises(MalformedMessage, match='cannot be used'):
        map_path('/maps', name)
    with pytest.raises(MalformedMessage):
        decode(MapRequest, json.dumps({'schema_version': 1, 'operation': 'save', 'name': name}))


def test_map_name_gets_the_suffix_once() -> None:
    assert map_path('/maps', 'first floor') == Path('/maps/first floor.ratslam')
    assert map_path('/maps', 'a.ratslam') == Path('/maps/a.ratslam')


def test_commands_and_results_are_decoded_as_encoded() -> None:
    command = MapCommand(5, SAVE, 'a', 7)
    assert decode(MapCommand, encode(command)) == command
    result = MapResult(5, 'local_view', False, 'no space')
    assert decode(MapResult, encode(result)) == result
    request = MapRequest(LOAD, 'a')
    assert decode(MapRequest, encode(request)) == request
    for payload in ({'operation': 'erase'}, {'operation': 3}, {'operation': 'save', 'name': 3}):
        with pytest.raises(MalformedMessage):
            decode(MapRequest, json.dumps({'schema_version': 1, **payload}))


def test_malformed_commands_are_logged_at_growing_intervals(
    world: MakeWorld, tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    nodes = world(ExperienceMapNode, arguments=('-p', f'map:={tmp_path / "a.ratslam"}'))
    [node] = nodes.nodes
    node.host.map.open()
    capfd.readouterr()
    kinds = MapCommand, MapRequest, MapResult
    refused = node.diagnostics.counts
    for number in range(100):
        for kind in kinds:
            nodes.send(kind.TOPIC, string(f'{{"{number}": 1}}'), GOAL)
        nodes.until(lambda n=number: refused['refused'] == len(kinds) * (n + 1))
    assert len(capfd.readouterr().err.splitlines()) == len(kinds)
