# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""A node of the user takes the place of each mapping node, by the public topics alone."""

from __future__ import annotations

import json
from collections.abc import Callable
from functools import partial
from typing import Any

import numpy as np
import pytest
from helpers import PERIOD_NS, START_NS, extended, picture
from nav_msgs.msg import Odometry as OdometryMessage
from rclpy.node import Node
from ros_messages import MakeWorld
from sensor_msgs.msg import Image
from std_msgs.msg import String

from ratslam_ros.core.common.odometry import Odometry, Twist
from ratslam_ros.core.common.pose import Pose
from ratslam_ros.core.config import Config
from ratslam_ros.core.pose_cells.map_action import MapAction
from ratslam_ros.core.pose_cells.torus import Place
from ratslam_ros.core.vision.local_view import LocalView, ViewMatch
from ratslam_ros.core.vision.visual_odometry import VisualOdometry
from ratslam_ros.messages.mapping import encode_map
from ratslam_ros.pipeline.choice import NAMES, neighbours
from ratslam_ros.pipeline.experience_map import ExperienceMapStage
from ratslam_ros.pipeline.items import NumberedAction
from ratslam_ros.pipeline.pipeline import Pipeline
from ratslam_ros.pipeline.pose_cells import PoseCellsStage
from ratslam_ros.pipeline.ratslam import RatSLAM
from ratslam_ros.ros.convert import image_message
from ratslam_ros.ros.host import Host
from ratslam_ros.ros.single_process import KINDS, main

CONFIG: Config = extended().with_values({
    'local_view.template_x_size': 16, 'local_view.template_y_size': 8,
    'local_view.vt_shift_match': 2, 'visual_odometry.vtrans_scaling': 1.0,
    'visual_odometry.camera_fov_deg': 10.0,
    # All images are sent at once, and the nodes pass them on as fast as they are.
    'inputs.max_lateness_s': 60.0,
})
LATENESS_NS = 60_000_000_000
SEEDS = [*range(8)] * 4
"""Images of four laps with eight places."""
DEPTH = 100


def stamp_of(header: Any) -> int:
    return int(header.stamp.sec * 10**9 + header.stamp.nanosec)


def as_json(stamp_ns: int, **fields: Any) -> Any:
    sec, nanosec = divmod(stamp_ns, 10**9)
    stamp = {'sec': sec, 'nanosec': nanosec}
    return String(data=json.dumps({'schema_version': 1, 'stamp': stamp, **fields}))


def stamped(message: Any) -> tuple[int, dict[str, Any]]:
    fields = json.loads(message.data)
    return fields['stamp']['sec'] * 10**9 + fields['stamp']['nanosec'], fields


def odometry_of(message: Any) -> Odometry:
    twist = Twist(message.twist.twist.linear.x, message.twist.twist.angular.z)
    return Odometry(stamp_of(message.header), twist, Pose(0.0, 0.0, 0.0))


def grey(message: Any) -> Any:
    return np.frombuffer(bytes(message.data), np.uint8).reshape(message.height, message.width)


# The nodes of the user; each returns the core of its map if it has one


def visual_odometry(node: Any) -> None:
    core = VisualOdometry(CONFIG.visual_odometry)
    publisher = node.create_publisher(OdometryMessage, 'odom', DEPTH)

    def see(image: Image) -> None:
        odometry = core.estimate(stamp_of(image.header), grey(image))
        if odometry is not None:
            message = OdometryMessage(header=image.header, child_frame_id='base_link')
            message.pose.pose.orientation.w = 1.0
            message.twist.twist.linear.x = odometry.twist.linear_x_mps
            message.twist.twist.angular.z = odometry.twist.angular_z_radps
            publisher.publish(message)

    node.create_subscription(Image, 'image', see, DEPTH)


def local_view(node: Any) -> None:
    core = LocalView(CONFIG.local_view)
    publisher = node.create_publisher(String, 'local_view/template', DEPTH)

    def see(image: Image) -> None:
        match = core.match(grey(image))
        publisher.publish(as_json(
            stamp_of(image.header), id=match.template_id, is_new=match.is_new, error=match.error,
            relative_rad=match.relative_rad, memory=START_NS,
        ))

    node.create_subscription(Image, 'image', see, DEPTH)


def pose_cells(node: Any) -> None:
    pipeline = Pipeline([PoseCellsStage(CONFIG)], LATENESS_NS)
    publisher = node.create_publisher(String, 'pose_cells/action', DEPTH)

    def publish(stamp_ns: int, item: NumberedAction) -> None:
        action, place = item.action, item.action.place
        publisher.publish(as_json(
            stamp_ns, sequence=item.number, action=action.action, source_id=action.source_id,
            target_id=action.target_id, template_id=action.template_id,
            relative_rad=action.relative_rad, pc_x=place.x, pc_y=place.y, pc_theta=place.theta,
            memory=START_NS,
        ))

    def move(message: OdometryMessage) -> None:
        pipeline.feed('odometry', stamp_of(message.header), odometry_of(message))

    def view(message: String) -> None:
        stamp_ns, f = stamped(message)
        match = ViewMatch(f['id'], f['is_new'], f['error'], f['relative_rad'])
        pipeline.feed('template', stamp_ns, match)

    pipeline.observe('action', publish)
    node.create_subscription(OdometryMessage, 'odom', move, DEPTH)
    node.create_subscription(String, 'local_view/template', view, DEPTH)


def experience_map(node: Any) -> Any:
    stage = ExperienceMapStage(CONFIG)
    pipeline = Pipeline([stage], LATENESS_NS)
    # Only the first action is answered: the pose cells must not wait for other answers.
    publisher = node.create_publisher(String, 'experience_map/relocation', DEPTH)

    def move(message: OdometryMessage) -> None:
        pipeline.feed('odometry', stamp_of(message.header), odometry_of(message))

    def act(message: String) -> None:
        stamp_ns, f = stamped(message)
        if f['sequence'] == 0:
            publisher.publish(as_json(stamp_ns, sequence=0, memory=f['memory']))
        ids = f['source_id'], f['target_id'], f['template_id']
        place = Place(f['pc_x'], f['pc_y'], f['pc_theta'])
        action = MapAction(f['action'], *ids, f['relative_rad'], place)
        pipeline.feed('action', stamp_ns, NumberedAction(f['sequence'], action))

    node.create_subscription(OdometryMessage, 'odom', move, DEPTH)
    node.create_subscription(String, 'pose_cells/action', act, DEPTH)
    return stage.core


FOREIGN: dict[str, Callable[[Any], Any]] = {
    'visual_odometry': visual_odometry, 'local_view': local_view, 'pose_cells': pose_cells,
    'experience_map': experience_map,
}


def replayed() -> str:
    slam = RatSLAM(CONFIG, head='visual_odometry')
    for n, seed in enumerate(SEEDS):
        slam.image(START_NS + n * PERIOD_NS, picture(seed, 24, 32))
    slam.finish()
    assert slam.experience_map.link_count > len(slam.experience_map)  # it has closed loops
    return encode_map(0, slam.experience_map)


@pytest.mark.parametrize(('name', 'split'), [
    *((name, False) for name in NAMES), ('experience_map', True)
])
def test_map_with_a_foreign_node_equals_that_of_a_replay(
    name: str, split: bool, world: MakeWorld
) -> None:
    class User(Node):  # type: ignore[misc]
        def __init__(self) -> None:
            super().__init__('user')
            self.map = FOREIGN[name](self)

        def close(self) -> None:
            pass

    stages = [one for one in NAMES if one != name]
    makers: list[Callable[[], Any]] = []
    hosts = []
    for group in [(one,) for one in stages] if split else neighbours(stages):
        hosts.append(Host(is_answered=False))
        makers += [partial(kind, CONFIG, hosts[-1]) for kind in KINDS if kind.SECTION in group]
    made = world(*makers, User)
    for host in hosts:
        host.start()
    *ours, user = made.nodes
    graph = ours[-1]._core if user.map is None else user.map
    for n, seed in enumerate(SEEDS):
        pixels = picture(seed, 24, 32)
        made.send('image', image_message(START_NS + n * PERIOD_NS, 'camera', pixels))
    expected = replayed()
    made.until(lambda: encode_map(0, graph) == expected)
    assert [node.diagnostics.counts for node in ours] == [{}] * len(ours)


def test_single_process_with_a_gap_between_its_stages_is_refused(
    capsys: pytest.CaptureFixture[str]
) -> None:
    with pytest.raises(SystemExit):
        main(['--stages', 'local_view,experience_map'])
    assert 'run the others in another process' in capsys.readouterr().err
