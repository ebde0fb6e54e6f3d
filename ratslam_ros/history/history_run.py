# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""A run that is read from its history file, finished or growing in another process."""

from __future__ import annotations

import sqlite3
from collections.abc import Iterator, Sequence
from contextlib import closing, contextmanager
from functools import cached_property
from itertools import accumulate, islice
from pathlib import Path

import yaml

from ratslam_ros.errors import UnusableInput
from ratslam_ros.history.encoding import decoded, unpacked
from ratslam_ros.history.file import HISTORY, PART, HistoryMeta
from ratslam_ros.history.recorded_images import RecordedImages
from ratslam_ros.history.records import ImageRecord, PoseRecord, Record, ViewRecord
from ratslam_ros.history.run_state import NS_PER_S, RunState
from ratslam_ros.history.truth import Truth
from ratslam_ros.maps.chunks import DamagedData
from ratslam_ros.maps.locks import is_written
from ratslam_ros.maps.schema import check_layout, connect, identity, typed
from ratslam_ros.results.trajectory import Trajectory

SECTION, VIEWS = '/**/pose_cells', 'pc_vt_agree_views'
"""Number of views that must agree on a place, in the configuration of the run."""

MAX_IMAGE_AGE_NS = 10 * NS_PER_S
"""Age up to which the last image is shown for a stamp."""

LATER, EARLIER = (
    f'SELECT first_record, begin_ns, data FROM segments WHERE {condition} LIMIT 1'
    for condition in (
        'first_record > ? AND end_ns > ? ORDER BY first_record',
        'first_record < ? AND begin_ns <= ? ORDER BY first_record DESC',
    )
)
"""Queries for the next segment in the direction of a search."""


class HistoryRun:
    """A ``RunSource`` over a history file; it may be used from several threads.

    All methods raise UnusableInput if the file is damaged. The position of a record in time is the
    largest stamp up to it: records of late messages have the time of those before them. All stamps
    of the methods are such times. The state at a stamp is the sum of all records up to it;
    advancing in steps of any size gives the same state as seeking.
    """

    def __init__(self, path: Path) -> None:
        """Open a history file.

        Args:
            path: the file; with the suffix ``.part`` while it grows.

        Raises:
            UnusableInput: the file is no history, or of another version.
        """
        self._path = path = path.resolve()  # results/latest names another run later
        self._identity = identity(path) or identity(self._final) or (0, 0)
        with self._reading() as database:
            check_layout(database, path, HISTORY)
            row = database.execute("SELECT value FROM meta WHERE key = 'run'").fetchone()
            if row is None:
                raise DamagedData('it describes no run')
            self.meta = HistoryMeta.from_json(row[0])
        self.title = self.meta.title
        """Name of the run, such as that of the recording."""
        self.added_notices: Sequence[str] = ()
        """What the user must know besides, set by the owner of the run."""
        self._trajectory: Trajectory | None = None
        self._truth: Truth | None = None
        self._images = RecordedImages(self.meta)
        self._begin_ns = self._end_ns = 0
        self._is_growing, self._has_ended = True, False
        self._poll()

    def close(self) -> None:
        """Close the recording; the file is only open during calls, so that its writer can end."""
        self._images.close()

    def set_truth(self, trajectory: Trajectory) -> None:
        """Show a true trajectory from now on; it is aligned by the first pose of the run."""
        self._trajectory, self._truth = trajectory, None

    @property
    def begin_ns(self) -> int:
        """Stamp of the first record, 0 if there is none yet."""
        self._poll()
        return self._begin_ns

    @property
    def end_ns(self) -> int:
        """Stamp of the last record, 0 if there is none yet."""
        self._poll()
        return self._end_ns

    @property
    def is_growing(self) -> bool:
        """Whether more records may follow."""
        self._poll()
        return self._is_growing

    @property
    def notices(self) -> Sequence[str]:
        """What the user must know."""
        self._poll()
        notices = [*self.added_notices]
        if not self._is_growing and not self._has_ended:
            notices.append('the run was interrupted: the history ends with its last moments')
        if self._images.problem:
            notices.append(self._images.problem)
        return notices

    @cached_property
    def required_views(self) -> float | None:
        """Number of views that must agree on a place, None if unknown."""
        try:
            sections = yaml.safe_load(self.meta.configuration)
            return float(sections[SECTION]['ros__parameters'][VIEWS])
        except (yaml.YAMLError, LookupError, TypeError, ValueError):
            return None

    def seek(self, stamp_ns: int) -> RunState:
        """Return a new state: that of the last record whose stamp is not later."""
        with self._reading() as database:
            row = database.execute(
                'SELECT data FROM checkpoints WHERE stamp_ns <= ? ORDER BY record_count DESC '
                'LIMIT 1', (stamp_ns,),
            ).fetchone()
            state = RunState() if row is None else decoded(unpacked(row[0]), RunState)
        self.advance(state, stamp_ns)
        return state

    def advance(self, state: RunState, stamp_ns: int) -> None:
        """Apply to a state all records between it and a later stamp."""
        with self._reading() as database:
            for first_record, begin_ns, data in database.execute(
                'SELECT first_record, begin_ns, data FROM segments WHERE first_record >= coalesce('
                '(SELECT max(first_record) FROM segments WHERE first_record <= ?), 0) '
                'ORDER BY first_record', (state.record_count,),
            ):
                if begin_ns > stamp_ns:
                    break
                records = decoded(unpacked(data), list[Record])
                for record in records[state.record_count - first_record :]:
                    if record.stamp_ns > stamp_ns:
                        break
                    state.apply(record)
        if self._trajectory is not None and state.pose is not None:
            if self._truth is None:
                self._truth = self._truth_of(self._trajectory)
            self._truth.apply(state)

    def image_at(self, stamp_ns: int) -> bytes | None:
        """Return the best image of a stamp as JPEG, None if there is none near it.

        That of the recording if it is there, else the small one of the history.
        """
        view = self.view_at(stamp_ns)
        if view is not None and stamp_ns - view.stamp_ns <= MAX_IMAGE_AGE_NS:
            image = self._images.at(view.stamp_ns)
            if image is not None:
                return image
        for at_ns, record in self._records(stamp_ns, later=False):
            if isinstance(record, ImageRecord):
                return record.jpeg
            if at_ns < stamp_ns - MAX_IMAGE_AGE_NS:
                break
        return None

    def view_at(self, stamp_ns: int) -> ViewRecord | None:
        """Return the last view whose stamp is not later."""
        return next((view for _, view in self._views(stamp_ns, later=False)), None)

    def step(self, stamp_ns: int, views: int) -> int:
        """Return the stamp of the view that is a number of views later, or earlier if negative.

        It is that of the first or last view if there are not as many, and the given one if there
        are none.
        """
        later, count = views > 0, views if views > 0 else 1 - views
        found = [*islice(self._views(stamp_ns, later), count)]
        found = found or [*islice(self._views(stamp_ns, not later), 1)]
        return found[-1][0] if found else stamp_ns

    def visits(self, experience_id: int, until_ns: int) -> list[ViewRecord]:
        """Return the first view of every visit of an experience up to a stamp, oldest first.

        The id may have been that of another experience before, whose visits are left out.
        """
        with self._reading() as database:
            views = [decoded(data, ViewRecord) for (data,) in database.execute(
                'SELECT record FROM visits WHERE experience = ? AND stamp_ns <= ? '
                'ORDER BY number', (experience_id, until_ns),
            )]
        created = [n for n, view in enumerate(views) if view.action == 'create']
        return views[created[-1] :] if created else views

    def _poll(self) -> None:
        """Read how far the run is, until it has ended."""
        if not self._is_growing:
            return
        is_alive = is_written(self._final)  # Asked first: the writer ends the run, then lets go.
        with self._reading() as database:
            row = database.execute(
                'SELECT coalesce((SELECT begin_ns FROM segments ORDER BY first_record LIMIT 1), 0)'
                ', coalesce((SELECT end_ns FROM segments ORDER BY first_record DESC LIMIT 1), 0), '
                "EXISTS (SELECT 1 FROM meta WHERE key = 'ended')"
            )
            ((self._begin_ns, self._end_ns, ended),) = typed(row, tuple[int, int, int])
        self._has_ended = ended > 0
        self._is_growing = is_alive and not self._has_ended

    @property
    def _final(self) -> Path:
        """Name of the file when the run has ended."""
        return self._path.with_name(self._path.name.removesuffix(PART))

    def _truth_of(self, trajectory: Trajectory) -> Truth:
        """Align a true trajectory by the first record of poses, which must exist."""
        for _, record in self._records(-1, later=True):
            if isinstance(record, PoseRecord):
                return Truth(trajectory, record.stamp_ns, record.pose)
        raise UnusableInput(
            f'{self._path} is damaged (a pose is missing); replay the recording again'
        )

    def _views(self, stamp_ns: int, later: bool) -> Iterator[tuple[int, ViewRecord]]:
        return (
            (at_ns, record) for at_ns, record in self._records(stamp_ns, later)
            if isinstance(record, ViewRecord)
        )

    def _records(self, stamp_ns: int, later: bool) -> Iterator[tuple[int, Record]]:
        """Yield times and records after a time, or those up to it, the newest first."""
        number = -1 if later else 2**62
        while True:
            with self._reading() as database:
                row = database.execute(LATER if later else EARLIER, (number, stamp_ns)).fetchone()
                if row is None:
                    return
                number, begin_ns, data = row
                records = decoded(unpacked(data), list[Record])
                stamps = accumulate((one.stamp_ns for one in records), max)
                times = (max(at_ns, begin_ns) for at_ns in stamps)
                found = [
                    (at_ns, one) for at_ns, one in zip(times, records, strict=True)
                    if (at_ns > stamp_ns) == later
                ]
            yield from found if later else reversed(found)

    @contextmanager
    def _reading(self) -> Iterator[sqlite3.Connection]:
        """Connect to the file, and name it in errors about it."""
        try:
            with closing(self._open()) as database:
                yield database
        except (sqlite3.Error, UnicodeError) as error:  # Errors quote damaged names.
            raise UnusableInput(
                f'{self._path} is no readable history ({error}); replay the recording again'
            ) from None
        # SQLite does not enforce the types of columns.
        except (DamagedData, ValueError, IndexError, OverflowError, TypeError) as error:
            raise UnusableInput(
                f'{self._path} is damaged ({error}); replay the recording again'
            ) from None

    def _open(self) -> sqlite3.Connection:
        while True:
            if identity(self._path) != self._identity:
                self._path = self._final  # The run has ended.
            is_part = self._path != self._final
            try:
                if identity(self._path) != self._identity:
                    raise UnusableInput(f'{self._path} was removed or replaced; open it again')
                return connect(self._path, 'mode=ro' if is_part else 'mode=ro&immutable=1')
            except (UnusableInput, sqlite3.OperationalError):
                if not is_part or identity(self._path) == self._identity:
                    raise
