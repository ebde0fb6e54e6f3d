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

from msgspec import Struct

from ratslam_ros.core.config import Config
from ratslam_ros.core.mapping.pose_hint import PoseHint

NOW = 0
"""Stamp of commands that take effect at once, after all inputs that were released before."""


class Command(Struct, frozen=True):
    """Base class of all commands."""


class Configure(Command, frozen=True):
    """Continue with other values of the parameters that may change at run time."""

    config: Config


class SetMapping(Command, frozen=True):
    """Learn, or only localise the robot on what was learned. stage: '' for all stages."""

    mapping: bool
    stage: str = ''


class SetPaused(Command, frozen=True):
    """Skip a stage: it reads nothing until it goes on, after which it may be elsewhere."""

    paused: bool
    stage: str


class Reset(Command, frozen=True):
    """Start with an empty memory. stage: '' for all stages."""

    stage: str = ''


class Relocated(Command, frozen=True):
    """The robot may have been moved since the last input. stage: '' for all stages."""

    stage: str = ''


class NewSession(Command, frozen=True):
    """The next inputs do not follow the last ones: another drive, or robot.

    The motion since the last session is unknown: the robot is in a separate component until it
    recognises a place. If stamps may begin anywhere, call ``Pipeline.begin_inputs``, too.
    """


class Hint(Command, frozen=True):
    """An operator has given the pose of the robot on the map."""

    hint: PoseHint


class NamePlace(Command, frozen=True):
    """Name the robot's place; rename a place, or remove its name.

    name: its name; '' for the next unused one. rename_to: the new name, '' to keep it.
    offset: pose of the robot in the frame of the current experience, None for that of the map.
    """

    name: str = ''
    rename_to: str = ''
    remove: bool = False
    offset: Sequence[float] | None = None


class SearchPlace(Command, frozen=True):
    """Search for the robot's place by its scans, and relocate it if a place is proven."""


class SetBehaviour(Command, frozen=True):
    """The robot drives by another behaviour, which is stored in the links; '' if unknown."""

    name: str


class ReportBehaviour(Command, frozen=True):
    """The robot reports its behaviour, which is stored in the links for a limited time.

    since_ns: the stamp of the report. failed: the attempt was blocked, and the map counts it.
    ahead_rad: direction in which it should have driven, in the map frame.
    """

    since_ns: int
    name: str
    failed: bool = False
    ahead_rad: float = 0.0


class MarkGoal(Command, frozen=True):
    """Mark the robot's place as a goal of the goal memory."""

    name: str


class BlockWay(Command, frozen=True):
    """The robot cannot drive on to a goal of the goal memory.

    bearing_rad: the direction, relative to the robot, positive to the left. tried_s: how long it
    has tried.
    """

    bearing_rad: float
    tried_s: float


class UseOdometry(Command, frozen=True):
    """`auto` has decided where the odometry comes from: `topic` or `camera`.

    It changes no stage: those of the process were chosen by it. stage: which saves it.
    """

    source: str
    stage: str = 'local_view'


class SetFieldOfView(Command, frozen=True):
    """The calibration of the camera has another horizontal field of view."""

    fov_deg: float


def concerns(command: Command, stage: str) -> bool:
    """Return whether a command is for a stage."""
    return getattr(command, 'stage', '') in ('', stage)
