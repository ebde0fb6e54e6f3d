# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Changes of the map, closure events and pose cells on topics."""

from __future__ import annotations

import json
from typing import Any

import numpy as np
from helpers import PERIOD_NS, START_NS, S
from ros_messages import MakeWorld, action_text, odometry, string, template
from sensor_msgs.msg import PointCloud2
from std_msgs.msg import String
from std_srvs.srv import Trigger

from ratslam_ros.core.mapping.map_changes import MapMirror
from ratslam_ros.core.pose_cells.map_action import Action
from ratslam_ros.messages.json_schema import decode
from ratslam_ros.messages.map_changes import ClosurePayload, MapChangeFollower, MapChangePayload
from ratslam_ros.messages.pose_cells import PacketsPayload
from ratslam_ros.ros.experience_map_node import ExperienceMapNode
from ratslam_ros.ros.pose_cells_node import PoseCellsNode


class Drive:
    """A map node and a robot that drives 1 m between two actions."""

    def __init__(self, world: MakeWorld, *arguments: str) -> None:
        self.world = world(
            ExperienceMapNode,
            arguments=('-p', 'map_period_s:=0.05', '-p', 'flush_after_s:=0.2', *arguments),
        )
        self.count = 0

    @property
    def map(self) -> Any:
        return self.world.nodes[0]._core

    def act(self, kind: Action, target: int, speed: float = 1.0) -> None:
        n, self.count = self.count, self.count + 1
        self.world.send('odom', odometry(START_NS + n * S, speed if n else 0.0))
        text = action_text(START_NS + n * S, n, kind, n - 1, target)
        self.world.send('pose_cells/action', string(text))

    def settle(self) -> None:
        """Wait until the node has executed all actions."""
        node = self.world.nodes[0]
        self.world.send('odom', odometry(START_NS + self.count * S))
        self.world.until(lambda: node._stage.action_ns == START_NS + (self.count - 1) * S)


class Receiver:
    """A mirror of the map that receives its changes."""

    def __init__(self, drive: Drive) -> None:
        self.mirror, self.follower = MapMirror(), MapChangeFollower()
        self.sizes: list[int] = []
        self._world = drive.world
        self._map = lambda: drive.map
        self._received = drive.world.listen(String, 'experience_map/changes')

    def equals(self) -> bool:
        """Apply the received messages; return whether the mirror equals the map of the node."""
        while self._received:
            message = decode(MapChangePayload, self._received.pop(0).data)
            if self.follower.accepts(message):
                self.mirror.apply(message.change)
                self.sizes.append(len(message.change))
        graph, mirror = self._map(), self.mirror
        return (
            mirror.restarts > 0 and mirror.pending == 0 and len(mirror) == len(graph)
            and mirror.link_count == graph.link_count and mirror.current_id == graph.current_id
            and bool(np.allclose(mirror.poses, graph.poses, atol=2e-3))
        )


def test_changes_reach_early_and_late_subscribers(world: MakeWorld) -> None:
    drive = Drive(world)
    early = Receiver(drive)
    for n in range(4):
        drive.act('create', n)
    drive.settle()
    drive.world.until(early.equals)
    late = Receiver(drive)
    drive.world.until(lambda: late.equals() and early.equals())
    drive.act('link', 1)
    drive.act('create', 4)
    drive.settle()
    assert len(drive.map) == 5
    drive.world.until(lambda: late.equals() and early.equals())
    assert not late.follower.needs_all and not early.follower.needs_all
    assert early.mirror.restarts == 2


def test_send_all_and_reset_restart(world: MakeWorld) -> None:
    drive = Drive(world)
    receiver = Receiver(drive)
    drive.act('create', 0)
    drive.act('create', 1)
    drive.settle()
    drive.world.until(receiver.equals)
    restarts = receiver.mirror.restarts
    assert drive.world.call(Trigger, 'experience_map/send_all').success
    drive.world.until(lambda: receiver.equals() and receiver.mirror.restarts == restarts + 1)
    assert drive.world.call(Trigger, 'experience_map/reset').success
    drive.world.until(lambda: receiver.equals() and len(receiver.mirror) == 0)


def test_nothing_is_compared_without_subscribers(world: MakeWorld) -> None:
    drive = Drive(world)
    node = drive.world.nodes[0]
    node._changes._tracker.next_change = None  # would raise if it was called
    drive.act('create', 0)
    drive.settle()
    drive.world.spin(0.3)
    assert node._changes._sequence == 0


def test_closures_are_published_with_their_reason(world: MakeWorld) -> None:
    drive = Drive(world, '-p', 'exp_gate_closures:=true')
    received = drive.world.listen(String, 'experience_map/closures')
    drive.world.until(
        lambda: drive.world.nodes[0]._changes._closures.get_subscription_count() == 1
    )
    for n in range(12):
        drive.act('create', n)
    drive.act('link', 10, speed=0.0)
    drive.act('link', 2)
    drive.settle()
    drive.world.until(lambda: len(received) == 2)
    closed, rejected = (decode(ClosurePayload, message.data) for message in received)
    assert (closed.outcome, closed.source_id, closed.target_id) == ('closed', 11, 10)
    assert (rejected.outcome, rejected.source_id, rejected.target_id) == ('rejected', 10, 2)
    assert 'moves the robot by 9.0 m' in rejected.reason
    assert (rejected.stamp.ns, rejected.sequence) == (START_NS + 13 * S, 13)


def test_pose_cells_are_published_to_subscribers(world: MakeWorld) -> None:
    made = world(PoseCellsNode)
    clouds = made.listen(PointCloud2, 'pose_cells/cells')
    texts = made.listen(String, 'pose_cells/packets')
    node = made.nodes[0]
    for n in range(60):
        stamp_ns = START_NS + n * PERIOD_NS
        made.send('local_view/template', template(stamp_ns, n % 15))
        made.send('odom', odometry(stamp_ns, 0.1))
        made.spin(0.02)
        if len(clouds) > 3 and len(texts) > 3:
            break
    cloud = clouds[-1]
    assert [field.name for field in cloud.fields] == ['x', 'y', 'z', 'activity']
    assert cloud.header.frame_id == 'pose_cells'
    points = np.frombuffer(cloud.data, '<f4').reshape(-1, 4)
    assert (points[:, :3] == np.floor(points[:, :3])).all()
    assert points[:, 3].min() > 0.0
    received = decode(PacketsPayload, texts[-1].data)
    packets, _ = received.arrays
    assert received.dims == node._core.dims
    assert len(packets) >= 1
    assert json.loads(texts[-1].data)['packets'][0][3] == packets[0, 3]
