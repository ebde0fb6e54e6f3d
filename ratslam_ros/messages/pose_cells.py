# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""JSON payload of ``pose_cells/packets``."""

from __future__ import annotations

from typing import Annotated, ClassVar

import numpy as np
from msgspec import Meta
from numpy.typing import NDArray

from ratslam_ros.core.pose_cells.active_cells import ActiveCells
from ratslam_ros.messages.json_schema import (
    MalformedMessage,
    Payload,
    Stamp,
    decode,
    encode,
)

MAX_CELLS = 100_000
"""Largest accepted extent of the pose cells, as for the parameters."""

_Extent = Annotated[int, Meta(ge=1, le=MAX_CELLS)]
_Coordinate = Annotated[float, Meta(ge=0.0)]
_Cell = tuple[_Coordinate, _Coordinate, _Coordinate, float]
"""x, y and theta in cells, and an activity."""


class _Packets(Payload, frozen=True):
    TOPIC: ClassVar[str] = 'pose_cells/packets'
    stamp: Stamp
    dims: tuple[_Extent, _Extent, _Extent]
    packets: list[_Cell]
    injections: list[_Cell]


def encode_packets(stamp_ns: int, dims: tuple[int, int, int], active: ActiveCells) -> str:
    """Return the payload of ``pose_cells/packets``.

    Args:
        stamp_ns: stamp of the last odometry or template message.
        dims: numbers of cells in x, y and theta.
        active: the activity; its cells are not included.
    """
    return encode(_Packets(
        Stamp.of(stamp_ns), dims, active.packets.tolist(), active.injections.tolist()
    ))  # fmt: skip


def decode_packets(
    payload: str,
) -> tuple[int, tuple[int, int, int], NDArray[np.float64], NDArray[np.float64]]:
    """Return (stamp_ns, dims, packets, injections) of a ``pose_cells/packets`` payload.

    Raises:
        MalformedMessage: the payload does not match the schema.
    """
    found = decode(_Packets, payload)
    packets, injections = (
        np.array(cells, np.float64).reshape(-1, 4) for cells in (found.packets, found.injections)
    )
    for cells in (packets, injections):
        outside = cells[(cells[:, :3] > found.dims).any(axis=1)]
        if len(outside):
            raise MalformedMessage(
                f'{_Packets.TOPIC}: a cell at {outside[0, :3].tolist()}; expected x, y and theta '
                f'up to {found.dims}'
            )
    return found.stamp.ns, found.dims, packets, injections
