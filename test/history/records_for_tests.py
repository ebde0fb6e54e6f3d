# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Random records, and comparison of states."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import fields, is_dataclass
from typing import Any, get_args

import numpy as np

from ratslam_ros.core.common.pose import Pose
from ratslam_ros.core.mapping.map_changes import (
    MAX_ROWS,
    ExperienceRows,
    LinkRows,
    MapChange,
)
from ratslam_ros.core.pose_cells.map_action import Action
from ratslam_ros.core.pose_cells.torus import Place
from ratslam_ros.history.records import (
    CellsRecord,
    CommandRecord,
    ImageRecord,
    MatchRecord,
    PoseRecord,
    Record,
    RouteRecord,
    ScanRecord,
    StatusRecord,
    ViewRecord,
)
from ratslam_ros.history.run_state import RunState
from ratslam_ros.history.writer import HistoryWriter
from ratslam_ros.viewer.live_history import MapRelay

ACTIONS = get_args(Action)


def random_records(seed: int, count: int, period_ns: int = 50_000_000) -> list[Record]:
    """Return a drive: a map that grows and moves, with records of all kinds and late stamps."""
    random = np.random.default_rng(seed)
    records: list[Record] = []
    at_ns, experiences, links = 5_000_000_000, 0, 0
    for number in range(count):
        at_ns += int(random.integers(0, 2 * period_ns)) if random.random() < 0.8 else 0
        stamp_ns = at_ns - (int(random.integers(0, period_ns)) if random.random() < 0.1 else 0)
        kind = int(random.integers(0, 10))
        records.append(random_record(random, kind, stamp_ns, experiences, number))
        if kind == 0:
            change = records[-1]
            assert isinstance(change, MapChange)
            experiences, links = change.experience_count, links + len(change.links)
    return records


def random_record(
    random: np.random.Generator, kind: int, stamp_ns: int, experiences: int, number: int
) -> Record:
    """Return a record of a kind, with numbers that are rounded as in a file."""

    def rounded(*shape: int) -> Any:
        return np.round(random.normal(0.0, 20.0, shape), 3)

    def pose() -> Pose:
        return Pose(*rounded(3).tolist())

    match kind:
        case 0:
            return random_change(random, stamp_ns, experiences)
        case 1:
            error, threshold, relative, x, y, theta, agreement = random.normal(size=7).tolist()
            error = float(np.float32(error))  # as in ``Visits``
            return ViewRecord(
                stamp_ns, int(random.integers(-1, 99)), bool(random.random() < 0.2), error,
                threshold, relative, ACTIONS[random.integers(0, 4)],
                int(random.integers(-1, 9)), int(random.integers(-1, 9)), Place(x, y, theta),
                int(random.integers(-1, 9)), agreement,
                'zu weit: 3 m' if random.random() < 0.1 else '',
                int(random.integers(-1, 2)),
            )
        case 2:
            return PoseRecord(
                stamp_ns, pose(), pose() if random.random() < 0.8 else None,
                pose() if random.random() < 0.5 else None,
                (0.25, -0.125, 0.5) if random.random() < 0.5 else None,
            )
        case 3:
            n = int(random.integers(0, 30))
            return CellsRecord(
                stamp_ns, (20, 21, 36), random.integers(0, 20, (n, 3)),
                random.random(n, np.float32), random.random((2, 4), np.float32),
            )
        case 4:
            return ImageRecord(stamp_ns, random.bytes(int(random.integers(0, 900))))
        case 5:
            view, template = random.integers(0, 256, (2, 6, 9)).astype(np.uint8)
            return MatchRecord(stamp_ns, int(random.integers(0, 99)), view, template, -2)
        case 6:
            return ScanRecord(stamp_ns, rounded(int(random.integers(0, 20)), 2))
        case 7:
            return RouteRecord(stamp_ns, rounded(int(random.integers(0, 20)), 2))
        case 8:
            return StatusRecord(stamp_ns, f'{{"goal": {number}, "name": "Küche"}}')
        case _:
            return CommandRecord(stamp_ns, f'{{"command": {{"Reset": [{number}]}}}}')


def random_change(random: np.random.Generator, stamp_ns: int, known: int) -> MapChange:
    """Return a change that adds two experiences, and moves and links some."""
    count = known + 2
    ids = np.unique(np.append(random.integers(0, count, 3), [count - 2, count - 1]))
    n, m = len(ids), int(random.integers(0, 5))
    ends = np.unique(random.integers(0, count, (m, 2)).reshape(-1, 2), axis=0)
    m = len(ends)
    return MapChange(
        stamp_ns, count, int(random.integers(-1, count)), False,
        ExperienceRows(
            ids, random.integers(0, 50, n), np.round(random.normal(size=(n, 3)), 3),
            random.integers(0, 2, n),
        ),
        LinkRows(
            ends, np.round(random.normal(0.0, 1.0, (m, 3)), 3), np.round(random.random(m), 3),
            np.round(random.random(m), 3), random.integers(1, 9, m), random.random(m) < 0.3,
            tuple('' if one < 5 else f'follow {one}' for one in random.integers(0, 9, m)),
        ),
        random.integers(0, count, (int(random.integers(0, 2)), 2)), int(random.integers(0, 9)),
    )


def add_all(writer: HistoryWriter, records: list[Record]) -> list[Record]:
    """Write records, and whole maps as the writer wants them; return those that are kept."""
    kept: list[Record] = []
    relay = MapRelay()
    for record in records:
        if isinstance(record, MapChange):
            relay.add(record)
            if writer.wants_whole_map:
                relay.restart()
                record = relay.next_change(MAX_ROWS)
        if writer.add(record):
            kept.append(record)
    return kept


def plain(value: Any) -> Any:
    """Return a record or state as plain values that can be compared exactly."""
    if isinstance(value, np.ndarray):
        return str(value.dtype), value.shape, value.tolist()
    names = getattr(type(value), '__struct_fields__', ())
    if is_dataclass(value) and not isinstance(value, type):
        names = tuple(one.name for one in fields(value))
    if names:
        return type(value).__name__, [plain(getattr(value, name)) for name in names]
    return list(value) if isinstance(value, Sequence) and not isinstance(value, str) else value


def plain_state(state: RunState) -> dict[str, Any]:
    """Return the content of a state, without counters that only tell what has changed."""
    rows = state.map.link_rows
    links = {
        tuple(rows.ends[row].tolist()): (
            rows.shapes[row].tolist(), rows.durations_s[row], rows.confidences[row],
            rows.counts[row], rows.recognised[row], rows.behaviours[row],
        )
        for row in range(len(rows)) if rows.ends[row, 0] >= 0
    }
    visits = state.visits
    return {
        'stamp_ns': state.stamp_ns, 'record_count': state.record_count, 'links': links,
        'experiences': [
            *map(plain, (state.map.template_ids, state.map.components, state.map.poses)),
            state.map.current_id, state.map.pending,
        ],
        'visits': [*map(
            plain, (visits.created_ns, visits.visited_ns, visits.counts, visits.errors)
        )],
        'last': [*map(plain, (
            state.pose, state.view, state.cells, state.image, state.match, state.scan,
            state.route, state.status,
        ))],
        'recent': [plain(view) for view in state.recent],
        'closures': [plain(view) for view in state.closures],
        'trails': [plain(one.points_m) for one in (
            state.trail, state.dead_reckoning, state.truth,
        )],
    }
