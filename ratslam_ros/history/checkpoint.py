# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Checkpoints: the whole state of a run as bytes."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from msgspec import Struct
from numpy.typing import NDArray

from ratslam_ros.core.mapping.map_changes import ExperienceRows, MapChange
from ratslam_ros.history.encoding import decoded, encode
from ratslam_ros.history.records import Record, ViewRecord
from ratslam_ros.history.run_state import RunState, Trail, Visits


class _Checkpoint(Struct, frozen=True, array_like=True):
    stamp_ns: int
    record_count: int
    map: MapChange
    last: list[Record]
    recent: list[ViewRecord]
    view: ViewRecord | None
    visits: Visits
    trails: list[NDArray[np.float64]]


def encode_state(state: RunState) -> bytes:
    """Return a state as bytes."""
    last = (
        state.pose, state.cells, state.image, state.match, state.scan, state.route, state.status,
        *state.commands,
    )
    return encode(_Checkpoint(
        state.stamp_ns, state.record_count, _whole_map(state),
        [record for record in last if record is not None], list(state.recent), state.view,
        state.visits, [trail.points_m for trail in _trails(state)],
    ))


def decode_state(data: bytes) -> RunState:
    """Return a state from its bytes; raises DamagedHistory."""
    saved = decoded(data, _Checkpoint)
    state = RunState()
    for record in (saved.map, *saved.last):
        state.apply(record)
    state.recent.extend(saved.recent)
    state.view, state.visits = saved.view, saved.visits
    for trail, points_m in zip(_trails(state), saved.trails, strict=True):
        trail.replace(points_m)
    state.stamp_ns, state.record_count = saved.stamp_ns, saved.record_count
    return state


def _whole_map(state: RunState) -> MapChange:
    """Return the change that leads to the map, without experiences that were not received yet."""
    change = state.map.complete(state.stamp_ns)
    rows, links = change.experiences, change.links
    known = np.isfinite(rows.poses[:, 0])
    return replace(
        change,
        experiences=ExperienceRows(
            rows.ids[known], rows.template_ids[known], rows.poses[known], rows.components[known],
        ),
        links=replace(links, behaviours=list(links.behaviours)),
    )


def _trails(state: RunState) -> tuple[Trail, Trail, Trail]:
    return state.trail, state.dead_reckoning, state.truth
