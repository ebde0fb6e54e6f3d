# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""History of a live run: a thread that writes the records, and a reader of what is written."""

from __future__ import annotations

import queue
import threading
from dataclasses import fields
from itertools import islice
from pathlib import Path
from typing import TypeVar

import numpy as np

from ratslam_ros.core.mapping.map_changes import ExperienceRows, LinkRows, MapChange, MapMirror
from ratslam_ros.errors import UnusableInput
from ratslam_ros.history.file import HistoryMeta, part_path
from ratslam_ros.history.history_run import HistoryRun
from ratslam_ros.history.records import Record
from ratslam_ros.history.writer import HistoryWriter
from ratslam_ros.version import __version__

_T = TypeVar('_T')


class LiveHistory:
    """Writes the records of one run to a file in a thread of its own.

    Writing a checkpoint of a large map takes longer than the period of drawing.
    """

    def __init__(self, path: Path, title: str) -> None:
        """Create the file; it replaces one of the same name when it is closed.

        Args:
            path: the file.
            title: name of the run.

        Raises:
            UnusableInput: the file cannot be written.
        """
        meta = HistoryMeta(title, ratslam_version=__version__)
        self._writer = HistoryWriter(path, meta, lambda _: None)
        if self._writer.problem:
            raise UnusableInput(self._writer.problem)
        self.reader = HistoryRun(part_path(path))
        """What has been written; it lags behind by up to 6 s."""
        self._queue: queue.SimpleQueue[Record | str | None] = queue.SimpleQueue()
        self._map = MapRelay()
        self._thread = threading.Thread(target=self._run, name='history', daemon=True)
        self._thread.start()

    @property
    def problem(self) -> str:
        """Why writing has ended early; '' if it has not."""
        return self._writer.problem

    def add(self, record: Record) -> None:
        """Append a record; may be called from any thread."""
        if not self.problem:
            self._queue.put(record)

    def configure(self, configuration: str) -> None:
        """Set the parameters of the nodes, as YAML; may be called from any thread."""
        self._queue.put(configuration)

    def close(self) -> None:
        """Write everything, and close the file."""
        self._queue.put(None)
        self._thread.join()
        self.reader.close()

    def _run(self) -> None:
        try:
            self._write()
        except Exception as error:  # the run goes on without its past
            self._writer.problem = f'the history ends here: {type(error).__name__}: {error}'

    def _write(self) -> None:
        writer, relay = self._writer, self._map
        while (record := self._queue.get()) is not None:
            if isinstance(record, str):
                writer.configure(record)
                continue
            if isinstance(record, MapChange):
                relay.add(record)
            else:
                writer.add(record)
            if relay.pending and writer.wants(MapChange, record.stamp_ns):
                writer.add_map(relay.restart, relay.next_change)
        while relay.pending:
            writer.add_map(relay.restart, relay.next_change)
        writer.close()


class MapRelay:
    """Passes a map on in changes of another size and rate than those it receives."""

    def __init__(self) -> None:
        self._mirror = MapMirror()
        self._last: MapChange | None = None
        self._ids: dict[int, None] = {}
        self._links: dict[tuple[int, int], None] = {}
        """Links that were set or removed."""
        self._is_restart = False

    @property
    def pending(self) -> bool:
        """Whether there is something to pass on."""
        return self._last is not None

    def add(self, change: MapChange) -> None:
        """Receive a change."""
        self._mirror.apply(change)
        self._last = change
        if change.is_restart:
            self.restart()
        self._ids |= dict.fromkeys(change.experiences.ids.tolist())
        for ends in change.removed_links, change.links.ends:
            self._links |= dict.fromkeys(map(tuple, ends.tolist()))

    def restart(self) -> None:
        """Pass on the whole map again, beginning with the next change."""
        self._is_restart = True
        self._ids = dict.fromkeys(np.flatnonzero(~np.isnan(self._mirror.poses[:, 0])).tolist())
        self._links = dict.fromkeys(map(tuple, self._mirror.links.ends.tolist()))

    def next_change(self, rows: int) -> MapChange:
        """Return what has changed since the last call, at most ``rows`` experiences and links."""
        assert self._last is not None
        mirror, last = self._mirror, self._last
        ids = np.array(_taken(self._ids, rows), np.int64)
        found = {pair: mirror.link_row(*pair) for pair in _taken(self._links, rows - len(ids))}
        removed = [pair for pair, row in found.items() if row is None]
        at = np.array([row for row in found.values() if row is not None], np.int64)
        links = mirror.link_rows
        change = MapChange(
            last.stamp_ns, last.experience_count, last.current_id, self._is_restart,
            ExperienceRows(
                ids, mirror.template_ids[ids], mirror.poses[ids], mirror.components[ids]
            ),
            LinkRows(**{one.name: getattr(links, one.name)[at] for one in fields(LinkRows)}),
            np.array(removed, np.int64).reshape(-1, 2),
            last.pending + len(self._ids) + len(self._links),
        )
        self._is_restart = False
        if not self._ids and not self._links:
            self._last = None
        return change


def _taken(waiting: dict[_T, None], most: int) -> list[_T]:
    """Remove at most a number of items, the oldest first, and return them."""
    found = list(islice(waiting, most))
    for one in found:
        del waiting[one]
    return found
