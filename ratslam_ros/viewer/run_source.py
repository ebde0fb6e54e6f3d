# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""What the viewer needs of a run, whether it is finished, being replayed or live."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Protocol

from ratslam_ros.history.records import ViewRecord
from ratslam_ros.history.run_state import RunState


class RunSource(Protocol):
    """A run that can be shown at any moment."""

    @property
    def title(self) -> str:
        """Name of the run, such as that of the recording."""

    @property
    def begin_ns(self) -> int:
        """Stamp of the first record, 0 if there is none yet."""

    @property
    def end_ns(self) -> int:
        """Stamp of the last record, 0 if there is none yet."""

    @property
    def is_growing(self) -> bool:
        """Whether more records may follow."""

    @property
    def notices(self) -> Sequence[str]:
        """What the user must know, such as that only the final state can be shown."""

    @property
    def required_views(self) -> float | None:
        """Number of views that must agree on a place (``pc_vt_agree_views``), None if unknown."""

    def seek(self, stamp_ns: int) -> RunState:
        """Return a new state: that of the last record whose stamp is not later."""

    def advance(self, state: RunState, stamp_ns: int) -> None:
        """Apply to a state all records between it and a later stamp."""

    def image_at(self, stamp_ns: int) -> bytes | None:
        """Return the best image of a stamp as JPEG, None if there is none near it."""

    def view_at(self, stamp_ns: int) -> ViewRecord | None:
        """Return the last view whose stamp is not later."""

    def step(self, stamp_ns: int, views: int) -> int:
        """Return the stamp of the view that is a number of views later, or earlier if negative."""

    def visits(self, experience_id: int, until_ns: int) -> list[ViewRecord]:
        """Return the first view of every visit of an experience up to a stamp, oldest first."""

    def closures(self, until_ns: int) -> list[ViewRecord]:
        """Return the newest views that closed a loop, or would have but for a reason.

        They are in order of time; a source limits their number.
        """


@dataclass(frozen=True, slots=True)
class Answer:
    """Answer to a request: whether it succeeded, and what was said."""

    success: bool
    message: str


class Controls(Protocol):
    """What the user can ask of the run; every request may take a while, and never raises.

    ``actions`` names the requests that this run has: the viewer offers only those.
    """

    @property
    def actions(self) -> frozenset[str]:
        """Names of the methods that can be used."""

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

    def go_to(self, x_m: float, y_m: float, then: bool = False) -> Answer:
        """Send a goal on the map; with ``then`` after the goals that have been sent."""

    def go_to_place(self, name: str, then: bool = False) -> Answer:
        """Send a named place as goal."""

    def name_place(self, name: str) -> Answer:
        """Name the robot's place."""

    def cancel_goals(self) -> Answer:
        """Cancel all goals."""

    def explore(self, on: bool) -> Answer:
        """Start or end exploration."""

    def pause_nodes(self, on: bool) -> Answer:
        """Have all nodes ignore their inputs, or continue."""

    def mapping(self, on: bool) -> Answer:
        """Switch learning on or off."""

    def relocate(self) -> Answer:
        """Search for the place of the robot by its laser scans."""

    def save(self) -> Answer:
        """Save the memory of all nodes."""

    def load(self) -> Answer:
        """Load the saved memory of all nodes."""

    def reset(self) -> Answer:
        """Empty the memory of all nodes."""

    def set_parameter(self, name: str, value: object) -> Answer:
        """Change a parameter, by ``section.name``."""

    def run_again(self) -> Answer:
        """Replay the recording again with the changed parameters."""


