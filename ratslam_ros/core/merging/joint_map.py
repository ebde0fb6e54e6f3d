# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Joint map: experiences and links of all sessions in one numbering, before fusing."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ratslam_ros.core.common.angles import wrap
from ratslam_ros.core.common.pose import Pose, composed, inverse
from ratslam_ros.core.config import ExperienceMapParameters
from ratslam_ros.core.mapping.link_weights import reach_m
from ratslam_ros.core.mapping.links import Link, Links
from ratslam_ros.core.mapping.odometry_noise import OdometryNoise
from ratslam_ros.core.mapping.optimiser import PoseGraphOptimiser
from ratslam_ros.core.merging.session import SessionMap

Reals = NDArray[np.float64]
Ints = NDArray[np.int64]

FREE_ROTATION_RAD = 0.6
"""Largest difference of the headings of two poses of one place."""

MAX_ITERATIONS = 100
"""Largest number of iterations of reweighted least squares; they converge in less than 20."""


class Correspondence(NamedTuple):
    """Two experiences of different sessions at one place.

    ``known``, ``seen``: the experiences, by their numbers on the joint map. ``pose``: of the
    latter in the frame of the former. ``same_view``: whether their views match. ``by_scan``:
    whether scans measured the pose; otherwise it follows from the views.
    """

    known: int
    seen: int
    pose: Pose
    same_view: bool = True
    by_scan: bool = False


class JointMap:
    """Experiences of all sessions, in parts whose relative poses are unknown at first."""

    def __init__(self, sessions: Sequence[SessionMap]) -> None:
        """Combine the maps of sessions, which keep their frames."""
        self.sessions = sessions
        first = sessions[0]
        self.parameters: ExperienceMapParameters = first.config.experience_map
        core = first.session.states['experience_map']['core']
        self.view_spacing_m = float(core.get('view_spacing_m', 0.0))
        """Scale of the weights of links; 0 if all links have the same weight."""
        self.noise = OdometryNoise()
        """Noise of the odometry, from the first session."""
        if 'odometry_noise' in core:
            self.noise.restore(core['odometry_noise'])
            self.noise.restart()
        starts = np.cumsum([0, *[len(one) for one in sessions]])
        self.starts: list[int] = starts.tolist()
        """Number of the first experience of each session, and of all experiences."""
        self.poses: Reals = np.concatenate([one.poses for one in sessions])
        self.session_of: Ints = np.repeat(np.arange(len(sessions)), np.diff(starts))
        self.parts: list[tuple[int, int]] = []
        """Number of the session and component of each part."""
        self.part_of: Ints = np.zeros(len(self.poses), np.int64)
        self.links: list[Link] = []
        for number, one in enumerate(sessions):
            for component in sorted(set(one.components.tolist())):
                members = np.flatnonzero(one.components == component) + starts[number]
                self.part_of[members] = len(self.parts)
                self.parts.append((number, component))
            self.links += [
                replace(
                    link, source_id=link.source_id + self.starts[number],
                    target_id=link.target_id + self.starts[number],
                )
                for link in one.links
            ]
        total_m = sum(link.distance_m for link in self.links if not link.recognised)
        total_s = sum(link.duration_s for link in self.links if not link.recognised)
        self.s_per_m = total_s / total_m if total_m > 0.0 else 0.0
        """Mean duration of driving a metre."""

    def __len__(self) -> int:
        return len(self.poses)

    def owner(self, number: int) -> tuple[int, int]:
        """Return the number of the session of an experience, and its id there."""
        session = int(self.session_of[number])
        return session, number - self.starts[session]

    def pose_of(self, number: int) -> Pose:
        """Return the pose of an experience."""
        return Pose(*self.poses[number].tolist())

    def members(self, part: int) -> Ints:
        """Return the experiences of a part, ascending."""
        found: Ints = np.flatnonzero(self.part_of == part)
        return found

    def part_name(self, part: int) -> str:
        """Return the name of a part for messages."""
        number, component = self.parts[part]
        one = self.sessions[number]
        has_several = len(set(one.components.tolist())) > 1
        return f'{one.name} (component {component})' if has_several else one.name

    def join_link(self, one: Correspondence) -> Link:
        """Return the link of a correspondence, as a recognition makes it."""
        pose = inverse(one.pose)
        return Link.by_pose(
            one.seen, one.known, pose, math.hypot(pose.x_m, pose.y_m) * self.s_per_m,
            recognised=self.view_spacing_m > 0.0 and not one.by_scan,
        )

    def relaxed(
        self, poses: Reals, correspondences: Iterable[Correspondence], among: Ints
    ) -> Reals:
        """Return poses after relaxation with links for correspondences.

        Args:
            poses: (n, 3) poses, at which the connected parts lie about right to each other.
            correspondences: the correspondences.
            among: experiences to relax. The others keep their poses.
        """
        row_of = np.full(len(self), -1, np.int64)
        row_of[among] = np.arange(len(among))
        links = Links()
        for link in [*self.links, *map(self.join_link, correspondences)]:
            source, target = int(row_of[link.source_id]), int(row_of[link.target_id])
            if min(source, target) >= 0 and links.row(source, target) is None:
                links.append(replace(link, source_id=source, target_id=target))
        poses = poses.copy()
        part = poses[among]
        self.settle(part, links)
        poses[among] = part
        return poses

    def settle(self, poses: Reals, links: Links) -> None:
        """Relax poses with the optimiser of the experience map until they do not change any more.

        Args:
            poses: (n, 3); changed in place.
            links: the constraints; recognitions that the others contradict are deleted.
        """
        optimiser = PoseGraphOptimiser(self.parameters)
        if len(links) == 0 or not optimiser.is_enabled:
            return
        optimiser.view_spacing_m, optimiser.noise = self.view_spacing_m, self.noise
        for _ in range(MAX_ITERATIONS):
            optimiser.settle(poses, links)
            if optimiser.is_settled:
                break


def links_of(links: Iterable[Link]) -> Links:
    """Return links as one table."""
    table = Links()
    for link in links:
        table.append(link)
    return table


def relative(poses: Reals, one: Correspondence) -> Pose:
    """Return the pose of the seen experience in the frame of the known one."""
    known, seen = Pose(*poses[one.known].tolist()), Pose(*poses[one.seen].tolist())
    return composed(inverse(known), seen)


def residual(poses: Reals, one: Correspondence) -> tuple[float, float]:
    """Return distance in m and rotation in rad by which poses deviate from a correspondence."""
    known, seen = Pose(*poses[one.known].tolist()), Pose(*poses[one.seen].tolist())
    return _deviation(composed(known, one.pose), seen)


def is_same_place(known: Pose, seen: Pose, relative_rad: float, spacing_m: float) -> bool:
    """Return whether two matching views were learned close enough to be of one place.

    Args:
        known, seen: poses at which the views were learned.
        relative_rad: rotation between them according to the match.
        spacing_m: view spacing.
    """
    expected = composed(known, Pose(0.0, 0.0, relative_rad))
    away_m, turned_rad = _deviation(expected, seen)
    return away_m <= reach_m(0.0, 0.0, spacing_m) and turned_rad <= FREE_ROTATION_RAD


def _deviation(expected: Pose, found: Pose) -> tuple[float, float]:
    error = composed(inverse(expected), found)
    return math.hypot(error.x_m, error.y_m), abs(wrap(error.heading_rad))
