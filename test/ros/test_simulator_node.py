# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The node of the simulated robot."""

from __future__ import annotations

import math
import time
from typing import Any

import numpy as np
import pytest
from floor_clearance import clearance_m
from geometry_msgs.msg import PoseStamped, Twist
from nav_msgs.msg import Odometry
from ros_messages import MakeWorld
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import CameraInfo, Image, LaserScan, Range
from tf2_msgs.msg import TFMessage

from ratslam_ros.errors import RatslamError
from ratslam_ros.ros.convert import stamp_ns
from ratslam_ros.ros.mapping.scans import scan_from_message
from ratslam_ros.ros.qos import CLOCK, STATIC
from ratslam_simulator.config import SimulatorParameters
from ratslam_simulator.floor_plan import office
from ratslam_simulator.node import SimulatorNode
from ratslam_simulator.simulation import START_STAMP_NS, STEP_NS
from ratslam_simulator.sonar import PIONEER

QUICK = ('-p', 'plan:=office', '-p', 'start:=E', '-p', 'rate:=5.0', '-p', 'noise:=0.0')


def simulator(world: MakeWorld, *arguments: str) -> Any:
    SimulatorNode.warm_up()
    return world(SimulatorNode, arguments=(*QUICK, *arguments))


def stamp_of(message: Any) -> int:
    return stamp_ns(message.header)


def velocity(speed: float, turn_rate: float) -> Any:
    message = Twist()
    message.linear.x, message.angular.z = speed, turn_rate
    return message


def test_all_sensor_topics_have_rates_and_contents(world: MakeWorld) -> None:
    made = simulator(world)
    kinds = {
        'image': Image, 'camera_info': CameraInfo, 'odom': Odometry, 'scan': LaserScan,
        'ground_truth/pose': PoseStamped,
    }
    received = {topic: made.listen(kind, topic) for topic, kind in kinds.items()}
    clock = made.listen(Clock, '/clock', CLOCK)
    made.until(lambda: clock and all(len(messages) >= 10 for messages in received.values()))
    camera_hz = SimulatorParameters().camera_rate_hz
    rates = {'image': camera_hz, 'camera_info': camera_hz, 'odom': 20, 'scan': 10}
    for topic, rate_hz in rates.items():
        stamps = [stamp_of(message) for message in received[topic]]
        assert set(np.diff(stamps)) == {10**9 // rate_hz}, topic
        assert min(stamps) >= START_STAMP_NS
    image, info, scan = (received[topic][0] for topic in ('image', 'camera_info', 'scan'))
    assert (image.width, image.height, image.encoding) == (80, 60, 'mono8')
    assert np.frombuffer(image.data, np.uint8).std() > 5.0
    assert (info.width, info.k[2]) == (80, 40.0)
    ranges_m = scan_from_message(scan).ranges_m
    assert len(ranges_m) == 181
    x_m, y_m = office().places['E']
    assert ranges_m[0] == pytest.approx(clearance_m(office(), x_m, y_m), abs=0.01)
    truth = received['ground_truth/pose'][0]
    assert truth.header.frame_id == 'world'
    assert (truth.pose.position.x, truth.pose.position.y) == pytest.approx((x_m, y_m))


def test_sonars_publish_ranges_and_frames(world: MakeWorld) -> None:
    made = simulator(world, '-p', 'sonars:=true')
    received = [made.listen(Range, f'sonar_{number}') for number in range(8)]
    frames = made.listen(TFMessage, '/tf_static', STATIC)
    made.until(lambda: frames and all(len(messages) >= 3 for messages in received))
    x_m, y_m = office().places['E']
    right_m = clearance_m(office(), x_m, y_m)  # see the first beam of the laser above
    for number, messages in enumerate(received):
        assert messages[0].header.frame_id == f'sonar_{number}'
        assert messages[0].field_of_view == pytest.approx(math.radians(30.0))
        assert (messages[0].min_range, messages[0].max_range) == pytest.approx((0.1, 5.0))
        assert messages[0].radiation_type == Range.ULTRASOUND
    assert received[7][0].range == pytest.approx(right_m + PIONEER[7].y_m, abs=0.02)
    mounted = {found.child_frame_id: found.transform for found in frames[0].transforms}
    assert list(mounted) == ['laser', *(f'sonar_{number}' for number in range(8))]
    assert mounted['sonar_7'].translation.y == pytest.approx(-0.13)
    assert mounted['sonar_7'].rotation.z == pytest.approx(-math.sqrt(0.5))


def test_robot_follows_cmd_vel_and_stops_without_it(world: MakeWorld) -> None:
    made = simulator(world, '-p', 'cmd_timeout_s:=0.5')
    received = made.listen(Odometry, 'odom')

    def drive(speed: float, turn_rate: float) -> Any:
        """Command a velocity; return the last one."""
        made.send('cmd_vel', velocity(speed, turn_rate))
        return received[-1].twist.twist if received else velocity(0.0, 0.0)

    made.until(lambda: drive(0.5, 0.0).linear.x > 0.45)
    made.until(lambda: abs(received[-1].twist.twist.linear.x) < 0.01)
    assert received[-1].pose.pose.position.x > 0.5
    made.until(lambda: drive(0.0, 1.0).angular.z > 0.9)
    for wrong in (velocity(math.nan, 0.0), velocity(0.0, math.inf)):
        made.send('cmd_vel', wrong)
    state = made.reported('simulator', refused='2')
    assert float(state['simulated_s']) > 5.0
    assert int(state['collisions']) == 0


def test_simulated_time_does_not_exceed_its_rate(world: MakeWorld) -> None:
    begin_s = time.monotonic()
    made = simulator(world, '-p', 'rate:=2.0')
    made.until(lambda: made.nodes[0].simulator.elapsed_s > 1.0)
    passed_s = time.monotonic() - begin_s
    assert made.nodes[0].simulator.elapsed_s <= 2.0 * passed_s + STEP_NS * 1e-9


@pytest.mark.parametrize(
    'wrong', ['plan:=mars', 'start:=Q', 'people:=-1', 'rate:=0.0', 'speed:=3', 'obstacles:=a,b']
)
def test_invalid_parameters_are_refused(world: MakeWorld, wrong: str) -> None:
    with pytest.raises(RatslamError):
        simulator(world, '-p', wrong)
