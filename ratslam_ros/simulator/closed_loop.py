# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""A simulated robot that maps, explores and goes where it is told, in lock-step with the core."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from ratslam_ros.core.config import Config
from ratslam_ros.core.experience_map import ExperienceMap
from ratslam_ros.core.exploration import Exploration
from ratslam_ros.core.goal_follower import Command, GoalFollower
from ratslam_ros.core.local_movement import Scan
from ratslam_ros.core.odometry import Odometry, Pose, Twist
from ratslam_ros.core.ratslam import RatSLAM, Step, ViewStep
from ratslam_ros.simulator.simulation import ImageSample, OdometrySample, ScanSample, Simulator

Steering = Callable[[Scan], Command]


@dataclass
class Log:
    """What happened, for tables and pictures; truth is seen by nobody else.

    Rows at every odometry message: stamp_ns; truth x, y, heading; believed x, y, heading; the
    same by dead reckoning; experience id; the packet's x, y, theta in the pose cells.
    """

    stamp_ns: list[int] = field(default_factory=list)
    truth: list[tuple[float, float, float]] = field(default_factory=list)
    believed: list[tuple[float, float, float]] = field(default_factory=list)
    dead_reckoning: list[tuple[float, float, float]] = field(default_factory=list)
    experience_id: list[int] = field(default_factory=list)
    packet: list[tuple[float, float, float]] = field(default_factory=list)
    closures_ns: list[int] = field(default_factory=list)
    """Stamps at which an experience that is not among the ten newest became current."""
    truth_of: dict[int, tuple[float, float, float]] = field(default_factory=dict)
    """Where the robot truly was when an experience was made."""

    def truths(self) -> NDArray[np.float64]:
        """Return (n, 3) the true poses."""
        return np.array(self.truth)


class ClosedLoop:
    """Simulator and RatSLAM; somebody steers by what the robot senses."""

    def __init__(self, simulator: Simulator, config: Config, exploring_seed: int) -> None:
        """``exploring_seed``: of what the exploration draws by lot."""
        self.simulator = simulator
        self.ratslam = RatSLAM(config)
        self.config = config
        self.exploration = Exploration(
            config.goal_follower, np.random.Generator(np.random.PCG64(exploring_seed))
        )
        self.follower = GoalFollower(config.goal_follower)
        self.log = Log()
        self.command = Command(0.0, 0.0, 'turn')
        self.odometry_pose = Pose(0.0, 0.0, 0.0)
        self._truth_at: dict[int, Pose] = {}

    @property
    def experience_map(self) -> ExperienceMap:
        """The map so far."""
        return self.ratslam.experience_map

    @property
    def now_s(self) -> float:
        """Simulated time since the beginning."""
        return self.simulator.elapsed_s

    def run(self, steer: Steering, until: Callable[[], bool]) -> None:
        """Go on until something holds, which is looked at after every scan."""
        simulator = self.simulator
        while True:
            for sample in simulator.step():
                if isinstance(sample, OdometrySample):
                    self._move(sample)
                elif isinstance(sample, ImageSample):
                    self._truth_at[sample.stamp_ns] = Pose(
                        sample.truth.x_m, sample.truth.y_m, sample.truth.heading_rad
                    )
                    self._note(self.ratslam.image(sample.stamp_ns, sample.image))
                else:
                    self.command = steer(scan_of(sample, simulator))
                    self.ratslam.behaviour = self.command.behaviour
                    simulator.command(self.command.speed_mps, self.command.turn_rate_radps)
                    if until():
                        return

    def explore(self, duration_s: float) -> None:
        """Explore for some time."""
        end_s = self.now_s + duration_s
        self.exploration.restart()
        self.run(self.exploring, lambda: self.now_s >= end_s)

    def exploring(self, scan: Scan) -> Command:
        """Steer as the exploration says."""
        return self.exploration(scan, self.odometry_pose)

    def _move(self, sample: OdometrySample) -> None:
        o = sample.odometry
        self.odometry_pose = Pose(o.pose.x_m, o.pose.y_m, o.pose.heading_rad)
        steps = self.ratslam.odometry(
            Odometry(
                sample.stamp_ns, Twist(o.speed_mps, o.turn_rate_radps), self.odometry_pose
            )
        )
        log, truth = self.log, sample.truth
        at, peak = self.experience_map, self.ratslam.pose_cells.peak
        log.stamp_ns.append(sample.stamp_ns)
        log.truth.append((truth.x_m, truth.y_m, truth.heading_rad))
        log.believed.append(tuple(at.pose))
        log.dead_reckoning.append(tuple(self.ratslam.dead_reckoning))
        log.experience_id.append(at.current_id)
        log.packet.append((peak.x, peak.y, peak.theta))
        self._note(steps)

    def _note(self, steps: Iterable[Step]) -> None:
        for step in steps:
            if not isinstance(step, ViewStep):
                continue
            truth = self._truth_at.pop(step.stamp_ns)
            action = step.action
            if action.action == 'create':
                self.log.truth_of[action.target_id] = tuple(truth)
            elif action.action != 'none' and action.target_id < len(self.experience_map) - 10:
                self.log.closures_ns.append(step.stamp_ns)


def scan_of(sample: ScanSample, simulator: Simulator) -> Scan:
    """Return a simulated scan as a robot's driver gives it."""
    laser = simulator.options.laser
    fov_rad = math.radians(laser.fov_deg)
    return Scan(
        sample.stamp_ns, -fov_rad / 2, fov_rad / (laser.beams - 1),
        sample.ranges_m.astype(np.float64),
    )  # fmt: skip
