# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""JSON payload of ``pose_cells/packets``."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ratslam_ros.core.pose_cells.active_cells import ActiveCells
from ratslam_ros.messages.json_schema import (
    SCHEMA_VERSION,
    MalformedMessage,
    check_range,
    check_types,
    decode_fields,
    decode_stamp,
    encode_json,
    encode_stamp,
    shown,
)

MAX_CELLS = 100_000
"""Largest accepted extent of the pose cells, as for the parameters."""


def encode_packets(stamp_ns: int, dims: tuple[int, int, int], active: ActiveCells) -> str:
    """Return the payload of ``pose_cells/packets``.

    Args:
        stamp_ns: stamp of the last odometry or template message.
        dims: numbers of cells in x, y and theta.
        active: the activity; its cells are not included.
    """
    return encode_json({
        'schema_version': SCHEMA_VERSION,
        'stamp': encode_stamp(stamp_ns),
        'dims': dims,
        'packets': active.packets.tolist(),
        'injections': active.injections.tolist(),
    })  # fmt: skip


def decode_packets(
    payload: str,
) -> tuple[int, tuple[int, int, int], NDArray[np.float64], NDArray[np.float64]]:
    """Return (stamp_ns, dims, packets, injections) of a ``pose_cells/packets`` payload.

    Raises:
        MalformedMessage: the payload does not match the schema.
    """
    name = 'pose_cells/packets'
    fields = decode_fields(
        payload, name, {'stamp': dict, 'dims': list, 'packets': list, 'injections': list}
    )
    dims = fields['dims']
    if len(dims) != 3:
        raise MalformedMessage(f'{name}: dims is {shown(dims)}; expected x, y and theta')
    for cells in dims:
        check_types({'dims': cells}, name, {'dims': int})
        check_range(name, 'dims', cells, 1, MAX_CELLS)
    tables: list[NDArray[np.float64]] = []
    for key in ('packets', 'injections'):
        for row in fields[key]:
            if not isinstance(row, list) or len(row) != 4:
                raise MalformedMessage(
                    f'{name}: {key} has {shown(row)}; expected x, y, theta and activity'
                )
            at = dict(zip(('x', 'y', 'theta', 'activity'), row, strict=True))
            check_types(at, name, dict.fromkeys(at, float))
            for axis, most in zip(('x', 'y', 'theta'), dims, strict=True):
                check_range(name, axis, at[axis], 0.0, most)
        tables.append(np.array(fields[key], np.float64).reshape(-1, 4))
    n_x, n_y, n_theta = dims
    return decode_stamp(fields['stamp']), (n_x, n_y, n_theta), tables[0], tables[1]
