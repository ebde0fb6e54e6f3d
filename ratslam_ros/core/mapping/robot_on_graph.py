# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The robot on the graph: how odometry, places, hints, scans and losses change its pose.

``ExperienceMap`` decides which places the robot is at, and links them.
"""

from __future__ import annotations

import math
from typing import NamedTuple, Self

import numpy as np
from numpy.typing import NDArray

from ratslam_ros.core.common.odometry import Motion, moved
from ratslam_ros.core.common.pose import Pose, composed, inverse
from ratslam_ros.core.config import ExperienceMapParameters
from ratslam_ros.core.mapping.carried import Carried
from ratslam_ros.core.mapping.graph import ExperienceGraph
from ratslam_ros.core.mapping.loop_closure_gate import CONTRADICTING_VIEW_COUNT, LoopClosureGate
from ratslam_ros.core.mapping.optimiser import PoseGraphOptimiser
from ratslam_ros.core.mapping.pose_covariance import (
    Localisation,
    Matrix,
    OdometryVariance,
    PoseCovariance,
    isotropic,
)
from ratslam_ros.core.mapping.pose_hint import LONGEST_M, GivenHint, PoseHint
from ratslam_ros.core.mapping.scan_match import ScanMatch
from ratslam_ros.core.pose_cells.map_action import NO_EXPERIENCE


class Departure(NamedTuple):
    """The experience from which the robot came to known places, and its way since by odometry.

    Attributes:
        experience_id: the experience.
        offset: pose of the robot in its frame.
        duration_s, travelled_m: time and distance since.
    """

    experience_id: int
    offset: Pose
    duration_s: float
    travelled_m: float

    @classmethod
    def from_state(cls, state: list[float]) -> Self:
        """Return the departure with a saved state."""
        experience_id, x_m, y_m, heading_rad, duration_s, travelled_m = state
        return cls(int(experience_id), Pose(x_m, y_m, heading_rad), duration_s, travelled_m)

    def state(self) -> list[float]:
        """Return what is saved."""
        return [self.experience_id, *self.offset, self.duration_s, self.travelled_m]

    def moved(self, motion: Motion) -> Self:
        """Return the departure after one more motion."""
        return self._replace(
            offset=moved(self.offset, motion), duration_s=self.duration_s + motion.dt_s,
            travelled_m=self.travelled_m + abs(motion.distance_m),
        )


class RobotOnGraph(ExperienceGraph):
    """The experience graph, and the robot's pose relative to its current experience."""

    def __init__(self, origin: Pose, parameters: ExperienceMapParameters) -> None:
        super().__init__(origin, parameters.map_frame)
        self.mapping = True
        """Whether the graph is extended and relaxed; if not, the robot is only localised on it."""
        self.current_id = NO_EXPERIENCE
        """Id of the current experience, -1 before the first one."""
        self.offset = Pose(0.0, 0.0, 0.0)
        """Pose of the robot in the frame of the current experience, or of the start before it."""
        self.departure: Departure | None = None
        """Where the robot came from, if its current experience was known before."""
        self.covariance = PoseCovariance()
        """Covariance of the robot's pose, and why it is unknown if it is."""
        self.hint: GivenHint | None = None
        """Where the robot is according to an operator, until recognised places confirm or refute
        it."""
        self.gate = LoopClosureGate()
        """Loop-closure gate; used with ``exp_gate_closures``."""
        self.carried = Carried()
        """Evidence of views that the robot was carried; used with ``exp_gate_closures``."""
        self._duration_s = self._odometer_m = 0.0
        self.travelled_m = 0.0
        """Distance travelled since the current experience, in m."""
        self.optimiser = PoseGraphOptimiser(parameters)
        """Relaxation of the graph, with the noise of the odometry that weighs its links."""

    @property
    def pose(self) -> Pose:
        """Pose of the robot on the map, including the motion since the current experience."""
        return composed(self.pose_of(self.current_id), self.offset)

    @property
    def view_spacing_m(self) -> float:
        """Distance between neighbouring views in m, 0 if it was not measured."""
        return self.optimiser.view_spacing_m

    @property
    def localisation(self) -> Localisation:
        """What is known of the robot's pose on the map."""
        return 'uncertain' if self.hint is not None else self.covariance.localisation

    def seen_from(self, experience_id: int) -> Pose | None:
        """Return the robot's pose in the frame of an experience.

        None if the id does not exist, or the experience is in another component than the robot.
        """
        if not 0 <= experience_id < len(self) or self.is_apart(experience_id):
            return None
        return composed(inverse(self.pose_of(experience_id)), self.pose)

    @property
    def odometer_m(self) -> float:
        """Distance travelled since the start, in m, forwards and backwards."""
        return self._odometer_m

    @property
    def created_m(self) -> NDArray[np.float64]:
        """(n,) odometer readings at which the experiences were created, in m; a view."""
        return self._created_at_m.values

    def integrate(self, motion: Motion) -> None:
        """Compose one motion with the offset from the current experience.

        An unknown motion ends the component of the map: there is no current experience, and the
        next one begins a new component at the present pose.
        """
        if not motion.is_known:
            self.optimiser.noise.restart()
            self._separate()
            self.lose('the motion since the last recognised place is unknown')
            return
        motion = motion.corrected(self.optimiser.turns)
        distance_m = abs(motion.distance_m)
        self.offset = moved(self.offset, motion)
        self._duration_s += motion.dt_s
        self.travelled_m += distance_m
        self._odometer_m += distance_m
        if self.departure is not None:
            self.departure = self.departure.moved(motion)
        self.optimiser.noise.integrate(motion)
        self.covariance.integrate(motion, self._noise)
        if self.hint is not None and self._odometer_m - self.hint.odometer_m > LONGEST_M:
            self.lose(f'no recognised place has confirmed the given pose within {LONGEST_M:g} m')

    def suggest(self, hint: PoseHint) -> bool:
        """Move the robot to a pose on the map that an operator has given.

        A component begins there, so that the operator's error does not bend the map. Recognised
        places confirm the pose, or refute it (``_fits_hint``). It has no effect on an empty map,
        which begins where the robot is, and if it agrees with a pose that is known better.

        Returns:
            Whether the robot was moved.
        """
        if len(self) == 0:
            return False
        expected = hint.covariance + self.view_covariance
        if self.localisation == 'localised' and self.covariance.agrees(
            self.pose, hint.pose, expected
        ):
            return False
        self._separate()
        self.gate.discard_path()
        self.gate.accepts_next = False
        self.offset = composed(inverse(self.origin), hint.pose)
        self.hint = GivenHint(hint, self._odometer_m)
        self.covariance.replace(hint.covariance)
        return True

    def lose(self, reason: str) -> None:
        """Make the robot's pose on the map unknown; an empty map begins where the robot is.

        Args:
            reason: why, for the user.
        """
        self.hint = None
        if len(self):
            self.covariance.lose(reason)

    def confirm(self) -> None:
        """Take scans into account that agree with those around the robot's pose."""
        if self._is_in_map:
            self.covariance.limit(self.view_covariance)

    def fuse(self, recognised: Pose) -> None:
        """Take a recognition into account that agrees with the pose, without moving the robot."""
        measured = self.view_covariance
        if self._is_in_map and self.covariance.agrees(self.pose, recognised, measured):
            self.covariance.fuse(measured)

    @property
    def _noise(self) -> OdometryVariance:
        """Variances that driving adds."""
        noise = self.optimiser.noise
        return noise.by_scans or noise.variance(self.view_spacing_m)

    def _noise_since(self, scan_match: ScanMatch) -> Matrix:
        """Return the covariance of the motion since a scan."""
        m2_per_m, rad2_per_m, _ = self._noise
        driven_m = scan_match.driven_m
        return isotropic(math.sqrt(m2_per_m * driven_m), math.sqrt(rad2_per_m * driven_m))

    def _align(self, scan_match: ScanMatch) -> None:
        """Correct the robot's pose relative to the current experience by a scan."""
        measured, offset = scan_match.current_covariance, scan_match.from_current
        if offset is None:
            return
        if measured is not None:
            self.optimiser.noise.compare(self.offset, offset, self.mapping)
            self.covariance.align(measured + self._noise_since(scan_match))
        self.offset = offset

    def _locate(self, scan_match: ScanMatch) -> None:
        """Take into account that the pose was set to a recognised one, by a scan or its view."""
        if not self._is_in_map:
            return
        if scan_match.covariance is None:
            self.covariance.replace(self.view_covariance)
            return
        since = self._noise_since(scan_match)
        # The place is where the robot was when it was learned, as long after its scan as now.
        self.covariance.replace(scan_match.covariance + 2.0 * since)
        self.covariance.relative = scan_match.covariance + since

    @property
    def _is_in_map(self) -> bool:
        """Whether the robot is in the main component.

        A place of a component that began after a gap proves nothing about the rest of the map.
        """
        return self._components.current == self._components.first

    @property
    def view_covariance(self) -> Matrix:
        """Covariance of the pose by a recognised view."""
        return self.optimiser.noise.recognition(self.view_spacing_m)

    def _fits_hint(self, target: int, target_offset: Pose) -> bool:
        """Return whether a place of another component may be where the robot is.

        If it contradicts the given pose, a second such place is required that agrees with it. The
        hint has served its purpose then, as after a place that agrees with it.
        """
        if self.hint is not None:
            here, claimed = self.pose, composed(self.pose_of(target), target_offset)
            if not self.covariance.agrees(
                here, claimed, self.view_covariance
            ) and not self.gate.record_closure(
                here, claimed, required_count=CONTRADICTING_VIEW_COUNT
            ):
                return False
        self.hint = None
        return True

    def is_doubtful(self, experience_id: int) -> bool:
        """Return whether an experience may be in a wrong place, as the robot was carried before.

        That it is recognised again proves nothing.
        """
        carried = self.carried
        return carried.is_lost and self.created_at_m(experience_id) > carried.since_m

    # Components

    def is_apart(self, experience_id: int) -> bool:
        """Return whether an experience is in another component than the robot."""
        return self._components.of(experience_id) != self._components.current

    def _separate(self) -> None:
        """Begin a new component; nothing happens if the present one has no experience."""
        if self.current_id == NO_EXPERIENCE:
            return
        self.offset = composed(inverse(self.origin), self.pose)
        self.current_id, self.departure = NO_EXPERIENCE, None
        self._duration_s = self.travelled_m = 0.0
        self._components.begin()
        self.gate.discard_path()
        self.carried.restart()

    def rejoin(self, target: int, target_offset: Pose) -> None:
        """Connect the components of the robot and of the place where it was recognised.

        The later component is moved rigidly, so that both poses of the robot coincide. If the
        robot has no experience in its component, or ``mapping`` is False, it only changes the
        component.

        Args:
            target: the recognised experience.
            target_offset: pose of the robot in the frame of the target.
        """
        components = self._components
        here, there = components.current, components.of(target)
        recognised = composed(self.pose_of(target), target_offset)
        if self.current_id == NO_EXPERIENCE or not self.mapping:
            components.current = there
            self.current_id, self.offset = target, target_offset
            return
        moved_part, fixed_part, before, after = here, there, self.pose, recognised
        if here < there:
            moved_part, fixed_part, before, after = there, here, recognised, self.pose
        transform = composed(after, inverse(before))
        for experience_id in components.members(moved_part):
            self._poses[experience_id] = composed(transform, self.pose_of(experience_id))
        components.merge(moved_part, fixed_part)
