# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Closed loop of the simulator and RatSLAM: a robot that maps, explores and drives to goals."""

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
from ratslam_ros.core.driving.exploration import Exploration, LookBacks
from ratslam_ros.core.driving.goal_follower import GoalFollower, in_robot_frame
from ratslam_ros.core.driving.steering import Command
from ratslam_ros.core.driving.untried_exits import UntriedExits
from ratslam_ros.core.mapping.experience_map import ExperienceMap
from ratslam_ros.core.navigation.goals import Target
from ratslam_ros.core.navigation.navigator import GoalTask, Navigator
from ratslam_ros.core.navigation.route_following import Guidance
from ratslam_ros.core.pose_cells.map_action import NO_EXPERIENCE
from ratslam_ros.core.pose_cells.torus import Place
from ratslam_ros.pipeline.items import Step, ViewStep
from ratslam_ros.pipeline.ratslam import RatSLAM
from ratslam_simulator.samples import ImageSample, OdometrySample, ScanSample, SonarSample
from ratslam_simulator.simulation import Simulator
from ratslam_simulator.sonar_scan import SonarScans

Steering = Callable[[Scan], Command]
"""Controller: computes a command from a scan."""

NEWEST_COUNT = 10
"""Newest experiences, to which a link is not counted as a loop closure."""


@dataclass
class Log:
    """Record of a run for evaluation; the true poses in it must not be used for control.

    The first six lists have one entry per odometry sample: its stamp, the true pose, the pose
    estimated by the experience map, the pose by dead reckoning, the id of the current experience,
    and the position of the activity packet in the pose cells.
    """

    stamp_ns: list[int] = field(default_factory=list)
    truth: list[Pose] = field(default_factory=list)
    estimated: list[Pose] = field(default_factory=list)
    dead_reckoning: list[Pose] = field(default_factory=list)
    experience_id: list[int] = field(default_factory=list)
    packet: list[Place] = field(default_factory=list)
    closures_ns: list[int] = field(default_factory=list)
    """Stamps of loop closures: an experience that is not among the newest became current."""
    jump_m: list[float] = field(default_factory=list)
    """True distance of the robot from the experience at each loop closure."""
    relocations_ns: list[int] = field(default_factory=list)
    """Stamps of those closures that were relocations by scans."""
    truth_of: dict[int, Pose] = field(default_factory=dict)
    """Id of an experience -> true pose of the experience when it was created."""

    def truths(self) -> NDArray[np.float64]:
        """Return the true poses, (n, 3)."""
        return np.array(self.truth)


class ClosedLoop:
    """A simulator and RatSLAM in lock-step, with controllers that steer by the scans.

    Controllers of a robot with sonars take these as scans, and not those of a laser.

    Attributes:
        tries_failed: number of behaviours of the goal follower that timed out without progress.
        links_unlearned: number of links that the experience map unlearned because of them.
    """

    def __init__(
        self, simulator: Simulator, config: Config, exploring_seed: int,
        look_backs: LookBacks = LookBacks(),
    ) -> None:
        """Connect RatSLAM to a simulator.

        Args:
            simulator: simulator of a robot with a laser or sonars.
            config: configuration of RatSLAM and of the goal follower.
            exploring_seed: seed of the exploration's random decisions.
            look_backs: when the exploring robot turns back.
        """
        self.simulator = simulator
        self.ratslam = RatSLAM(config)
        self.config = config
        self.exploration = Exploration(
            config.goal_follower, np.random.Generator(np.random.PCG64(exploring_seed)), look_backs
        )
        self.follower = GoalFollower(config.goal_follower)
        self.navigator = Navigator(config.goal_recall, self.experience_map)
        self.experience_map.on_pruned.append(self.navigator.remove_pruned)
        self._exits: UntriedExits | None = None
        if config.goal_follower.explore_by == 'exits':
            self._exits = UntriedExits(config.goal_follower, self.navigator.planner)
            self.experience_map.on_pruned.append(self._exits.remove_pruned)
        sonars = simulator.options.sonars
        self._sonar_scans = SonarScans(sonars.mounts) if sonars is not None else None
        self.guidance = Guidance('idle')
        self.tries_failed = self.links_unlearned = 0
        self.log = Log()
        self.command = Command(0.0, 0.0, 'turn')
        self.odometry_pose = Pose(0.0, 0.0, 0.0)
        self._truth_at: dict[int, Pose] = {}

    @property
    def experience_map(self) -> ExperienceMap:
        """Experience map of RatSLAM."""
        return self.ratslam.experience_map

    @property
    def now_s(self) -> float:
        """Simulated time since the start, in seconds."""
        return self.simulator.elapsed_s

    def run(self, steer: Steering, until: Callable[[], bool]) -> None:
        """Run the loop until a condition holds, which is evaluated after every scan."""
        simulator = self.simulator
        over = False
        while not over:
            for sample in simulator.step():
                if isinstance(sample, OdometrySample):
                    self._move(sample)
                elif isinstance(sample, ImageSample):
                    self._truth_at[sample.stamp_ns] = sample.truth
                    self._note(self.ratslam.image(sample.stamp_ns, sample.image))
                else:
                    scan = self._scan(sample)
                    if scan is None:
                        continue
                    self.command = steer(scan)
                    self.ratslam.behaviour = self.command.behaviour
                    simulator.command(self.command.speed_mps, self.command.turn_rate_radps)
                    over = until()

    def explore(self, duration_s: float) -> None:
        """Explore for a simulated duration."""
        end_s = self.now_s + duration_s
        self.exploration.restart()
        self.run(self.exploring, lambda: self.now_s >= end_s)

    def exploring(self, scan: Scan) -> Command:
        """Return the command of the exploration for a scan."""
        if self._exits is not None:
            command = self._exits.command(scan, self.ratslam.pose, self.ratslam.offset)
            if command is not None:
                self.exploration.restart()
                return command
        return self._along_walls(scan)

    def _along_walls(self, scan: Scan) -> Command:
        return self.exploration.command(scan, self.odometry_pose)

    def name_place(self, name: str) -> None:
        """Name the present place of the robot, as an operator who accompanies it would."""
        self.navigator.goals.name_place(self.experience_map, name, self.ratslam.offset)

    def go_to(self, *targets: Target, until: Callable[[], bool] = lambda: False) -> list[GoalTask]:
        """Drive to targets in order.

        Args:
            targets: names or experience ids.
            until: condition under which the remaining targets are cancelled.

        Returns:
            The goal tasks with their outcomes.

        Raises:
            UnreachableGoal: a target is unknown, or no link leads to it.
        """
        tasks = self.navigator.go_to(*targets)
        self.exploration.restart()
        self.run(self.seeking, lambda: not self.navigator.queue or until())
        self.navigator.cancel()
        return tasks

    def seeking(self, scan: Scan) -> Command:
        """Return the command along the route for a scan, or of the exploration without a route."""
        graph = self.experience_map
        pose = self.ratslam.pose
        self.guidance = self.navigator.update(scan.stamp_ns, pose)
        if self.guidance.explore:
            return self._along_walls(scan)
        if len(self.guidance.positions_m) == 0:
            return Command(0.0, 0.0, 'turn')
        route = in_robot_frame(pose, self.guidance.positions_m)
        command = self.follower.command(scan, route, self.guidance.behaviour)
        if command.failed:
            self.tries_failed += 1
            if self.navigator.report_blocked():
                ahead_rad = wrap(pose.heading_rad + command.ahead_rad)
                self.links_unlearned += graph.unlearn_blocked(command.behaviour, ahead_rad, pose)
        return command

    def _scan(self, sample: ScanSample | SonarSample) -> Scan | None:
        """Let RatSLAM use a scan; return the one to steer by, None if it is of another sensor."""
        if isinstance(sample, SonarSample):
            assert self._sonar_scans is not None  # there is a sample
            return self._sonar_scans.add(sample.stamp_ns, sample.ranges_m, self.odometry_pose)
        scan = scan_from_sample(sample, self.simulator)
        self._note(self.ratslam.scan(scan))
        looks_ahead = scan.laser == 0 and self._sonar_scans is None
        return scan if looks_ahead else None

    def _move(self, sample: OdometrySample) -> None:
        reading = sample.odometry
        self.odometry_pose = reading.pose
        twist = Twist(reading.speed_mps, reading.turn_rate_radps)
        steps = self.ratslam.odometry(Odometry(sample.stamp_ns, twist, reading.pose))
        log, graph = self.log, self.experience_map
        log.stamp_ns.append(sample.stamp_ns)
        log.truth.append(sample.truth)
        log.estimated.append(graph.pose)
        log.dead_reckoning.append(self.ratslam.dead_reckoning)
        log.experience_id.append(graph.current_id)
        log.packet.append(self.ratslam.pose_cells.peak)
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
            elif action.action != 'none' and not step.rejected and (
                action.target_id < len(self.experience_map) - NEWEST_COUNT
            ):
                self._note_closure(step.stamp_ns, truth, action.target_id)
            if step.relocated_to != NO_EXPERIENCE:
                self.log.relocations_ns.append(step.stamp_ns)
                self._note_closure(step.stamp_ns, truth, step.relocated_to)

    def _note_closure(self, stamp_ns: int, truth: Pose, target_id: int) -> None:
        target = self.log.truth_of[target_id]
        self.log.closures_ns.append(stamp_ns)
        self.log.jump_m.append(math.hypot(target.x_m - truth.x_m, target.y_m - truth.y_m))


def scan_from_sample(sample: ScanSample, simulator: Simulator) -> Scan:
    """Convert a scan sample to the scan that the core takes."""
    laser = simulator.options.lasers[sample.laser]
    ranges_m = sample.ranges_m.astype(np.float64)
    mount = laser.mount
    return Scan(
        sample.stamp_ns, laser.first_rad + mount.heading_rad, laser.step_rad, ranges_m, mount.x_m,
        mount.y_m, sample.laser,
    )
