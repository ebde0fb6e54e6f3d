# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The world, the robots and the faults of a simulation, and the maps that a replay builds."""

from __future__ import annotations

import math
import random
from dataclasses import dataclass
from functools import cache
from typing import Any

import numpy as np
from helpers import SMALL_IMAGES, extended, picture
from laser_rooms import full_turn
from nav_msgs.msg import Odometry
from rclpy.serialization import deserialize_message, serialize_message
from sensor_msgs.msg import LaserScan
from state_digest import digest_of
from virtual_bus import BusFaults
from virtual_time import EPOCH_NS, MS, S, Scheduler

from ratslam_ros.chain import Chain
from ratslam_ros.core.common.pose import Pose
from ratslam_ros.pipeline.landmark_map import LandmarkMapStage
from ratslam_ros.pipeline.ratslam import RatSLAM
from ratslam_ros.recordings.events import ImageEvent, OdometryEvent, Orientation, ScanEvent
from ratslam_ros.ros.convert import header_of, image_message, odometry_of
from ratslam_ros.ros.experience_map_node import ExperienceMapNode
from ratslam_ros.ros.landmark_map_node import LandmarkMapNode
from ratslam_ros.ros.local_view_node import LocalViewNode
from ratslam_ros.ros.mapping.scans import scan_from_message
from ratslam_ros.ros.navigation.goal_follower_node import GoalFollowerNode
from ratslam_ros.ros.pose_cells_node import PoseCellsNode
from ratslam_ros.ros.visual_odometry_node import VisualOdometryNode

SETTINGS = dict(SMALL_IMAGES)

KINDS: dict[str, tuple[type[Any], ...]] = {
    'local_view': (LocalViewNode,), 'pose_cells': (PoseCellsNode,),
    'experience_map': (ExperienceMapNode,), 'visual_odometry': (VisualOdometryNode,),
    'landmark_map': (LandmarkMapNode,), 'goal_follower': (GoalFollowerNode,),
    'single_process': (LocalViewNode, PoseCellsNode, ExperienceMapNode),
    'camera_process': (VisualOdometryNode, LocalViewNode, PoseCellsNode, ExperienceMapNode),
    'camera_head': (VisualOdometryNode, LocalViewNode),
}
"""Nodes of each process."""
MAPPING = 'local_view', 'pose_cells', 'experience_map'
ROBOTS: dict[str, tuple[str, ...]] = {
    'wheels': MAPPING,
    'camera': ('camera_head', *MAPPING[1:]),
    'laser': (*MAPPING, 'landmark_map', 'goal_follower'),
    'wheels, one process': ('single_process',),
    'camera, one process': ('camera_process',),
}
"""Processes by the sensors of the robot."""

CHAINS = {
    'local_view': Chain(is_followed=True), 'camera_head': Chain(is_followed=True),
    'pose_cells': Chain('local_view', is_followed=True), 'experience_map': Chain('pose_cells'),
}
"""Places of the processes of a split."""

ROBOTS_OF_SEEDS = 'wheels', 'wheels', 'wheels, one process', 'camera', 'laser'

LEARNING = {*MAPPING, 'visual_odometry', 'landmark_map'}
DRIVE_S = 20
WALLS: list[list[tuple[float, float]]] = [
    [(-3.0, -2.0), (4.0, -2.0), (4.0, 2.5), (2.5, 2.5), (2.5, 5.0), (-3.0, 5.0), (-3.0, -2.0)]
]
BEAMS = 120
ODOMETRY_NS, IMAGE_NS = 100 * MS, 200 * MS
PER_LAP, RADIUS_M = 20, 1.5
SETTLED_NS, MOST_NS = 6 * S, 600 * S
"""Time without a message after which the nodes are considered idle, and the limit of a run: in
lockstep, the source waits 10 s for each image that is lost."""

JITTER_NS = 40 * MS
"""Deviation of the stamps of odometry, whose period is 100 ms, in some of the simulations."""

SMALL_BACKLOG = 4_000
"""Bytes of images that wait in a shrunk queue."""

LOSSES = {
    'lost': r'\d+ messages of [\w ]+ were lost in transport',
    'dropped': r'an image was dropped',
    'late': r'came too late',
    'refused': r'was refused',
    'gap': r'has a gap before|odometry has a gap',
    'lost span': (
        r'\w+ from \S+ s to \S+ s (are|is) lost|'
        r'(\w+ after \S+ s|until then|messages of \w+) may be lost|'
        r's are missing, up to stamp'
    ),
    'missed': r'actions of pose_cells were lost',
    'no answer': r'does not answer',
    'restarted empty': r'has started with an empty memory|has gone back to an earlier memory',
    'late start': r'this node started late',
}
"""Reports that explain why a map differs from that of the replay, by their texts."""


@dataclass(frozen=True)
class Plan:
    """What happens in a simulation, drawn from the seed.

    kills: time after the start of the drive, in ns, names of the nodes, and time until they start
    again. full: begin and end of a full disk. resends: the source keeps a history.
    lockstep: the source waits for the action of each image, as ``ratslam play --lockstep``.
    duplicates: probability that a message is published twice. swaps: probability that an odometry
    message is published after the next image. backlog: limit of the waiting images, in bytes.
    best_effort: the camera is. ends: how the nodes end, ``closed`` or ``killed``.
    robot: its sensors, of ``ROBOTS``. jitter_ns: deviation of the stamps of odometry, at most.
    """

    bus: BusFaults
    kills: tuple[tuple[int, tuple[str, ...], int], ...]
    full: tuple[int, int] | None
    resends: bool
    lockstep: bool
    duplicates: float
    swaps: float
    backlog: int
    best_effort: bool
    ends: str
    robot: str = 'wheels'
    jitter_ns: int = 0

    @property
    def names(self) -> tuple[str, ...]:
        """The nodes."""
        return ROBOTS[self.robot]

    @property
    def is_repairable(self) -> bool:
        """Whether the source can send everything again, and waits for restarted nodes.

        While it waits, its inputs are silent, and what is held is processed (``flush_after_s``);
        an image that is swapped with an odometry message is late then.
        """
        return (
            self.lockstep
            and self.resends
            and not (self.best_effort and self.bus.loss)
            and not self.backlog
            and not (self.swaps and self.kills)
        )

    @classmethod
    def drawn(cls, seed: int) -> Plan:
        """Return the plan of a seed; each kind of fault occurs in some of them."""
        chance = Scheduler(f'plan {seed}').chance
        bus = BusFaults(
            chance.choice([2, 5, 20]) * MS, chance.choice([0.0, 0.0, 0.002, 0.02]),
            chance.choice([100, 300, 800]) * MS, chance.choice([0.0, 0.02, 0.1]),
            chance.choice([0, 0, 0, 0, 0, 2, 20]), chance.choice([20, 100, 400]) * MS,
            chance.choice([0.0, 0.0, 0.005]),
        )
        robot = chance.choice(ROBOTS_OF_SEEDS)
        kills = []
        for _ in range(chance.choice([0, 1, 1, 2, 3, 4])):
            all_of_them = chance.random() < 0.15
            names = ROBOTS[robot] if all_of_them else (chance.choice(ROBOTS[robot]),)
            kills.append(
                (chance.randrange(DRIVE_S * S), names, chance.choice([100 * MS, S, 3 * S]))
            )
        full = None
        if chance.random() < 0.2:
            begin_ns = chance.randrange(DRIVE_S * S)
            full = begin_ns, begin_ns + chance.randrange(8 * S)
        return cls(
            bus, tuple(sorted(kills)), full, chance.random() < 0.85,
            # In lockstep, each message that is lost in a short queue would take ten seconds.
            bus.depth == 0 and chance.random() < 0.8,
            chance.choice([0.0, 0.0, 0.05]), chance.choice([0.0, 0.0, 0.1]),
            chance.choice([0, 0, 0, SMALL_BACKLOG]), chance.random() < 0.15,
            chance.choice(['closed', 'killed']), robot, chance.choice([0, 0, JITTER_NS]),
        )


@dataclass(frozen=True)
class Event:
    """A message of the world."""

    stamp_ns: int
    topic: str
    message: Any
    recorded: Any
    pixels: Any = None


@cache
def world(robot: str, jitter_ns: int = 0) -> tuple[Event, ...]:
    """Return what the sensors of a robot measure on a drive in circles, in the order of stamps.

    The stamps of odometry deviate by up to ``jitter_ns``.
    """
    events = []
    start_ns, deviations = EPOCH_NS, random.Random('jitter')
    for n in range(DRIVE_S * S // ODOMETRY_NS):
        stamp_ns = start_ns + n * ODOMETRY_NS
        lap_s = PER_LAP * IMAGE_NS / S
        odometry_ns = stamp_ns + deviations.randint(-jitter_ns, jitter_ns)
        odometry = Odometry(header=header_of(odometry_ns, 'odom'), child_frame_id='base_link')
        odometry.twist.twist.linear.x = 2.0 * math.pi * RADIUS_M / lap_s
        odometry.twist.twist.angular.z = 2.0 * math.pi / lap_s
        odometry.pose.pose.orientation.w = 1.0
        twist = odometry.twist.twist
        if 'camera' not in robot:
            events.append(Event(odometry_ns, 'odom', odometry, OdometryEvent(
                odometry_ns, odometry_ns, twist.linear.x, twist.angular.z, 0.0, 0.0,
                Orientation(0.0, 0.0, 0.0, 1.0),
            )))
        number, between = divmod(n * ODOMETRY_NS, IMAGE_NS)
        if between == 0:
            pixels = picture(number % PER_LAP, 24, 32)
            stamp_ns += MS
            image = image_message(stamp_ns, 'camera', pixels)
            recorded = ImageEvent(stamp_ns, stamp_ns, image)
            events.append(Event(stamp_ns, 'image', image, recorded, pixels))
        elif robot == 'laser':
            stamp_ns += 2 * MS
            angle = 2.0 * math.pi * (stamp_ns - EPOCH_NS) / (PER_LAP * IMAGE_NS)
            pose = Pose(RADIUS_M * math.sin(angle), RADIUS_M * (1.0 - math.cos(angle)), angle)
            scan = full_turn(WALLS, pose, BEAMS // 2)
            message = LaserScan(
                header=header_of(stamp_ns, ''), angle_min=scan.angle_min_rad,
                angle_increment=scan.angle_increment_rad, range_max=20.0,
                ranges=scan.ranges_m.astype(np.float32),
            )
            message = deserialize_message(serialize_message(message), LaserScan)  # has float32
            recorded_scan = ScanEvent(stamp_ns, stamp_ns, 0.0, 0.0, 0.0, 20.0, message.ranges)
            events.append(Event(stamp_ns, 'scan', message, recorded_scan))
    return tuple(sorted(events, key=lambda event: event.stamp_ns))


@cache
def replayed(robot: str, jitter_ns: int = 0) -> dict[str, bytes]:
    """Return the digests of what each part has learned in an undisturbed replay."""
    config = extended().with_values(SETTINGS)
    head = 'visual_odometry' if 'camera' in robot else 'local_view'
    slam = RatSLAM(config, head, stages=[LandmarkMapStage] if robot == 'laser' else [])
    for event in world(robot, jitter_ns):
        if event.topic == 'odom':
            slam.odometry(odometry_of(event.message))
        elif event.topic == 'scan':
            slam.scan(scan_from_message(event.message))
        else:
            slam.image(event.stamp_ns, event.pixels)
    slam.finish()
    states = slam.state()
    parts = [kind.SECTION for name in ROBOTS[robot] for kind in KINDS[name]]
    return {part: digest_of(states[part]['core']) for part in parts if part in LEARNING}
