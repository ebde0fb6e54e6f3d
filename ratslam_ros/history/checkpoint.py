# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Checkpoints: the whole state of a run as bytes."""

from __future__ import annotations

import struct
from collections.abc import Iterable
from dataclasses import replace
from typing import Any, cast

import numpy as np

from ratslam_ros.core.mapping.map_changes import ExperienceRows, MapChange
from ratslam_ros.history.encoding import MAX_EXPERIENCES, decode, encode, heads
from ratslam_ros.history.packing import (
    DamagedHistory,
    Unpacker,
    pack_bytes,
    pack_floats,
    pack_ints,
    pack_rounded,
)
from ratslam_ros.history.records import Record, ViewRecord
from ratslam_ros.history.run_state import RunState, Trail

_HEAD = struct.Struct('<qQ')


def encode_state(state: RunState, recent: Iterable[bytes] | None = None) -> bytes:
    """Return a state as bytes.

    Args:
        state: the state.
        recent: encoded ``state.recent``; None: encode it.
    """
    if recent is None:
        recent = map(encode, state.recent)
    visits, last = state.visits, (
        state.pose, state.cells, state.image, state.match, state.scan, state.route, state.status,
        *state.commands,
    )
    return b''.join([
        _HEAD.pack(state.stamp_ns, state.record_count),
        pack_bytes(encode(_whole_map(state))),
        pack_bytes(b''.join(encode(record) for record in last if record is not None)),
        pack_bytes(b''.join(recent)),
        pack_bytes(b'' if state.view is None else encode(state.view)),
        pack_ints(visits.created_ns, visits.visited_ns, visits.counts),
        pack_floats(visits.errors),
        *(pack_rounded(*trail.points_m.T) for trail in _trails(state)),
    ])


def decode_state(data: bytes) -> RunState:
    """Return a state from its bytes; raises DamagedHistory."""
    unpacker = Unpacker(data)
    state = RunState()
    stamp_ns, record_count = cast(Any, unpacker.fields(_HEAD))
    for record in _records(unpacker.bytes()):
        state.apply(record)
    for record in _records(unpacker.bytes()):
        state.apply(record)
    recent = _records(unpacker.bytes())
    state.recent.extend(view for view in recent if isinstance(view, ViewRecord))
    for record in _records(unpacker.bytes()):
        state.view = record if isinstance(record, ViewRecord) else None
    visits = state.visits
    visits.created_ns = unpacker.ints()
    n = len(visits.created_ns)
    if n > 2 * MAX_EXPERIENCES:
        raise DamagedHistory(f'{n} experiences were visited')
    visits.visited_ns, visits.counts = unpacker.ints(n), unpacker.ints(n)
    visits.errors = unpacker.floats(n)
    for trail in _trails(state):
        x = unpacker.rounded()
        trail.replace(np.stack([x, unpacker.rounded(len(x))], axis=1))
    state.stamp_ns, state.record_count = stamp_ns, record_count
    return state


def _whole_map(state: RunState) -> MapChange:
    """Return the change that leads to the map, without experiences that were not received yet."""
    change = state.map.complete(state.stamp_ns)
    rows = change.experiences
    known = np.isfinite(rows.poses[:, 0])
    return replace(change, experiences=ExperienceRows(
        rows.ids[known], rows.template_ids[known], rows.poses[known], rows.components[known],
    ))


def _records(data: bytes) -> list[Record]:
    return [decode(kind, content) for kind, _, content in heads(data)]


def _trails(state: RunState) -> tuple[Trail, Trail, Trail]:
    return state.trail, state.dead_reckoning, state.truth
