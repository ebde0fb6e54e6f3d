# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
from typing import Any

from hypothesis import given
from hypothesis import strategies as st
from viewer_doubles import BEGIN_NS, STEP_NS, FakeRun

from ratslam_ros.history.run_state import NS_PER_S, RunState
from ratslam_ros.viewer.playback import MAX_ADVANCE_NS, Playback


def shown(state: RunState) -> list[Any]:
    """Return everything that distinguishes two states of the run."""
    return [
        state.stamp_ns, state.view, state.pose, [view.stamp_ns for view in state.recent],
        state.trail.points_m.tolist(), len(state.map), state.map.poses.tolist(),
        state.map.link_rows.counts.tolist(), state.visits.counts.tolist(),
    ]


def test_finished_run_shows_its_end_first() -> None:
    run = FakeRun(10)
    playback = Playback(run)
    state = playback.tick(0.1)
    assert state.stamp_ns == playback.cursor_ns == run.end_ns
    assert not playback.playing and not playback.following


def test_end_of_followed_run_ends_playing_at_last_record() -> None:
    run = FakeRun(10, is_growing=True)
    playback = Playback(run)
    playback.tick(0.1)
    run.grow(2)
    run.is_growing = False
    assert playback.tick(0.1).stamp_ns == run.end_ns
    assert not playback.playing and not playback.following and playback.at_end


def test_speed_scales_motion_of_cursor() -> None:
    playback = Playback(FakeRun(100))
    playback.seek(BEGIN_NS)
    playback.speed = 4.0
    playback.play()
    playback.tick(0.5)
    playback.tick(0.25)
    assert playback.cursor_ns == BEGIN_NS + 3 * NS_PER_S


def test_stall_of_loop_moves_cursor_by_a_second() -> None:
    playback = Playback(FakeRun(100))
    playback.seek(BEGIN_NS)
    playback.play()
    playback.tick(20.0)
    assert playback.cursor_ns == BEGIN_NS + NS_PER_S


def test_scrubbing_back_leaves_the_end_and_plays_on() -> None:
    run = FakeRun(100, is_growing=True)
    playback = Playback(run)
    playback.tick(0.1)
    playback.seek(BEGIN_NS + 10 * STEP_NS)
    assert playback.tick(0.0).stamp_ns == BEGIN_NS + 10 * STEP_NS
    assert playback.playing and not playback.following
    run.grow(10)
    assert playback.tick(0.5).stamp_ns == BEGIN_NS + 11 * STEP_NS


def test_cursor_that_reaches_growing_end_follows_again() -> None:
    run = FakeRun(10, is_growing=True)
    playback = Playback(run)
    playback.seek(run.end_ns - STEP_NS)
    playback.tick(1.0)
    assert playback.following
    run.grow(10)
    assert playback.tick(0.1).stamp_ns == run.end_ns


def test_paused_cursor_stays_while_run_grows() -> None:
    run = FakeRun(10, is_growing=True)
    playback = Playback(run)
    playback.pause()
    before = playback.tick(0.1).stamp_ns
    run.grow(10)
    assert playback.tick(1.0).stamp_ns == before
    playback.toggle()
    assert playback.playing
    playback.toggle()
    assert not playback.playing


def test_play_at_end_of_finished_run_starts_over() -> None:
    run = FakeRun(10)
    playback = Playback(run)
    playback.play()
    assert playback.tick(0.0).stamp_ns == run.begin_ns
    for _ in range(10):
        state = playback.tick(1.0)
    assert state.stamp_ns == run.end_ns
    assert not playback.playing


def test_steps_pause_and_stay_within_the_run() -> None:
    run = FakeRun(10)
    playback = Playback(run)
    playback.play()
    playback.step(3)
    assert not playback.playing
    assert playback.tick(1.0).stamp_ns == BEGIN_NS + 3 * STEP_NS
    playback.step(-99)
    assert playback.tick(1.0).stamp_ns == run.begin_ns
    playback.step(99)
    assert playback.tick(1.0).stamp_ns == run.end_ns


def test_several_seeks_between_ticks_cost_one() -> None:
    run = FakeRun(100)
    playback = Playback(run)
    playback.tick(0.1)
    before = run.seeks
    for number in range(50):
        playback.seek(BEGIN_NS + number * STEP_NS)
    playback.tick(0.1)
    assert run.seeks == before + 1


def test_long_way_ahead_is_sought_and_short_way_advanced() -> None:
    run = FakeRun(1 + 2 * MAX_ADVANCE_NS // STEP_NS)
    playback = Playback(run)
    playback.seek(run.begin_ns)
    state, before = playback.tick(0.0), run.seeks
    playback.seek(run.begin_ns + MAX_ADVANCE_NS)
    assert playback.tick(0.0) is state
    assert run.seeks == before
    playback.seek(run.begin_ns)
    playback.tick(0.0)
    playback.seek(run.begin_ns + MAX_ADVANCE_NS + 1)
    playback.tick(0.0)
    assert run.seeks == before + 2


def test_unmoved_cursor_reads_nothing() -> None:
    run = FakeRun(10)
    playback = Playback(run)
    state, seeks = playback.tick(0.1), run.seeks
    assert playback.tick(0.1) is state
    assert run.seeks == seeks


def test_other_run_is_shown_from_its_own_records() -> None:
    playback = Playback(FakeRun(100))
    playback.speed = 5.0
    playback.tick(0.1)
    run = FakeRun(3, is_growing=True)
    playback.use(run)
    assert shown(playback.tick(0.1)) == shown(run.seek(run.end_ns))
    assert playback.following
    assert playback.speed == 5.0


def test_run_that_begins_again_is_read_again() -> None:
    run = FakeRun(100, is_growing=True)
    playback = Playback(run)
    playback.tick(0.1)
    del run.stamps[4:], run.records[4:]
    assert shown(playback.tick(0.1)) == shown(run.seek(run.end_ns))


OPERATIONS = st.one_of(
    st.tuples(st.just('tick'), st.floats(0.0, 2.0)),
    st.tuples(st.just('seek'), st.integers(-5, 400).map(lambda n: BEGIN_NS + n * STEP_NS // 3)),
    st.tuples(st.just('step'), st.integers(-30, 30)),
    st.tuples(st.just('speed'), st.floats(0.01, 200.0)),
    st.tuples(st.just('grow'), st.integers(0, 60)),
    st.tuples(st.sampled_from(['follow', 'pause', 'play', 'toggle', 'finish']), st.none()),
)


@given(st.integers(0, 60), st.booleans(), st.lists(OPERATIONS, max_size=15))
def test_any_operations_show_the_same_as_a_seek(
    steps: int, is_growing: bool, operations: list[tuple[str, Any]]
) -> None:
    run = FakeRun(steps, is_growing)
    playback = Playback(run)
    for name, value in operations:
        if name == 'grow':
            run.grow(value if run.is_growing else 0)
        elif name == 'finish':
            run.is_growing = False
        elif name == 'speed':
            playback.speed = value
        elif value is None:
            getattr(playback, name)()
        else:
            getattr(playback, name)(value)
        state = playback.tick(0.0)
        assert run.begin_ns <= playback.cursor_ns <= run.end_ns
        assert shown(state) == shown(run.seek(playback.cursor_ns))
        assert playback.playing or not playback.following
        assert run.is_growing or not playback.following
