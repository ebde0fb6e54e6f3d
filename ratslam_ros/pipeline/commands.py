# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Commands: everything that changes a stage and is no measurement.

A command is part of the stream like a message. With a stamp it takes effect before the first input
with that stamp or a later one; with the stamp 0 it takes effect at once.
"""

from __future__ import annotations

from dataclasses import dataclass

from ratslam_ros.core.config import Config
from ratslam_ros.core.mapping.pose_hint import PoseHint

NOW = 0
"""Stamp of commands that take effect at once, after all inputs that were processed before."""


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

    Held inputs are dropped, and stamps may begin anywhere. The motion since the last session is
    unknown: the robot is in a separate component until it recognises a place.
    """


@dataclass(frozen=True, slots=True)
class Flush:
    """Process all held inputs: none is expected at present."""


@dataclass(frozen=True, slots=True)
class Hint:
    """An operator has given the pose of the robot on the map."""

    hint: PoseHint


@dataclass(frozen=True, slots=True)
class SetBehaviour:
    """The robot drives by another behaviour, which is stored in the links; '' if unknown."""

    name: str


@dataclass(frozen=True, slots=True)
class SetFieldOfView:
    """The calibration of the camera has another horizontal field of view."""

    fov_deg: float


Command = (
    Configure | SetMapping | SetPaused | Reset | Relocated | NewSession | Flush | Hint
    | SetBehaviour | SetFieldOfView
)


def concerns(command: SetMapping | Reset | Relocated, stage: str) -> bool:
    """Return whether a command is for a stage."""
    return command.stage in ('', stage)
