# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""A robot with a laser on a small floor; it is carried, and then sees only new views."""

from __future__ import annotations

import math
from typing import NamedTuple

from helpers import START_NS, extended, seen, twist
from rooms import Line, scan_in

from ratslam_ros.core.common.angles import wrap
from ratslam_ros.core.common.odometry import Motion, Odometry, moved
from ratslam_ros.core.common.pose import Pose
from ratslam_ros.core.common.scan import Scan
from ratslam_ros.core.config import Config
from ratslam_ros.core.config.parameter import Value
from ratslam_ros.core.vision.local_view import ViewMatch
from ratslam_ros.pipeline.items import ViewStep
from ratslam_ros.pipeline.ratslam import RatSLAM

STEP_NS = 250_000_000
STEP_M, STEP_RAD = 0.16, math.pi / 12.0

FLOOR: list[Line] = [
    [(0.0, 0.0), (14.0, 0.0), (14.0, 4.0), (15.0, 4.0), (15.0, 6.0), (14.0, 6.0), (14.0, 11.0),
     (9.0, 11.0), (9.0, 12.0), (6.0, 12.0), (6.0, 11.0), (0.0, 11.0), (0.0, 7.5), (-0.8, 7.5),
     (-0.8, 6.5), (0.0, 6.5), (0.0, 0.0)],
    [(2.5, 2.5), (2.5, 8.5), (4.5, 8.5), (4.5, 8.0), (8.0, 8.0), (8.0, 8.5), (11.5, 8.5),
     (11.5, 6.0), (11.0, 6.0), (11.0, 2.5), (7.0, 2.5), (7.0, 3.0), (5.0, 3.0), (5.0, 2.5),
     (2.5, 2.5)],
    [(12.6, 0.0), (12.6, 0.5), (13.0, 0.5), (13.0, 0.0)],
    [(0.0, 3.0), (0.4, 3.0), (0.4, 3.7), (0.0, 3.7)],
]
"""A ring of corridors with niches, and no two corners alike."""

START = Pose(1.25, 1.25, 0.0)
SIDES_M = (11.36, 8.32, 11.36, 8.32)
"""A lap: straight on, and a left turn after each side."""

LAP_STEPS = sum(round(side_m / STEP_M) for side_m in SIDES_M) + 4 * 6


class Sample(NamedTuple):
    """What the robot measures at one moment, and where it is."""

    stamp_ns: int
    truth: Pose
    odometry: Odometry
    scan: Scan
    match: ViewMatch


def config(**changes: Value) -> Config:
    return extended().with_values({
        'pose_cells.pc_dim_xy': 61, 'pose_cells.pc_cell_x_size': 0.25,
        'experience_map.exp_align_scans': True, 'experience_map.exp_gate_closures': True,
        'experience_map.exp_relocate': 'both', 'experience_map.exp_initial_em_deg': 0.0,
        **{name.replace('__', '.'): value for name, value in changes.items()},
    })


def lap() -> list[tuple[float, float]]:
    """Return the distance and turn of every step of a lap."""
    steps: list[tuple[float, float]] = []
    for side_m in SIDES_M:
        steps += [(STEP_M, 0.0)] * round(side_m / STEP_M) + [(0.0, STEP_RAD)] * 6
    return steps


def samples(laps: int, carried_to: Pose | None = None, steps: int = 0) -> list[Sample]:
    """Drive some laps; then carry the robot to where all views are new, and drive straight on.

    Args:
        laps: number of laps; each view lasts for two steps.
        carried_to: pose that the robot is carried to; None: it continues.
        steps: number of steps after that, along the lap or, if it was carried, straight on.
    """
    around = lap()
    motions = around * laps + (around if carried_to is None else [(STEP_M, 0.0)] * 200)[:steps]
    pose, at_ns, found = START, START_NS, []
    known: set[int] = set()
    for n, (distance_m, turn_rad) in enumerate([(0.0, 0.0), *motions]):
        if n == laps * len(around) + 1 and carried_to is not None:
            pose = carried_to
        pose = moved(pose, Motion(0.25, distance_m, turn_rad))
        at_ns += STEP_NS
        is_carried = n > laps * len(around) and carried_to is not None
        view = (n if is_carried else n % len(around)) // 2
        match = seen(view, is_new=view not in known)
        known.add(view)
        odometry = twist(at_ns, distance_m / 0.25, turn_rad / 0.25)
        found.append(Sample(at_ns, pose, odometry, scan_in(FLOOR, pose, at_ns, beams=181), match))
    return found


class Drive:
    """RatSLAM, fed with samples."""

    def __init__(self, parameters: Config) -> None:
        self.slam = RatSLAM(parameters, 'pose_cells')
        self.steps: list[ViewStep] = []

    def feed(self, given: list[Sample]) -> None:
        for sample in given:
            for step in (
                *self.slam.odometry(sample.odometry), *self.slam.scan(sample.scan),
                *self.slam.template(sample.stamp_ns, sample.match),
            ):
                if isinstance(step, ViewStep):
                    self.steps.append(step)

    def error(self, truth: Pose) -> tuple[float, float]:
        """Return the error of the robot's pose on the map, in m and rad."""
        pose = self.slam.pose
        x, y = truth.x_m - START.x_m, truth.y_m - START.y_m
        turned = abs(wrap(pose.heading_rad - truth.heading_rad))
        return math.dist(pose[:2], (x, y)), turned
