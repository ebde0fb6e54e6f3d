# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Sessions of robots on a square track, on floors that look different, for merging."""

from __future__ import annotations

import math
from functools import cache

import numpy as np
from gap_drives import GAP_NS, true_pose
from helpers import START_NS, extended, twist
from numpy.typing import NDArray

from ratslam_ros.core.common.angles import wrap
from ratslam_ros.core.config import Config
from ratslam_ros.core.config.parameter import Value
from ratslam_ros.core.merging.merge import MergedMap
from ratslam_ros.core.merging.session import Session
from ratslam_ros.core.pose_cells.map_action import NO_EXPERIENCE
from ratslam_ros.pipeline.ratslam import RatSLAM

PERIOD_NS = 500_000_000
WIDTH, HEIGHT = 12, 6
LAP = 80
"""Steps of a lap of 40 m."""


def config(**changes: Value) -> Config:
    return extended().with_values({
        'local_view.template_x_size': WIDTH, 'local_view.template_y_size': HEIGHT,
        'local_view.vt_shift_match': 1, 'local_view.vt_match_threshold': 0.1,
        'local_view.vt_patch_normalise': 0,
        'pose_cells.pc_dim_xy': 41, 'pose_cells.pc_cell_x_size': 0.5,
        'pose_cells.exp_delta_pc_threshold': 0.6, 'pose_cells.pc_vt_agree_views': 3.0,
        'pose_cells.pc_vt_agree_spacing': 1.0,
        'inputs.max_odom_gap_s': 2.0,
        'experience_map.exp_initial_em_deg': 0.0,
        **changes,
    })


@cache
def view(place: int, floor: int, alike: int) -> NDArray[np.uint8]:
    """Return the image at a place of the track.

    If ``alike`` is above 0, each place whose number it divides looks as on floor 1, and the others
    as on the next floor.
    """
    if alike:
        floor = 1 if place % alike == 0 else floor + 1
    rng = np.random.default_rng((floor, place % LAP))
    return rng.integers(0, 256, (HEIGHT, WIDTH)).astype(np.uint8)


class Robot:
    """A robot on the track."""

    def __init__(
        self, start: int, floor: int = 1, noise: int = 0, slam: RatSLAM | None = None,
        alike: int = 0, **changes: Value,
    ) -> None:
        self.config = config(**changes)
        self.slam = slam or RatSLAM(self.config)
        self.at, self.floor, self._alike = start, floor, alike
        self._stamp_ns = START_NS
        self._rng = np.random.default_rng(noise)
        self._noise = noise
        self.places: dict[int, int] = {}
        """Experience -> place at which it was created."""
        self._observe(0.0, 0.0)

    @classmethod
    def on(cls, slam: RatSLAM, start: int, noise: int) -> Robot:
        """Return a robot that continues in a map."""
        return cls(start, noise=noise, slam=slam)

    def carry(self, steps: int) -> None:
        """Move the robot during a gap of the odometry."""
        self._stamp_ns += GAP_NS
        self.at += steps
        self._observe(0.0, 0.0)

    def forward(self, steps: int) -> Robot:
        """Drive along the track."""
        for _ in range(steps):
            before, after = true_pose(self.at), true_pose(self.at + 1)
            self._stamp_ns += PERIOD_NS
            self.at += 1
            length_m = math.dist(before[:2], after[:2])
            self._observe(length_m, wrap(after.heading_rad - before.heading_rad))
        return self

    def _observe(self, length_m: float, turn_rad: float) -> None:
        error, turned = 0.01 * self._rng.normal(size=2) * (self._noise > 0)
        period_s = PERIOD_NS * 1e-9
        length_m *= 1.0 + error
        self.slam.odometry(
            twist(self._stamp_ns, length_m / period_s, (turn_rad + turned) / period_s)
        )
        image = view(self.at, self.floor, self._alike).astype(np.int64)
        if self._noise:
            image = np.clip(image + self._rng.integers(-9, 10, image.shape), 0, 255)
        self.slam.image(self._stamp_ns, image.astype(np.uint8))
        current = self.slam.experience_map.current_id
        if current != NO_EXPERIENCE:
            self.places.setdefault(current, self.at)

    def session(self, name: str) -> Session:
        """Return the map."""
        return Session(name, self.config, self.slam.state())


def continued(merged: MergedMap) -> RatSLAM:
    """Return a system that continues in a merged map."""
    slam = RatSLAM(merged.config)
    slam.restore(merged.states)
    slam.begin_session()
    return slam


def size(merged: MergedMap) -> tuple[int, int, int]:
    """Return the numbers of templates, experiences and components."""
    core = merged.states['experience_map']['core']
    templates = merged.states['local_view']['core']['templates']
    return len(templates), len(core['labels']), merged.components
