# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Map actions: the output of the pose cells and the input of the experience map."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal, NamedTuple

from ratslam_ros.core.common.odometry import Motion
from ratslam_ros.core.common.pose import Pose
from ratslam_ros.core.common.turn_correction import TurnCorrection
from ratslam_ros.core.pose_cells.torus import Place

Action = Literal['create', 'link', 'set', 'none']

NO_EXPERIENCE = -1
"""Experience id that stands for no experience."""


@dataclass(frozen=True, slots=True)
class MapAction:
    """Change of the experience map that one template message causes.

    Attributes:
        action: ``create`` adds an experience and makes it current; ``link`` makes an existing
            experience current by a transition that occurs for the first time, ``set`` by one that
            has occurred before; ``none`` keeps the current experience.
        source_id: the previous current experience, -1 if none.
        target_id: the new current experience, -1 if none. A ``create`` with the id of an existing
            experience prunes that experience and reuses its id.
        template_id: the template of the message.
        relative_rad: heading of the robot minus the heading of the target's view.
        place: the target's place in the pose cells; the peak of activity if there is no target.
        correction: correction of the odometry with later stamps; None to leave it as it is.
        recognised_id: experience that the view was recognised as, current or not; -1 if none.
        agreement: share of the required number of recognitions that agree with it, 0 to 1.
        view_spacing_m: scale of the weights of the links, see ``link_weights``; with 0 all links
            have the same weight.
    """

    action: Action
    source_id: int
    target_id: int
    template_id: int
    relative_rad: float
    place: Place
    correction: TurnCorrection | None = None
    recognised_id: int = NO_EXPERIENCE
    agreement: float = 0.0
    view_spacing_m: float = 0.0

    @property
    def relative_pose(self) -> Pose:
        """Pose of the robot in the frame of the target, at whose position it is recognised."""
        return Pose(0.0, 0.0, self.relative_rad)


class Viewed(NamedTuple):
    """How the pose cells have processed a view.

    Attributes:
        has_effect: False if it showed no template, or the robot may be anywhere.
        is_again: whether its template is that of the view before.
        component: component that the robot is in.
        is_learning: whether the pose cells learn.
    """

    has_effect: bool
    is_again: bool
    component: int
    is_learning: bool


class Extension:
    """A part beside the published algorithm; each method does nothing unless it is overridden."""

    def integrate(self, motion: Motion) -> None:
        """Follow a known motion of the robot."""

    def restart(self) -> None:
        """Continue where the robot is now; the motion since the last view is unknown."""

    def extended(self, action: MapAction, view: Viewed) -> MapAction:
        """Return the action of a view with what the extension adds to it."""
        return action
