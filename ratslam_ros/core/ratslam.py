# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""RatSLAM: one step, as the architecture's picture shows it.

    camera image --+--> visual_odometry --> odometry <-- wheel encoders
                   |                           |
                   +--> local_view -template-> pose_cells -action-> experience_map
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from contextlib import AbstractContextManager, contextmanager, nullcontext
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ratslam_ros.core.common.odometry import MotionFromOdometry, Odometry, moved
from ratslam_ros.core.common.pose import Pose, composed
from ratslam_ros.core.common.scan import Scan
from ratslam_ros.core.common.stamp_order import Counts, Released, StampOrder
from ratslam_ros.core.config import Config
from ratslam_ros.core.goal_memory.goal_memory import GoalMemory
from ratslam_ros.core.mapping.experience_map import ExperienceMap, Forgotten
from ratslam_ros.core.mapping.scan_matching import ScanMatcher
from ratslam_ros.core.pose_cells.map_action import MapAction
from ratslam_ros.core.pose_cells.pose_cells import PoseCells
from ratslam_ros.core.vision.local_view import UNDECODABLE, LocalView, ViewMatch
from ratslam_ros.core.vision.visual_odometry import VisualOdometry
from ratslam_ros.errors import UnusableParameter

Stopwatch = Callable[[str], AbstractContextManager[object]]


@dataclass(frozen=True, slots=True)
class OdometryStep:
    """What one odometry message led to: the believed pose, and what it is made of."""

    stamp_ns: int
    pose: Pose
    dead_reckoning: Pose
    experience_id: int
    offset: Pose


@dataclass(frozen=True, slots=True)
class ViewStep:
    """What one template message led to.

    ``forgotten``: whose number a new experience took. ``refused``: the map did not believe the
    action, and did nothing.
    """

    stamp_ns: int
    match: ViewMatch
    action: MapAction
    forgotten: Forgotten | None = None
    refused: bool = False


Step = OdometryStep | ViewStep


class RatSLAM:
    """All four parts in one process, fed in any order that the order rule allows."""

    def __init__(
        self,
        config: Config,
        visual_odometry: bool = False,
        stopwatch: Stopwatch = lambda name: nullcontext(),
    ) -> None:
        """Prepare an empty map.

        Args:
            config: all parameters.
            visual_odometry: take odometry from the images.
            stopwatch: entered with a part's name around each of its steps (core has no clock).
        """
        self.visual_odometry = VisualOdometry(config.visual_odometry) if visual_odometry else None
        self.local_view = LocalView(config.local_view)
        self.pose_cells = PoseCells(config.pose_cells)
        self.experience_map = ExperienceMap(config.experience_map)
        self.behaviour = ''
        """Name of what the robot is doing, for the links that it makes; empty: nobody tells."""
        self.goal_memory: GoalMemory | None = None
        """Learns beside the map, where ``goal_memory.goal_memory`` is set."""
        if config.goal_memory.goal_memory:
            self.goal_memory = GoalMemory(config.goal_memory, config.pose_cells)
        self.scans = ScanMatcher() if config.experience_map.exp_align_scans else None
        """Tells where at a recognised place the robot is, where there is a laser."""
        self.dead_reckoning = self.experience_map.origin
        self.order: StampOrder[Odometry | ViewMatch] = StampOrder(
            ('odometry', 'template'), round(config.pose_cells.max_lateness_s * 1e9)
        )
        self._motion = MotionFromOdometry(config.pose_cells.odom_source)
        self._images: StampOrder[NDArray[np.uint8] | None] = StampOrder(('image',), 0)
        self._refused = 0
        self._looked = False
        self._watch = stopwatch

    @property
    def counts(self) -> Counts:
        """What did not make it into the map."""
        order, images = self.order.counts, self._images.counts
        return Counts(order.late, order.refused + images.refused + self._refused)

    @property
    def offset(self) -> Pose:
        """Motion since the current experience, that which waits for a view included."""
        waiting = (o for o in self.order.waiting('odometry') if isinstance(o, Odometry))
        return self._motion.ahead(waiting, self.experience_map.offset)

    @property
    def pose(self) -> Pose:
        """Where the robot is on the map now."""
        at = self.experience_map
        return composed(at.pose_of(at.current_id), self.offset)

    def image(self, stamp_ns: int, image: NDArray[np.uint8] | None) -> list[Step]:
        """Take one image, (H, W) uint8 grey, or None where it could not be decoded."""
        return self._look(self._images.push('image', stamp_ns, image))

    def _look(self, images: Iterable[Released[NDArray[np.uint8] | None]]) -> list[Step]:
        return [step for stamp_ns, _, image in images for step in self._see(stamp_ns, image)]

    def _see(self, stamp_ns: int, image: NDArray[np.uint8] | None) -> list[Step]:
        match, odometry = UNDECODABLE, None
        if image is not None:
            if self.visual_odometry is not None:
                with self._fitting(), self._watch('visual_odometry'):
                    odometry = self.visual_odometry.estimate(stamp_ns, image)
            with self._fitting(), self._watch('local_view'):
                match = self.local_view.match(image)
                self._looked = True
        steps = [] if odometry is None else self.odometry(odometry.as_received())
        return steps + self.template(stamp_ns, match)

    @contextmanager
    def _fitting(self) -> Iterator[None]:
        """Take an image unlike those before, that no window fits, for one without pixels."""
        try:
            yield
        except UnusableParameter:
            if not self._looked:
                raise  # the crop, window or template does not fit this camera

    def odometry(self, odometry: Odometry) -> list[Step]:
        """Take one odometry message; return what it and those that waited for it led to.

        One that is not finite is refused, and counted.
        """
        if not self._motion.accepts(odometry):
            self._refused += 1
            return []
        return self._process(self.order.push('odometry', odometry.stamp_ns, odometry))

    def template(self, stamp_ns: int, match: ViewMatch) -> list[Step]:
        """Take one template message; return what it and those that waited for it led to."""
        return self._process(self.order.push('template', stamp_ns, match))

    def scan(self, scan: Scan) -> None:
        """Take one laser scan, before the images of its time; see ``exp_align_scans``."""
        if self.scans is not None:
            self.scans.scan(scan)

    def finish(self) -> list[Step]:
        """Process all that still waits."""
        return self._look(self._images.flush()) + self._process(self.order.flush())

    def _process(self, released: Iterable[Released[Odometry | ViewMatch]]) -> list[Step]:
        return [
            self._move(item) if isinstance(item, Odometry) else self._act(stamp_ns, item)
            for stamp_ns, _, item in released
        ]

    def _move(self, odometry: Odometry) -> OdometryStep:
        motion = self._motion.update(odometry)
        if motion is not None:
            with self._watch('pose_cells'):
                self.pose_cells.integrate(motion)
            if self.goal_memory is not None:
                with self._watch('goal_memory'):
                    self.goal_memory.integrate(motion, self.pose_cells)
            self.experience_map.integrate(motion)
            self.dead_reckoning = moved(self.dead_reckoning, motion)
            if self.scans is not None:
                self.scans.integrate(odometry.stamp_ns, motion)
        at = self.experience_map
        return OdometryStep(
            odometry.stamp_ns, at.pose, self.dead_reckoning, at.current_id, at.offset
        )

    def _act(self, stamp_ns: int, match: ViewMatch) -> ViewStep:
        with self._watch('pose_cells_view'):
            action = self.pose_cells.view(match)
        with self._watch('experience_map'):
            at, sight = self.experience_map, None
            if self.scans is not None:
                expected = at.seen_from(action.target_id)
                sight = self.scans.locate(stamp_ns, action, at.current_id, at.offset, expected)
            before = at.gate.refused
            forgotten = at.apply(action, self.behaviour, sight)
            refused = at.gate.refused > before
            if refused and self.scans is not None:
                self.scans.refused()
        return ViewStep(stamp_ns, match, action, forgotten, refused)
