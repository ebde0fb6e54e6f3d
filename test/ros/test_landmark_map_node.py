# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Node of the landmark map: the same map as offline, memory, and messages it refuses."""

from __future__ import annotations

import json
import math
from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy as np
from helpers import PERIOD_NS, START_NS
from laser_rooms import ROOM, noisy_scan
from ros_messages import MakeWorld, even_scan, laser_scan, odometry
from states import differences
from std_msgs.msg import String
from std_srvs.srv import Trigger
from tf2_msgs.msg import TFMessage
from visualization_msgs.msg import MarkerArray

from ratslam_ros.core.common.odometry import Motion, Odometry, Twist, moved
from ratslam_ros.core.common.pose import Pose
from ratslam_ros.core.common.scan import Scan, UnusableScan
from ratslam_ros.core.config import Config
from ratslam_ros.messages.json_schema import encode
from ratslam_ros.messages.landmarks import LandmarksPayload
from ratslam_ros.pipeline.landmark_map import LandmarkMapStage
from ratslam_ros.pipeline.pipeline import Pipeline
from ratslam_ros.pipeline.ratslam import RatSLAM
from ratslam_ros.ros.landmark_map_node import LandmarkMapNode
from ratslam_ros.ros.mapping.scans import scan_from_message
from ratslam_ros.ros.qos import LATCHED

START = Pose(-1.0, 0.0, 0.0)


class Driven:
    """A node, a robot that circles in the room, and the same messages offline."""

    def __init__(self, world: MakeWorld, *arguments: str) -> None:
        self.made = world(LandmarkMapNode, arguments=arguments)
        [self.node] = self.made.nodes
        self.maps = self.made.listen(String, 'landmark_map/map', LATCHED)
        self.offline = RatSLAM(stages=[LandmarkMapStage])
        self.pose, self.tick = START, 0
        self.rng = np.random.default_rng(1)

    def drive(self, ticks: int) -> None:
        """Drive; each tick has an odometry message, and a scan half a period later."""
        for _ in range(ticks):
            self.tick += 1
            stamp_ns = START_NS + self.tick * PERIOD_NS
            self.pose = moved(self.pose, Motion(0.1, 0.05, 0.05))
            self.odometry(stamp_ns, 0.5, 0.5)
            self.scan(noisy_scan(ROOM, self.pose, self.rng, beams=181, stamp_ns=stamp_ns))
        order = self.node.host.pipeline.order
        for stream in ('odometry', 'scan'):
            self.made.until(lambda stream=stream: order.newest_of(stream) == stamp_ns)

    def odometry(self, stamp_ns: int, speed_mps: float, turn_rate_radps: float) -> None:
        self.made.send('odom', odometry(stamp_ns, speed_mps, turn_rate_radps))
        twist = Twist(speed_mps, turn_rate_radps)
        self.offline.odometry(Odometry(stamp_ns, twist, Pose(0.0, 0.0, 0.0)))

    def scan(self, scan: Scan, **changed: Any) -> None:
        message = laser_scan(scan, **changed)
        self.made.send('scan', message)
        with suppress(UnusableScan):
            self.offline.scan(scan_from_message(message))

    def latest(self) -> str:
        """Return the map that the node publishes last."""
        count = len(self.maps)
        self.node.host.pipeline.finish()
        self.node._changed = True
        self.node._send_map()
        self.made.until(lambda: len(self.maps) > count)
        return str(self.maps[-1].data)

    def call(self, name: str) -> Any:
        return self.made.call(Trigger, f'landmark_map/{name}')


def test_node_publishes_the_bytes_of_the_offline_map(world: MakeWorld) -> None:
    driven = Driven(world)
    driven.drive(80)
    text = driven.latest()
    driven.offline.finish()
    stage: Any = driven.offline.pipeline.stages['landmark_map']
    assert text == encode(LandmarksPayload.of(stage.scan_ns, stage.core, 'landmark_map'))
    assert len(json.loads(text)['landmarks']) >= 4


def test_early_odometry_gives_the_offline_map() -> None:
    """Its next stamp is predicted in both: the scan after it need not wait, and comes first."""
    config = Config()
    stage = LandmarkMapStage(config)
    pipeline, offline = Pipeline([stage], 10**9), RatSLAM(config, stages=[LandmarkMapStage])
    pose, rng = START, np.random.default_rng(1)
    for tick in [*np.arange(1.0, 41.0), 40.6, 41.6]:
        odometry_ns = START_NS + round(tick * PERIOD_NS)
        scan_ns = odometry_ns + (PERIOD_NS // 2 if tick % 1.0 == 0.0 else 1)
        pose = moved(pose, Motion(0.1, 0.12, 0.12))
        odometry = Odometry(odometry_ns, Twist(1.2, 1.2), pose)
        scan = noisy_scan(ROOM, pose, rng, beams=181, stamp_ns=scan_ns)
        pipeline.feed('odometry', odometry_ns, odometry)
        pipeline.feed('scan', scan_ns, scan)
        offline.odometry(odometry)
        offline.scan(scan)
    pipeline.finish()
    offline.finish()
    offline_state = offline.state()['landmark_map']['core']
    assert list(differences(stage.core.state(), offline_state)) == []


def test_saved_map_is_loaded_and_the_robot_finds_itself(world: MakeWorld, tmp_path: Path) -> None:
    driven = Driven(world, '-p', f'memory_folder:={tmp_path}')
    driven.drive(160)
    before = json.loads(driven.latest())
    assert driven.call('save').success and driven.call('reset').success
    assert json.loads(driven.latest())['landmarks'] == []
    assert driven.call('load').success
    after = json.loads(driven.latest())
    assert after['landmarks'] == before['landmarks'] and after['pose']['is_lost']
    driven.drive(60)
    found = json.loads(driven.latest())
    assert not found['pose']['is_lost']
    c, s = driven.pose.x_m - START.x_m, driven.pose.y_m - START.y_m
    assert math.dist((found['pose']['x_m'], found['pose']['y_m']), (c, s)) < 0.2


def test_unusable_messages_are_refused_and_counted(world: MakeWorld) -> None:
    driven = Driven(world)
    driven.drive(2)
    for field in ({'angle_min': math.nan}, {'ranges': []}):
        driven.scan(even_scan(START_NS, 1.0), **field)
    driven.odometry(START_NS, math.nan, 0.0)
    driven.made.until(lambda: driven.node.diagnostics.counts['refused'] == 3)
    diagnostics = driven.made.diagnostics()['landmark_map']
    assert diagnostics['landmarks'] == '0' and diagnostics['scans_used'] == '1'


def test_frame_of_the_map_hangs_below_the_odometry(world: MakeWorld) -> None:
    driven = Driven(world)
    frames = driven.made.listen(TFMessage, '/tf')
    markers = driven.made.listen(MarkerArray, 'landmark_map/markers')
    driven.drive(80)
    driven.made.until(lambda: len(frames) > 0)
    [frame] = frames[-1].transforms
    assert (frame.header.frame_id, frame.child_frame_id) == ('odom', 'landmark_map')
    driven.latest()
    driven.made.until(lambda: len(markers) > 0 and len(markers[-1].markers[0].points) >= 4)
