# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""JSON payloads of the pose cells for viewers, and directions to goals on them."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Annotated, ClassVar

import numpy as np
from msgspec import Meta, Struct
from numpy.typing import NDArray

from ratslam_ros.core.driving.goal_queue import SoughtGoal
from ratslam_ros.core.pose_cells.active_cells import ActiveCells
from ratslam_ros.messages.json_schema import Payload, Stamp, Text, finite, only_if

MAX_CELLS = 100_000
"""Largest accepted extent of the pose cells, as for the parameters."""

_Extent = Annotated[int, Meta(ge=1, le=MAX_CELLS)]
_Coordinate = Annotated[float, Meta(ge=0.0)]
_Cell = tuple[_Coordinate, _Coordinate, _Coordinate, float]
"""x, y and theta in cells, and an activity."""


class PacketsPayload(Payload, frozen=True):
    """The activity in ``pose_cells/cells``, as packets."""

    TOPIC: ClassVar[str] = 'pose_cells/packets'
    stamp: Stamp
    """Stamp of the last odometry or template message."""
    dims: Annotated[tuple[_Extent, _Extent, _Extent], Meta(examples=[[21, 21, 36]])]
    """Numbers of cells in x, y and heading; the cells wrap around."""
    packets: Annotated[list[_Cell], Meta(examples=[
        [[10.25, 4.5, 18.0, 0.875], [3.0, 16.5, 2.25, 0.125]]
    ])]
    """X, y and heading of the peak of each packet, in cells, and the sum of its activities, the
    strongest packet first."""
    injections: Annotated[list[_Cell], Meta(examples=[[[3.0, 16.5, 2.25, 0.1]]])]
    """X, y and heading of the activity that the last view has injected, in cells, and its energy;
    empty if it injected none."""

    def __post_init__(self) -> None:
        for *cell, _ in (*self.packets, *self.injections):
            if any(at > extent for at, extent in zip(cell, self.dims, strict=True)):
                raise ValueError(f'a cell at {cell}; expected x, y and theta up to {self.dims}')

    @classmethod
    def of(
        cls, stamp_ns: int, dims: tuple[int, int, int], active: ActiveCells
    ) -> PacketsPayload:
        """Return the payload of the activity; its cells are not included."""
        return cls(
            Stamp.of(stamp_ns), dims, active.packets.tolist(), active.injections.tolist()
        )

    @property
    def arrays(self) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """The packets and the injections, (n, 4) each."""
        packets, injections = (
            np.array(cells, np.float64).reshape(-1, 4)
            for cells in (self.packets, self.injections)
        )
        return packets, injections


class GoalMemoryPayload(Payload, frozen=True):
    """Direction to a goal on the pose cells."""

    TOPIC: ClassVar[str] = 'pose_cells/goal_memory'
    stamp: Stamp
    """Stamp of the odometry."""
    goal: Annotated[str, Meta(examples=['goal_1'])]
    """Name of the goal."""
    bearing_rad: Annotated[float | None, Meta(examples=[-0.42])]
    """Direction relative to the robot, positive to the left; null at the goal, and if no route is
    known."""
    remaining_s: Annotated[float | None, Meta(examples=[18.5])]
    """Expected time to the goal; null if no route is known."""
    reached: bool
    """Whether the activity peak is within one cell of the goal, which then leaves the queue."""
    given_up: Text = ''
    """Why the goal leaves the queue without being reached; left out if it does not."""
    waiting: tuple[str, ...] = ()
    """Names of the goals that follow; left out if there are none."""

    @classmethod
    def of(
        cls, stamp_ns: int, sought: SoughtGoal, waiting: Sequence[str] = ()
    ) -> GoalMemoryPayload:
        """Return the direction to a goal, and the names of those that follow."""
        return cls(
            Stamp.of(stamp_ns), sought.name, sought.bearing_rad, finite(sought.remaining_s),
            sought.is_reached, only_if(sought.given_up != '', sought.given_up),
            only_if(len(waiting) > 0, tuple(waiting)),
        )


class _Active(Struct, frozen=True):
    id: Annotated[int, Meta(examples=[12])]
    """The experience."""
    activity: Annotated[float, Meta(examples=[0.875])]
    """Above 0, at most 2; see [algorithm.md](algorithm.md#activity-of-experiences)."""


class ActivePayload(Payload, frozen=True):
    """Experiences of the current template near the activity peak."""

    TOPIC: ClassVar[str] = 'pose_cells/active_experiences'
    stamp: Stamp
    """Stamp of the template."""
    template_id: Annotated[int, Meta(examples=[17])]
    """The current template."""
    experiences: list[_Active]
    """The most active first."""

    @classmethod
    def of(
        cls, stamp_ns: int, template_id: int, active: Sequence[tuple[int, float]]
    ) -> ActivePayload:
        """Return the payload of the id and activity of each experience."""
        return cls(Stamp.of(stamp_ns), template_id, [_Active(*one) for one in active])
