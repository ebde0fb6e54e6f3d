# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""History of a live run: a thread that writes the records, and a reader of what is written."""

from __future__ import annotations

import queue
import threading
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from ratslam_ros.core.mapping.map_changes import ExperienceRows, LinkRows, MapChange
from ratslam_ros.errors import UnusableInput
from ratslam_ros.history.file import HistoryMeta, part_path
from ratslam_ros.history.history_run import HistoryRun
from ratslam_ros.history.records import Record, RouteRecord, StatusRecord, ViewRecord
from ratslam_ros.history.writer import HistoryWriter

DEFERRED = MapChange, RouteRecord, StatusRecord
"""Records that are written later if they are not due yet; others are samples and are dropped."""


class LiveHistory:
    """Writes the records of one run to a file in a thread of its own.

    Writing a checkpoint of a large map takes longer than the period of drawing.
    """

    def __init__(self, path: Path, meta: HistoryMeta) -> None:
        """Create the file; one that exists is replaced.

        Args:
            path: the file.
            meta: what is known of the run.

        Raises:
            UnusableInput: the file cannot be written.
        """
        self._writer = HistoryWriter(path, meta, report=lambda line: None)  # ``error`` has it
        if self._writer.problem:
            raise UnusableInput(self._writer.problem)
        self.reader = HistoryRun(part_path(path))
        """What has been written; it lags behind by a second."""
        self._queue: queue.SimpleQueue[Record | None] = queue.SimpleQueue()
        self._changes: list[MapChange] = []
        self._deferred: dict[type[Record], Record] = {}
        self._thread = threading.Thread(target=self._write, name='history', daemon=True)
        self._thread.start()

    @property
    def error(self) -> str:
        """Why writing has ended early; '' if it has not."""
        return self._writer.problem

    def add(self, record: Record) -> None:
        """Append a record; may be called from any thread."""
        self._queue.put(record)

    def close(self) -> None:
        """Write everything, and close the file."""
        self._queue.put(None)
        self._thread.join()
        self.reader.close()

    def _write(self) -> None:
        while (record := self._queue.get()) is not None:
            self._add(record)
        self._add_deferred(self._deferred)
        self._writer.close()

    def _add(self, record: Record) -> None:
        writer, kind = self._writer, type(record)
        if isinstance(record, MapChange):
            self._changes.append(record)
        if isinstance(record, DEFERRED):
            self._deferred[kind] = record
        elif isinstance(record, ViewRecord) or writer.wants(kind, record.stamp_ns):
            writer.add(record)
        if self._deferred:
            due = [one for one in self._deferred if writer.wants(one, record.stamp_ns)]
            self._add_deferred(due)

    def _add_deferred(self, kinds: Sequence[type[Record]] | Mapping[type[Record], Record]) -> None:
        for kind in list(kinds):
            record = self._deferred.pop(kind)
            if isinstance(record, MapChange):
                record, self._changes = merged(self._changes), []
            self._writer.add(record)


def merged(changes: Sequence[MapChange]) -> MapChange:
    """Return one change with the effect of successive ones, of which there is at least one."""
    first = max((n for n, change in enumerate(changes) if change.is_restart), default=0)
    changes = changes[first:]
    last = changes[-1]
    if len(changes) == 1:
        return last
    rows = [change.experiences for change in changes]
    ids = np.concatenate([one.ids for one in rows])
    keep = _last_rows(ids)
    experiences = ExperienceRows(
        ids[keep],
        np.concatenate([one.template_ids for one in rows])[keep],
        np.concatenate([one.poses for one in rows])[keep],
        np.concatenate([one.components for one in rows])[keep],
    )
    return MapChange(
        last.stamp_ns, last.experience_count, last.current_id, changes[0].is_restart,
        experiences, *_merged_links(changes), pending=last.pending,
    )  # fmt: skip


def _merged_links(changes: Sequence[MapChange]) -> tuple[LinkRows, NDArray[np.int64]]:
    """Return the links that are set, and all that were removed at any time.

    Links are removed before others are set, so that one that is removed and set again remains.
    """
    ends = np.concatenate([change.links.ends for change in changes])
    order = np.repeat(np.arange(len(changes)), [len(change.links) for change in changes])
    removed_after = {
        pair: n for n, change in enumerate(changes)
        for pair in map(tuple, change.removed_links.tolist())
    }  # fmt: skip
    rows: dict[tuple[int, ...], int] = {}
    for row, pair in enumerate(map(tuple, ends.tolist())):
        rows[pair] = row
    keep = np.array(
        [row for pair, row in rows.items() if removed_after.get(pair, -1) <= order[row]], np.int64
    )
    links = [change.links for change in changes]
    behaviours = [name for one in links for name in one.behaviours]
    return LinkRows(
        ends[keep],
        np.concatenate([one.shapes for one in links])[keep],
        np.concatenate([one.durations_s for one in links])[keep],
        np.concatenate([one.confidences for one in links])[keep],
        np.concatenate([one.counts for one in links])[keep],
        np.concatenate([one.recognised for one in links])[keep],
        tuple(behaviours[row] for row in keep.tolist()),
    ), np.array(list(removed_after), np.int64).reshape(-1, 2)


def _last_rows(ids: NDArray[np.int64]) -> NDArray[np.int64]:
    """Return the row of the last occurrence of each id."""
    _, rows = np.unique(ids[::-1], return_index=True)
    return np.asarray(len(ids) - 1 - rows, np.int64)
