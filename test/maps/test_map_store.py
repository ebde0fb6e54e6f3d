# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The writer of a map: what is durable, what a failing disk causes, and what stays in the file."""

from __future__ import annotations

import os
import sqlite3
import threading
import time
from collections.abc import Callable
from contextlib import closing
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from map_states import LONG_S, META, growing_state, opened, same, write

from ratslam_ros.errors import UnusableInput
from ratslam_ros.maps import Cut, MapStore, read_map, save_map
from ratslam_ros.maps.file_writer import FileWriter
from ratslam_ros.maps.sessions import KEPT_CUTS
from ratslam_ros.maps.store import WAITING_CUTS

PART = 'local_view'


def rows(path: Path, query: str) -> list[Any]:
    with closing(sqlite3.connect(path)) as database:
        return database.execute(query).fetchall()


def test_new_map_restores_nothing_and_ends_as_one_file(tmp_path: Path) -> None:
    path = tmp_path / 'folder' / 'a.map'
    store = opened(path, PART)
    assert store.file.restored is None
    assert not store.file.joins
    write(store, 1)
    assert store.acknowledged == Cut(1, 10)
    store.close()
    assert os.listdir(path.parent) == ['a.map']
    saved = read_map(path)
    assert same(saved.states, {PART: growing_state(1)})
    assert (saved.cut, saved.meta, saved.notes) == (Cut(1, 10), META, [])
    assert saved.sessions[0].ended


@settings(max_examples=15)
@given(st.lists(
    st.tuples(st.integers(0, 30_000), st.lists(st.integers(0, 40_000), max_size=5), st.booleans()),
    min_size=1, max_size=25,
))
def test_any_series_of_states_is_restored(
    tmp_path_factory: pytest.TempPathFactory, series: list[tuple[int, list[int], bool]]
) -> None:
    """Arrays grow, shrink, change, vanish and return; the old cuts stay readable."""
    path = tmp_path_factory.mktemp('map') / 'a.map'
    writer = FileWriter(path, (PART,), META)
    states = []
    for number, (length, changes, has_other) in enumerate(series, 1):
        values = np.zeros(length, np.uint16)
        values[[change for change in changes if change < length]] = number
        state = {'a': values, 'n': list(range(length % 70))}
        if has_other:
            state['other'] = values[: length // 2].astype(np.float32)
        states.append(state)
        writer.write(Cut(number, number), {PART: state})
        assert same(read_map(path).states, {PART: state})
    writer.close(complete=True)
    again = FileWriter(path, (PART,), META)
    assert again.restored is not None
    assert same(again.restored.states, {PART: states[-1]})
    again.write(Cut(1, 1), {PART: states[0]})
    again.close(complete=True)
    assert same(read_map(path).states, {PART: states[0]})
    versions = rows(path, 'SELECT count(*), count(DISTINCT array || position) FROM chunks')
    assert versions[0][0] <= versions[0][1] * (KEPT_CUTS + 2)


def test_cut_writes_only_changed_chunks(tmp_path: Path) -> None:
    store = opened(tmp_path / 'a.map', PART)
    array = np.random.default_rng(1).random(100_000)
    write(store, 1, {'a': array})
    changed = array.copy()
    changed[[5, 50_000]] = 0.5
    write(store, 2, {'a': changed})
    write(store, 3, {'a': changed})
    counts = "SELECT since, count(*) FROM chunks WHERE array = '/a' GROUP BY since"
    assert rows(store.path, counts) == [(1, 98), (2, 2)]
    store.close()


def test_file_stays_small_however_many_cuts_are_written(tmp_path: Path) -> None:
    writer = FileWriter(tmp_path / 'a.map', (PART,), META)
    generator = np.random.default_rng(1)
    for number in range(1, 6 * KEPT_CUTS):
        writer.write(Cut(number, number), {PART: {'a': generator.random(5000)}})
    found = rows(tmp_path / 'a.map', 'SELECT number FROM cuts ORDER BY id')
    assert [number for (number,) in found] == list(range(5 * KEPT_CUTS, 6 * KEPT_CUTS))
    assert rows(tmp_path / 'a.map', 'SELECT count(*) FROM chunks WHERE array > ""') == [
        (KEPT_CUTS * 5,)
    ]
    writer.close(complete=True)
    once = tmp_path / 'b.map'
    save_map(once, read_map(tmp_path / 'a.map').states, META)
    assert (tmp_path / 'a.map').stat().st_size < 2 * KEPT_CUTS * once.stat().st_size


def test_versions_of_a_killed_process_are_removed_later(tmp_path: Path) -> None:
    path = tmp_path / 'a.map'
    generator = np.random.default_rng(1)
    number = 0
    for _ in range(4):
        writer = FileWriter(path, (PART,), META)
        for _ in range(KEPT_CUTS + 3):
            number += 1
            state = {'a': generator.random(3000), 'b': np.zeros(5000 // number)}
            writer.write(Cut(number, number), {PART: state})
        writer.release()
    assert rows(path, 'SELECT count(*) FROM cuts') == [(KEPT_CUTS,)]
    assert rows(path, "SELECT count(*) FROM chunks WHERE array = '/a'") == [(KEPT_CUTS * 3,)]


def test_same_states_have_the_same_digest(tmp_path: Path) -> None:
    path = tmp_path / 'a.map'
    for numbers in ([1, 2, 3], [4, 9]):
        store = opened(path, PART, 'pose_cells')
        for number in numbers:
            write(store, number)
        store.close()
    save_map(tmp_path / 'b.map', dict.fromkeys((PART, 'pose_cells'), growing_state(9)), META)
    save_map(tmp_path / 'c.map', dict.fromkeys((PART, 'pose_cells'), growing_state(9)), META)
    assert read_map(path).digest == read_map(tmp_path / 'b.map').digest
    assert (tmp_path / 'b.map').read_bytes() == (tmp_path / 'c.map').read_bytes()


class SlowWriter:
    """Lets the thread of a store wait in the middle of its first cut."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch) -> None:
        self.begun, self.go = threading.Event(), threading.Event()
        write_now = FileWriter.write

        def wait(writer: FileWriter, *values: Any) -> None:
            self.begun.set()
            assert self.go.wait(LONG_S)
            write_now(writer, *values)

        monkeypatch.setattr(FileWriter, 'write', wait)


def test_slow_disk_leaves_out_odd_cuts_and_never_waits(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    slow = SlowWriter(monkeypatch)
    store = opened(tmp_path / 'a.map', PART)
    store.cut(Cut(1, 10), {PART: growing_state(1)})
    assert slow.begun.wait(LONG_S)
    for number in range(2, 36):
        store.cut(Cut(number, number * 10), {PART: {'n': number}})
        assert len(store._cuts) <= WAITING_CUTS
    slow.go.set()
    assert store.flush(LONG_S)
    found = [number for (number,) in rows(store.path, 'SELECT number FROM cuts')]
    assert found == [1, 16, 32, 35]  # those that other parts, too, leave out last
    store.close()


def test_cut_with_smaller_number_is_left_out(tmp_path: Path) -> None:
    store = opened(tmp_path / 'a.map', PART)
    write(store, 5)
    write(store, 4)
    write(store, 5, {'n': 1})
    assert same(read_map(store.path).states[PART], growing_state(5))
    store.close()


def test_parts_of_others_cannot_be_handed_over(tmp_path: Path) -> None:
    store = opened(tmp_path / 'a.map', PART)
    with pytest.raises(ValueError, match='pose_cells'):
        store.cut(Cut(1, 1), {'pose_cells': {}})
    store.close()


def test_changed_parameters_are_recorded_with_the_next_cut(tmp_path: Path) -> None:
    """Those of other processes, and what else is known of the session, stay as they are."""
    first, second = opened(tmp_path / 'a.map', PART), opened(tmp_path / 'a.map', 'pose_cells')
    first.file.configure('local_view:\n  vt_match_threshold: 0.5\n')
    second.file.configure('pose_cells:\n  pc_vt_agree_views: 7\n')
    assert read_map(tmp_path / 'a.map').meta == META
    for store in (first, second):
        write(store, 1)
    found = read_map(tmp_path / 'a.map').meta
    assert 'vt_match_threshold: 0.5' in found.configuration
    assert 'pc_vt_agree_views: 7' in found.configuration
    assert replace(found, configuration=META.configuration) == META
    first.file.configure('local_view:\n  vt_match_threshold: 0.25\n')
    write(first, 2)
    found = read_map(tmp_path / 'a.map').meta
    assert 'vt_match_threshold: 0.25' in found.configuration
    assert 'vt_match_threshold: 0.5' not in found.configuration
    assert 'pc_vt_agree_views: 7' in found.configuration
    for store in (first, second):
        store.close()


# Failures


def fail_on_connect(monkeypatch: pytest.MonkeyPatch, error: Exception) -> Callable[[], None]:
    """Let every transaction fail, until the returned function is called."""
    begin = FileWriter._opened

    def fail(writer: FileWriter) -> Any:
        raise error

    monkeypatch.setattr(FileWriter, '_opened', fail)
    return lambda: monkeypatch.setattr(FileWriter, '_opened', begin)


@pytest.mark.parametrize(('error', 'text'), [
    (sqlite3.OperationalError('database or disk is full'), 'the disk is full; free some space'),
    (sqlite3.OperationalError('database is locked'), 'another program has locked it'),
    (sqlite3.OperationalError('attempt to write a readonly database'), 'it is read-only'),
    (sqlite3.OperationalError('unable to open database file'), 'check its folder'),
    (sqlite3.OperationalError('disk I/O error'), 'disk I/O error'),
    (OSError(30, 'Read-only file system'), 'Read-only file system'),
    (ZeroDivisionError('defect'), 'ZeroDivisionError: defect'),
])
def test_failure_is_reported_once_and_so_is_its_end(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, error: Exception, text: str
) -> None:
    monkeypatch.setattr('ratslam_ros.maps.store.RETRY_S', 0.01)
    reports: list[str] = []
    store = opened(tmp_path / 'a.map', PART, reports=reports)
    write(store, 1)
    repair = fail_on_connect(monkeypatch, error)
    for number in range(2, 12):
        store.cut(Cut(number, number), {PART: growing_state(number)})
        assert not store.flush(0.02)
    end_s = time.monotonic() + 60.0
    while not reports and time.monotonic() < end_s:  # the thread may not have run yet
        time.sleep(0.01)
    assert len(reports) == 1
    assert text in reports[0]
    assert '\n' not in reports[0]
    assert store.problem
    assert store.acknowledged == Cut(1, 10)
    assert same(read_map(store.path).states[PART], growing_state(1))
    repair()
    assert store.flush(LONG_S)
    assert store.acknowledged == Cut(11, 11)
    store.close()
    assert reports[1:] == [f'{store.path} is written again; nothing in memory was lost']
    assert not store.problem
    assert same(read_map(store.path).states[PART], growing_state(11))


def test_lock_of_another_program_delays_saving_only(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr('ratslam_ros.maps.schema.BUSY_S', 0.01)
    reports: list[str] = []
    store = opened(tmp_path / 'a.map', PART, reports=reports)
    write(store, 1)
    with closing(sqlite3.connect(store.path, isolation_level=None)) as other:
        other.execute('BEGIN IMMEDIATE')
        store.cut(Cut(2, 20), {PART: growing_state(2)})
        assert not store.flush(0.3)
        other.execute('ROLLBACK')
    assert 'another program has locked it' in reports[0]
    write(store, 3)
    store.close()
    assert same(read_map(store.path).states[PART], growing_state(3))


def test_deleted_file_is_written_anew_with_all_parts(tmp_path: Path) -> None:
    save_map(tmp_path / 'a.map', {'landmark_map': {'n': 1}}, META)
    store = opened(tmp_path / 'a.map', PART)
    write(store, 1)
    for file in tmp_path.iterdir():
        file.unlink()
    write(store, 2)
    expected = {'landmark_map': {'n': 1}, PART: growing_state(2)}
    assert same(read_map(store.path).states, expected)
    store.close()
    assert os.listdir(tmp_path) == ['a.map']


def test_deleted_file_is_written_anew_by_all_writers(tmp_path: Path) -> None:
    stores = [opened(tmp_path / 'a.map', part) for part in (PART, 'pose_cells')]
    for store in stores:
        write(store, 1)
    (tmp_path / 'a.map').unlink()
    for store in stores:
        write(store, 2)
    assert read_map(tmp_path / 'a.map').cut == Cut(2, 20)
    for store in stores:
        store.close()
    assert sorted(read_map(tmp_path / 'a.map').states) == [PART, 'pose_cells']


def test_vanished_folder_is_reported_and_its_return_too(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr('ratslam_ros.maps.store.RETRY_S', 0.01)
    reports: list[str] = []
    folder, away = tmp_path / 'maps', tmp_path / 'away'
    store = opened(folder / 'a.map', PART, reports=reports)
    write(store, 1)
    folder.rename(away)
    store.cut(Cut(2, 20), {PART: growing_state(2)})
    assert not store.flush(0.2)
    assert not folder.exists()  # It may be a disk that was unplugged.
    assert 'No such file or directory' in reports[0]
    away.rename(folder)
    write(store, 3)
    assert 'written again' in reports[1]
    store.close()
    assert read_map(folder / 'a.map').cut == Cut(3, 30)


@pytest.mark.parametrize('parts', [(PART, 'pose_cells'), ('pose_cells', PART)])
@pytest.mark.parametrize('is_map', [True, False])
def test_file_moved_over_a_map_is_left_alone(
    tmp_path: Path, parts: tuple[str, ...], is_map: bool
) -> None:
    other, path, reports = tmp_path / 'other.map', tmp_path / 'a.map', list[str]()
    other.write_text('no map ' * 1000)
    if is_map:
        other.unlink()
        save_map(other, {PART: growing_state(7)}, META)
    before = other.read_bytes()
    save_map(path, {'landmark_map': {'n': 1}}, META)
    stores = [opened(path, part, reports=reports) for part in parts]
    for store in stores:
        write(store, 1)
    os.replace(other, path)
    for store in stores:
        write(store, 2)
    for store in stores:
        store.close()
    assert path.read_bytes() == before
    assert {store.path.name for store in stores} | {'a.map'} == set(os.listdir(tmp_path))
    assert reports == [
        f'{path} is another file now, and is left alone; saving to {stores[0].path}'
    ] * 2
    saved = read_map(stores[0].path)
    assert same(saved.states, {
        'landmark_map': {'n': 1}, **dict.fromkeys(sorted(parts), growing_state(2))
    })
    assert [row.number for row in saved.sessions] == [1, 2]


def test_map_moved_away_is_kept_and_the_other_left_alone(tmp_path: Path) -> None:
    store = opened(tmp_path / 'a.map', PART)
    write(store, 1)
    kept = tmp_path / 'kept.map'
    for suffix in ('', '-wal'):
        os.rename(f'{store.path}{suffix}', f'{kept}{suffix}')
    save_map(tmp_path / 'other.map', {PART: growing_state(7)}, META)
    os.replace(tmp_path / 'other.map', tmp_path / 'a.map')
    store.close()  # without a further state
    assert same(read_map(tmp_path / 'a.map').states[PART], growing_state(7))
    assert same(read_map(kept).states[PART], growing_state(1))
    assert same(read_map(store.path).states[PART], growing_state(1))


def test_opening_reports_what_is_wrong(tmp_path: Path) -> None:
    (tmp_path / 'text.map').write_text('no map ' * 1000)
    (tmp_path / 'empty.map').touch()
    for name, text in (
        ('text.map', 'is not a map file'), ('empty.map', 'is empty: expected a map of RatSLAM'),
        ('', 'is a folder'), ('text.map/a.map', 'cannot be written'),
    ):
        before = sorted(os.listdir(tmp_path))
        with pytest.raises(UnusableInput, match=text) as error:
            opened(tmp_path / name, PART)
        assert '\n' not in str(error.value)
        assert sorted(os.listdir(tmp_path)) == before
    assert (tmp_path / 'text.map').read_text() == 'no map ' * 1000


def test_stale_log_is_not_applied_to_a_new_map(tmp_path: Path) -> None:
    path = tmp_path / 'a.map'
    store = opened(path, PART)
    write(store, 1)
    log = Path(f'{path}-wal').read_bytes()
    store.close()
    path.unlink()
    Path(f'{path}-wal').write_bytes(log)
    store = opened(path, 'pose_cells')
    assert store.file.restored is None
    write(store, 1)
    store.close()
    assert list(read_map(path).states) == ['pose_cells']


def test_close_twice_and_without_cuts(tmp_path: Path) -> None:
    store = opened(tmp_path / 'a.map', PART)
    store.close()
    store.close()
    assert read_map(tmp_path / 'a.map').states == {}
    assert MapStore(tmp_path / 'a.map', [PART], META, print).file.restored is None
