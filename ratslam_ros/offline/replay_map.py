# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Map file of a replay: continued, saved while the replay runs, or used to localise only.

A replay saves its whole state between two events, together with the number of events of each
stream that it has processed. A replay of the same recording therefore continues with the event
after the last saved one, and builds the same map as without the interruption.
"""

from __future__ import annotations

import time
from collections import Counter
from collections.abc import Callable, Iterable, Iterator
from contextlib import suppress
from pathlib import Path
from typing import Any

from ratslam_ros.core.common.state import State
from ratslam_ros.core.config import Config
from ratslam_ros.errors import RatslamError, UnusableInput
from ratslam_ros.files.config import stored_config, to_yaml
from ratslam_ros.maps import Cut, MapMeta, MapStore, SavedMap, read_map
from ratslam_ros.maps.saved_map import seconds
from ratslam_ros.maps.saving import locked
from ratslam_ros.maps.schema import remove
from ratslam_ros.pipeline.ratslam import RatSLAM
from ratslam_ros.recordings import Event, Recording, Selection
from ratslam_ros.results.plots import counted
from ratslam_ros.version import __version__

CUT_PERIOD_S = 20.0
"""Time of the recording between two saved states: what a killed replay has to repeat. Saving a
state of 20,000 views takes some milliseconds of the replay."""

ENDLESS_CUT_PERIOD_S = 2.0
"""The same for a camera, whose images cannot be read again: what a killed process loses."""

FLUSH_S, FLUSH_STEP_S = 600.0, 1.0
"""Longest time to wait until a state is on the disk, and between two checks whether it cannot be
written at all."""

PROGRESS = 'replay'
"""Key of the progress of the replay in the part `inputs`."""

STRUCTURE = (
    ('local_view', 'vt_descriptor'), ('local_view', 'template_x_size'),
    ('local_view', 'template_y_size'), ('pose_cells', 'pc_dim_x'), ('pose_cells', 'pc_dim_y'),
    ('pose_cells', 'pc_dim_th'),
)
"""Parameters that a map cannot change, because its templates and cells have their sizes."""


class ReplayMap:
    """A map file during a replay.

    Call ``open`` before the first event, ``after`` for each event, and ``finish`` or ``abandon``
    at the end.
    """

    def __init__(
        self, path: Path, localize: bool, notify: Callable[[str], None],
        report: Callable[[str], None],
    ) -> None:
        """Choose the file; nothing is read.

        Args:
            path: the map file.
            localize: leave the map as it is, and only localise the robot on it.
            notify: receives lines on what is continued.
            report: receives lines on problems with the file, and on their end.
        """
        self.path = path
        self.localize = localize
        self.skipped = 0
        """Number of events that the map already contained."""
        self.last_view_ns = 0
        """Stamp of the last view of the map that had a template."""
        self.problem = ''
        """Why the last state could not be saved; '' if it is saved."""
        self.saved: Cut | None = None
        """The last state that this replay has saved, once the file is closed."""
        self._notify, self._report = notify, report
        self._store: MapStore | None = None
        self._slam: RatSLAM | None = None
        self._identity: State = {}
        self._counts: Counter[str] = Counter()
        self._to_skip: Counter[str] = Counter()
        self._number = 0
        self._saved_ns = 0
        self._is_complete = self._has_changed = self._is_endless = self._is_new = False
        self._saved: SavedMap | None = None

    def configuration(self) -> str:
        """Return the configuration stored in the map as YAML, '' for a new map.

        Raises:
            UnusableInput: the file is no map, or there is none to localise on.
        """
        saved = self._read()
        return '' if saved is None else saved.meta.configuration

    def _read(self) -> SavedMap | None:
        """Read the map once; None if there is no file yet."""
        if self._saved is None and self.path.exists():
            self._saved = read_map(self.path)
        if self._saved is None and self.localize:
            raise UnusableInput(
                f'{self.path} does not exist; make it first with ratslam replay RECORDING --map '
                f'{self.path}'
            )
        return self._saved

    def open(
        self, slam: RatSLAM, recording: Recording, selection: Selection, config: Config,
        start_s: float,
    ) -> None:
        """Restore the map into a new system, and open the file.

        Args:
            slam: the system; nothing has been processed.
            recording, selection: what is replayed.
            config: the parameters.
            start_s: skipped seconds at the start of the recording.

        Raises:
            UnusableInput: the map cannot be used, or is in use. The file is unchanged then.
        """
        self._slam = slam
        self._identity = _identity(recording, selection, start_s)
        self._identity['landmarks'] = 'landmark_map' in slam.pipeline.stages
        self._is_endless = recording.is_endless
        saved = self._read()
        self._is_new = saved is None
        lines = [f'{self.path}: new map']
        digests: dict[str, bytes] = {}
        if saved is not None and saved.states:
            _check_structure(saved, config)
            lines = self._restore(slam, saved)
            digests = saved.digests
        if slam.mapping == self.localize:
            slam.mapping = not self.localize
        if not self.localize:
            meta = MapMeta(
                title=recording.name, ratslam_version=__version__,
                configuration=to_yaml(config), recording=str(recording.path.absolute()),
                recording_bytes=self._identity['bytes'], first_ns=recording.start_ns,
            )
            self._store = MapStore(self.path, [*slam.state()], meta, self._report)
            found = self._store.file.restored
            before = {} if found is None else found.digests
            if any(digest != digests.get(part) for part, digest in before.items()):
                self.abandon()
                raise UnusableInput(f'{self.path} was changed in the meantime; try again')
        for line in lines:
            self._notify(line)
        self._saved = None  # The states are not needed twice.
        self._saved_ns = recording.start_ns

    def _restore(self, slam: RatSLAM, saved: SavedMap) -> list[str]:
        """Restore a map; continue its recording, or begin a session; return the lines on it."""
        progress = saved.states.get('inputs', {}).get(PROGRESS)
        try:
            if not slam.restore(saved.states):
                progress = None  # the held messages of this recording are not known
        except RatslamError as error:
            raise UnusableInput(f'{self.path} cannot be continued: {error}') from None
        action_ns = saved.states.get('experience_map', {}).get('action_ns', 0)
        self.last_view_ns = int(action_ns if progress is None else progress['last_view_ns'])
        verb = 'localises on' if self.localize else 'continues'
        lines = [f'{verb} {self.path}: {described(slam, saved)}']
        lines += [f'{self.path}: {note}' for note in saved.notes]
        if self.localize or progress is None or progress['identity'] != self._identity:
            slam.finish()
            slam.begin_session()
            return lines
        self._counts = Counter(progress['counts'])
        self._to_skip = self._counts.copy()
        self._is_complete = bool(progress['complete'])
        count = self._to_skip.total()
        if self._is_complete:
            return [*lines, f'the map contains all {count} messages of this recording already']
        return [
            *lines,
            f'continues this recording after {count} messages that the map contains; the results '
            'of that part are not written again',
        ]

    def remaining(self, events: Iterable[Event]) -> Iterator[Event]:
        """Yield the events that the map does not contain; the others are not decoded."""
        for event in events:
            if self._to_skip[event.KIND] > 0:
                self._to_skip[event.KIND] -= 1
                self.skipped += 1
            else:
                yield event

    def after(self, event: Event, last_view_ns: int) -> None:
        """Count a processed event, and save the state if it is due.

        Args:
            event: the event.
            last_view_ns: stamp of the last view that had a template, 0 if there was none.
        """
        self._counts[event.KIND] += 1
        self._has_changed, self._is_complete = True, False
        if last_view_ns:
            self.last_view_ns = last_view_ns
        period_s = ENDLESS_CUT_PERIOD_S if self._is_endless else CUT_PERIOD_S
        if self._store is not None and event.log_ns - self._saved_ns >= period_s * 1e9:
            self._saved_ns = event.log_ns
            self._save()

    def save_before_end(self) -> None:
        """Save the state with the messages that are still held, so that it can be continued."""
        if self._store is not None and self._has_changed:
            self._save()

    def finish(self, complete: bool, last_view_ns: int) -> None:
        """Save the last state, and close the file.

        Args:
            complete: the recording was replayed to its end, and no message is held any more.
            last_view_ns: as for ``after``.
        """
        if self._store is None:
            return
        if last_view_ns:
            self.last_view_ns = last_view_ns
        if complete and (self._has_changed or not self._is_complete):
            self._is_complete = True
            self._save()
        self.problem = self._flush()
        if self.problem and not self.path.parent.exists():  # It was removed during the replay.
            with suppress(OSError):
                self.path.parent.mkdir(parents=True)
                self.problem = self._flush()
        self._close()

    def abandon(self) -> None:
        """Close the file with what has been saved; remove a new one without a place."""
        store, slam = self._store, self._slam
        self._close()
        if self._is_new and store and slam and not (
            store.file.restored or len(slam.experience_map)
        ):
            self.problem = 'it has no place'
            with suppress(UnusableInput), locked(store.path):  # unless another process writes it
                remove(store.path)  # self.path may be a link

    def _close(self) -> None:
        if self._store is not None:
            self._store.close()
            if self._store.path != self.path.resolve():  # Another file has its name now.
                self.path = self._store.path
            self.saved = self._store.acknowledged
            self._store = None

    def _flush(self) -> str:
        """Wait until the state is on the disk; return why it cannot be written, or ''."""
        assert self._store is not None
        until_s = time.monotonic() + FLUSH_S
        while not self._store.flush(FLUSH_STEP_S):
            if self._store.problem or time.monotonic() > until_s:
                return self._store.problem or f'{self.path}: the disk is too slow'
        return ''

    def summary(self) -> dict[str, Any]:
        """Return what summary.json contains of the map."""
        return {
            'file': str(self.path), 'localize': self.localize, 'messages_before': self.skipped,
            'saved': not self.problem and not self.localize,
        }

    def _save(self) -> None:
        assert self._store is not None
        assert self._slam is not None
        states = self._slam.state()
        states['inputs'] = {
            **states.get('inputs', {}),
            PROGRESS: {
                'identity': self._identity, 'counts': dict(sorted(self._counts.items())),
                'last_view_ns': self.last_view_ns,
                # The images that a camera would have sent cannot be read again.
                'complete': self._is_complete or self._is_endless,
            },
        }
        if not self._store.problem:
            self._flush()  # The store would leave out cuts if the disk is slow, others each time.
        self._number += 1
        stamp_ns = self._slam.newest_ns
        self._store.cut(Cut(self._number, stamp_ns), states)


def described(slam: RatSLAM, saved: SavedMap) -> str:
    """Return the size of a map for the user."""
    graph = slam.experience_map
    sessions = len(session_titles(saved))
    parts = f', {graph.component_count} parts' if graph.component_count > 1 else ''
    return f'{counted(len(graph), "place")}, {counted(sessions, "session")}{parts}'


def unfinished_note(saved: SavedMap) -> list[str]:
    """Return one line if the last replay did not reach the end of its recording, else none."""
    progress = saved.states.get('inputs', {}).get(PROGRESS)
    if progress is None or progress['complete'] or saved.cut is None:
        return []
    return [
        f'the replay of {progress["identity"]["name"]} did not reach its end: the map is saved up '
        f'to stamp {seconds(saved.cut.stamp_ns)} s; give the command of the replay again to '
        'continue after it'
    ]


def session_titles(saved: SavedMap) -> list[str]:
    """Return the titles of the sessions; a recording that was interrupted counts once."""
    titles: list[str] = []
    before = ('', 0)
    for one in saved.sessions:
        recording = one.meta.recording, one.meta.first_ns
        if recording != before or not recording[0]:
            titles.append(one.meta.title or f'session {one.number}')
        before = recording
    return titles


def _identity(recording: Recording, selection: Selection, start_s: float) -> State:
    """Return what distinguishes a sequence of messages; its path does not."""
    size = sum(one.stat().st_size for one in recording.files if one.is_file())
    topics = [
        selection.image_topic, selection.odom_topic, selection.scan_topic,
        selection.template_topic,
    ]
    return {
        'name': recording.name, 'kind': recording.kind, 'bytes': size, 'topics': topics,
        'first_ns': recording.start_ns, 'last_ns': recording.end_ns,
        'start_ns': round(start_s * 1e9),
    }


def _check_structure(saved: SavedMap, config: Config) -> None:
    """Raise if a configuration contradicts the sizes of the templates and cells of a map."""
    if not saved.meta.configuration:
        return  # Restoring compares the sizes, too.
    before = stored_config(saved.meta.configuration, str(saved.path))[0].values()
    given = config.values()
    for section, name in STRUCTURE:
        if before[section][name] != given[section][name]:
            raise UnusableInput(
                f'{saved.path} has {section}.{name} {before[section][name]}, but '
                f'{given[section][name]} was given: leave it out, or use another map'
            )
