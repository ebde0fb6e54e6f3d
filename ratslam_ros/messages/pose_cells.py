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
from ratslam_ros.messages.json_schema import Payload, Stamp, Text, about, finite, only_if

MAX_CELLS = 100_000
"""Largest accepted extent of the pose cells, as for the parameters."""

_Extent = Annotated[int, Meta(ge=1, le=MAX_CELLS)]
_Coordinate = Annotated[float, Meta(ge=0.0)]
_Cell = tuple[_Coordinate, _Coordinate, _Coordinate, float]
"""x, y and theta in cells, and an activity."""


class PacketsPayload(Payload, frozen=True):
    """The activity in ``pose_cells/cells``, as packets."""

    TOPIC: ClassVar[str] = 'pose_cells/packets'
    stamp: Annotated[Stamp, about('stamp of the last odometry or template message')]
    dims: Annotated[tuple[_Extent, _Extent, _Extent], about(
        'numbers of cells in x, y and heading; the cells wrap around', [21, 21, 36]
    )]
    packets: Annotated[list[_Cell], about(
        'x, y and heading of the peak of each packet, in cells, and the sum of its activities, '
        'the strongest packet first', [[10.25, 4.5, 18.0, 0.875], [3.0, 16.5, 2.25, 0.125]]
    )]
    injections: Annotated[list[_Cell], about(
        'x, y and heading of the activity that the last view has injected, in cells, and its '
        'energy; empty if it injected none', [[3.0, 16.5, 2.25, 0.1]]
    )]

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
    stamp: Annotated[Stamp, about('stamp of the odometry')]
    goal: Annotated[str, about('name of the goal', 'goal_1')]
    bearing_rad: Annotated[float | None, about(
        'direction relative to the robot, positive to the left; null at the goal, and if no route '
        'is known', -0.42
    )]
    remaining_s: Annotated[float | None, about(
        'expected time to the goal; null if no route is known', 18.5
    )]
    reached: Annotated[bool, about(
        'whether the activity peak is within one cell of the goal, which then leaves the queue'
    )]
    given_up: Annotated[Text, about(
        'why the goal leaves the queue without being reached; left out if it does not'
    )] = ''
    waiting: Annotated[tuple[str, ...], about(
        'names of the goals that follow; left out if there are none'
    )] = ()

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
    id: Annotated[int, about('the experience', 12)]
    activity: Annotated[float, about(
        'above 0, at most 2; see [algorithm.md](algorithm.md#activity-of-experiences)', 0.875
    )]


class ActivePayload(Payload, frozen=True):
    """Experiences of the current template near the activity peak."""

    TOPIC: ClassVar[str] = 'pose_cells/active_experiences'
    stamp: Annotated[Stamp, about('stamp of the template')]
    template_id: Annotated[int, about('the current template', 17)]
    experiences: Annotated[list[_Active], about('the most active first')]

    @classmethod
    def of(
        cls, stamp_ns: int, template_id: int, active: Sequence[tuple[int, float]]
    ) -> ActivePayload:
        """Return the payload of the id and activity of each experience."""
        return cls(Stamp.of(stamp_ns), template_id, [_Active(*one) for one in active])
