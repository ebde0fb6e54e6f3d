# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Records that arrive out of order become one run with a state at any moment."""

from __future__ import annotations

import random

import numpy as np
import pytest
from helpers import START_NS

from ratslam_ros.core.common.pose import Pose
from ratslam_ros.core.mapping.map_changes import ExperienceRows, MapChange
from ratslam_ros.core.pose_cells.torus import Place
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
from ratslam_ros.viewer.live_run import HOLD_NS, LiveRun

TENTH_NS = 100_000_000


class Clock:
    now_s = 0.0

    def __call__(self) -> float:
        return self.now_s


@pytest.fixture
def clock() -> Clock:
    return Clock()


@pytest.fixture
def run(clock: Clock) -> LiveRun:
    return LiveRun('live', clock)


def pose(k: int, x_m: float | None = None) -> PoseRecord:
    return PoseRecord(START_NS + k * TENTH_NS, Pose(0.2 * k if x_m is None else x_m, 0.0, 0.0))


def view(k: int, target_id: int = 0, action: str = 'set', reason: str = '') -> ViewRecord:
    return ViewRecord(
        START_NS + k * TENTH_NS, 0, False, 0.1, 0.2, 0.0, action, 0, target_id,  # type: ignore[arg-type]
        Place(0.0, 0.0, 0.0), reason=reason,
    )  # fmt: skip


def image(k: int) -> ImageRecord:
    return ImageRecord(START_NS + k * TENTH_NS, f'image {k}'.encode())


def released(run: LiveRun, clock: Clock) -> None:
    """Let the run notice that nothing more arrives."""
    clock.now_s += 10.0
    assert run.end_ns


def stamps_and_kinds(records: list[Record]) -> list[tuple[int, str]]:
    return [(record.stamp_ns, type(record).__name__) for record in records]


def test_records_of_slow_topics_get_their_place(run: LiveRun, clock: Clock) -> None:
    rng = random.Random(1)
    arrivals = [(k * TENTH_NS, pose(k)) for k in range(100)]
    arrivals += [
        (k * TENTH_NS + rng.randrange(HOLD_NS - TENTH_NS), view(k)) for k in range(0, 100, 5)
    ]
    for _, record in sorted(arrivals, key=lambda arrival: arrival[0]):
        run.add(record)
    released(run, clock)
    found = [record.stamp_ns for record in run._tail]
    assert found == sorted(record.stamp_ns for _, record in arrivals)
    state = run.seek(START_NS + 52 * TENTH_NS)
    assert state.view == view(50)
    assert state.pose == pose(52)


def test_reader_that_follows_gets_every_record_once(run: LiveRun, clock: Clock) -> None:
    """Late records included: they are moved behind what the reader has seen."""
    rng = random.Random(2)
    arrivals: list[tuple[float, Record]] = [(k, pose(k)) for k in range(200)]
    arrivals += [(k + 30 * rng.random(), view(k, target_id=k)) for k in range(200)]
    state = RunState()
    applied: list[Record] = []
    state.apply = applied.append  # type: ignore[method-assign,assignment]
    for _, record in sorted(arrivals, key=lambda arrival: arrival[0]):
        run.add(record)
        if rng.random() < 0.3:
            run.advance(state, run.end_ns)
            state.stamp_ns = applied[-1].stamp_ns if applied else 0
    released(run, clock)
    run.advance(state, run.end_ns)
    found = [record.stamp_ns for record in applied]
    assert found == sorted(found)
    assert len(applied) == 400
    assert {r.target_id for r in applied if isinstance(r, ViewRecord)} == set(range(200))


def test_seek_and_advance_reach_the_same_state(run: LiveRun, clock: Clock) -> None:
    for k in range(100):
        run.add(pose(k))
        run.add(view(k, target_id=k % 7, action='create' if k < 7 else 'link'))
    released(run, clock)
    at_ns = START_NS + 80 * TENTH_NS
    sought, advanced = run.seek(at_ns), run.seek(START_NS + 10 * TENTH_NS)
    run.advance(advanced, at_ns)
    assert sought.view == advanced.view == view(80, 80 % 7, 'link')
    assert np.array_equal(sought.trail.points_m, advanced.trail.points_m)
    assert np.array_equal(sought.visits.counts, advanced.visits.counts)


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
    assert [one.reason for one in run.closures(run.end_ns)] == ['too far']


def test_memory_is_bounded_and_the_state_remains(
    run: LiveRun, clock: Clock, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(live_run, 'MAX_TAIL', 50)
    for k in range(1000):
        run.add(pose(k))
        assert len(run._tail) <= 101
    released(run, clock)
    assert len(run.seek(run.end_ns).trail.points_m) == 1000


def test_questions_about_views(run: LiveRun, clock: Clock) -> None:
    for k, target_id in enumerate([3, 3, 4, 4, 3, 5]):
        run.add(view(k, target_id, 'link' if k == 4 else 'set'))
        run.add(image(k))
    released(run, clock)
    end_ns = run.end_ns
    assert [one.stamp_ns for one in run.visits(3, end_ns)] == [START_NS, START_NS + 4 * TENTH_NS]
    assert len(run.visits(3, START_NS + 3 * TENTH_NS)) == 1
    assert [one.target_id for one in run.closures(end_ns)] == [3]
    assert run.image_at(START_NS + 2 * TENTH_NS + 7) == b'image 2'
    assert run.image_at(START_NS + 100 * NS_PER_S) is None
    assert run.view_at(START_NS + 2 * TENTH_NS + 7) == view(2, 4)
    assert run.view_at(START_NS - 1) is None
    assert run.step(START_NS + 2 * TENTH_NS, -1) == START_NS + TENTH_NS
    assert run.step(START_NS + 2 * TENTH_NS, 100) == end_ns
