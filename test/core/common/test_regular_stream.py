# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Messages do not wait for a regular stream, and the order still depends on the stamps alone."""

import heapq
import json
import random

import pytest
from hypothesis import given
from hypothesis import strategies as st

from ratslam_ros.pipeline.order import Released, StampOrder
from ratslam_ros.pipeline.rhythm import STEP_COUNT

STREAMS = 'odometry', 'template'
MS = 1_000_000
STEP_NS = 20 * MS
Message = tuple[str, int]


def regular_order(max_lateness_ns: int = 2000 * MS) -> StampOrder[None]:
    return StampOrder(STREAMS, max_lateness_ns, 'odometry')


def after_regular_odometry(order: StampOrder[None], jitter_ms: int = 6) -> int:
    """Push messages until the next odometry is predicted; return its last stamp."""
    for n in range(1, STEP_COUNT + 2):
        late_ns = n % 2 * jitter_ms * MS  # steps of 20 ms, and this more or less
        order.push('template', n * STEP_NS - STEP_NS // 2, None)
        order.push('odometry', n * STEP_NS + late_ns, None)
    return n * STEP_NS + late_ns


def pushed(order: StampOrder[None], messages: list[Message]) -> list[Message]:
    out: list[Released[None]] = []
    for stream, stamp_ns in messages:
        out += order.push(stream, stamp_ns, None)
    return [(stream, stamp_ns) for stamp_ns, stream, *_ in out]


@pytest.mark.parametrize(('jitter_ms', 'after_ms', 'waits'), [
    (6, 0, False), (6, 9, False), (6, 10, True), (1, 16, False), (1, 17, True),
    (0, 19, False), (0, 20, True),
])
def test_message_waits_only_near_the_predicted_stamp(
    jitter_ms: int, after_ms: int, waits: bool
) -> None:
    order = regular_order()
    template = 'template', after_regular_odometry(order, jitter_ms) + after_ms * MS
    assert (template not in pushed(order, [template])) == waits
    assert (template in pushed(order, [('odometry', template[1] + STEP_NS)])) == waits


def test_message_waits_until_the_steps_are_known() -> None:
    order = regular_order()
    for n in range(1, STEP_COUNT + 1):
        order.push('odometry', n * STEP_NS, None)
        assert ('template', n * STEP_NS + 1) not in pushed(order, [('template', n * STEP_NS + 1)])


def test_messages_of_equal_stamps_always_belong_together() -> None:
    order = regular_order()
    for n in range(1, 3 * STEP_COUNT):
        message = 'template', n * STEP_NS
        assert pushed(order, [message]) == []
        assert message in pushed(order, [('odometry', n * STEP_NS)])
    early = (3 * STEP_COUNT - 1) * STEP_NS + 5 * MS
    assert pushed(order, [('template', early)]) == []
    assert pushed(order, [('odometry', early)]) == [('odometry', early), ('template', early)]


def test_early_message_goes_after_what_did_not_wait_for_it() -> None:
    early = 'odometry', 431 * MS  # predicted for 435.3 ms at the earliest
    templates = [('template', 430 * MS), ('template', 434 * MS), ('template', 440 * MS)]
    expected = [*templates[:2], early, templates[2]]
    for arrivals in ([early, *templates], [*templates, early], [templates[0], early,
                                                               *templates[1:]]):
        order = regular_order()
        assert after_regular_odometry(order) == 426 * MS
        later = [('odometry', 445 * MS), ('template', 450 * MS)]
        out = [m for m in pushed(order, [*arrivals, *later]) if m[1] > 426 * MS]
        assert out[:4] == expected
        assert order.counts.late == order.counts.refused == 0


@given(st.lists(st.integers(1, 40), min_size=30, max_size=90), st.randoms(use_true_random=False))
def test_any_arrival_gives_the_same_order(steps_ms: list[int], chance: random.Random) -> None:
    stamps: dict[str, list[int]] = {'odometry': [], 'template': []}
    at_ns = 0
    for step in steps_ms:
        at_ns += step * MS
        stamps['odometry'].append(at_ns)
        stamps['template'].append(at_ns - chance.randrange(step) * MS - MS // 2)
    by_stamp = list(heapq.merge(
        *([(stamp, stream) for stamp in stamps[stream]] for stream in STREAMS)
    ))
    found = []
    for _ in range(3):
        order = regular_order(10**12)
        queues = {stream: list(values) for stream, values in stamps.items()}
        arrivals = []
        while any(queues.values()):
            stream = chance.choice([stream for stream, queue in queues.items() if queue])
            arrivals.append((stream, queues[stream].pop(0)))
        out = pushed(order, arrivals)
        out += [(stream, stamp_ns) for stamp_ns, stream, *_ in order.flush()]
        found.append(out)
        assert order.counts.late == order.counts.refused == 0
    assert found[0] == found[1] == found[2]
    assert sorted(found[0]) == sorted((stream, stamp) for stamp, stream in by_stamp)


def test_old_state_without_prediction_is_restored() -> None:
    order: StampOrder[None] = StampOrder(STREAMS, 100)
    order.push('odometry', 5, None)
    again = StampOrder[None](STREAMS, 100, 'odometry')
    again.restore(order.state())
    assert pushed(again, [('template', 7), ('odometry', 8)]) == [('odometry', 5), ('template', 7)]


@given(
    st.lists(st.integers(1, 40), min_size=50, max_size=120), st.integers(0, 200),
    st.randoms(use_true_random=False),
)
def test_restarted_order_goes_on_as_the_one_before(
    steps_ms: list[int], count: int, chance: random.Random
) -> None:
    messages, at_ns = [], 0
    for step in steps_ms:
        at_ns += step * MS
        messages += [
            ('template', at_ns - chance.randrange(step) * MS - MS // 2), ('odometry', at_ns)
        ]
    order, again = regular_order(10**12), regular_order(10**12)
    pushed(order, messages[:count])
    again.restore(json.loads(json.dumps(order.state())))
    assert pushed(again, messages[count:]) == pushed(order, messages[count:])
