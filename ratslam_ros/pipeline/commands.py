# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Commands: everything that changes a stage and is no measurement.

A command is part of the stream like a message, and takes effect before the first input with its
stamp or a later one. A command without a stamp, or with one that the inputs have passed, gets the
stamp after that of the last released input. So it acts at once, a request need not wait for the
next input, and the inputs with these stamps and commands give the same states again.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from ratslam_ros.core.config import Config
from ratslam_ros.core.mapping.pose_hint import PoseHint

NOW = 0
"""Stamp of commands that take effect at once, after all inputs that were released before."""


@dataclass(frozen=True, slots=True)
class Configure:
    """Continue with other values of the parameters that may change at run time."""

    config: Config


@dataclass(frozen=True, slots=True)
class SetMapping:
    """Learn, or only localise the robot on what was learned. stage: '' for all stages."""

    mapping: bool
    stage: str = ''


@dataclass(frozen=True, slots=True)
class SetPaused:
    """Skip a stage: it reads nothing until it goes on, after which it may be elsewhere."""

    paused: bool
    stage: str


@dataclass(frozen=True, slots=True)
class Reset:
    """Start with an empty memory. stage: '' for all stages."""

    stage: str = ''


@dataclass(frozen=True, slots=True)
class Relocated:
    """The robot may have been moved since the last input. stage: '' for all stages."""

    stage: str = ''


@dataclass(frozen=True, slots=True)
class NewSession:
    """The next inputs do not follow the last ones: another drive, or robot.

    The motion since the last session is unknown: the robot is in a separate component until it
    recognises a place. If stamps may begin anywhere, call ``Pipeline.begin_inputs``, too.
    """


@dataclass(frozen=True, slots=True)
class Hint:
    """An operator has given the pose of the robot on the map."""

    hint: PoseHint


@dataclass(frozen=True, slots=True)
class NamePlace:
    """Name the robot's place; rename a place, or remove its name.

    name: its name; '' for the next unused one. rename_to: the new name, '' to keep it.
    offset: pose of the robot in the frame of the current experience, None for that of the map.
    """

    name: str = ''
    rename_to: str = ''
    remove: bool = False
    offset: Sequence[float] | None = None


@dataclass(frozen=True, slots=True)
class SearchPlace:
    """Search for the robot's place by its scans, and relocate it if a place is proven."""


@dataclass(frozen=True, slots=True)
class SetBehaviour:
    """The robot drives by another behaviour, which is stored in the links; '' if unknown."""

    name: str


@dataclass(frozen=True, slots=True)
class ReportBehaviour:
    """The robot reports its behaviour, which is stored in the links for a limited time.

    since_ns: the stamp of the report. failed: the attempt was blocked, and the map counts it.
    ahead_rad: direction in which it should have driven, in the map frame.
    """

    since_ns: int
    name: str
    failed: bool = False
    ahead_rad: float = 0.0


@dataclass(frozen=True, slots=True)
class MarkGoal:
    """Mark the robot's place as a goal of the goal memory."""

    name: str


@dataclass(frozen=True, slots=True)
class UseOdometry:
    """`auto` has decided where the odometry comes from: `topic` or `camera`.

    It changes no stage: those of the process were chosen by it. stage: which saves it.
    """

    source: str
    stage: str = 'local_view'


@dataclass(frozen=True, slots=True)
class SetFieldOfView:
    """The calibration of the camera has another horizontal field of view."""

    fov_deg: float


Command = (
    Configure | SetMapping | SetPaused | Reset | Relocated | NewSession | Hint | NamePlace
    | SearchPlace | SetBehaviour | ReportBehaviour | MarkGoal | SetFieldOfView | UseOdometry
)


def concerns(command: Command, stage: str) -> bool:
    """Return whether a command is for a stage."""
    return getattr(command, 'stage', '') in ('', stage)
