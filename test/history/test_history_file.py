# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Writing and reading of history files, in one process and in two."""

from __future__ import annotations

import signal
import sqlite3
import subprocess
import sys
import threading
from contextlib import closing
from functools import partial
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from msgspec import structs
from records_for_tests import add_all, plain, plain_state, random_records

from ratslam_ros.core.common.pose import Pose
from ratslam_ros.core.mapping.map_changes import MapChange
from ratslam_ros.core.pose_cells.torus import Place
from ratslam_ros.errors import UnusableInput
from ratslam_ros.history.budget import RATE_BYTES_PER_S, RESERVE_BYTES
from ratslam_ros.history.file import HISTORY, HISTORY_NAME, HistoryMeta, part_path
from ratslam_ros.history.history_run import HistoryRun
from ratslam_ros.history.opening import open_run
from ratslam_ros.history.records import ImageRecord, PoseRecord, Record, ViewRecord
from ratslam_ros.history.run_state import NS_PER_S, RunState
from ratslam_ros.history.writer import HistoryWriter
from ratslam_ros.maps.locks import is_written
from ratslam_ros.results.trajectory import Trajectory

META = HistoryMeta('a drive', configuration='exp_correction: 1\n')
VIEW = ViewRecord(0, 1, False, 0.1, 0.2, 0.0, 'set', 0, 0, Place(0.0, 0.0, 0.0))
T = TypeVar('T')


def written(path: Path, records: list[Record]) -> list[Record]:
    """Write records to a file; return those that were not left out."""
    writer = HistoryWriter(path, META)
    kept = add_all(writer, records)
    writer.close()
    assert writer.problem == ''
    return kept


def times_of(records: list[Record]) -> list[int]:
    return np.maximum.accumulate([record.stamp_ns for record in records]).tolist()


def timed(records: list[Record], kind: type[T]) -> list[tuple[int, T]]:
    """Return the records of a kind with their times."""
    pairs = zip(times_of(records), records, strict=True)
    return [(at_ns, one) for at_ns, one in pairs if isinstance(one, kind)]


def rows_of(path: Path) -> dict[str, list[tuple[object, ...]]]:
    with closing(sqlite3.connect(path)) as database:
        return {
            table: database.execute(f'SELECT * FROM {table} ORDER BY 1, 2').fetchall()
            for table in ('meta', 'segments', 'checkpoints', 'visits')
        }


@pytest.fixture(scope='module')
def drive(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, list[Record]]:
    path = tmp_path_factory.mktemp('drive') / HISTORY_NAME
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr('ratslam_ros.history.writer.MIN_CHECKPOINT_BYTES', 2**14)
        return path, written(path, random_records(1, 3000))


@settings(max_examples=25, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(st.lists(st.integers(0, 80 * NS_PER_S), max_size=8))
def test_advancing_in_any_steps_equals_seeking(
    drive: tuple[Path, list[Record]], offsets: list[int]
) -> None:
    path, _ = drive
    run = HistoryRun(path)
    state = run.seek(0)
    for offset in sorted(offsets):
        run.advance(state, run.begin_ns + offset)
        assert plain_state(state) == plain_state(run.seek(run.begin_ns + offset))
    run.close()


def test_seek_equals_sum_of_records_up_to_stamp(drive: tuple[Path, list[Record]]) -> None:
    path, records = drive
    run, times = HistoryRun(path), times_of(records)
    assert (run.begin_ns, run.end_ns) == (times[0], times[-1])
    with closing(sqlite3.connect(path)) as database:
        assert database.execute('SELECT count(*) FROM checkpoints').fetchone()[0] > 1
    for number in (0, 1, 700, 1500, len(records) - 1):
        expected = RunState()
        for record, at_ns in zip(records, times, strict=True):
            if at_ns <= times[number]:
                expected.apply(record)
        assert plain_state(run.seek(times[number])) == plain_state(expected)
    run.close()


def test_look_ups_equal_search_in_all_views(drive: tuple[Path, list[Record]]) -> None:
    path, records = drive
    run = HistoryRun(path)
    views = timed(records, ViewRecord)
    for number in (0, 1, 100, len(views) - 1):
        at_ns = views[number][0]
        last = max(k for k, (ns, _) in enumerate(views) if ns <= at_ns)
        assert plain(run.view_at(at_ns)) == plain(views[last][1])
        for step in (-10**6, -3, 0, 1, 10**6):
            expected = views[min(max(last + step, 0), len(views) - 1)][0]
            assert run.step(at_ns, step) == expected
    assert run.view_at(views[0][0] - 1) is None
    assert run.step(views[0][0] - 1, 1) == views[0][0]
    until_ns = views[len(views) // 2][0]
    rejected = [plain(one) for ns, one in views if ns <= until_ns and one.reason]
    assert [plain(one) for one in run.seek(until_ns).closures if one.reason] == rejected
    assert run.seek(run.begin_ns - 1).closures == []
    expected_visits, before = [], -1
    for at_ns, one in views:
        if one.target_id >= 0 and not one.reason:
            if one.target_id != before and one.target_id == 3 and at_ns <= until_ns:
                expected_visits = [] if one.action == 'create' else expected_visits
                expected_visits.append(plain(one))
            before = one.target_id
    assert expected_visits
    assert [plain(one) for one in run.visits(3, until_ns)] == expected_visits
    run.close()


def test_image_is_the_last_one_up_to_stamp(drive: tuple[Path, list[Record]]) -> None:
    path, records = drive
    run, images = HistoryRun(path), timed(records, ImageRecord)
    at_ns, image = images[len(images) // 2]
    assert run.image_at(at_ns) == image.jpeg
    assert run.image_at(run.begin_ns - 1) is None
    run.close()


def test_same_records_give_identical_content(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    records = random_records(2, 1500)
    written(tmp_path / 'a.sqlite', records)
    # Commits depend on the clock, the content does not.
    monkeypatch.setattr('ratslam_ros.history.writer.COMMIT_S', 0.0)
    written(tmp_path / 'b.sqlite', records)
    assert rows_of(tmp_path / 'a.sqlite') == rows_of(tmp_path / 'b.sqlite')
    assert (tmp_path / 'a.sqlite').read_bytes() == (tmp_path / 'b.sqlite').read_bytes()
    assert sorted(one.name for one in tmp_path.iterdir()) == ['a.sqlite', 'b.sqlite']


def test_growing_file_is_followed(tmp_path: Path) -> None:
    path = tmp_path / HISTORY_NAME
    path.write_bytes(b'results of an earlier run')
    records = random_records(3, 800)
    writer = HistoryWriter(path, META)
    kept = [record for record in records[:400] if writer.add(record)]
    writer.flush()
    run = open_run(tmp_path)
    assert isinstance(run, HistoryRun) and run.is_growing
    assert path.read_bytes() == b'results of an earlier run'
    assert run.title == 'a drive'
    state = run.seek(run.end_ns)
    assert state.record_count == len(kept)
    kept += [record for record in records[400:] if writer.add(record)]
    writer.close()
    assert not run.is_growing
    run.advance(state, run.end_ns)
    assert state.record_count == len(kept)
    assert plain_state(state) == plain_state(run.seek(run.end_ns))
    assert run.notices == []
    run.close()


def test_another_run_at_the_same_path_is_not_shown_as_this_one(tmp_path: Path) -> None:
    path = tmp_path / HISTORY_NAME
    writer = HistoryWriter(path, META)
    kept = [record for record in random_records(3, 400) if writer.add(record)]
    writer.flush()
    run = open_run(tmp_path)
    writer.close()
    following = HistoryWriter(path, META)  # before the first look at the finished run
    assert run.seek(run.end_ns).record_count == len(kept)
    following.close()
    with pytest.raises(UnusableInput, match='removed or replaced'):
        run.seek(run.end_ns)
    run.close()


def test_writer_waits_for_look_up_before_it_ends(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr('ratslam_ros.maps.schema.ATTEMPTS', 2)  # a map would not wait as long
    path = tmp_path / HISTORY_NAME
    writer = HistoryWriter(path, META)
    for record in random_records(3, 100):
        writer.add(record)
    writer.flush()
    reader = sqlite3.connect(part_path(path), check_same_thread=False)
    rows = reader.execute('SELECT * FROM segments')
    rows.fetchone()

    def end() -> None:
        rows.close()
        reader.close()

    timer = threading.Timer(0.2, end)
    timer.start()
    writer.close()
    timer.join()
    assert writer.problem == ''
    assert [one.name for one in tmp_path.iterdir()] == [HISTORY_NAME]


def test_number_that_does_not_fit_ends_recording(tmp_path: Path) -> None:
    lines: list[str] = []
    writer = HistoryWriter(tmp_path / HISTORY_NAME, META, lines.append)
    writer.add(PoseRecord(2**64, Pose(0.0, 0.0, 0.0)))
    writer.flush()
    assert len(lines) == 1
    assert writer.problem


def test_queue_is_written_after_few_seconds_of_stamps(tmp_path: Path) -> None:
    writer = HistoryWriter(tmp_path / HISTORY_NAME, META)
    for second in range(1, 20):
        writer.add(structs.replace(VIEW, stamp_ns=second * NS_PER_S))
    assert writer._database is not None
    (end_ns,) = writer._database.execute('SELECT max(end_ns) FROM segments').fetchone()
    assert end_ns >= 12 * NS_PER_S
    writer.discard()


def test_closures_are_the_newest_in_order(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr('ratslam_ros.history.run_state.MAX_CLOSURES', 4)
    written(tmp_path / HISTORY_NAME, [
        structs.replace(VIEW, stamp_ns=second * NS_PER_S, reason='too far')
        for second in range(1, 20)
    ])
    run = HistoryRun(tmp_path / HISTORY_NAME)
    found = [one.stamp_ns // NS_PER_S for one in run.seek(9 * NS_PER_S).closures]
    assert found == [6, 7, 8, 9]
    run.close()


WRITER = """
import sys, time
from pathlib import Path
sys.path.insert(0, sys.argv[2])
from records_for_tests import random_records
from ratslam_ros.history.file import HistoryMeta
from ratslam_ros.history.writer import HistoryWriter
writer = HistoryWriter(Path(sys.argv[1]), HistoryMeta('killed'))
for record in random_records(4, 2000):
    writer.add(record)
writer.flush()
for record in random_records(5, 10):
    writer.add(record)
print('ready', flush=True)
time.sleep(60)
"""


def test_killed_writer_leaves_readable_history(tmp_path: Path) -> None:
    with subprocess.Popen(
        [sys.executable, '-c', WRITER, str(tmp_path / HISTORY_NAME), str(Path(__file__).parent)],
        stdout=subprocess.PIPE, text=True,
    ) as process:
        assert process.stdout is not None
        assert process.stdout.readline() == 'ready\n'
        run = open_run(tmp_path)
        assert run.is_growing
        other = HistoryWriter(tmp_path / HISTORY_NAME, META, lambda _: None)
        assert 'is in use' in other.problem
        process.send_signal(signal.SIGKILL)
        process.wait()
    assert not run.is_growing
    assert 'interrupted' in run.notices[0]
    expected = RunState()
    writer = HistoryWriter(tmp_path / 'same.sqlite', META)
    for record in random_records(4, 2000):
        if writer.add(record):
            expected.apply(record)
    writer.discard()
    assert plain_state(run.seek(run.end_ns)) == plain_state(expected)
    run.close()
    again = open_run(tmp_path)
    assert again.end_ns == expected.stamp_ns and not again.is_growing
    again.close()


def test_new_run_replaces_interrupted_one(tmp_path: Path) -> None:
    path = tmp_path / HISTORY_NAME
    part_path(path).write_bytes(b'rest of an interrupted run')
    kept = written(path, random_records(6, 50))
    run = HistoryRun(path)
    assert run.seek(run.end_ns).record_count == len(kept)
    assert sorted(one.name for one in tmp_path.iterdir()) == [HISTORY_NAME]


def foreign_database(path: Path) -> None:
    with closing(sqlite3.connect(path)) as database:
        database.execute('CREATE TABLE meta (key, value)')


def other_version(path: Path, version: int) -> None:
    written(path, random_records(1, 30))
    with closing(sqlite3.connect(path)) as database:
        database.execute(f'PRAGMA user_version = {version}')


def damaged_schema(path: Path) -> None:
    written(path, random_records(1, 30))
    path.write_bytes(path.read_bytes().replace(b'visits (\n', b'visits [\n'))


def damaged_segment(path: Path) -> None:
    written(path, random_records(1, 30))
    with closing(sqlite3.connect(path)) as database:
        database.execute("UPDATE segments SET data = x'28b52ffd00'")
        database.commit()


def truncated(path: Path) -> None:
    written(path, random_records(1, 300))
    path.write_bytes(path.read_bytes()[:3000])


@pytest.mark.parametrize(
    ('make', 'message'),
    [
        (lambda path: path.write_text('no database' * 100), 'no readable history'),
        (foreign_database, 'not a history of RatSLAM'),
        (partial(other_version, version=HISTORY.version + 1), 'newer version.*update ratslam_ros'),
        (partial(other_version, version=2), 'history format 2, .* replay the recording again'),
        (damaged_schema, 'malformed database schema'),
        (damaged_segment, 'is damaged'),
        (truncated, 'replay the recording again'),
    ],
    ids=['text', 'foreign', 'newer', 'older', 'schema', 'damaged', 'truncated'],
)
def test_unusable_file_is_refused_in_one_line(tmp_path: Path, make, message: str) -> None:
    make(tmp_path / HISTORY_NAME)
    with pytest.raises(UnusableInput, match=message) as caught:
        HistoryRun(tmp_path / HISTORY_NAME).seek(2**60)
    assert '\n' not in str(caught.value)


def test_missing_first_pose_is_refused_in_one_line(drive: tuple[Path, list[Record]]) -> None:
    path = drive[0].with_name('without-poses.sqlite')
    path.write_bytes(drive[0].read_bytes())
    with closing(sqlite3.connect(path)) as database:
        database.execute('DELETE FROM segments')
        database.commit()
    run = HistoryRun(path)
    assert run.seek(2**60).pose is not None  # that of a checkpoint
    run.set_truth(Trajectory(np.array([0, 1]), np.zeros((2, 2)), np.zeros(2), True))
    with pytest.raises(UnusableInput, match='is damaged'):
        run.seek(2**60)


def test_missing_folder_is_refused_in_one_line(tmp_path: Path) -> None:
    with pytest.raises(UnusableInput, match='does not exist'):
        open_run(tmp_path / 'none')
    with pytest.raises(UnusableInput, match='neither a history nor'):
        open_run(tmp_path)


@pytest.mark.parametrize('name', [f'file/{HISTORY_NAME}', 'link'])
def test_unwritable_path_is_reported_once(name: str, tmp_path: Path) -> None:
    (tmp_path / 'file').touch()
    (tmp_path / 'link').symlink_to('/dev/null')
    lines: list[str] = []
    writer = HistoryWriter(tmp_path / name, META, lines.append)
    for record in random_records(1, 100):
        assert not writer.add(record)
    writer.close()
    assert lines == [writer.problem] and 'cannot be written' in lines[0]
    assert writer.problem


def test_discarded_history_is_not_that_of_another_writer(tmp_path: Path) -> None:
    first = HistoryWriter(tmp_path / HISTORY_NAME, META)
    second = HistoryWriter(tmp_path / HISTORY_NAME, META, lambda _: None)
    assert 'in use' in second.problem
    second.discard()
    kept = add_all(first, random_records(3, 50))
    first.close()
    assert first.problem == ''
    assert HistoryRun(tmp_path / HISTORY_NAME).seek(2**60).record_count == len(kept)


def test_full_disk_ends_recording_and_not_the_run(tmp_path: Path) -> None:
    lines: list[str] = []
    writer = HistoryWriter(tmp_path / HISTORY_NAME, META, lines.append)
    assert writer._database is not None
    writer._database.execute('PRAGMA max_page_count = 20')
    for record in random_records(1, 2000):
        writer.add(record)
    writer.close()
    assert len(lines) == 1 and 'full' in lines[0]
    assert not is_written(tmp_path / HISTORY_NAME)


def empty_change(stamp_ns: int, count: int, rows: int) -> MapChange:
    assert rows >= 64
    return MapChange(stamp_ns, count, 0)


@pytest.mark.parametrize('jpeg_bytes', [3_000, 100_000])
def test_file_stays_within_budget(tmp_path: Path, jpeg_bytes: int) -> None:
    random = np.random.default_rng(1)
    writer = HistoryWriter(tmp_path / HISTORY_NAME, META)
    seconds, images, count = 600, 0, 0
    for step in range(seconds * 10):
        at_ns = NS_PER_S + step * NS_PER_S // 10
        count += step % 20 == 0
        writer.add(PoseRecord(at_ns, Pose(0.1 * step, 1.0, 0.5)))
        assert writer.add(structs.replace(VIEW, stamp_ns=at_ns))
        if writer.wants(ImageRecord, at_ns, step % 7 == 0):
            images += writer.add(ImageRecord(at_ns, random.bytes(jpeg_bytes)), step % 7 == 0)
        if writer.wants(MapChange, at_ns):
            writer.add_map(lambda: None, partial(empty_change, at_ns, count))
    writer.close()
    size = (tmp_path / HISTORY_NAME).stat().st_size
    assert size <= RESERVE_BYTES + seconds * RATE_BYTES_PER_S + 2 * jpeg_bytes
    # The budget is not left unused: either all images that are due are there, or it is used up.
    is_used_up = size > 0.8 * seconds * RATE_BYTES_PER_S
    assert is_used_up if jpeg_bytes > 10_000 else images >= seconds


def test_bytes_per_hour_are_within_promise() -> None:
    assert RESERVE_BYTES + 3600 * RATE_BYTES_PER_S <= 50_000_000


def test_reader_during_creation_sees_complete_file(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """After every statement of the writer, there is no file or a complete one."""
    path, connect, seen = tmp_path / HISTORY_NAME, sqlite3.connect, []

    class Database(sqlite3.Connection):
        def execute(self, *args: Any) -> sqlite3.Cursor:
            rows = super().execute(*args)
            seen.append(part_path(path).exists())
            if seen[-1]:
                with monkeypatch.context() as patch:
                    patch.setattr(sqlite3, 'connect', connect)
                    HistoryRun(part_path(path)).close()
            return rows

    monkeypatch.setattr(sqlite3, 'connect', partial(connect, factory=Database))
    HistoryWriter(path, META).discard()
    assert set(seen) == {False, True}


def test_reader_that_opens_while_run_ends_reads_final_file(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    writer = HistoryWriter(tmp_path / HISTORY_NAME, META)
    run, connect = HistoryRun(part_path(writer.path)), sqlite3.connect

    def connect_late(*args: Any, **options: Any) -> sqlite3.Connection:
        monkeypatch.setattr(sqlite3, 'connect', connect)
        writer.close()
        return connect(*args, **options)

    monkeypatch.setattr(sqlite3, 'connect', connect_late)
    assert not run.is_growing
    run.close()
