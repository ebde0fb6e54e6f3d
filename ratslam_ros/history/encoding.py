# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Records as bytes. The first byte of a record is its kind, and the next four its length.

Rounding is idempotent: what is decoded and encoded again has the same bytes.
"""

from __future__ import annotations

import struct
from collections.abc import Callable, Iterator
from typing import Any, cast, get_args

import numpy as np

from ratslam_ros.core.common.pose import Pose
from ratslam_ros.core.mapping.map_changes import ExperienceRows, LinkRows, MapChange
from ratslam_ros.core.pose_cells.map_action import Action
from ratslam_ros.core.pose_cells.torus import Place
from ratslam_ros.history.packing import (
    ROUNDING,
    DamagedHistory,
    Unpacker,
    pack_bytes,
    pack_floats,
    pack_ints,
    pack_rounded,
    pack_text,
    rounded,
)
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

MAX_EXPERIENCES = 1_000_000
"""Largest accepted number of experiences; a reader allocates memory for all of them."""

MAX_MM = 2**53
"""Largest stored coordinate in mm; a double still distinguishes them."""

ACTIVITY_STEPS = 65535
"""Activities of cells are stored in 16 bits, as a share of the largest one."""

ACTIONS: tuple[Action, ...] = get_args(Action)

_Fields = tuple[Any, ...]

_HEAD = struct.Struct('<BI')
_STAMP = struct.Struct('<q')
_VIEW = struct.Struct('<i ? fff B ii fff i f i')
_KNOWN = struct.Struct('<B')
_XYH = struct.Struct('<qqi')
_COVARIANCE = struct.Struct('<fff')
_CELLS = struct.Struct('<III II d')
_MATCH = struct.Struct('<q i HH HH')
_MAP = struct.Struct('<I i ? Q')


def encode(record: Record) -> bytes:
    """Return a record as bytes with its kind and length in front."""
    kind = KINDS[type(record)]
    data = _STAMP.pack(record.stamp_ns) + _CODECS[kind][1](record)
    return _HEAD.pack(kind, len(data)) + data


def heads(data: bytes) -> Iterator[tuple[int, int, memoryview]]:
    """Yield kind, stamp and encoded content of every record; raises DamagedHistory."""
    unpacker = Unpacker(data)
    while not unpacker.is_at_end:
        kind, length = unpacker.fields(_HEAD)
        content = unpacker.raw(cast(int, length))
        if not 0 <= kind < len(_CODECS) or len(content) < _STAMP.size:
            raise DamagedHistory(f'a record has the kind {kind} and {len(content)} bytes')
        yield cast(int, kind), _STAMP.unpack_from(content)[0], content


def decode(kind: int, content: bytes | memoryview) -> Record:
    """Return a record from its kind and content, see ``heads``.

    Raises:
        DamagedHistory: the content is not that of such a record.
    """
    created, _, decoder = _CODECS[kind]
    unpacker = Unpacker(content)
    (stamp_ns,) = unpacker.fields(_STAMP)
    record = created(stamp_ns, *decoder(unpacker))
    if not unpacker.is_at_end:
        raise DamagedHistory(f'a {created.__name__} is longer than expected')
    return cast(Record, record)


def as_stored(record: PoseRecord) -> PoseRecord:
    """Return a record of poses with the rounding of the file."""
    return PoseRecord(
        record.stamp_ns, _rounded_pose(record.pose),
        None if record.dead_reckoning is None else _rounded_pose(record.dead_reckoning),
        None if record.truth is None else _rounded_pose(record.truth),
        None if record.covariance is None else _COVARIANCE.unpack(
            _COVARIANCE.pack(*record.covariance)
        ),
    )


def _rounded_pose(pose: Pose) -> Pose:
    x, y, heading = _fixed(pose)
    return Pose(x / ROUNDING, y / ROUNDING, heading / ROUNDING)


def _fixed(pose: Pose) -> tuple[int, int, int]:
    """Return a pose in mm and mrad."""
    x, y, heading = pose
    return (
        round(min(max(x * ROUNDING, -MAX_MM), MAX_MM)),
        round(min(max(y * ROUNDING, -MAX_MM), MAX_MM)), round(heading * ROUNDING),
    )


# Views


def _encode_view(view: ViewRecord) -> bytes:
    return _VIEW.pack(
        view.template_id, view.is_new, view.error, view.threshold,
        view.relative_rad, ACTIONS.index(view.action), view.source_id, view.target_id,
        *view.place, view.recognised_id, view.agreement, view.relocated_to,
    ) + pack_text(view.reason)


def _decode_view(data: Unpacker) -> _Fields:
    (
        template_id, is_new, error, threshold, relative_rad, action, source_id,
        target_id, x, y, theta, recognised_id, agreement, relocated_to,
    ) = cast(Any, data.fields(_VIEW))
    if action >= len(ACTIONS) or max(target_id, recognised_id, relocated_to) >= MAX_EXPERIENCES:
        raise DamagedHistory(f'a view has the action {action} and the target {target_id}')
    return (
        template_id, is_new, error, threshold, relative_rad, ACTIONS[action],
        source_id, target_id, Place(x, y, theta), recognised_id, agreement, data.text(),
        relocated_to,
    )


# Poses


def _encode_pose(record: PoseRecord) -> bytes:
    known = (record.dead_reckoning is not None) + 2 * (record.truth is not None)
    known += 4 * (record.covariance is not None)
    data = _KNOWN.pack(known) + _XYH.pack(*_fixed(record.pose))
    if record.dead_reckoning is not None:
        data += _XYH.pack(*_fixed(record.dead_reckoning))
    if record.truth is not None:
        data += _XYH.pack(*_fixed(record.truth))
    if record.covariance is not None:
        data += _COVARIANCE.pack(*record.covariance)
    return data


def _decode_pose(data: Unpacker) -> _Fields:
    (known,) = cast(Any, data.fields(_KNOWN))

    def pose() -> Pose:
        x, y, heading = data.fields(_XYH)
        return Pose(x / ROUNDING, y / ROUNDING, heading / ROUNDING)

    return (
        pose(), pose() if known & 1 else None, pose() if known & 2 else None,
        cast(Any, data.fields(_COVARIANCE)) if known & 4 else None,
    )


# Pose cells


def _encode_cells(record: CellsRecord) -> bytes:
    largest = float(record.activity.max(initial=0.0))
    shares = np.zeros(len(record.activity), np.int64)
    if largest > 0.0:
        shares = np.rint(record.activity / largest * ACTIVITY_STEPS).astype(np.int64)
    cells, shares = record.cells[shares > 0], shares[shares > 0]
    return b''.join([
        _CELLS.pack(*record.dims, len(record.packets), len(record.injections), largest),
        pack_ints(*cells.T),
        pack_bytes(shares.astype('<u2').tobytes()),
        pack_floats(record.packets.ravel()),
        pack_floats(record.injections.ravel()),
    ])


def _decode_cells(data: Unpacker) -> _Fields:
    n_x, n_y, n_theta, packets, injections, largest = cast(Any, data.fields(_CELLS))
    x = data.ints()
    cells = np.stack([x, data.ints(len(x)), data.ints(len(x))], axis=1)
    shares = data.bytes()
    if len(shares) != 2 * len(x):
        raise DamagedHistory(f'{len(x)} cells have {len(shares)} bytes of activity')
    return (
        (n_x, n_y, n_theta), cells,
        np.frombuffer(shares, '<u2') / ACTIVITY_STEPS * largest,
        data.floats(4 * packets).reshape(-1, 4), data.floats(4 * injections).reshape(-1, 4),
    )


# Pictures of matches


def _encode_match(record: MatchRecord) -> bytes:
    return _MATCH.pack(
        record.template_id, record.shift_px, *record.view.shape, *record.template.shape,
    ) + record.view.tobytes() + record.template.tobytes()


def _decode_match(data: Unpacker) -> _Fields:
    template_id, shift_px, h, w, height, width = cast(Any, data.fields(_MATCH))
    view = np.frombuffer(data.raw(h * w), np.uint8).reshape(h, w)
    template = np.frombuffer(data.raw(height * width), np.uint8).reshape(height, width)
    return template_id, view.copy(), template.copy(), shift_px


# Points and texts


def _encode_points(record: ScanRecord | RouteRecord) -> bytes:
    return pack_rounded(*record.points_m.T)


def _decode_points(data: Unpacker) -> _Fields:
    x = data.rounded()
    return (np.stack([x, data.rounded(len(x))], axis=1),)


def _encode_payload(record: StatusRecord | CommandRecord) -> bytes:
    return pack_text(record.payload)


def _decode_payload(data: Unpacker) -> _Fields:
    return (data.text(),)


# Changes of the map


def _encode_map(change: MapChange) -> bytes:
    rows, links = change.experiences, change.links
    names = sorted(set(links.behaviours))
    numbers = {name: number for number, name in enumerate(names)}
    return b''.join([
        _MAP.pack(
            change.experience_count, change.current_id, change.is_restart, change.pending
        ),
        pack_ints(rows.ids, rows.template_ids, rows.components, *rounded(rows.poses.T)),
        pack_ints(
            *links.ends.T, *rounded(links.shapes.T), rounded(links.durations_s),
            rounded(links.confidences), links.counts, links.recognised.astype(np.int64),
        ),
        pack_text('\n'.join(names)),
        pack_ints(np.array([numbers[name] for name in links.behaviours], np.int64)),
        pack_ints(*change.removed_links.T),
    ])


def _decode_map(data: Unpacker) -> _Fields:
    count, current_id, is_restart, pending = cast(Any, data.fields(_MAP))
    ids = data.ints()
    n = len(ids)
    if count > MAX_EXPERIENCES or (n and not 0 <= ids.min() <= ids.max() < count):
        raise DamagedHistory(f'a map of {count} experiences has others')
    template_ids, components = data.ints(n), data.ints(n)
    poses = np.stack([data.rounded(n) for _ in range(3)], axis=1)
    sources = data.ints()
    m = len(sources)
    ends = np.stack([sources, data.ints(m)], axis=1)
    shapes = np.stack([data.rounded(m) for _ in range(3)], axis=1)
    durations_s, confidences = data.rounded(m), data.rounded(m)
    counts, recognised = data.ints(m), data.ints(m) > 0
    names, behaviours = data.text().split('\n'), data.ints(m)
    if m and not 0 <= behaviours.min() <= behaviours.max() < len(names):
        raise DamagedHistory('a link has a behaviour without name')
    removed = data.ints()
    return (
        count, current_id, is_restart,
        ExperienceRows(ids, template_ids, poses, components),
        LinkRows(
            ends, shapes, durations_s, confidences, counts, recognised,
            tuple(names[number] for number in behaviours.tolist()),
        ),
        np.stack([removed, data.ints(len(removed))], axis=1), pending,
    )


_CODECS: tuple[tuple[type, Callable[[Any], bytes], Callable[[Unpacker], _Fields]], ...] = (
    (MapChange, _encode_map, _decode_map),
    (ViewRecord, _encode_view, _decode_view),
    (PoseRecord, _encode_pose, _decode_pose),
    (CellsRecord, _encode_cells, _decode_cells),
    (ImageRecord, lambda record: pack_bytes(record.jpeg), lambda data: (data.bytes(),)),
    (MatchRecord, _encode_match, _decode_match),
    (ScanRecord, _encode_points, _decode_points),
    (RouteRecord, _encode_points, _decode_points),
    (StatusRecord, _encode_payload, _decode_payload),
    (CommandRecord, _encode_payload, _decode_payload),
)
"""Every kind of record, and how its fields after the stamp are encoded and decoded.

The order gives the numbers of the kinds in the file: append new ones at the end.
"""

KINDS: dict[type, int] = {kind: number for number, (kind, _, _) in enumerate(_CODECS)}
"""Number of every kind of record."""
