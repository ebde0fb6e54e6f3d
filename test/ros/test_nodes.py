# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Each node alone: its inputs, its outputs and its handling of invalid messages."""

from __future__ import annotations

import json
import math
import time
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from geometry_msgs.msg import PoseStamped
from helpers import PERIOD_NS, START_NS, Hue, S, extended, picture, template_text
from nav_msgs.msg import Odometry
from nav_msgs.msg import Path as PathMessage
from nav_msgs.srv import GetPlan
from rclpy.parameter import Parameter
from rclpy.qos import qos_profile_sensor_data
from ros_messages import MakeWorld, action_text, image, odometry, stamped_pose, string, template
from sensor_msgs.msg import CameraInfo, CompressedImage, Image
from states import differences
from std_msgs.msg import String
from std_srvs.srv import SetBool, Trigger
from tf2_msgs.msg import TFMessage

from ratslam_ros.core.common.pose import Pose
from ratslam_ros.core.config import Config
from ratslam_ros.core.vision.visual_odometry import VisualOdometry
from ratslam_ros.errors import UnusableInput, UnusableParameter
from ratslam_ros.files.config import UNNAMED, load_config
from ratslam_ros.maps import read_map, save_map
from ratslam_ros.messages.json_schema import decode
from ratslam_ros.messages.mapping import ActionPayload, TemplatePayload
from ratslam_ros.ros import visual_odometry_node
from ratslam_ros.ros.convert import header_of, odometry_of
from ratslam_ros.ros.experience_map_node import ExperienceMapNode
from ratslam_ros.ros.local_view_node import LocalViewNode
from ratslam_ros.ros.parameters import initial_config
from ratslam_ros.ros.pose_cells_node import PoseCellsNode
from ratslam_ros.ros.qos import LATCHED, PLAYED
from ratslam_ros.ros.visual_odometry_node import VisualOdometryNode
from ratslam_ros.starting import announced
from ratslam_simulator.node import SimulatorNode

SMALL = (
    '-p', 'base:=extended',
    '-p', 'template_x_size:=16', '-p', 'template_y_size:=8', '-p', 'vt_shift_match:=2',
)


# Local view


def local_view(world: MakeWorld, *arguments: str) -> tuple[Any, list[Any]]:
    made = world(LocalViewNode, arguments=(*SMALL, *arguments))
    return made, made.listen(String, 'local_view/template')


def ids_of_colours(world: MakeWorld, parameter: str, *colours: tuple[int, ...]) -> list[int]:
    """Return the templates of images of one colour (BGR) each."""
    made, received = local_view(world, '-p', parameter, '-p', 'vt_min_structure:=0.0')
    for n, bgr in enumerate(colours):
        data = np.full((24, 32, 3), bgr, np.uint8).tobytes()
        made.send('image', image(START_NS + n * PERIOD_NS, encoding='bgr8', step=96, data=data))
    made.until(lambda: len(received) == len(colours))
    return [decode(TemplatePayload, message.data).id for message in received]


@pytest.mark.parametrize(('grey', 'ids'), [('luma', [0, 0]), ('mean', [0, 1])])
def test_image_grey_distinguishes_colours_of_equal_luma(
    world: MakeWorld, grey: str, ids: list[int]
) -> None:
    colours = (29, 29, 29), (255, 0, 0)
    assert ids_of_colours(world, f'image_grey:={grey}', *colours) == ids


@pytest.mark.parametrize(('wants_colour', 'ids'), [(True, [0, 1]), (False, [0, 0])])
def test_descriptor_that_wants_colour_gets_it(
    world: MakeWorld, monkeypatch: pytest.MonkeyPatch, wants_colour: bool, ids: list[int]
) -> None:
    monkeypatch.setattr(Hue, 'wants_colour', wants_colour)
    monkeypatch.setattr('ratslam_ros.descriptors._installed', lambda name: Hue())
    colours = (255, 80, 20), (20, 80, 255)
    assert ids_of_colours(world, 'vt_descriptor:=hue', *colours) == ids


def test_invalid_images_are_counted_and_change_nothing(world: MakeWorld) -> None:
    made, received = local_view(world)
    wrong = [
        image(START_NS + 1, width=0, height=0, step=0, data=b''),
        image(START_NS + 2, width=2**32 - 1, height=2**32 - 1, step=2**32 - 1),
        image(START_NS + 3, encoding='nonsense'),
        image(START_NS + 4, data=b'\x00' * 5),
        image(0, 5), image(START_NS + 3600 * S, 6), image(START_NS - S, 7), image(5, 8),
    ]
    made.send('image', image(START_NS, 0))
    for message in wrong:
        made.send('image', message)
    made.send('image', image(START_NS + PERIOD_NS, 1))
    made.until(lambda: len(received) >= 6)
    found = [decode(TemplatePayload, message.data) for message in received]
    assert [template.id for template in found] == [0, -1, -1, -1, -1, 1]
    state = made.reported('local_view', undecodable='4', refused='4')
    assert state['templates'] == '2'
    assert state['level'] == '1'


def test_compressed_images_are_used_for_the_whole_run(world: MakeWorld) -> None:
    made, received = local_view(world)
    data = cv2.imencode('.png', picture(0, 24, 32))[1].tobytes()
    for n in range(3):
        header = header_of(START_NS + n * PERIOD_NS, '')
        message = CompressedImage(header=header, format='png', data=data)
        made.send('image/compressed', message)
    made.until(lambda: len(received) == 3)
    # A raw camera that starts later is ignored: the stream keeps its topic.
    camera = made.tester.create_publisher(Image, 'image', PLAYED)
    made.until(lambda: made.nodes[0].count_publishers('image') > 0)
    made.diagnostics()  # the node looks for publishers then
    camera.publish(image(START_NS + 3 * PERIOD_NS, 9))
    made.send('image/compressed',
              CompressedImage(header=header_of(START_NS + 4 * PERIOD_NS, ''), format='png',
                              data=data))
    made.until(lambda: len(received) == 4)
    assert {decode(TemplatePayload, message.data).id for message in received} == {0}


def test_camera_remapped_with_both_topics_keeps_its_stream(world: MakeWorld) -> None:
    made, received = local_view(
        world, '-r', 'image:=/cam/image_raw',
        '-r', 'image/compressed:=/cam/image_raw/compressed',
    )
    data = cv2.imencode('.jpg', picture(0, 24, 32))[1].tobytes()
    packed = CompressedImage(header=header_of(START_NS, ''), format='jpeg', data=data)
    made.send('/cam/image_raw/compressed', packed)
    made.until(lambda: len(received) == 1)
    for n in range(1, 6):  # the stream keeps its topic
        packed.header = header_of(START_NS + n * PERIOD_NS, '')
        made.send('/cam/image_raw/compressed', packed)
        made.send('/cam/image_raw', image(START_NS + n * PERIOD_NS, n))
    made.until(lambda: len(received) == 6)
    made.spin(0.2)
    state = made.diagnostics()['local_view']
    assert 'refused' not in state or state['refused'] == '0'
    assert state['templates'] == '1'


def test_matched_template_is_published_to_subscribers(world: MakeWorld) -> None:
    made, received = local_view(world)
    shown = made.listen(Image, 'local_view/matched')
    made.until(lambda: made.nodes[0].count_subscribers('local_view/matched') > 0)
    made.spin(0.2)
    made.send('image', image(START_NS))
    made.until(lambda: shown and received)
    assert (shown[0].width, shown[0].height) == (240, 15 * (8 + 1 + 8))
    assert shown[0].encoding == 'mono8'
    pixels = np.frombuffer(shown[0].data, np.uint8).reshape(shown[0].height, 240)
    assert np.array_equal(pixels[: 15 * 8], pixels[15 * 9 :])  # the template just learned


def test_best_effort_camera_is_received_without_a_false_alarm(
    world: MakeWorld, capfd: pytest.CaptureFixture[str]
) -> None:
    made, received = local_view(world)
    camera = made.tester.create_publisher(Image, 'image', qos_profile_sensor_data)
    made.until(lambda: camera.get_subscription_count() > 0)
    camera.publish(image(START_NS))
    made.until(lambda: received)
    logged = ''.join(capfd.readouterr())
    assert '/image has a best-effort publisher: subscribing again as best effort' in logged
    assert 'No messages will be received' not in logged


def test_memory_learned_at_stamp_0_is_numbered_1(world: MakeWorld) -> None:
    made, received = local_view(world)
    for n in range(3):
        made.send('image', image(n * PERIOD_NS, n))
    made.until(lambda: len(received) == 3)
    found = [decode(TemplatePayload, message.data) for message in received]
    assert [(template.stamp.ns, template.memory) for template in found] == [
        (0, 1), (PERIOD_NS, 1), (2 * PERIOD_NS, 1),
    ]


def test_named_parameter_overrides_an_alias_of_several(world: MakeWorld) -> None:
    made, _ = pose_cells(world, '-p', 'pc_dim_x:=31', '-p', 'pc_dim_xy:=11')
    p = made.nodes[0].config.pose_cells
    assert (p.pc_dim_x, p.pc_dim_y) == (31, 11)


def test_last_images_after_a_gap_are_flushed(world: MakeWorld) -> None:
    made, received = local_view(world, '-p', 'flush_after_s:=0.1')
    for n in range(3):
        made.send('image', image(START_NS + n * PERIOD_NS, n))
    for n in range(2):
        made.send('image', image(START_NS + 5 * S + n * PERIOD_NS, n))
    made.until(lambda: len(received) == 5)
    assert made.diagnostics()['local_view']['gaps'] == '1'


# Pose cells


def pose_cells(world: MakeWorld, *arguments: str) -> tuple[Any, list[Any]]:
    made = world(PoseCellsNode, arguments=('-p', 'base:=extended', *arguments))
    return made, made.listen(String, 'pose_cells/action')


def test_template_gives_action_when_odometry_reaches_its_stamp(world: MakeWorld) -> None:
    made, received = pose_cells(world)
    made.send('odom', odometry(START_NS))
    made.send('local_view/template', template(START_NS + 5, 0))
    made.spin(0.2)
    assert received == []
    made.send('odom', odometry(START_NS + 10, 1.0))
    made.until(lambda: len(received) == 1)
    first = decode(ActionPayload, received[0].data)
    assert first.stamp.ns == START_NS + 5
    assert (first.sequence, first.action, first.memory) == (0, 'none', 0)
    made.send('local_view/template', template(START_NS + 15, 0))
    made.send('odom', odometry(START_NS + 20, 1.0))
    made.until(lambda: len(received) == 2)
    second = decode(ActionPayload, received[1].data)
    assert (second.sequence, second.action, second.target_id) == (1, 'create', 0)
    assert second.memory == START_NS + 15


def test_held_messages_are_flushed_when_inputs_are_silent(world: MakeWorld) -> None:
    made, received = pose_cells(world, '-p', 'flush_after_s:=0.1')
    made.send('odom', odometry(START_NS))
    made.send('local_view/template', template(START_NS + 5, 0))
    made.until(lambda: len(received) == 1)


def test_messages_that_arrived_during_a_stall_are_not_late(world: MakeWorld) -> None:
    """The machine stops the process for longer than flush_after_s."""
    made, received = pose_cells(world, '-p', 'flush_after_s:=0.5')
    made.send('odom', odometry(START_NS))
    made.send('local_view/template', template(START_NS + 50, 0))
    made.until(lambda: made.nodes[0].host.pipeline.order.newest_of('template') == START_NS + 50)
    for n in range(1, 11):
        made.send('odom', odometry(START_NS + 10 * n, 1.0))
    time.sleep(0.6)
    made.until(lambda: len(received) == 1)
    made.until(lambda: made.nodes[0].host.pipeline.order.newest_of('odometry') == START_NS + 100)
    assert made.nodes[0].diagnostics.counts['late'] == 0


def test_malformed_templates_are_refused_and_counted(world: MakeWorld) -> None:
    made, received = pose_cells(world)
    for payload in ('nonsense', template_text(START_NS + 7, -2), '[' * 5000):
        made.send('local_view/template', string(payload))
    made.send('odom', odometry(START_NS))
    made.send('local_view/template', template(START_NS + 5, 0))
    made.send('odom', odometry(START_NS + 10))
    made.until(lambda: len(received) == 1)
    assert made.diagnostics()['pose_cells']['refused'] == '3'


def test_invalid_odometry_is_refused_and_counted(world: MakeWorld) -> None:
    made, received = pose_cells(world)
    made.send('odom', odometry(START_NS))
    for n, (speed, turn_rate) in enumerate(
        [(math.nan, 0.0), (math.inf, 0.0), (0.0, -math.inf), (1e300, 0.0)], 1
    ):
        made.send('odom', odometry(START_NS + n, speed, turn_rate))
    made.send('odom', odometry(0, 1.0))
    made.send('odom', odometry(START_NS - 5 * S, 1.0))
    made.send('odom', odometry(START_NS + 3600 * S, 1.0))
    made.send('local_view/template', template(START_NS + 5, 0))
    made.send('odom', odometry(START_NS + 10))
    made.until(lambda: len(received) == 1)
    assert made.diagnostics()['pose_cells']['refused'] == '7'


def test_earlier_start_or_restart_of_local_view_is_detected(world: MakeWorld) -> None:
    made, received = pose_cells(world)
    made.send('odom', odometry(START_NS))
    made.send('local_view/template', template(START_NS + 5, 57))
    made.send('odom', odometry(START_NS + 10, 1.0))
    made.until(lambda: len(received) == 1)
    assert 'started late' in made.diagnostics()['pose_cells']['message']
    made.send('local_view/template',
              template(START_NS + 15, 0, memory=START_NS + 15))
    made.send('odom', odometry(START_NS + 20, 1.0))
    made.until(lambda: len(received) == 2)
    assert decode(ActionPayload, received[1].data).template_id == 58
    # The old numbers cannot be seen again, so that restarts do not accumulate associations.
    associated = made.nodes[0].host.live.state_of(made.nodes[0].SECTION)['core']['memories']
    assert [template_id for template_id, *_ in associated] == [58]
    assert 'empty memory' in made.diagnostics()['pose_cells']['message']


def test_local_view_loading_an_older_memory_is_detected(world: MakeWorld) -> None:
    made, received = pose_cells(world)
    for n, number in enumerate((0, 1, 2, 1)):
        stamp = START_NS + n * PERIOD_NS
        made.send('odom', odometry(stamp, 10.0))
        new = n == 0 or (n, number) in ((1, 1), (2, 2), (3, 1))
        made.send('local_view/template', template(stamp, number, is_new=new))
    made.send('odom', odometry(START_NS + S))
    made.until(lambda: len(received) == 4)
    numbers = [decode(ActionPayload, message.data).template_id for message in received]
    assert numbers == [0, 1, 2, 4]
    assert 'earlier memory' in made.diagnostics()['pose_cells']['message']


def test_activity_is_published_to_subscribers(world: MakeWorld) -> None:
    made, _ = pose_cells(world)
    shown = made.listen(Image, 'pose_cells/activity')
    for n in range(50):
        made.send('odom', odometry(START_NS + n * PERIOD_NS, 0.1))
        made.spin(0.02)
        if shown:
            break
    pixels = np.frombuffer(shown[0].data, np.uint8).reshape(shown[0].height, shown[0].width)
    assert pixels.shape == (21, 21)
    assert pixels.max() == 255


def test_active_experiences_are_published_to_subscribers(world: MakeWorld) -> None:
    made, actions = pose_cells(world)
    received = made.listen(String, 'pose_cells/active_experiences')
    for n in range(3):
        made.send('odom', odometry(START_NS + n * PERIOD_NS, 20.0))
        made.send('local_view/template', template(START_NS + n * PERIOD_NS, n))
        made.spin(0.05)
    made.send('odom', odometry(START_NS + S))
    made.until(lambda: len(actions) == 3 and received)
    fields = json.loads(received[-1].data)
    template_id = fields['template_id']
    stamp_ns = fields['stamp']['sec'] * S + fields['stamp']['nanosec']
    assert stamp_ns == START_NS + template_id * PERIOD_NS
    # The first view came before any motion.
    assert fields['experiences'] == [{'id': template_id - 1, 'activity': 2.0}]


# Experience map


def experience_map(world: MakeWorld, *arguments: str) -> tuple[Any, list[Any]]:
    made = world(ExperienceMapNode, arguments=('-p', 'map_period_s:=0.05', *arguments))
    return made, made.listen(String, 'experience_map/map', LATCHED)


def drive_straight(made: Any, experiences: int = 5, first: int = 0) -> None:
    """Send a drive of 1 m between experiences, along y of the map."""
    for n in range(first, first + experiences):
        at = Pose(float(n), 0.0, 0.0)
        made.send('odom', odometry(START_NS + n * S, 1.0 if n else 0.0, pose=at))
        text = action_text(START_NS + n * S, n, 'create', n - 1, n)
        made.send('pose_cells/action', string(text))
    made.send('odom', odometry(START_NS + (first + experiences) * S, pose=Pose(99.0, 0.0, 0.0)))


def last_map(made: Any, received: list[Any], experiences: int) -> dict[str, Any]:
    def complete() -> bool:
        return bool(received) and len(json.loads(received[-1].data)['experiences']) == experiences

    made.until(complete)
    return json.loads(received[-1].data)  # type: ignore[no-any-return]


def test_map_pose_and_transform_are_published(world: MakeWorld) -> None:
    made, received = experience_map(world)
    poses = made.listen(PoseStamped, 'experience_map/pose')
    transforms = made.listen(TFMessage, '/tf')
    drive_straight(made)
    graph = last_map(made, received, 5)
    assert [e['y_m'] for e in graph['experiences']] == pytest.approx([0, 1, 2, 3, 4])
    assert len(graph['links']) == 4
    made.until(lambda: len(poses) == 6 and len(transforms) == 6)
    assert [p.pose.position.y for p in poses] == pytest.approx([0, 1, 2, 3, 4, 4])
    assert {p.header.frame_id for p in poses} == {'map'}
    frames = transforms[2].transforms[0]
    assert (frames.header.frame_id, frames.child_frame_id) == ('map', 'odom')
    # The robot is 2 m along x of odom, and 2 m along y of the map: odom is turned by 90 degrees.
    assert frames.transform.translation.x == pytest.approx(0.0, abs=1e-9)
    assert frames.transform.rotation.z == pytest.approx(math.sqrt(0.5))


def test_held_odometry_changes_the_pose_only(world: MakeWorld) -> None:
    made, _ = experience_map(world)
    poses = made.listen(PoseStamped, 'experience_map/pose')
    for n in range(5):
        made.send('odom', odometry(START_NS + n * S // 10, 1.0))
    made.until(lambda: len(poses) == 5)
    assert poses[-1].pose.position.y == pytest.approx(0.4)
    assert made.nodes[0]._core.offset.x_m == 0.0


def test_recall_goal_answers_with_a_route(world: MakeWorld) -> None:
    made, received = experience_map(world)
    drive_straight(made)
    last_map(made, received, 5)
    name = 'experience_map/recall_goal'
    path = made.call(GetPlan, name, goal=stamped_pose(0.1, 1.0)).plan
    assert path.header.frame_id == 'map'
    assert [p.pose.position.y for p in path.poses] == pytest.approx([4, 3, 2, 1])
    last = START_NS + 5 * S
    stamps = [p.header.stamp.sec * S + p.header.stamp.nanosec for p in path.poses]
    assert stamps == [last, last + S, last + 2 * S, last + 3 * S]
    headings = [math.atan2(p.pose.orientation.z, p.pose.orientation.w) * 2 for p in path.poses]
    assert headings == pytest.approx([-math.pi / 2] * 4)
    start, end = stamped_pose(0.0, 0.1), stamped_pose(0.0, 2.0)
    other = made.call(GetPlan, name, start=start, goal=end).plan
    assert [p.pose.position.y for p in other.poses] == pytest.approx([0, 1, 2])
    # The robot is at (0, 4), heading along y: 2 m behind it is (0, 2).
    behind = made.call(GetPlan, name, goal=stamped_pose(-2.0, 0.0, 'base_link')).plan
    assert behind.poses[-1].pose.position.y == pytest.approx(2.0)


def test_recall_goal_without_route_is_empty_with_reason(world: MakeWorld) -> None:
    made, received = experience_map(world)
    drive_straight(made)
    last_map(made, received, 5)
    before = received[-1].data
    for place, tolerance, reason in (
        ((0.9, 1.0, 'map'), 0.5, 'away'), ((0.0, 1.0, 'mars'), 0.0, 'mars'),
        ((math.nan, 1.0, 'map'), 0.0, 'finite'), ((0.0, 1.0, 'map'), math.nan, 'tolerance'),
        ((0.0, 1.0, 'map'), -1.0, 'tolerance'), ((50.0, 1.0, 'map'), 0.0, 'away'),
    ):
        answer = made.call(
            GetPlan, 'experience_map/recall_goal', goal=stamped_pose(*place), tolerance=tolerance
        )
        assert list(answer.plan.poses) == []
        assert reason in made.diagnostics()['experience_map']['no_route_because']
        assert received[-1].data == before
    # Latched, without further odometry.
    statuses = made.listen(String, 'experience_map/status', LATCHED)
    made.until(lambda: statuses and reason in json.loads(statuses[-1].data)['reason'])


def test_goal_pose_gives_a_route_updated_with_the_robot(world: MakeWorld) -> None:
    made, received = experience_map(world)
    routes = made.listen(PathMessage, 'experience_map/route', LATCHED)
    drive_straight(made)
    last_map(made, received, 5)
    made.send('goal_pose', stamped_pose(0.0, 0.0))
    made.until(lambda: routes)
    assert len(routes[-1].poses) == 5
    text = action_text(START_NS + 6 * S, 5, 'link', 4, 2)
    made.send('odom', odometry(START_NS + 6 * S))
    made.send('pose_cells/action', string(text))
    made.send('odom', odometry(START_NS + 7 * S))
    made.until(lambda: len(routes[-1].poses) == 3)
    made.send('goal_pose', stamped_pose(500.0, 0.0))
    made.until(lambda: len(routes[-1].poses) == 0)


def test_lost_action_is_counted(world: MakeWorld) -> None:
    made, received = experience_map(world)
    drive_straight(made, 3)
    made.send('pose_cells/action', string(action_text(START_NS + 3 * S, 4, 'create', 3, 4)))
    made.send('odom', odometry(START_NS + 4 * S))
    last_map(made, received, 4)
    assert made.diagnostics()['experience_map']['missed'] == '1'


def test_late_join_maps_on_and_is_reported(world: MakeWorld) -> None:
    made, received = experience_map(world)
    for n in range(3):
        made.send('odom', odometry(START_NS + n * S, 1.0))
        text = action_text(START_NS + n * S, 40 + n, 'create', 20 + n, 21 + n)
        made.send('pose_cells/action', string(text))
    made.send('odom', odometry(START_NS + 3 * S))
    graph = last_map(made, received, 3)
    assert [e['id'] for e in graph['experiences']] == [0, 1, 2]
    assert 'started late: 40 actions' in made.diagnostics()['experience_map']['message']


def test_invalid_actions_are_refused_and_leave_the_map(world: MakeWorld) -> None:
    made, received = experience_map(world)
    drive_straight(made)
    last_map(made, received, 5)
    made.spin(0.2)
    before = received[-1].data
    stamp = START_NS + 5 * S
    good = action_text(stamp + 1, 5, 'create', 4, 5)
    wrong = [
        'nonsense', '{}', good.replace('create', 'jump'),
        good.replace('"target_id":5', '"target_id":-1'),
        action_text(0, 5, 'create', 4, 5), action_text(START_NS, 5, 'create', 4, 5),
        action_text(stamp + 3600 * S, 5, 'create', 4, 5),
    ]
    for text in wrong:
        made.send('pose_cells/action', string(text))
    made.reported('experience_map', refused='6')  # one is still held
    assert received[-1].data == before
    made.send('pose_cells/action', string(good))
    made.send('odom', odometry(stamp + 2))
    last_map(made, received, 6)
    assert made.diagnostics()['experience_map']['refused'] == '7'


def test_pause_ignores_inputs_and_reset_empties_the_map(world: MakeWorld) -> None:
    made, received = experience_map(world)
    drive_straight(made)
    last_map(made, received, 5)
    assert made.call(SetBool, 'experience_map/pause', data=True).success
    drive_straight(made, 2, first=7)
    made.spin(0.3)
    assert len(json.loads(received[-1].data)['experiences']) == 5
    assert made.call(SetBool, 'experience_map/pause', data=False).success
    assert made.call(Trigger, 'experience_map/reset').success
    made.until(lambda: json.loads(received[-1].data)['experiences'] == [])
    drive_straight(made, 3)
    experiences = last_map(made, received, 3)['experiences']
    assert [e['y_m'] for e in experiences] == pytest.approx([0, 1, 2])


def test_saved_map_is_loaded_and_damaged_file_refused(world: MakeWorld, tmp_path: Path) -> None:
    folder = ('-p', f'memory_folder:={tmp_path}')
    made, received = experience_map(world, *folder)
    answer = made.call(Trigger, 'experience_map/load')
    assert not answer.success
    assert 'does not exist' in answer.message
    drive_straight(made)
    last_map(made, received, 5)
    assert made.call(Trigger, 'experience_map/save').success
    before = received[-1].data
    assert made.call(Trigger, 'experience_map/reset').success
    assert made.call(Trigger, 'experience_map/load').success
    made.until(lambda: received[-1].data == before)
    [file] = tmp_path.iterdir()
    assert file.name == 'experience_map.ratslam'
    content = bytearray(file.read_bytes())
    content[len(content) // 2:] = bytes(len(content) - len(content) // 2)
    file.write_bytes(content)
    assert not made.call(Trigger, 'experience_map/load').success
    made.send('odom', odometry(START_NS + 11 * S // 2, 2.0))
    made.send('odom', odometry(START_NS + 6 * S, 2.0))
    made.send('pose_cells/action', string(action_text(START_NS + 6 * S, 5, 'create', 4, 5)))
    made.send('odom', odometry(START_NS + 13 * S // 2, 0.0))
    graph = last_map(made, received, 6)
    assert graph['experiences'][5]['y_m'] == pytest.approx(5.0)


def test_memory_file_without_a_key_is_refused_unchanged(world: MakeWorld, tmp_path: Path) -> None:
    made, received = experience_map(world, '-p', f'memory_folder:={tmp_path}')
    drive_straight(made)
    last_map(made, received, 5)
    assert made.call(Trigger, 'experience_map/save').success
    [path] = tmp_path.iterdir()
    saved = read_map(path)
    del saved.states['experience_map']['core']['poses']
    save_map(path, saved.states, saved.meta)
    before = received[-1].data
    node = made.nodes[0]
    learned = node.host.live.state_of(node.SECTION)
    answer = made.call(Trigger, 'experience_map/load')
    assert not answer.success
    assert answer.message == (
        f"{path} has no 'poses': it was written by an older version of ratslam_ros; map "
        'again and save'
    )
    assert list(differences(node.host.live.state_of(node.SECTION), learned)) == []
    made.spin(0.2)
    assert received[-1].data == before


# Visual odometry


def test_visual_odometry_publishes_estimates_of_core_and_tf(world: MakeWorld) -> None:
    made = world(VisualOdometryNode, arguments=('-p', 'publish_tf:=true'))
    received = made.listen(Odometry, 'odom')
    transforms = made.listen(TFMessage, '/tf')
    core = VisualOdometry(Config().visual_odometry)
    expected = []
    for n in range(5):
        stamp_ns = START_NS + n * PERIOD_NS
        made.send('image', image(stamp_ns, n))
        expected.append(core.estimate(stamp_ns, picture(n, 24, 32)))
    made.until(lambda: len(received) == len(transforms) == 4)
    assert [odometry_of(message) for message in received] == [
        odometry.as_received() for odometry in expected if odometry is not None
    ]
    frame = transforms[-1].transforms[0]
    assert (frame.header.frame_id, frame.child_frame_id) == ('odom', 'base_link')
    assert frame.header.stamp == received[-1].header.stamp
    variances = [message.pose.covariance[0] for message in received]
    assert variances == sorted(variances)
    assert all(variance > 0.0 for variance in variances)


def test_field_of_view_is_taken_from_camera_info(world: MakeWorld) -> None:
    made = world(VisualOdometryNode)
    received = made.listen(Odometry, 'odom')
    info = CameraInfo(width=32, height=24)
    info.k[0] = 16.0  # half the width: 90 degrees
    publisher = made.tester.create_publisher(CameraInfo, 'camera_info', 1)
    made.until(lambda: made.nodes[0].count_publishers('camera_info') > 0)
    made.until(lambda: publisher.get_subscription_count() > 0)
    for n in range(3):
        made.send('image', image(START_NS + n * PERIOD_NS, n))
    made.spin(0.3)
    assert received == []  # the images wait for camera_info
    publisher.publish(info)
    made.spin(0.2)
    made.send('image', image(START_NS + 3 * PERIOD_NS, 3))
    made.until(lambda: len(received) == 3)
    assert made.diagnostics()['visual_odometry']['field_of_view'] == '90.00 deg (camera_info)'


def test_images_of_the_past_wait_beside_the_executor(world: MakeWorld) -> None:
    """It could not receive camera_info while it waits."""
    made = world(VisualOdometryNode)
    received = made.listen(Odometry, 'odom')
    info = CameraInfo(width=32, height=24)
    info.k[0] = 16.0
    publisher = made.tester.create_publisher(CameraInfo, 'camera_info', 1)
    made.until(lambda: made.nodes[0].count_publishers('camera_info') > 0)
    made.until(lambda: publisher.get_subscription_count() > 0)
    begun_s = time.monotonic()
    with made.nodes[0]._lock:
        for n in range(3):
            made.nodes[0].host.map.recovery.inputs['image'].receive(
                image(START_NS + n * PERIOD_NS, n)
            )
    assert time.monotonic() - begun_s < visual_odometry_node.CAMERA_INFO_WAIT_S
    publisher.publish(info)
    made.send('image', image(START_NS + 3 * PERIOD_NS, 3))
    made.until(lambda: len(received) == 3)
    assert made.diagnostics()['visual_odometry']['field_of_view'] == '90.00 deg (camera_info)'


@pytest.mark.parametrize('calibrated', [False, None])
def test_wait_for_unusable_camera_info_is_limited(
    world: MakeWorld, calibrated: bool | None, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(visual_odometry_node, 'CAMERA_INFO_WAIT_S', 0.3)
    made = world(visual_odometry_node.VisualOdometryNode)
    received = made.listen(Odometry, 'odom')
    publisher = made.tester.create_publisher(CameraInfo, 'camera_info', 1)
    made.until(lambda: publisher.get_subscription_count() > 0)
    if calibrated is False:
        publisher.publish(CameraInfo(width=32, height=24))
        made.spin(0.2)
    made.send('image', image(START_NS, 0))
    made.spin(0.2 if calibrated is False else 0.4)
    for n in range(1, 4):
        made.send('image', image(START_NS + n * PERIOD_NS, n))
        made.until(lambda n=n: len(received) == n)


def test_views_without_structure_are_a_warning_until_one_has_some(world: MakeWorld) -> None:
    """As in the dark or behind a cover: nothing is mapped although images arrive."""
    made = world(LocalViewNode, arguments=(*SMALL, '-p', 'vt_min_structure:=0.001'))
    missing = made.nodes[0].diagnostics.missing
    flat = image(START_NS, 0)
    flat.data = bytes(len(flat.data))
    for n in range(8):
        flat.header = header_of(START_NS + n * S, 'camera')
        made.send('image', flat)
    made.until(lambda: 'too little structure' in missing.get('structure', ''))
    made.send('image', image(START_NS + 8 * S, 1))
    made.until(lambda: 'structure' not in missing)
    for n in (30, 31):  # after a pause
        flat.header = header_of(START_NS + n * S, 'camera')
        made.send('image', flat)
    made.until(lambda: made.nodes[0]._low_texture == 10)
    assert 'structure' not in missing


# All nodes


def test_jump_back_resets_or_keeps_the_memory(world: MakeWorld) -> None:
    for choice, templates in (('start_over', 12), ('go_on', 20)):
        made = world(LocalViewNode, arguments=(*SMALL, '-p', f'on_jump_back:={choice}'))
        received = made.listen(String, 'local_view/template')
        for n in range(20):
            made.send('image', image(START_NS + n * PERIOD_NS, n))
        made.until(lambda received=received: len(received) == 20)
        for n in range(12):
            made.send('image', image(START_NS - 60 * S + n * PERIOD_NS, n))
        made.until(lambda received=received: len(received) == 32)
        state = made.diagnostics()['local_view']
        assert (state['templates'], state['refused']) == (str(templates), '0')
        made.close()


@pytest.mark.parametrize(('argument', 'word'), [
    ('vt_match_treshold:=0.1', 'vt_match_threshold'),
    ('vt_match_threshold:=7.0', 'vt_match_threshold'),
    ('template_x_size:=many', 'template_x_size'), ('vt_panoramic:=3', 'vt_panoramic'),
    ('vt_shift_match:=40', 'vt_shift_match'),
])
def test_invalid_parameter_raises_unusable_parameter(
    world: MakeWorld, argument: str, word: str
) -> None:
    with pytest.raises(UnusableParameter, match=word):
        world(LocalViewNode, arguments=('-p', argument))


def test_given_values_apply_to_initial_configuration(world: MakeWorld) -> None:
    values = {'local_view.template_x_size': 20, 'local_view.vt_shift_match': 3}
    initial = Config().with_values(values)
    made = world(lambda: LocalViewNode(initial), arguments=('-p', 'template_x_size:=16'))
    node = made.nodes[0]
    assert node.config == initial.with_values({'local_view.template_x_size': 16})
    assert node.get_parameter('vt_shift_match').value == 3


@pytest.mark.parametrize(('text', 'expected'), [
    ('', Config()), ('/**: {ros__parameters: {use_sim_time: true}}', Config()),
    ('/**: {ros__parameters: {vt_shift_match: 3}}', load_config('openratslam')[0]),
])
def test_parameter_file_without_base_keeps_its_meaning(
    text: str, expected: Config, tmp_path: Path
) -> None:
    file = tmp_path / 'a.yaml'
    file.write_text(text)
    arguments = ['--ros-args', '-p', 'template_x_size:=16']
    assert initial_config(arguments) == Config()
    assert initial_config([*arguments, '--params-file', str(file)]) == expected


@pytest.mark.parametrize('where', ['/**', 'pose_cells'])
def test_removed_parameters_in_a_file_are_named_and_ignored(
    where: str, world: MakeWorld, tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    file = tmp_path / 'a.yaml'
    file.write_text(f'{where}: {{ros__parameters: {{exp_place_offset: true, pc_dim_x: 20}}}}')
    [node] = world(PoseCellsNode, arguments=('--params-file', str(file))).nodes
    assert node.config.pose_cells.pc_dim_x == 20
    assert 'exp_place_offset: had no effect on maps' in capfd.readouterr().err


def test_node_takes_unset_parameters_from_its_base(
    world: MakeWorld, tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    file = tmp_path / 'a.yaml'
    file.write_text('/**: {ros__parameters: {base: irat, vt_shift_match: 3}}')
    made = world(LocalViewNode, SimulatorNode, arguments=('--params-file', str(file)))
    expected = load_config('irat')[0].with_values({'local_view.vt_shift_match': 3})
    assert made.nodes[0].config == expected
    assert not made.nodes[0].has_parameter('base')
    assert UNNAMED not in capfd.readouterr().err


def test_node_with_assumed_base_says_so(
    world: MakeWorld, capfd: pytest.CaptureFixture[str]
) -> None:
    world(lambda: LocalViewNode(extended()), arguments=('-p', 'vt_shift_match:=3'))
    assert UNNAMED in capfd.readouterr().err


def test_unknown_base_is_refused(world: MakeWorld) -> None:
    with pytest.raises(UnusableInput, match='the presets are'):
        world(LocalViewNode, arguments=('-p', 'base:=nowhere'))


def test_parameters_have_descriptions_and_only_some_are_settable(world: MakeWorld) -> None:
    made = world(ExperienceMapNode, arguments=('-p', 'max_lateness_s:=5', '-p', 'exp_loops:=3'))
    node = made.nodes[0]
    assert node.get_parameter('max_lateness_s').value == 5.0
    assert node.get_parameter('exp_loops').value == 3
    assert node.get_parameter('goal_recall.goal_tolerance_m').value == 0.5
    described = node.describe_parameters(['exp_correction'])[0]
    assert described.read_only
    assert (described.floating_point_range[0].from_value,
            described.floating_point_range[0].to_value) == (0.0, 0.5)
    assert 'error' in described.description
    [result] = node.set_parameters([Parameter('exp_loops', value=7)])
    assert not result.successful
    [result] = node.set_parameters([Parameter('goal_recall.goal_tolerance_m', value=2.0)])
    assert result.successful
    assert node.config.goal_recall.goal_tolerance_m == 2.0
    [result] = node.set_parameters([Parameter('map_period_s', value=-2.0)])
    assert not result.successful


def test_silence_is_reported_with_topic_and_publishers(world: MakeWorld) -> None:
    made, _ = pose_cells(world, '-p', 'watchdog_after_s:=0.2')
    made.send('odom', odometry(START_NS))
    made.until(lambda: 'publishers on' in made.diagnostics()['pose_cells']['message'])
    text = made.diagnostics()['pose_cells']['message']
    assert 'no ' in text
    assert '/odom' in text or '/local_view/template' in text


def test_views_without_odometry_name_visual_odometry(world: MakeWorld) -> None:
    made, _ = pose_cells(world, '-p', 'watchdog_after_s:=0.1')
    (node,) = made.nodes
    missing = node.diagnostics.missing
    made.until(lambda: set(missing) == {'odometry', 'template'})
    warned: list[str] = []
    node.diagnostics.warn = warned.append
    made.send('local_view/template', template(START_NS, 0))
    made.until(lambda: 'no template for' in missing.get('template', ''))
    assert 'ratslam launch --odometry camera' in missing['odometry']
    assert any('odometry:=camera' in text for text in warned)


def test_node_waits_silently_for_one_that_is_starting(world: MakeWorld) -> None:
    made, _ = pose_cells(world, '-p', 'watchdog_after_s:=0.1')
    node = made.nodes[0]
    with announced('local_view'):  # compiling, which takes up to a minute
        for _ in range(3):
            made.spin(0.1)
            assert made.diagnostics()['pose_cells']['message'].startswith('waiting for')
        assert node.diagnostics.missing == {}
    made.until(lambda: set(node.diagnostics.missing) == {'odometry', 'template'})


def test_an_input_that_has_ended_is_no_warning(world: MakeWorld) -> None:
    made, _ = pose_cells(world, '-p', 'watchdog_after_s:=0.2')
    made.send('odom', odometry(START_NS))
    node = made.nodes[0]
    odom = node.inputs[0]
    made.until(lambda: odom.state == 'silent')
    assert 'publishers on' in node.diagnostics.missing['odometry']
    made.tester.destroy_publisher(made.publishers.pop('odom'))
    made.until(lambda: odom.state == 'finished')
    assert 'odometry' not in node.diagnostics.missing


def test_memory_folder_stays_below_that_of_start(world: MakeWorld, tmp_path: Path) -> None:
    made, _ = experience_map(world, '-p', f'memory_folder:={tmp_path}/maps')
    (node,) = made.nodes
    for folder, is_accepted in ((f'{tmp_path}/maps/home', True), (f'{tmp_path}/other', False)):
        (result,) = node.set_parameters([Parameter('memory_folder', value=folder)])
        assert result.successful is is_accepted, result.reason
    assert node.get_parameter('memory_folder').value == f'{tmp_path}/maps/home'
