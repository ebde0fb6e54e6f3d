# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The state of one part in a map file: versions of chunks, each valid since a cut.

A state consists, for each chunk, of the newest version that is not newer than its cut. A cut
therefore writes only the chunks that differ from the part's previous cut.
"""

from __future__ import annotations

import math
import sqlite3
from collections import defaultdict
from collections.abc import Iterable
from dataclasses import dataclass
from itertools import pairwise
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ratslam_ros.core.common.saved import Saved, check
from ratslam_ros.core.common.state import State
from ratslam_ros.maps.chunks import (
    CHUNK_BYTES,
    MAX_OUTLINE_BYTES,
    OUTLINE,
    Arrays,
    Compressor,
    DamagedData,
    array_digest,
    changed,
    chunk_count,
    chunk_hash,
    decompressed,
    flat,
    state_digest,
    unpack,
)
from ratslam_ros.maps.saved_map import Cut
from ratslam_ros.maps.schema import typed
from ratslam_ros.pipeline.experience_map import ExperienceMapStage
from ratslam_ros.pipeline.landmark_map import LandmarkMapStage
from ratslam_ros.pipeline.live_stages import LivePoseCells
from ratslam_ros.pipeline.local_view import LocalViewStage
from ratslam_ros.pipeline.stage import NAME
from ratslam_ros.pipeline.visual_odometry import VisualOdometryStage

STAGES: dict[str, type[Saved]] = {
    kind.NAME: kind for kind in (
        VisualOdometryStage, LocalViewStage, LivePoseCells, ExperienceMapStage, LandmarkMapStage,
    )
}
"""Stages that declare the fields of the parts of their names; those of your own do not."""


class Row(NamedTuple):
    """A cut of a part as in the table ``cuts``."""

    id: int
    session: int
    part: str
    number: int
    stamp_ns: int
    outline_bytes: int
    digest: bytes


@dataclass(frozen=True, slots=True)
class StoredArray:
    """An array as in the file.

    Attributes:
        array: its content.
        hashes: of its chunks.
        digest: hash of the whole.
        since: (chunks,) cut that has written the version of each chunk.
    """

    array: NDArray[Any]
    hashes: list[bytes]
    digest: bytes
    since: NDArray[np.int64]


Image = dict[str, StoredArray]
"""The arrays of a state as in the file, by their names."""

Chunk = tuple[str, int]
"""Name of an array, and number of a chunk in it."""


class PartWriter:
    """Writes the cuts of a part, each as its difference to the previous one."""

    def __init__(self, part: str, compressor: Compressor) -> None:
        self.part = part
        self.row: Row | None = None
        """The previous cut."""
        self._compressor = compressor
        self._image: Image = {}
        self._superseded: defaultdict[tuple[int, int], list[Chunk]] = defaultdict(list)
        """Replaced versions that are still in the file, by the cuts that wrote and replaced
        them."""
        self._written: tuple[Row, Image, dict[int, list[Chunk]]] | None = None
        """The last written cut, its arrays, and the chunks that it has replaced, by the cut that
        had written them."""
        self._removed: list[tuple[int, int]] = []
        """Replaced versions that are deleted in its transaction."""

    def start(self, database: sqlite3.Connection, row: Row | None, image: Image) -> None:
        """Continue after a cut in the file.

        Args:
            database: the map.
            row: the cut; None if there is none, and nothing of the part in the file.
            image: arrays of the cut, from ``load``.
        """
        self.row, self._image = row, image
        self._superseded.clear()
        if row is None:
            return
        versions: dict[Chunk, list[int]] = defaultdict(list)
        rows = database.execute(
            'SELECT array, position, since FROM chunks WHERE part = ?'
            ' ORDER BY array, position, since', (self.part,),
        )
        for name, position, since in typed(rows, tuple[str, int, int]):
            versions[name, position].append(since)
        for (name, position), found in versions.items():
            stored = image.get(name)
            if stored is None or position >= len(stored.since):
                found.append(row.id)  # Not in this state: it was dropped by this cut at last.
            for since, until in pairwise(found):
                self._superseded[since, until].append((name, position))

    def write(
        self, database: sqlite3.Connection, session: int, cut: Cut, arrays: Arrays
    ) -> None:
        """Write the difference to the previous cut, within a transaction; see ``adopt``.

        Args:
            database: the map.
            session: its last session.
            cut: moment of the state.
            arrays: the state, see ``chunks.pack``.
        """
        (number,) = database.execute('SELECT coalesce(max(id), 0) + 1 FROM cuts').fetchone()
        image: Image = {}
        rows: list[tuple[str, str, int, int, bytes]] = []
        for name, array in arrays.items():
            image[name] = self._stored(name, array, self._image.get(name), number, rows)
        superseded: defaultdict[int, list[Chunk]] = defaultdict(list)
        for name, old in self._image.items():
            since = np.full(len(old.since), number)  # The chunk is gone, or has a newer version.
            if name in image:
                shared = image[name].since[: len(since)]
                since[: len(shared)] = shared
            for position in np.flatnonzero(since != old.since).tolist():
                superseded[int(old.since[position])].append((name, position))
        digest = state_digest({name: stored.digest for name, stored in image.items()})
        size = arrays[OUTLINE].nbytes
        row = Row(number, session, self.part, cut.number, cut.stamp_ns, size, digest)
        database.executemany('INSERT INTO chunks VALUES (?, ?, ?, ?, ?)', rows)
        database.execute('INSERT INTO cuts VALUES (?, ?, ?, ?, ?, ?, ?)', row)
        self._written = row, image, superseded

    def adopt(self) -> None:
        """Make the written cut the previous one of the next, once it is committed."""
        assert self._written is not None
        self.row, self._image, superseded = self._written
        for since, chunks in superseded.items():
            self._superseded[since, self.row.id] += chunks
        for key in self._removed:
            self._superseded.pop(key, None)

    def remove_versions(self, database: sqlite3.Connection, kept: list[int]) -> None:
        """Delete the replaced versions that no cut needs, within a transaction; see ``adopt``.

        Args:
            database: the map.
            kept: the cuts of the part that stay.
        """
        self._removed = [
            (since, until) for since, until in self._superseded
            if not any(since <= cut < until for cut in kept)
        ]
        database.executemany(
            'DELETE FROM chunks WHERE part = ? AND array = ? AND position = ? AND since = ?',
            (
                (self.part, name, position, since)
                for since, until in self._removed
                for name, position in self._superseded[since, until]
            ),
        )

    def _stored(
        self, name: str, array: NDArray[Any], old: StoredArray | None, cut: int,
        rows: list[tuple[str, str, int, int, bytes]],
    ) -> StoredArray:
        """Return an array as in the file, and add its changed chunks to ``rows``."""
        count = chunk_count(array.nbytes)
        flags = np.ones(count, np.bool_) if old is None else changed(array, old.array)
        if old is not None and array.shape == old.array.shape and not flags.any():
            return old  # also keeps only one of two equal arrays in memory
        hashes = [b''] * count
        since = np.full(count, cut, np.int64)
        if old is not None:
            same = np.flatnonzero(~flags)
            since[same] = old.since[same]
            for position in same.tolist():
                hashes[position] = old.hashes[position]
        data = flat(array)
        for position in np.flatnonzero(flags).tolist():
            chunk = data[position * CHUNK_BYTES : (position + 1) * CHUNK_BYTES]
            hashes[position] = chunk_hash(chunk.data)
            frame = self._compressor.compressed(chunk, array.dtype.itemsize)
            rows.append((self.part, name, position, cut, frame))
        return StoredArray(array, hashes, array_digest(name, array, hashes), since)


def load(database: sqlite3.Connection, row: Row) -> tuple[State, Image]:
    """Return the state of a part at a cut, and its arrays as in the file.

    Raises:
        DamagedData: a chunk is missing or damaged, or the state is not the one that was saved.
        UnusableInput: a field of the state has another type or shape, or is out of range.
    """
    image: Image = {}

    def read(name: str, kind: np.dtype[Any], shape: tuple[int, ...]) -> NDArray[Any]:
        stored = _read(database, row, name, kind, shape)
        image[name] = stored
        return stored.array

    if not 0 < row.outline_bytes <= MAX_OUTLINE_BYTES:
        raise DamagedData(f'{row.part}: the outline claims {row.outline_bytes} bytes')
    outline = read(OUTLINE, np.dtype('u1'), (row.outline_bytes,)).tobytes()
    state = unpack(outline, read)
    if state_digest({name: stored.digest for name, stored in image.items()}) != row.digest:
        raise DamagedData(f'{row.part}: the state is not the one that was saved')
    if row.part in STAGES:
        check(STAGES[row.part], state, row.part, {})
    return state, image


def rows_of(database: sqlite3.Connection, condition: str, values: Iterable[Any]) -> list[Row]:
    """Return the cuts that meet a condition in SQL, in the order in which they were written."""
    found = database.execute(f'SELECT * FROM cuts WHERE {condition} ORDER BY id', tuple(values))
    rows = typed(found, Row)
    for row in rows:
        check_part(row.part)
    return rows


def check_part(part: str) -> None:
    """Check the name of a part; raises DamagedData."""
    if part != 'inputs' and not NAME.fullmatch(part):
        raise DamagedData(f'it has a part {part[:40]!r}; expected the name of a stage')


def _read(
    database: sqlite3.Connection, row: Row, name: str, kind: np.dtype[Any], shape: tuple[int, ...]
) -> StoredArray:
    size = math.prod(shape) * kind.itemsize
    count = chunk_count(size)
    found = database.execute(
        'SELECT position, max(since), data FROM chunks WHERE part = ? AND array = ?'
        ' AND position < ? AND since <= ? GROUP BY position ORDER BY position',
        (row.part, name, count, row.id),
    ).fetchall()
    if [position for position, *_ in found] != list(range(count)):
        raise DamagedData(f'{row.part}{name}: {len(found)} of {count} chunks are there')
    chunks = []
    for position, _, frame in typed(found, tuple[int, int, bytes]):
        expected = min(size - position * CHUNK_BYTES, CHUNK_BYTES)
        chunks.append(decompressed(frame, expected, kind.itemsize))
    data = b''.join(chunks)
    if kind.kind == 'b' and max(data, default=0) > 1:
        raise DamagedData(f'{row.part}{name}: a flag is neither 0 nor 1')
    array = np.frombuffer(data, kind).reshape(shape)
    hashes = [chunk_hash(chunk) for chunk in chunks]
    since = np.array([since for _, since, _ in found], np.int64)
    return StoredArray(array, hashes, array_digest(name, array, hashes), since)
