# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The writer of parts of a map: callers hand over states, and a thread makes them durable."""

from __future__ import annotations

import threading
import time
from collections import deque
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path

from ratslam_ros.core.common.state import State
from ratslam_ros.errors import UnusableInput
from ratslam_ros.maps.file_writer import FileWriter
from ratslam_ros.maps.saved_map import Cut, MapMeta

Report = Callable[[str], None]

WAITING_CUTS = 3
"""Number of cuts that may wait for the thread; they bound its memory."""

RETRY_S = 2.0
"""Wall-clock time between attempts to write after a failure."""

CLOSE_S = 4.0
"""Wall-clock time that the end may take: a process has 5 s after SIGTERM."""


class MapStore:
    """Writes parts of a map file, together with other processes that write its other parts.

    No method but ``close`` waits for the disk. If the file cannot be written, this is
    reported once, the newest states stay in memory, and writing is tried again until it succeeds,
    which is reported too.
    """

    def __init__(
        self, path: str | Path, parts: Sequence[str], meta: MapMeta, report: Report
    ) -> None:
        """Open a map to write parts of it; create the file if it is missing.

        Args:
            path: the map file.
            parts: the parts that this process writes.
            meta: what is known of the session.
            report: receives one line for every failure and its end, in another thread.

        Raises:
            UnusableInput: another process writes one of the parts, or the file cannot be created
                or is no map.
        """
        self.file = FileWriter(Path(path), tuple(parts), meta)
        """The file, with what was found in it."""
        self.path = self.file.path
        self.problem = ''
        """Why the file cannot be written now, '' if it can."""
        self.acknowledged: Cut | None = None
        """Newest cut of this session that is durable."""
        self._report = report
        self._wake = threading.Condition()
        self._cuts: deque[tuple[Cut, Mapping[str, State]]] = deque()
        self._newest = self.file.number
        self._is_writing = self._is_urgent = self._is_closing = self._is_abandoned = False
        self._thread = threading.Thread(target=self._run, name='map writer', daemon=True)
        self._thread.start()

    def cut(self, cut: Cut, states: Mapping[str, State]) -> None:
        """Hand over the states of parts at a cut, to be written soon.

        If the disk is slower than the cuts, some of them are left out, and the newest is written.
        A cut whose number does not increase is left out too.

        Args:
            cut: the moment; the numbers of a session increase.
            states: by part. Arrays must not be changed afterwards.
        """
        if not states.keys() <= set(self.file.parts):
            raise ValueError(f'parts {sorted(states)}; this process writes {self.file.parts}')
        with self._wake:
            if self._newest is not None and cut.number <= self._newest:
                return
            self._newest = cut.number
            self._cuts.append((cut, dict(states)))
            self._thin()
            self._wake.notify_all()

    def flush(self, timeout_s: float) -> bool:
        """Wait until everything that was handed over is durable; return whether it is."""
        with self._wake:
            self._is_urgent = True
            self._wake.notify_all()
            return self._wake.wait_for(self._is_idle, timeout_s)

    def close(self) -> None:
        """Write what is waiting, and end; the last process leaves a single file."""
        with self._wake:
            if self._is_closing:
                return
            self._is_closing = True
            self._wake.notify_all()
        self._thread.join(CLOSE_S)

    def abandon(self) -> None:
        """End as if the process had been killed: another attempt finds the map as it was."""
        self._is_abandoned = True
        self.close()

    def _is_idle(self) -> bool:
        return not (self._cuts or self._is_writing)

    def _thin(self) -> None:
        """Leave out cuts if too many wait.

        The newest stays, and those whose numbers divide by the highest powers of two, so that
        parts which leave out cuts independently still have some in common.
        """
        while len(self._cuts) > WAITING_CUTS:
            numbers = [cut.number for cut, _ in list(self._cuts)[:-1]]
            del self._cuts[min(range(len(numbers)), key=lambda n: numbers[n] & -numbers[n])]

    def _run(self) -> None:
        """Write what is handed over, until the end."""
        retry_due = 0.0
        while True:
            with self._wake:
                while True:
                    now = time.monotonic()
                    due = 0.0 if self._is_closing or self._is_urgent else retry_due
                    if self._cuts and now >= due:
                        break
                    if self._is_idle():
                        self._is_urgent = False
                        if self._is_closing:
                            break
                    self._wake.wait(due - now if self._cuts else None)
                work = self._cuts.popleft() if self._cuts else None
                self._is_writing = work is not None
                is_closing = self._is_closing
            failure = '' if work is None else self._write(*work)
            retry_due = time.monotonic() + RETRY_S if failure else 0.0
            with self._wake:
                self._is_writing = False
                if failure:
                    self._is_urgent = False
                    assert work is not None
                    self._cuts.appendleft(work)
                    self._thin()
                elif work is not None:
                    self.acknowledged = work[0]
                ends = is_closing and (bool(failure) or self._is_idle())
                self._wake.notify_all()
            self._report_change(failure)
            if ends:
                if self._is_abandoned:
                    self.file.release()
                else:
                    self.file.close(complete=not failure)
                self._follow()
                return

    def _write(self, cut: Cut, states: Mapping[str, State]) -> str:
        """Write a cut; return why this is not possible, or ''."""
        try:
            self.file.write(cut, states)
            self._follow()
        except UnusableInput as error:
            return str(error)
        except Exception as error:  # A defect here must not end the mapping.
            return f'{self.path} cannot be written ({type(error).__name__}: {error})'
        return ''

    def _follow(self) -> None:
        """Report if another file took the name of the map, which is written beside it then."""
        before, self.path = self.path, self.file.path
        if self.path != before:
            self._report(f'{before} is another file now, and is left alone; saving to {self.path}')

    def _report_change(self, failure: str) -> None:
        before, self.problem = self.problem, failure
        if failure and not before:
            self._report(f'{failure}; mapping continues in memory, and saving is tried again')
        elif before and not failure:
            self._report(f'{self.path} is written again; nothing in memory was lost')
