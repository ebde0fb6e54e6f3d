# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Which cuts belong together: sessions, processes that join or crash, and locks on parts."""

from __future__ import annotations

from pathlib import Path

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from map_states import META, growing_state, kill, opened, write

from ratslam_ros.errors import UnusableInput
from ratslam_ros.maps import Cut, MapMeta, MapStore, read_map, save_map
from ratslam_ros.maps.file_writer import FileWriter
from ratslam_ros.maps.sessions import KEPT_CUTS

VIEWS, CELLS, GRAPH = 'local_view', 'pose_cells', 'experience_map'


def numbers(path: Path) -> dict[str, int]:
    """Return the number within the state of each part."""
    return {part: state['n'] for part, state in read_map(path).states.items()}


def put(number: int, *stores: MapStore) -> None:
    for store in stores:
        write(store, number, {'n': number})


def restored(store: MapStore) -> dict[str, int]:
    """Return the number within each restored state."""
    found = store.file.restored
    return {} if found is None else {part: state['n'] for part, state in found.states.items()}


def interrupted(path: Path) -> None:
    """Write a cut of both parts, and kill their processes."""
    views, cells = opened(path, VIEWS), opened(path, CELLS)
    put(1, views, cells)
    kill(views, cells)


def test_part_without_the_last_messages_is_not_a_loss(tmp_path: Path) -> None:
    """At the end, each part has the stamp of the last message that it has processed."""
    stores = [opened(tmp_path / 'a.map', part) for part in ('local_view', 'pose_cells')]
    for store, stamp_ns in zip(stores, (40, 45), strict=True):
        store.cut(Cut(5, stamp_ns), {store.file.parts[0]: growing_state(1)})
        store.close()
    saved = read_map(tmp_path / 'a.map')
    assert (saved.cut, saved.notes) == (Cut(5, 45), [])


def test_new_session_drops_what_does_not_belong_together(tmp_path: Path) -> None:
    path = tmp_path / 'a.map'
    views, cells = opened(path, VIEWS), opened(path, CELLS)
    for number in (1, 2, 3):
        put(number, views)
    put(1, cells)
    put(2, cells)
    kill(views, cells)
    views, cells = opened(path, VIEWS), opened(path, CELLS)
    assert restored(views) == {VIEWS: 2}
    assert 'is of stamp 0.00000002 s; 0.00 s are missing, up to stamp 0.00000003 s' in (
        views.file.notes[0]
    )
    assert restored(cells) == {CELLS: 2}
    assert cells.file.notes == views.file.notes
    assert not cells.file.joins
    assert numbers(path) == {VIEWS: 2, CELLS: 2}
    put(3, views)
    assert numbers(path) == {VIEWS: 2, CELLS: 2}
    put(3, cells)
    assert numbers(path) == {VIEWS: 3, CELLS: 3}
    views.close()
    cells.close()
    assert [row.lost for row in read_map(path).sessions] == [None, (20, 30)]


@pytest.mark.parametrize('is_saved', [True, False])
def test_interruption_without_a_known_loss_is_noted(tmp_path: Path, is_saved: bool) -> None:
    path = tmp_path / 'a.map'
    views = opened(path, VIEWS)
    assert views.file.notes == []
    if is_saved:
        put(1, views)
    kill(views)
    views, cells = opened(path, VIEWS), opened(path, CELLS)
    expected = 'after 0.00000001 s may be lost' if is_saved else 'all until then may be lost'
    assert views.file.notes == cells.file.notes
    assert expected in views.file.notes[0]
    kill(cells)
    cells = opened(path, CELLS)
    assert (cells.file.joins, cells.file.notes) == (True, [])  # Others know what it missed.
    views.close()
    cells.close()
    views = opened(path, VIEWS)
    assert views.file.notes == []
    views.close()


def test_loss_is_reported_again_if_the_session_after_it_was_killed_at_once(tmp_path: Path) -> None:
    path = tmp_path / 'a.map'
    views, cells = opened(path, VIEWS), opened(path, CELLS)
    put(1, views, cells)
    put(2, views)
    kill(views, cells)
    for _ in range(2):
        views = opened(path, VIEWS)
        assert len(views.file.notes) == 1
        assert '0.00 s are missing, up to stamp 0.00000002 s' in views.file.notes[0]
        kill(views)
    views, cells = opened(path, VIEWS), opened(path, CELLS)
    put(2, views, cells)
    kill(views, cells)
    views = opened(path, VIEWS)
    assert 'may be lost' in views.file.notes[0]  # and nothing is known to be missing
    views.close()


def test_interrupted_part_is_awaited_in_the_next_session(tmp_path: Path) -> None:
    """It needs what the others have received since the last cut that all had."""
    path = tmp_path / 'a.map'
    interrupted(path)
    for number in (2, 3):
        views = opened(path, VIEWS)
        assert restored(views) == {VIEWS: 1}
        put(number, views)
        assert views.file.common is None
        kill(views)
    views, cells = opened(path, VIEWS), opened(path, CELLS)
    assert not cells.file.joins and cells.file.is_interrupted
    put(4, views, cells)
    views.close()
    cells.close()
    assert numbers(path) == {VIEWS: 4, CELLS: 4}


@pytest.mark.parametrize('is_closed', [True, False])
def test_part_that_is_not_started_again_is_left_behind(tmp_path: Path, is_closed: bool) -> None:
    path = tmp_path / 'a.map'
    interrupted(path)
    views = opened(path, VIEWS)
    last = 2 if is_closed else KEPT_CUTS + 1
    for number in range(2, last + 1):
        assert numbers(path) == {VIEWS: 1, CELLS: 1}
        put(number, views)
    (views.close if is_closed else views.file.release)()
    assert numbers(path) == {VIEWS: last, CELLS: 1}
    views = opened(path, VIEWS)
    put(last + 1, views)
    assert numbers(path) == {VIEWS: last + 1, CELLS: 1}
    views.close()


def test_replay_awaits_no_interrupted_part(tmp_path: Path) -> None:
    path = tmp_path / 'a.map'
    cells = opened(path, CELLS)
    put(1, cells)
    kill(cells)
    replay = opened(path, VIEWS, 'inputs')
    put(2, replay)
    assert numbers(path) == {VIEWS: 2, 'inputs': 2, CELLS: 1}
    replay.close()


def test_part_that_is_not_used_stays_as_it_was(tmp_path: Path) -> None:
    path = tmp_path / 'a.map'
    save_map(path, {VIEWS: {'n': 7}, 'landmark_map': {'n': 7}, 'inputs': {'n': 7}}, META)
    for _ in range(3):
        views = opened(path, VIEWS)
        put(1, views)
        put(2, views)
        views.close()
    assert numbers(path) == {VIEWS: 2, 'landmark_map': 7}
    landmarks = opened(path, 'landmark_map')
    assert restored(landmarks) == {'landmark_map': 7}
    landmarks.close()


def test_session_without_cuts_changes_nothing(tmp_path: Path) -> None:
    path = tmp_path / 'a.map'
    save_map(path, {VIEWS: {'n': 7}, 'inputs': {'n': 7}}, META, Cut(7, 70))
    digest = read_map(path).digest
    for _ in range(3):
        store = opened(path, VIEWS)
        assert store.file.restored is not None
        assert store.file.restored.cut == Cut(7, 70)
        store.close()
        assert read_map(path).digest == digest
        assert read_map(path).cut == Cut(7, 70)


def test_sessions_may_have_earlier_stamps(tmp_path: Path) -> None:
    path = tmp_path / 'a.map'
    for number in (900, 5, 300, 1):
        store = opened(path, VIEWS, CELLS)
        put(number, store)
        store.close()
        assert read_map(path).cut == Cut(number, number * 10)
        assert numbers(path) == {VIEWS: number, CELLS: number}


def test_part_that_lags_far_behind_keeps_its_common_cut(tmp_path: Path) -> None:
    path = tmp_path / 'a.map'
    views, cells = opened(path, VIEWS), opened(path, CELLS)
    put(1, views, cells)
    for number in range(2, 3 * KEPT_CUTS):
        put(number, views)
    assert numbers(path) == {VIEWS: 1, CELLS: 1}
    put(3 * KEPT_CUTS - 1, cells)
    assert numbers(path) == {VIEWS: 3 * KEPT_CUTS - 1, CELLS: 3 * KEPT_CUTS - 1}
    views.close()
    cells.close()


def test_number_of_sessions_is_bounded(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr('ratslam_ros.maps.sessions.MAX_SESSIONS', 8)
    path = tmp_path / 'a.map'
    save_map(path, {VIEWS: {'n': 7}}, META)
    for _ in range(8 + 3):
        FileWriter(path, (CELLS,), MapMeta('again')).close(complete=True)
    saved = read_map(path)
    assert len(saved.sessions) == 8
    assert saved.sessions[-1].number == 8 + 4
    assert saved.states == {VIEWS: {'n': 7}}


@pytest.mark.parametrize('last', [2, 5])
def test_closed_parts_belong_together_whatever_their_numbers(tmp_path: Path, last: int) -> None:
    """A part that has seen less or more of the drive numbers its last state differently."""
    path = tmp_path / 'a.map'
    views, cells = opened(path, VIEWS), opened(path, CELLS)
    put(1, views)
    put(3, views)
    put(1, cells)
    views.close()
    assert numbers(path) == {VIEWS: 1, CELLS: 1}  # cells may still write 2
    put(last, cells)
    cells.close()
    saved = read_map(path)
    assert (numbers(path), saved.notes) == ({VIEWS: 3, CELLS: last}, [])
    views = opened(path, VIEWS)
    assert restored(views) == {VIEWS: 3}
    assert not views.file.is_interrupted
    views.close()
    assert numbers(path) == {VIEWS: 3, CELLS: last}


def test_map_goes_on_after_one_part_was_closed(tmp_path: Path) -> None:
    path = tmp_path / 'a.map'
    views, cells = opened(path, VIEWS), opened(path, CELLS)
    put(1, views, cells)
    put(3, views)
    views.close()
    last = 3 * KEPT_CUTS
    for number in range(2, last + 1):
        put(number, cells)
    assert numbers(path) == {VIEWS: 3, CELLS: last}
    views = opened(path, VIEWS)
    assert restored(views) == {VIEWS: 3}
    put(last + 1, cells)
    assert numbers(path) == {VIEWS: 3, CELLS: last}  # until views goes on too
    put(last + 1, views)
    assert numbers(path) == {VIEWS: last + 1, CELLS: last + 1}
    views.close()
    cells.close()


class Model:
    """What a map has to contain after writers have been opened, killed and closed.

    A part has a state at each number that it wrote, at all until it joined, and, once closed, at
    all after its last. The map is that of the largest number at which all parts have one. A part
    that was killed in the session before is awaited until it joins or all others have been closed.
    """

    def __init__(self) -> None:
        self.base: dict[str, int] = {}
        self.written: dict[str, list[int]] = {}
        self.joined: dict[str, int | None] = {}
        self.closed: set[str] = set()
        self.awaited: set[str] = set()
        self.start = 0

    def has(self, part: str, number: int) -> bool:
        written = self.written[part]
        return (
            number in written or number <= (self.joined[part] or 0)
            or (part in self.closed and number >= max(written, default=0))
        )

    def common(self) -> int | None:
        found = set[int]().union(*self.written.values())
        parts = self.written
        if self.awaited:
            return None
        return max((n for n in found if all(self.has(part, n) for part in parts)), default=None)

    def states(self) -> dict[str, int]:
        common = self.common() or 0
        kept = {part: [n for n in of if n <= common] for part, of in self.written.items()}
        return {**self.base, **{part: max(of) for part, of in kept.items() if of}}

    def open(self, part: str, is_first: bool) -> tuple[int | None, bool]:
        """Return the number to restore, and whether the part has to catch up."""
        if is_first:
            self.base = self.states()
            self.start = max([self.start, *(n for of in self.written.values() for n in of)])
            self.awaited |= self.written.keys() - self.closed
            self.written, self.joined, self.closed = {}, {}, set()
        common, joins = self.common(), part in self.written
        self.awaited.discard(part)
        if part not in self.written or part in self.closed:
            self.joined[part] = common
            self.written.setdefault(part, [])
            self.closed.discard(part)
        else:
            self.written[part] = [n for n in self.written[part] if n <= (common or 0)]
        return max(self.written[part], default=self.base.get(part)), joins

    def write(self, part: str) -> int:
        written = self.written[part]
        written.append(max(written, default=self.joined[part] or self.start) + 1)
        if len(written) == KEPT_CUTS:
            self.awaited.clear()
        return written[-1]


@settings(max_examples=20)
@given(st.lists(
    st.tuples(st.sampled_from((VIEWS, CELLS, GRAPH)), st.sampled_from('wwwwkc!')), max_size=30
))
def test_any_order_of_events_gives_the_state_of_the_model(
    tmp_path_factory: pytest.TempPathFactory, events: list[tuple[str, str]]
) -> None:
    path = tmp_path_factory.mktemp('map') / 'a.map'
    writers: dict[str, FileWriter] = {}
    model = Model()
    for part, event in events:
        if part not in writers:
            number, joins = model.open(part, is_first=not writers)
            writers[part] = FileWriter(path, (part,), META)
            restored = writers[part].restored
            found = None if restored is None else restored.states.get(part)
            assert found == (None if number is None else {'n': number})
            assert writers[part].joins == joins
        if event == 'w':
            number = model.write(part)
            writers[part].write(Cut(number, number), {part: {'n': number}})
        elif event == 'k':
            writers.pop(part).release()
        elif event == 'c':
            writers.pop(part).close(complete=True)
            model.closed.add(part)
            if not writers:
                model.awaited.clear()
        else:
            while writers:
                writers.popitem()[1].release()
        assert numbers(path) == model.states()
    while writers:
        writers.popitem()[1].release()


# Locks


def test_part_has_one_writer(tmp_path: Path) -> None:
    path = tmp_path / 'a.map'
    store = opened(path, VIEWS, CELLS)
    with pytest.raises(UnusableInput, match=r'in use: pose_cells is written by process \d+'):
        opened(path, GRAPH, CELLS)
    with pytest.raises(UnusableInput, match='in use'):
        save_map(path, {GRAPH: {}}, META)
    graph = opened(path, GRAPH)  # A refused writer leaves no lock.
    graph.close()
    put(1, store)
    store.close()
    opened(path, GRAPH, CELLS).close()


def test_links_to_a_map_are_the_same_map(tmp_path: Path) -> None:
    (tmp_path / 'link.map').symlink_to(tmp_path / 'a.map')
    store = opened(tmp_path / 'link.map', VIEWS)
    put(1, store)
    with pytest.raises(UnusableInput, match='in use'):
        opened(tmp_path / 'a.map', VIEWS)
    assert read_map(tmp_path / 'a.map').cut == read_map(tmp_path / 'link.map').cut == Cut(1, 10)
    store.close()


def test_removed_lock_file_is_noticed(tmp_path: Path) -> None:
    """A second system may begin a session then; the first one writes nothing into it."""
    path = tmp_path / 'a.map'
    reports: list[str] = []
    first = opened(path, VIEWS, reports=reports)
    put(1, first)
    Path(f'{path}-lock').unlink()
    second = opened(path, VIEWS)
    put(2, second)
    first.cut(Cut(5, 50), {VIEWS: {'n': 5}})
    assert not first.flush(0.3)
    assert 'opened by another process although this one writes it' in reports[0]
    assert numbers(path) == {VIEWS: 2}
    second.close()
    first.close()
