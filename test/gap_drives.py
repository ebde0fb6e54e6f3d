# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""A robot on a square track whose odometry has gaps, in which the robot is moved."""

from __future__ import annotations

import math

from helpers import START_NS, extended, seen, twist

from ratslam_ros.core.common.angles import wrap
from ratslam_ros.core.common.odometry import Odometry
from ratslam_ros.core.common.pose import Pose, composed, inverse
from ratslam_ros.core.config import Config
from ratslam_ros.pipeline.items import Step, ViewStep
from ratslam_ros.pipeline.ratslam import RatSLAM

PERIOD_NS = 500_000_000
STEP_M = 0.5
SIDE_STEPS, SIDES = 20, 4
LAP_STEPS = SIDE_STEPS * SIDES
GAP_NS = 10 * 10**9
"""Longer than the limit of 2 s."""


def config(max_gap_s: float = 2.0, **changes: float | str | bool) -> Config:
    return extended().with_values({
        'pose_cells.pc_dim_xy': 41, 'pose_cells.exp_delta_pc_threshold': 0.4,
        'experience_map.exp_initial_em_deg': 0.0,
        'inputs.max_odom_gap_s': max_gap_s, **changes,
    })


def true_pose(step: int) -> Pose:
    """Return the pose on a square track after a number of steps.

    The odometry turns a corner in one step, so its chord differs from the true step by 0.2 m.
    """
    side, along = divmod(step % LAP_STEPS, SIDE_STEPS)
    x, y = [(0.0, 0.0), (10.0, 0.0), (10.0, 10.0), (0.0, 10.0)][side]
    heading = wrap(side * math.pi / 2.0)
    distance = along * STEP_M
    return Pose(x + distance * math.cos(heading), y + distance * math.sin(heading), heading)


class Drive:
    """A robot on the square track, where each step has its own template."""

    def __init__(self, parameters: Config) -> None:
        self.slam = RatSLAM(parameters, 'pose_cells')
        self.stamp_ns = START_NS
        self.at = 0
        self.truths: dict[int, Pose] = {}
        self.steps: list[Step] = []
        self.messages: dict[int, Odometry] = {}
        self.templates: dict[int, int] = {}
        self._observe()

    def forward(self, steps: int) -> None:
        """Drive along the track."""
        for _ in range(steps):
            self.stamp_ns += PERIOD_NS
            turn = wrap(
                true_pose(self.at + 1).heading_rad - true_pose(self.at).heading_rad
            )
            self.at += 1
            self._observe(STEP_M, turn)

    def stand(self, messages: int) -> None:
        for _ in range(messages):
            self.stamp_ns += PERIOD_NS
            self._observe()

    def carry(self, steps: int, gap_ns: int = GAP_NS) -> None:
        """Move the robot during a gap, after which its odometry shows the last velocity."""
        self.stamp_ns += gap_ns
        self.at += steps
        self._observe(STEP_M)

    def _observe(self, distance_m: float = 0.0, turn_rad: float = 0.0) -> None:
        dt_s = PERIOD_NS * 1e-9
        self.truths[self.stamp_ns] = true_pose(self.at)
        slam = self.slam
        message = twist(self.stamp_ns, distance_m / dt_s, turn_rad / dt_s)
        self.messages[self.stamp_ns] = message
        self.templates[self.stamp_ns] = self.at % LAP_STEPS
        self.steps += slam.odometry(message)
        self.steps += slam.template(self.stamp_ns, seen(self.at % LAP_STEPS))

    def finish(self) -> RatSLAM:
        self.steps += self.slam.finish()
        return self.slam

    def error_m(self) -> float:
        """Return the largest error of an experience, after alignment at experience 0."""
        poses = [e.pose for e in self.slam.experience_map.experiences()]
        truths = [
            self.truths[step.stamp_ns] for step in self.steps
            if isinstance(step, ViewStep) and step.action.action == 'create'
        ]
        to_map = composed(poses[0], inverse(truths[0]))
        return max(
            math.dist(composed(to_map, truth)[:2], pose[:2])
            for pose, truth in zip(poses, truths, strict=True)
        )
