# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Items that stages write: templates are ``ViewMatch``, odometry is ``Odometry``."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

from ratslam_ros.core.common.pose import Pose
from ratslam_ros.core.mapping.id_map import NO_MEMORY_NS
from ratslam_ros.core.mapping.map_update import MapUpdate, PrunedExperience
from ratslam_ros.core.pose_cells.map_action import NO_EXPERIENCE, MapAction
from ratslam_ros.core.pose_cells.map_relocation import MapRelocation
from ratslam_ros.core.vision.local_view import ViewMatch


class Template(NamedTuple):
    """A match of a live process, and the stamp of the memory that its id belongs to."""

    match: ViewMatch
    memory_ns: int


class NumberedAction(NamedTuple):
    """An action of the pose cells; the numbers count from 0.

    memory_ns: stamp of the memory of the pose cells, whose ids it has; see core/mapping/id_map.py.
    """

    number: int
    action: MapAction
    memory_ns: int = NO_MEMORY_NS


class Answer(NamedTuple):
    """Answer of the map to an action: where it has relocated the robot, None if it has not.

    memory_ns: that of the action, whose ids it has.
    """

    number: int
    relocation: MapRelocation | None
    memory_ns: int = NO_MEMORY_NS


class MapStep(NamedTuple):
    """What an action, with the ids of the map, changed in it."""

    number: int
    action: MapAction
    update: MapUpdate


@dataclass(frozen=True, slots=True)
class OdometryStep:
    """Result of one odometry message.

    ``pose``: estimate on the map, composed of the pose of experience ``experience_id`` and
    ``offset``. ``dead_reckoning``: pose by odometry alone. ``gap_s``: length of the gap of the
    odometry that this message ends, after which the motion is unknown; otherwise 0.
    """

    stamp_ns: int
    pose: Pose
    dead_reckoning: Pose
    experience_id: int
    offset: Pose
    gap_s: float = 0.0


@dataclass(frozen=True, slots=True)
class ViewStep:
    """Result of one template message.

    ``pruned``: the experience that made room for a new one. ``rejected``: the loop-closure gate
    rejected the action, and the map is unchanged. ``relocated_to``: experience to which scans have
    relocated the robot after the action, -1 if they have not. ``reason``: why the gate rejected
    the action, '' if it did not.
    """

    stamp_ns: int
    match: ViewMatch
    action: MapAction
    pruned: PrunedExperience | None = None
    rejected: bool = False
    relocated_to: int = NO_EXPERIENCE
    reason: str = ''


Step = OdometryStep | ViewStep
