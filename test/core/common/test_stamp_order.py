# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The order of messages depends on their stamps alone, and not on their arrival times."""


import pytest
from hypothesis import given
from hypothesis import strategies as st

from ratslam_ros.pipeline.order import RUN_COUNT, Released, StampOrder

STREAMS = ('odometry', 'template')
Arrivals = list[tuple[str, int]]


def order(max_lateness_ns: int = 100, streams: tuple[str, ...] = STREAMS) -> StampOrder[str]:
    return StampOrder(streams, max_lateness_ns)


def run(arrivals: Arrivals, max_lateness_ns: int = 100) -> tuple[list[Released[str]], int, int]:
    """Return the released messages in order, the late count and the refused count."""
    merger = order(max_lateness_ns)
    out = []
    for stream, stamp in arrivals:
        out += merger.push(stream, stamp, f'{stream} {stamp}')
    out += merger.flush()
    return out, merger.counts.late, merger.counts.refused


def by_stamp(arrivals: Arrivals) -> Arrivals:
    return sorted(arrivals, key=lambda a: (a[1], STREAMS.index(a[0])))


@st.composite
def arrivals_within(draw: st.DrawFn, bound: int) -> Arrivals:
    """Draw an arrival order of two increasing streams that respects the lateness bound."""
    queues = {
        name: sorted(draw(st.sets(st.integers(1, 60), max_size=20))) for name in STREAMS
    }
    arrivals: Arrivals = []
    newest = -1
    while any(queues.values()):
        # A stream may deliver next if the head of the other stream does not become too late.
        heads = [queue[0] for queue in queues.values() if queue]
        candidates = [
            name for name, queue in queues.items()
            if queue and max(newest, queue[0]) - min(heads) <= bound
        ]
        name = draw(st.sampled_from(candidates))
        stamp = queues[name].pop(0)
        newest = max(newest, stamp)
        arrivals.append((name, stamp))
    return arrivals


@given(st.integers(0, 30).flatmap(lambda b: st.tuples(st.just(b), arrivals_within(b))))
def test_any_arrival_within_bound_is_released_by_stamp(case: tuple[int, Arrivals]) -> None:
    bound, arrivals = case
    released, late, refused = run(arrivals, bound)
    assert [(r.stream, r.stamp_ns) for r in released] == by_stamp(arrivals)
    assert (late, refused) == (0, 0)


@given(
    st.lists(st.tuples(st.sampled_from(STREAMS), st.integers(1, 40)), max_size=40),
    st.integers(0, 20),
)
def test_any_arrival_is_released_in_order_or_counted(arrivals: Arrivals, bound: int) -> None:
    merger = order(bound)
    out: list[Released[str]] = []
    for number, (stream, stamp) in enumerate(arrivals, 1):
        out += merger.push(stream, stamp, '')
        assert len(out) + merger.held + merger.counts.late + merger.counts.refused == number
    out += merger.flush()
    assert merger.held == 0
    assert len(out) + merger.counts.late + merger.counts.refused == len(arrivals)
    keys = [(r.stamp_ns, STREAMS.index(r.stream)) for r in out]
    assert keys == sorted(set(keys))


@given(st.lists(st.integers(1, 5), max_size=60), st.integers(0, 20))
def test_silent_stream_delays_messages_by_the_bound(gaps: list[int], bound: int) -> None:
    """If the camera stops, the map lags by at most max_lateness."""
    merger = order(bound)
    stamp = 0
    sent: list[int] = []
    out: list[int] = []
    for gap in gaps:
        stamp += gap
        sent.append(stamp)
        out += [r.stamp_ns for r in merger.push('odometry', stamp, '')]
        assert out == [s for s in sent if stamp - s > bound]
        assert merger.held == sum(stamp - s <= bound for s in sent)
    assert merger.counts.late == merger.counts.refused == 0


def test_equal_stamps_release_odometry_first() -> None:
    for arrivals in ([('odometry', 5), ('template', 5)], [('template', 5), ('odometry', 5)]):
        merger = order()
        assert merger.push(*arrivals[0], '') == [] or arrivals[0][0] == 'template'
        released = merger.push(*arrivals[1], '')
        assert [r.stream for r in released] == ['odometry', 'template']


@pytest.mark.parametrize('stamp', [10, 9, -1])
def test_non_increasing_stamp_is_refused_and_counted(stamp: int) -> None:
    merger = order()
    merger.push('odometry', 10, 'first')
    assert merger.push('odometry', stamp, 'again') == []
    assert (merger.counts.refused, merger.counts.late, merger.held) == (1, 0, 1)
    assert [r.item for r in merger.flush()] == ['first']


def test_message_older_than_last_released_is_dropped_late() -> None:
    merger = order(3)
    merger.push('odometry', 1, 'a')
    assert [r.item for r in merger.push('odometry', 5, 'b')] == ['a']
    merger.push('odometry', 9, 'c')  # releases b
    assert merger.push('template', 2, 'too late') == []
    assert merger.counts.late == 1
    assert [r.item for r in merger.push('template', 6, 'd')] == ['d']
    assert [r.item for r in merger.flush()] == ['c']


def test_odometry_after_template_of_equal_stamp_is_late() -> None:
    merger = order(1)
    merger.push('template', 5, '')
    assert [r.stream for r in merger.push('template', 7, '')] == ['template']
    merger.push('odometry', 5, '')
    assert merger.counts.late == 1


def test_template_after_odometry_of_equal_stamp_is_released() -> None:
    merger = order(1)
    merger.push('odometry', 5, '')
    merger.push('odometry', 7, '')
    assert [r.stamp_ns for r in merger.push('template', 5, '')] == [5]
    assert merger.counts.late == 0


S = 1_000_000_000
LATENESS_NS = 2 * S


def single() -> StampOrder[int]:
    return StampOrder(('image',), 0)


def stamps_of(merger: StampOrder[int], stamps: list[int]) -> list[int]:
    out = []
    for stamp in stamps:
        out += [r.stamp_ns for r in merger.push('image', stamp, stamp)]
    return out


def test_single_future_stamp_is_refused() -> None:
    merger = single()
    assert stamps_of(merger, [S, S + 1, 3600 * S, S + 2, S + 3]) == [S, S + 1, S + 2, S + 3]
    assert (merger.counts.refused, merger.held) == (1, 0)


def test_short_burst_of_future_stamps_is_refused() -> None:
    merger = single()
    future = [3600 * S + n for n in range(RUN_COUNT - 1)]
    assert stamps_of(merger, [S, *future]) == [S]
    assert merger.held == RUN_COUNT - 1
    assert stamps_of(merger, [S + 1]) == [S + 1]
    assert (merger.counts.refused, merger.held) == (RUN_COUNT - 1, 0)


def test_pause_is_accepted_after_a_run() -> None:
    merger = single()
    later = [100 * S + n * S // 20 for n in range(RUN_COUNT)]
    assert stamps_of(merger, [S, *later[:-1]]) == [S]
    assert stamps_of(merger, later[-1:]) == later
    assert (merger.counts.refused, merger.counts.gaps) == (0, 1)


def test_slow_stream_is_held_until_step_is_known() -> None:
    merger = single()
    slow = [n * 5 * S for n in range(1, 2 * RUN_COUNT)]
    assert stamps_of(merger, slow[:3]) == slow[:1]
    assert stamps_of(merger, slow[3:4]) == slow[1:4]
    for stamp in slow[4:]:
        assert stamps_of(merger, [stamp]) == [stamp]
    assert merger.counts.refused == 0


def test_flush_refuses_single_jump_accepts_confirmed_jump() -> None:
    merger = single()
    stamps_of(merger, [S, 9 * S])
    assert merger.flush() == []
    assert merger.counts.refused == 1
    stamps_of(merger, [20 * S, 21 * S])
    assert [r.stamp_ns for r in merger.flush()] == [20 * S, 21 * S]


def test_zero_stamp_is_refused_unless_recording_begins_there() -> None:
    merger = single()
    assert stamps_of(merger, [0, 1_700_000_000 * S]) == [1_700_000_000 * S]
    assert merger.counts.refused == 1
    assert stamps_of(merger, [0]) == []
    video = single()
    assert stamps_of(video, [0, S // 30, S // 15]) == [0, S // 30, S // 15]
    assert video.counts.refused == 0


def test_negative_stamps_are_refused_until_they_are_positive() -> None:
    merger = single()
    steps = [i * S // 10 for i in range(-30, 30)]
    assert stamps_of(merger, steps) + [r.stamp_ns for r in merger.flush()] == steps[30:]
    assert merger.counts.refused == 30


def test_restarted_recording_is_detected_without_loss() -> None:
    merger = single()
    stamps_of(merger, [n * S for n in range(100, 120)])
    again = [n * S // 20 for n in range(100, 100 + RUN_COUNT)]
    assert stamps_of(merger, again[:-1]) == []
    assert not merger.jumped_back
    assert stamps_of(merger, again[-1:]) == []
    assert merger.jumped_back
    assert [r.stamp_ns for r in merger.restart()] == again
    assert (merger.jumped_back, merger.counts.refused) == (False, 0)


def test_wrong_past_stamps_are_no_restart() -> None:
    merger = single()
    stamps_of(merger, [100 * S])
    stamps_of(merger, [n * S for n in range(60, 20, -1)])  # backwards
    stamps_of(merger, [7 * S] * 40)
    stamps_of(merger, [1, 30 * S, 60 * S, 90 * S])  # implausibly large steps
    assert not merger.jumped_back
    for n in range(40):  # a second publisher interleaves old stamps
        stamps_of(merger, [n * S, (101 + n) * S])
    assert not merger.jumped_back
    assert merger.counts.refused == 124


def test_slow_camera_restart_needs_three_images() -> None:
    merger = single()
    stamps_of(merger, [n * S for n in range(100, 120)])
    assert stamps_of(merger, [S, 2 * S]) == []
    assert not merger.jumped_back
    stamps_of(merger, [3 * S])
    assert merger.jumped_back
    assert [r.stamp_ns for r in merger.restart()] == [S, 2 * S, 3 * S]


def test_restart_keeps_messages_of_slower_streams() -> None:
    merger = order(LATENESS_NS)
    for n in range(100, 110):
        merger.push('odometry', n * S, 'old')
        merger.push('template', n * S, 'old')
    merger.flush()
    for n in range(RUN_COUNT):  # the camera is the faster one
        if n % 3 == 0:
            merger.push('odometry', n * S // 30 + 1, 'new')
        merger.push('template', n * S // 30 + 1, 'new')
    assert merger.jumped_back
    out = merger.restart() + merger.flush()
    assert [r.stream for r in out].count('odometry') == 4
    assert [r.stream for r in out].count('template') == RUN_COUNT
    assert merger.counts.refused == 0


def test_restart_counts_held_messages_as_refused() -> None:
    merger = order(LATENESS_NS)
    for n in range(5):
        merger.push('odometry', 100 * S + n, 'old')
    for n in range(RUN_COUNT):
        merger.push('odometry', S + n, 'new')
    merger.restart()
    assert merger.counts.refused == 5


def test_restart_drops_old_messages_of_lagging_streams() -> None:
    merger = order(LATENESS_NS)
    for n in range(100, 110):
        merger.push('odometry', n * S, 'old')
        merger.push('template', n * S, 'old')
    for n in range(RUN_COUNT):
        merger.push('odometry', n * S // 10 + 1, 'new')
    assert merger.jumped_back
    merger.flush()
    out = merger.restart()
    for n in range(110, 113):  # a slow local view still sends messages from before
        assert merger.push('template', n * S, 'old') == []
    assert merger.counts.refused == 3
    for n in range(RUN_COUNT):
        out += merger.push('template', n * S // 10 + 1, 'new')
    out += merger.flush()
    assert [r.item for r in out] == ['new'] * 2 * RUN_COUNT
    assert [r.stream for r in out] == [*STREAMS] * RUN_COUNT
    assert (merger.counts.refused, merger.counts.late) == (3, 0)


@given(st.lists(st.integers(0, 200), max_size=60), st.integers(0, 200))
def test_released_stamps_increase_and_rest_is_counted(tens: list[int], flush_after: int) -> None:
    merger = single()
    out: list[int] = []
    for number, ten in enumerate(tens):
        out += stamps_of(merger, [ten * S // 4])
        if number == flush_after:
            out += [r.stamp_ns for r in merger.flush()]
        assert len(out) + merger.held + merger.counts.refused == number + 1
    assert out == sorted(set(out))
