# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""What the viewer needs of a run and of its controls, whether it is finished, replayed or live."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Protocol

from ratslam_ros.history.history_run import HistoryRun
from ratslam_ros.history.opening import EmptyRun
from ratslam_ros.viewer.live_run import LiveRun

RunSource = EmptyRun | HistoryRun | LiveRun
"""A run that can be shown at any moment: of a history file, live, or without records."""


@dataclass(frozen=True, slots=True)
class Answer:
    """Answer to a request: whether it succeeded, and what was said."""

    success: bool
    message: str


class Controls(Protocol):
    """What the user can ask of the run."""

    @property
    def actions(self) -> Mapping[str, Callable[..., Answer]]:
        """What the run can be asked to do, by name: all but ``run_again`` if it has a robot.

        ``go_to(x_m, y_m, then)`` and ``go_to_place(name, then)`` send a goal, with ``then`` after
        those that have been sent. ``name_place(name)`` names the robot's place,
        ``cancel_goals()`` cancels all goals, and ``relocate()`` searches for the robot's place by
        its laser scans. ``explore(on)``, ``pause_nodes(on)`` and ``mapping(on)`` are switches.
        ``save()``, ``load()`` and ``reset()`` concern the memory of all nodes.
        ``set_parameter(name, value)`` changes a parameter by ``section.name``, and
        ``run_again()`` replays the recording with the changed ones. A request may take a while,
        and never raises.
        """

    @property
    def diagnostics(self) -> dict[str, tuple[str, str]]:
        """Level (`OK`, `WARN`, `ERROR`) and message of every node."""

    @property
    def places(self) -> Sequence[str]:
        """Names of the named places."""

    @property
    def switches(self) -> Mapping[str, bool]:
        """Whether ``explore``, ``mapping`` and ``pause_nodes`` are on, if it is known."""

    @property
    def parameters(self) -> dict[str, object]:
        """Current values of the parameters that can be changed, by ``section.name``."""


FINISHED = (
    'This run is finished, so there is nothing to command. To command a robot, start its nodes '
    'with "ratslam launch --view".'
)


class NoControls:
    """Controls of a finished run."""

    def __init__(self, reason: str = FINISHED):
        self.reason = reason
        """Why there is nothing to command, for the user."""
        self.actions: Mapping[str, Callable[..., Answer]] = {}
        self.diagnostics: dict[str, tuple[str, str]] = {}
        self.places: Sequence[str] = ()
        self.switches: Mapping[str, bool] = {}
        self.parameters: dict[str, object] = {}
