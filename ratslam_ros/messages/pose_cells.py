# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""JSON payload of ``pose_cells/packets``."""

from __future__ import annotations

from typing import Annotated, ClassVar

import numpy as np
from msgspec import Meta
from numpy.typing import NDArray

from ratslam_ros.core.pose_cells.active_cells import ActiveCells
from ratslam_ros.messages.json_schema import Payload, Stamp, about

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
    )]  # fmt: skip
    packets: Annotated[list[_Cell], about(
        'x, y and heading of the peak of each packet, in cells, and the sum of its activities, '
        'the strongest packet first', [[10.25, 4.5, 18.0, 0.875], [3.0, 16.5, 2.25, 0.125]]
    )]  # fmt: skip
    injections: Annotated[list[_Cell], about(
        'x, y and heading of the activity that the last view has injected, in cells, and its '
        'energy; empty if it injected none', [[3.0, 16.5, 2.25, 0.1]]
    )]  # fmt: skip

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
