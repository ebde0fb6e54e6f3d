# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""A simulated robot that maps, explores and goes where it is told, in lock-step with the core."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from ratslam_ros.core.common.angles import wrap
from ratslam_ros.core.common.odometry import Odometry, Twist
from ratslam_ros.core.common.pose import Pose
from ratslam_ros.core.common.scan import Scan
from ratslam_ros.core.config import Config
from ratslam_ros.core.driving.exploration import Exploration
from ratslam_ros.core.driving.goal_follower import GoalFollower, in_robot_frame
from ratslam_ros.core.driving.steering import Command
from ratslam_ros.core.mapping.experience_map import ExperienceMap
from ratslam_ros.core.navigation.goals import Target
from ratslam_ros.core.navigation.navigator import GoalTask, Navigator
from ratslam_ros.core.navigation.route_following import Guidance
from ratslam_ros.core.pose_cells.torus import Place
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
    truth: list[Pose] = field(default_factory=list)
    believed: list[Pose] = field(default_factory=list)
    dead_reckoning: list[Pose] = field(default_factory=list)
    experience_id: list[int] = field(default_factory=list)
    packet: list[Place] = field(default_factory=list)
    closures_ns: list[int] = field(default_factory=list)
    """Stamps at which an experience that is not among the ten newest became current."""
    jump_m: list[float] = field(default_factory=list)
    """How far off the robot truly was, each time that an older experience became current."""
    truth_of: dict[int, Pose] = field(default_factory=dict)
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
        self.navigator = Navigator(config.goal_recall, self.experience_map)
        self.experience_map.on_forgotten.append(self.navigator.forgotten)
        self.guidance = Guidance('idle')
        self.tries_failed = self.links_unlearned = 0
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
        """Go on until something holds, which is looked at after every step with a scan."""
        simulator = self.simulator
        over = False
        while not over:
            for sample in simulator.step():
                if isinstance(sample, OdometrySample):
                    self._move(sample)
                elif isinstance(sample, ImageSample):
                    self._truth_at[sample.stamp_ns] = Pose(
                        sample.truth.x_m, sample.truth.y_m, sample.truth.heading_rad
                    )
                    self._note(self.ratslam.image(sample.stamp_ns, sample.image))
                else:
                    scan = scan_of(sample, simulator)
                    self.ratslam.scan(scan)
                    self.command = steer(scan)
                    self.ratslam.behaviour = self.command.behaviour
                    simulator.command(self.command.speed_mps, self.command.turn_rate_radps)
                    over = until()

    def explore(self, duration_s: float) -> None:
        """Explore for some time."""
        end_s = self.now_s + duration_s
        self.exploration.restart()
        self.run(self.exploring, lambda: self.now_s >= end_s)

    def exploring(self, scan: Scan) -> Command:
        """Steer as the exploration says."""
        return self.exploration.command(scan, self.odometry_pose)

    def name_place(self, name: str) -> None:
        """Call the place where the robot is by a name, as somebody who walks beside it would."""
        self.navigator.goals.name_place(self.experience_map, name, self.ratslam.offset)

    def go_to(self, *targets: Target, until: Callable[[], bool] = lambda: False) -> list[GoalTask]:
        """Go to some places; return what became of each.

        ``until``: give up when this holds.

        Raises:
            UnreachableGoal: one is not known, or no link leads there.
        """
        errands = self.navigator.go_to(*targets)
        self.exploration.restart()
        self.run(self.seeking, lambda: not self.navigator.queue or until())
        self.navigator.cancel()
        return errands

    def seeking(self, scan: Scan) -> Command:
        """Steer along the route; where it is lost explore."""
        graph = self.experience_map
        here = self.ratslam.pose
        self.guidance = self.navigator.update(scan.stamp_ns, here)
        if self.guidance.explore:
            return self.exploring(scan)
        if len(self.guidance.positions_m) == 0:
            return Command(0.0, 0.0, 'turn')
        route = in_robot_frame(here, self.guidance.positions_m)
        command = self.follower.command(scan, route, self.guidance.behaviour)
        if command.failed:
            self.tries_failed += 1
            if self.navigator.report_blocked():
                ahead_rad = wrap(here.heading_rad + command.ahead_rad)
                self.links_unlearned += graph.fail(command.behaviour, ahead_rad, here)
        return command

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
        log.truth.append(Pose(truth.x_m, truth.y_m, truth.heading_rad))
        log.believed.append(at.pose)
        log.dead_reckoning.append(self.ratslam.dead_reckoning)
        log.experience_id.append(at.current_id)
        log.packet.append(peak)
        self._note(steps)

    def _note(self, steps: Iterable[Step]) -> None:
        for step in steps:
            if not isinstance(step, ViewStep):
                continue
            truth = self._truth_at.pop(step.stamp_ns)
            action = step.action
            if action.action == 'create':
                heading_rad = wrap(truth.heading_rad - action.relative_rad)
                self.log.truth_of[action.target_id] = truth._replace(heading_rad=heading_rad)
            elif action.action == 'none' or step.refused:
                continue
            elif action.target_id < len(self.experience_map) - 10:
                self.log.closures_ns.append(step.stamp_ns)
                there = self.log.truth_of[action.target_id]
                self.log.jump_m.append(math.hypot(there.x_m - truth.x_m, there.y_m - truth.y_m))


def scan_of(sample: ScanSample, simulator: Simulator) -> Scan:
    """Return a simulated scan as a robot's driver gives it."""
    laser = simulator.options.laser
    assert laser is not None  # or there would be no sample
    ranges_m = sample.ranges_m.astype(np.float64)
    return Scan(sample.stamp_ns, laser.first_rad, laser.step_rad, ranges_m)
