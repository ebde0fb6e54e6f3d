# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The node of the live view: messages become records, and requests reach the nodes."""

from __future__ import annotations

import socket
import threading
from collections.abc import Callable
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from geometry_msgs.msg import PoseWithCovarianceStamped
from helpers import PERIOD_NS, START_NS
from ros_messages import MakeWorld, odometry, stamped_pose, string, template
from sensor_msgs.msg import PointCloud2
from std_srvs.srv import SetBool, Trigger

from ratslam_ros.core.common.pose import Pose
from ratslam_ros.core.mapping.loop_closure_gate import ClosureEvent
from ratslam_ros.core.mapping.map_changes import ExperienceRows, MapChange
from ratslam_ros.core.pose_cells.map_action import MapAction
from ratslam_ros.core.pose_cells.torus import Place
from ratslam_ros.errors import UnusableInput
from ratslam_ros.messages.commands import CommandPayload
from ratslam_ros.messages.json_schema import Stamp, decode, encode
from ratslam_ros.messages.map_changes import ClosurePayload, MapChangePayload
from ratslam_ros.messages.mapping import ActionPayload
from ratslam_ros.messages.pose_cells import PacketsPayload
from ratslam_ros.ros.convert import header_of, image_message
from ratslam_ros.ros.experience_map_node import ExperienceMapNode
from ratslam_ros.ros.mapping.match_pictures import joined, separated
from ratslam_ros.ros.pose_cells_node import PoseCellsNode
from ratslam_ros.ros.qos import LATCHED, STATE, VIEW
from ratslam_ros.ros.viewing import viewer_node
from ratslam_ros.ros.viewing.viewer_node import ViewerNode

POSE = 'experience_map/pose_with_covariance'
USES_PARAMETER_SERVICES = True


class Page:
    """A page without a server: it has as many browsers as a test wants."""

    url = 'http://127.0.0.1:1/token/'
    client_count = 0
    error: BaseException | None = None

    def __init__(self, *_: Any) -> None:
        self.closed, self.server = False, self

    def close(self) -> None:
        self.closed = True

    stop = close


@pytest.fixture
def viewer(world: MakeWorld, monkeypatch: pytest.MonkeyPatch) -> Callable[..., Any]:
    """Return a function that makes a world with a viewer that one browser watches."""
    monkeypatch.setattr('ratslam_ros.viewer.app.Page', Page)
    monkeypatch.setattr('ratslam_ros.viewer.server.ViewServer', Page)
    monkeypatch.setattr(viewer_node, 'open_browser', lambda url: False)
    monkeypatch.setattr(viewer_node, 'CHECK_PERIOD_S', 0.05)
    monkeypatch.setattr('ratslam_ros.ros.viewing.viewer_controls.DISCOVERY_S', 0.3)
    monkeypatch.setattr('ratslam_ros.ros.mapping.followed_map.REQUEST_PERIOD_S', 0.3)
    monkeypatch.setattr('ratslam_ros.viewer.live_run.SILENCE_S', 0.1)

    def make(*others: Any, watched: bool = True, arguments: tuple[str, ...] = ()) -> Any:
        made = world(viewer_node.ViewerNode, *others, arguments=arguments)
        made.viewer = made.nodes[0]
        if watched:
            made.viewer._page.client_count = 1
            made.until(lambda: made.viewer.topics is not None)
        return made

    return make


def pose(k: int, x_m: float = 0.0) -> Any:
    return stamped_pose(x_m, 2.0, heading_rad=0.5, stamp_ns=START_NS + k * PERIOD_NS)


def located(k: int, x_m: float = 0.0, variances: tuple[float, ...] = (0.0, 0.0, 0.0)) -> Any:
    message = PoseWithCovarianceStamped(header=pose(k).header)
    message.pose.pose = pose(k, x_m).pose
    message.pose.covariance[[0, 1, 7]] = variances
    return message


def moved(k: int, x_m: float, speed: float = 0.0) -> Any:
    return odometry(START_NS + k * PERIOD_NS, speed, pose=Pose(x_m, 2.0, 0.5))


def action(k: int, kind: str = 'create', source_id: int = -1, target_id: int = 0) -> Any:
    made = MapAction(kind, source_id, target_id, 7, 0.25, Place(1.0, 2.0, 3.0))  # type: ignore[arg-type]
    return string(encode(ActionPayload.of(START_NS + k * PERIOD_NS, k, made, START_NS)))


def change(sequence: int, ids: list[int], count: int, restart: bool = False) -> Any:
    n = len(ids)
    rows = ExperienceRows(
        np.array(ids), np.array(ids), np.full((n, 3), 0.5), np.zeros(n, np.int64)
    )
    made = MapChange(START_NS, count, 0, restart, rows)
    return string(encode(MapChangePayload.of(made, sequence, 1, 'map')))


def state_of(made: Any) -> Any:
    """Return the state at the end of the run."""
    run = made.viewer.run
    return run.seek(run.end_ns)


def requested(made: Any, call: Callable[[], Any]) -> Any:
    """Return the answer to a request, which blocks while the nodes are spun."""
    answers: list[Any] = []
    thread = threading.Thread(target=lambda: answers.append(call()))
    thread.start()
    made.until(lambda: not thread.is_alive())
    thread.join()
    return answers[0]


def test_commands_of_a_node_are_in_the_history(viewer: Any) -> None:
    """A reset, and the paused pose cells; a viewer that comes later gets them too."""
    made = viewer(PoseCellsNode, watched=False)
    assert made.call(Trigger, 'pose_cells/reset').success
    made.viewer._page.client_count = 1
    made.until(lambda: made.viewer.topics is not None)
    made.send(POSE, located(0))
    assert made.call(SetBool, 'pose_cells/pause', data=True).success
    made.until(lambda: len(state_of(made).commands) == 2)
    payloads = [decode(CommandPayload, one.payload) for one in state_of(made).commands]
    assert [(one.stamp.ns, one.command) for one in payloads] == [
        (0, {'Reset': ['pose_cells']}), (0, {'SetPaused': [True, 'pose_cells']}),
    ]
    assert state_of(made).commands[0].stamp_ns == START_NS


def test_port_in_use_leaves_the_history_of_an_earlier_run(
    world: MakeWorld, tmp_path: Path
) -> None:
    pytest.importorskip('viser')
    earlier = tmp_path / 'history.sqlite'
    earlier.write_text('an earlier run')
    with socket.create_server(('127.0.0.1', 0)) as other:
        port = other.getsockname()[1]
        with pytest.raises(UnusableInput, match=f'port {port}'):
            world(ViewerNode, arguments=(
                '-p', f'viewer:port:={port}', '-p', f'viewer:history_file:={earlier}',
            ))
    assert [*tmp_path.iterdir()] == [earlier]
    assert earlier.read_text() == 'an earlier run'


def test_unwatched_viewer_receives_no_topic(viewer: Any) -> None:
    made = viewer(watched=False)
    made.spin(0.2)
    topics = {one.topic_name for one in made.viewer.subscriptions}
    assert not [topic for topic in topics if 'experience_map' in topic or 'image' in topic]


def test_subscriptions_end_after_the_grace_time(
    viewer: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    made = viewer()
    made.viewer._page.client_count = 0
    made.spin(0.2)
    assert made.viewer.topics is not None  # the page may be being reloaded
    monkeypatch.setattr(viewer_node, 'GRACE_S', 0.0)
    made.until(lambda: made.viewer.topics is None)
    made.until(lambda: made.tester.count_subscribers('/experience_map/changes') == 0)


def test_poses_carry_aligned_odometry_and_truth(viewer: Any) -> None:
    made = viewer()
    made.send('odom', moved(0, 3.0))
    made.send('ground_truth/pose', pose(0, 4.0), STATE)
    made.until(lambda: made.viewer.topics._truth is not None)
    made.until(lambda: made.viewer.topics._dead_reckoning is not None)
    made.send(POSE, located(0, 5.0, (0.25, -0.125, 0.5)), STATE)
    made.until(lambda: state_of(made).pose is not None)
    record = state_of(made).pose
    assert record.stamp_ns == START_NS
    assert record.pose[:2] == (5.0, 2.0)
    assert record.covariance == (0.25, -0.125, 0.5)
    assert np.allclose(record.dead_reckoning, record.pose)
    assert np.allclose(record.truth, record.pose)
    made.spin(0.2)  # poses are sampled
    made.send('odom', moved(9, 3.5))
    made.send('ground_truth/pose', pose(9, 4.75), STATE)
    made.until(lambda: made.viewer.topics._truth[0] == 4.75)
    made.until(lambda: made.viewer.topics._dead_reckoning[0] == 3.5)
    made.send(POSE, located(9, 5.25, (2e6, 0.0, 2e6)), STATE)  # lost
    made.until(lambda: state_of(made).pose.stamp_ns > START_NS)
    record = state_of(made).pose
    assert record.covariance is None
    assert np.allclose(record.dead_reckoning[:2], (5.5, 2.0))
    assert np.allclose(record.truth[:2], (5.75, 2.0))


def test_view_joins_template_action_and_rejection(viewer: Any) -> None:
    made = viewer()
    made.viewer.controls.values['local_view.vt_match_threshold'] = 0.125
    made.send('local_view/template', template(START_NS, 7, error=0.0625))
    made.until(lambda: made.viewer.topics._templates)
    made.send('pose_cells/action', action(0, 'link', 3, 4))
    event = ClosureEvent('rejected', 3, 4, 'too far')
    made.send('experience_map/closures', string(encode(ClosurePayload.of(START_NS, 0, event))))
    made.until(lambda: state_of(made).view is not None and state_of(made).view.reason)
    view = state_of(made).view
    assert (view.template_id, view.error, view.threshold) == (7, 0.0625, 0.125)
    assert (view.action, view.source_id, view.target_id) == ('link', 3, 4)
    assert view.reason == 'too far'


def test_gap_in_the_changes_requests_the_whole_map(viewer: Any) -> None:
    made = viewer()
    asked: list[int] = []

    def send_all(request: Any, response: Any) -> Any:
        asked.append(1)
        made.send('experience_map/changes', change(9, [0, 1, 2, 3], 4, restart=True))
        return response

    made.tester.create_service(Trigger, 'experience_map/send_all', send_all)
    made.send('experience_map/changes', change(0, [0, 1], 2, restart=True))
    made.send('experience_map/changes', change(1, [2], 3))
    made.until(lambda: len(state_of(made).map) == 3)
    assert not asked
    made.send('experience_map/changes', change(3, [3], 4))
    made.until(lambda: len(state_of(made).map) == 4)
    assert asked
    assert np.array_equal(state_of(made).map.template_ids, [0, 1, 2, 3])


def test_images_are_reduced_and_sampled(viewer: Any) -> None:
    made = viewer()
    for k in range(5):
        picture = np.full((480, 640), 50 * k, np.uint8)
        made.send('image', image_message(START_NS + k * PERIOD_NS, 'camera', picture))
    made.until(lambda: state_of(made).image is not None)
    made.spin(0.1)
    images = [r for r in made.viewer.run._tail if type(r).__name__ == 'ImageRecord']
    assert len(images) < 5
    assert cv2.imdecode(np.frombuffer(images[0].jpeg, np.uint8), 0).shape == (240, 320)


def test_match_pictures_are_separated(viewer: Any) -> None:
    rng = np.random.default_rng(1)
    for width, height in ((60, 10), (32, 24), (250, 30), (7, 1)):
        pair = rng.integers(0, 255, (2, height, width), np.uint8)
        found = separated(joined(*pair))
        assert found is not None
        assert np.array_equal(found, pair)
    assert separated(np.zeros((10, 10), np.uint8)) is None
    made = viewer()
    made.send('local_view/matched', image_message(START_NS, 'camera', joined(*pair)), VIEW)
    values = {'template_x_size': 60, 'vt_shift_fov_deg': 90.0, 'vt_panoramic': False}
    for name, value in values.items():
        made.viewer.controls.values[f'local_view.{name}'] = value
    turn_rad = np.pi / 6
    made.send('local_view/template', template(START_NS, 7, relative_rad=turn_rad))
    made.until(lambda: state_of(made).match is not None)
    match = state_of(made).match
    assert match.template_id == 7
    assert match.shift_px == 20
    assert np.array_equal([match.view, match.template], pair)


def test_malformed_messages_are_reported_and_not_used(viewer: Any) -> None:
    made = viewer()
    topics = (
        'local_view/template', 'pose_cells/action', 'pose_cells/packets', 'experience_map/changes',
        'experience_map/closures', 'experience_map/status',
    )
    for topic in topics:
        qos = LATCHED if topic.endswith('status') else None
        made.send(topic, string('{"schema_version":1}'), qos)
        text = f'{topic.split("/")[-1]} was refused: '
        made.until(lambda text=text: any(text in one for one in made.viewer.run.notices))
    assert made.viewer.run.end_ns == 0


@pytest.mark.parametrize('points', [b'17 bytes, not 16.', np.full(4, np.nan, '<f4').tobytes()])
def test_cells_that_are_no_cells_are_reported_and_not_used(viewer: Any, points: bytes) -> None:
    made = viewer()
    made.send('pose_cells/cells', PointCloud2(header=header_of(START_NS, ''), data=points), VIEW)
    made.until(lambda: made.viewer.topics._cells is not None)
    packets = PacketsPayload(Stamp.of(START_NS), (21, 21, 36), [], [])
    made.send('pose_cells/packets', string(encode(packets)), VIEW)
    made.until(lambda: any('its cells have 17 bytes' in one or 'one of its cells' in one
                           for one in made.viewer.run.notices))
    assert made.viewer.run.end_ns == 0


def test_silent_topics_are_named(viewer: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(viewer_node, 'SILENCE_S', 0.3)
    made = viewer()
    made.until(lambda: made.viewer.run.notices)
    [notice] = made.viewer.run.notices
    topics = f'/{POSE}, /local_view/template, /pose_cells/action'
    assert notice == f'no node publishes {topics}: are the nodes running?'
    made.send(POSE, located(0), STATE)
    made.until(lambda: f'no messages on /{POSE}: ' in made.viewer.run.notices[0])


# Requests


def test_missing_nodes_are_named_in_the_answers(viewer: Any) -> None:
    made = viewer()
    controls = made.viewer.controls
    no_map = 'experience_map does not answer: is it running?'
    for call in (
        lambda: controls.go_to(1.0, 2.0), lambda: controls.name_place('kitchen'),
        controls.actions['cancel_goals'],
    ):
        answer = requested(made, call)
        assert not answer.success
        assert answer.message == no_map
    answer = requested(made, lambda: controls.explore(True))
    assert answer.message == 'goal_follower does not answer: is it running?'
    answer = requested(made, controls.actions['save'])
    assert answer.message == no_map


def with_map(viewer: Any, *arguments: str) -> Any:
    """Return a world with a map of 3 experiences, 1 m apart."""
    made = viewer(ExperienceMapNode, arguments=('-p', 'flush_after_s:=0.2', *arguments))
    for k in range(4):
        made.send('odom', moved(10 * k, float(k), 1.0))
        if k < 3:
            made.send('pose_cells/action', action(10 * k, 'create', k - 1, k))
    made.until(lambda: len(state_of(made).map) == 3)
    return made


def test_goal_is_sent_and_its_status_answers(viewer: Any) -> None:
    made = with_map(viewer)
    controls = made.viewer.controls
    answer = requested(made, lambda: controls.go_to(0.0, 0.0))
    assert answer.success, answer
    made.until(lambda: state_of(made).route is not None and len(state_of(made).route.points_m))
    answer = requested(made, lambda: controls.go_to(500.0, 0.0))
    assert not answer.success
    assert '500.00 m away' in answer.message
    again = requested(made, lambda: controls.go_to(500.0, 0.0))
    assert again == answer
    answer = requested(made, lambda: controls.go_to_place('nowhere'))
    assert not answer.success
    assert 'nowhere' in answer.message


def test_places_are_named_listed_and_driven_to(viewer: Any) -> None:
    made = with_map(viewer)
    controls = made.viewer.controls
    answer = requested(made, lambda: controls.name_place('kitchen'))
    assert answer.success, answer
    assert controls.places == ('kitchen',)
    assert requested(made, lambda: controls.go_to_place('kitchen')).success
    answer = requested(made, controls.actions['cancel_goals'])
    assert answer.success
    assert 'cancelled' in answer.message


def test_services_answer_for_all_nodes(viewer: Any, tmp_path: Any) -> None:
    made = with_map(viewer, '-p', f'memory_folder:={tmp_path}')
    controls = made.viewer.controls
    answer = requested(made, lambda: controls.actions['pause_nodes'](True))
    assert answer.message == 'experience_map is paused'
    made.nodes[1]._publish_diagnostics()
    made.until(lambda: controls.switches == {'explore': False, 'pause_nodes': True})
    assert requested(made, lambda: controls.actions['pause_nodes'](False)).success
    assert 'localises only' in requested(made, lambda: controls.actions['mapping'](False)).message
    made.nodes[1]._publish_diagnostics()
    made.until(
        lambda: controls.switches == {'explore': False, 'pause_nodes': False, 'mapping': False}
    )
    answer = requested(made, controls.actions['relocate'])
    assert not answer.success
    assert 'exp_relocate' in answer.message
    assert not list(tmp_path.iterdir())
    assert requested(made, controls.actions['save']).success
    assert list(tmp_path.iterdir())
    assert requested(made, controls.actions['reset']).success
    assert len(made.nodes[1]._core) == 0
    assert requested(made, controls.actions['load']).success
    assert len(made.nodes[1]._core) == 3
    for path in tmp_path.iterdir():
        path.unlink()
    answer = requested(made, controls.actions['load'])
    assert not answer.success
    assert str(tmp_path) in answer.message


def test_parameters_are_read_and_set(viewer: Any) -> None:
    made = with_map(viewer, '-p', 'map_period_s:=2.5')
    controls = made.viewer.controls
    made.until(lambda: controls.parameters['experience_map.map_period_s'] == 2.5)
    key = 'experience_map.map_period_s'
    assert requested(made, lambda: controls.set_parameter(key, 3)).success
    assert made.nodes[1].config.experience_map.map_period_s == 3.0
    assert controls.parameters['experience_map.map_period_s'] == 3.0
    key = 'goal_recall.goal_tolerance_m'
    assert requested(made, lambda: controls.set_parameter(key, 0.75)).success
    assert made.nodes[1].config.goal_recall.goal_tolerance_m == 0.75
    answer = requested(made, lambda: controls.set_parameter(key, -5.0))
    assert not answer.success
    assert 'goal_tolerance_m' in answer.message
    answer = requested(made, lambda: controls.set_parameter('experience_map.exp_loops', 7))
    assert answer.message == 'experience_map.exp_loops cannot be changed while the nodes run'


def test_diagnostics_of_the_nodes_are_shown(viewer: Any) -> None:
    made = with_map(viewer)
    controls = made.viewer.controls
    made.until(lambda: 'experience_map' in controls.diagnostics)
    level, message = controls.diagnostics['experience_map']
    assert level in ('OK', 'WARN')
    assert message
