# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Records that arrive out of order become one run with a state at any moment."""

from __future__ import annotations

import random
import threading
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from helpers import START_NS

from ratslam_ros.core.common.pose import Pose
from ratslam_ros.core.config import Config
from ratslam_ros.core.mapping.map_changes import (
    MAX_ROWS,
    ExperienceRows,
    LinkRows,
    MapChange,
)
from ratslam_ros.core.pose_cells.torus import Place
from ratslam_ros.files.config import to_yaml
from ratslam_ros.history.history_run import HistoryRun
from ratslam_ros.history.records import (
    ImageRecord,
    PoseRecord,
    Record,
    RouteRecord,
    StatusRecord,
    ViewRecord,
)
from ratslam_ros.history.run_state import NS_PER_S, RunState
from ratslam_ros.viewer import live_run
from ratslam_ros.viewer.live_history import MapRelay
from ratslam_ros.viewer.live_run import LiveRun

TENTH_NS = 100_000_000


class Clock:
    now_s = 0.0

    def __call__(self) -> float:
        return self.now_s


@pytest.fixture
def clock() -> Clock:
    return Clock()


@pytest.fixture
def run(clock: Clock, tmp_path: Path) -> Iterator[LiveRun]:
    made = LiveRun('live', tmp_path / 'history.sqlite', clock)
    yield made
    made.close()


def test_history_contains_parameters_that_become_known(run: LiveRun, tmp_path: Path) -> None:
    run.add(pose(0))
    run.configure(to_yaml(Config().with_values({'pose_cells.pc_vt_agree_views': 7.0})))
    run.add(pose(1))
    run.close()
    history = HistoryRun(tmp_path / 'history.sqlite')
    assert history.required_views == 7.0
    assert history.meta.title == 'live'
    history.close()


def pose(k: int, x_m: float | None = None) -> PoseRecord:
    return PoseRecord(START_NS + k * TENTH_NS, Pose(0.2 * k if x_m is None else x_m, 0.0, 0.0))


def view(k: int, target_id: int = 0, action: str = 'set', reason: str = '') -> ViewRecord:
    return ViewRecord(
        START_NS + k * TENTH_NS, 0, False, 0.1, 0.2, 0.0, action, 0, target_id,  # type: ignore[arg-type]
        Place(0.0, 0.0, 0.0), reason=reason,
    )


def image(k: int) -> ImageRecord:
    return ImageRecord(START_NS + k * TENTH_NS, f'image {k}'.encode())


def released(run: LiveRun, clock: Clock) -> None:
    """Let the run notice that nothing more arrives, and wait until everything is written."""
    clock.now_s += 10.0
    assert run.end_ns
    history, is_written = run._history, threading.Event()

    def flush(_: str) -> None:
        history._writer.flush()
        is_written.set()

    history._writer.configure = flush  # type: ignore[method-assign]
    history.configure('')  # The thread that writes gets this after all records.
    assert is_written.wait(20.0), history.problem


def test_reader_that_follows_gets_every_record_once(run: LiveRun, clock: Clock) -> None:
    """Late records included: they are moved behind what the reader has seen."""
    rng = random.Random(2)
    arrivals: list[tuple[float, Record]] = [(k, pose(k)) for k in range(200)]
    arrivals += [(k + 30 * rng.random(), view(k, target_id=k)) for k in range(200)]
    applied: list[Record] = []

    class Recorder(RunState):
        def apply(self, record: Record) -> None:
            applied.append(record)
            super().apply(record)

    state = Recorder()
    for _, record in sorted(arrivals, key=lambda arrival: arrival[0]):
        run.add(record)
        if rng.random() < 0.3:
            run.advance(state, run.end_ns)
    released(run, clock)
    run.advance(state, run.end_ns)
    found = [record.stamp_ns for record in applied]
    assert found == sorted(found)
    assert len(applied) == 400
    assert {r.target_id for r in applied if isinstance(r, ViewRecord)} == set(range(200))


def test_latched_records_do_not_begin_the_run(run: LiveRun, clock: Clock) -> None:
    """A status from an hour ago is shown, but the run does not begin an hour ago."""
    run.add(StatusRecord(START_NS - 3600 * NS_PER_S, 'idle'))
    run.add(RouteRecord(START_NS - 1800 * NS_PER_S, np.zeros((0, 2))))
    for k in range(10):
        run.add(pose(k))
    released(run, clock)
    assert run.begin_ns == START_NS
    assert run.seek(START_NS).status is not None


def test_map_of_a_robot_that_is_off_is_shown(run: LiveRun, clock: Clock) -> None:
    rows = ExperienceRows(np.arange(1), np.arange(1), np.zeros((1, 3)), np.zeros(1, np.int64))
    run.add(MapChange(START_NS, 1, 0, True, rows))
    released(run, clock)
    assert len(run.seek(run.end_ns).map) == 1


def test_records_are_held_no_longer_than_silence(run: LiveRun, clock: Clock) -> None:
    run.add(pose(0))
    run.add(pose(1))
    assert run.end_ns == 0
    clock.now_s += live_run.SILENCE_S + 0.1
    assert run.end_ns == START_NS + TENTH_NS


def test_jump_back_begins_a_new_run(run: LiveRun) -> None:
    assert not any(run.add(pose(k)) for k in range(100))
    assert run.add(pose(0, x_m=7.0))
    assert not run.add(pose(1, x_m=7.1))
    for k in range(2, 10):
        run.add(pose(k, x_m=8.0))
    assert run.begin_ns == START_NS
    assert run.end_ns < START_NS + NS_PER_S
    assert run.seek(START_NS).pose == pose(0, x_m=7.0)


def test_view_can_be_completed_while_it_is_held(run: LiveRun, clock: Clock) -> None:
    run.add(pose(0))
    held, complete = view(1), view(1, reason='too far')
    run.add(held)
    assert run.replace_view(held, complete)
    for k in range(1, 10):
        run.add(pose(k))
    assert not run.replace_view(complete, held)
    released(run, clock)
    assert [one.reason for one in run.seek(run.end_ns).closures] == ['too far']


def drive(run: LiveRun, count: int) -> None:
    """Add poses, views and changes of the map, by which old experiences move too."""
    rng = np.random.default_rng(3)
    for k in range(count):
        run.add(pose(k))
        run.add(view(k, target_id=k, action='create'))
        ids = np.unique(np.append(rng.integers(0, k + 1, 3), k))
        poses = np.round(rng.uniform(-9, 9, (len(ids), 3)) / 3, 3)
        rows = ExperienceRows(ids, ids, poses, np.zeros(len(ids), np.int64))
        run.add(MapChange(START_NS + k * TENTH_NS, k + 1, k, k == 0, rows, links(k, rng)))


def links(k: int, rng: np.random.Generator) -> LinkRows:
    targets = rng.integers(0, k + 1, 2)
    ends = np.unique(np.stack([np.full(2, k), targets], axis=1), axis=0)
    n = len(ends)
    return LinkRows(
        ends, np.full((n, 3), k / 1000), np.full(n, 0.5), np.full(n, 0.25), np.full(n, k),
        np.zeros(n, np.bool_), ('',) * n,
    )


def assert_same(one: RunState, other: RunState) -> None:
    """The map and the views are equal; poses of the history are samples."""
    assert_same_view(one, other)
    assert np.allclose(one.map.poses, other.map.poses, rtol=0.0, atol=1e-6)
    assert np.array_equal(one.map.template_ids, other.map.template_ids)
    assert link_set(one) == link_set(other)
    assert np.array_equal(one.visits.counts, other.visits.counts)


def link_set(state: RunState) -> set[tuple[int, ...]]:
    rows = state.map.link_rows
    pairs = np.column_stack([rows.ends, rows.counts])
    return {tuple(row) for row in pairs[rows.ends[:, 0] >= 0].tolist()}


def test_seek_behind_the_tail_reads_the_history(
    run: LiveRun, clock: Clock, monkeypatch: pytest.MonkeyPatch
) -> None:
    whole = LiveRun('all in memory', clock=clock)
    drive(whole, 600)
    released(whole, clock)
    monkeypatch.setattr(live_run, 'MAX_TAIL', 480)  # 16 s of three records at 10 Hz
    drive(run, 600)
    assert len(run._tail) < 1000
    released(run, clock)
    assert whole.end_ns == run.end_ns
    for k in (0, 100, 430, 590, 599):
        at_ns = START_NS + k * TENTH_NS
        found = run.seek(at_ns)
        assert_same_view(found, whole.seek(at_ns))
        assert_nearly_same_map(found, whole.seek(at_ns))
        run.advance(found, run.end_ns)
        assert_same(found, whole.seek(run.end_ns))
    whole.close()


def assert_same_view(one: RunState, other: RunState) -> None:
    assert one.view is not None and other.view is not None
    assert one.view.stamp_ns == other.view.stamp_ns
    assert one.view.target_id == other.view.target_id


def assert_nearly_same_map(one: RunState, other: RunState) -> None:
    """The history has the map at intervals of 0.5 s, during which 5 experiences are created."""
    assert len(other.map) - 6 <= len(one.map) <= len(other.map)


def test_given_file_is_a_history(clock: Clock, tmp_path: Path) -> None:
    run = LiveRun('live', tmp_path / 'history.sqlite', clock)
    drive(run, 100)
    run.add(pose(0))
    drive(run, 50)
    run.close()
    history = HistoryRun(tmp_path / 'history.sqlite')
    assert not history.is_growing
    assert len(history.seek(history.end_ns).map) == 100
    assert len(HistoryRun(tmp_path / 'history-2.sqlite').seek(history.end_ns).map) == 50


def test_temporary_file_is_removed(clock: Clock) -> None:
    run = LiveRun('live', clock=clock)
    drive(run, 10)
    folder = run._path.parent
    assert folder.is_dir()
    run.close()
    assert not folder.exists()


def test_relayed_map_is_that_of_all_changes() -> None:
    rng = np.random.default_rng(5)
    count = 30
    one, other, relay = RunState(), RunState(), MapRelay()
    for k in range(300):
        ids = np.unique(rng.integers(0, count, 4))
        rows = ExperienceRows(ids, ids, rng.normal(size=(len(ids), 3)), ids)
        removed = np.unique(rng.integers(0, 4, (3, 2)), axis=0)
        ends = np.unique(rng.integers(0, 4, (4, 2)), axis=0)
        n = len(ends)
        set_links = LinkRows(
            ends, rng.normal(size=(n, 3)), rng.random(n), rng.random(n), np.arange(n) + k,
            rng.random(n) < 0.5, tuple(f'{k} {row}' for row in range(n)),
        )
        change = MapChange(k, count, count - 1, rng.random() < 0.02, rows, set_links, removed)
        one.apply(change)
        relay.add(change)
        if rng.random() < 0.05:
            relay.restart()  # for a checkpoint
            other.apply(relay.next_change(MAX_ROWS))
        elif rng.random() < 0.5:
            other.apply(relay.next_change(7))
    while relay.pending:
        other.apply(relay.next_change(7))
    assert other.map.pending == 0
    assert np.array_equal(one.map.poses, other.map.poses, equal_nan=True)
    assert named_links(one) == named_links(other)


def named_links(state: RunState) -> set[tuple[object, ...]]:
    rows = state.map.link_rows
    return {
        (*ends, *rows.shapes[n], rows.counts[n], rows.behaviours[n])
        for n, ends in enumerate(rows.ends.tolist()) if ends[0] >= 0
    }


def test_questions_about_views(run: LiveRun, clock: Clock) -> None:
    actions = 'create', 'none', 'create', 'none', 'link', 'set'
    for k, (target_id, action) in enumerate(zip([3, 3, 4, 4, 3, 5], actions, strict=True)):
        # The newest experiences count as no loop closures.
        run.add(view(k, target_id, action, reason='too far' if k == 4 else ''))
        run.add(image(k))
    released(run, clock)
    end_ns = run.end_ns
    assert [one.stamp_ns for one in run.visits(4, end_ns)] == [START_NS + 2 * TENTH_NS]
    assert not run.visits(4, START_NS + TENTH_NS)
    assert [one.target_id for one in run.seek(end_ns).closures] == [3]
    assert run.image_at(START_NS + 2 * TENTH_NS + 7) == b'image 2'
    assert run.image_at(START_NS + 100 * NS_PER_S) is None
    assert run.step(START_NS + 2 * TENTH_NS, -1) == START_NS + TENTH_NS
    assert run.step(START_NS + 2 * TENTH_NS, 100) == end_ns
