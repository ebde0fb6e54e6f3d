# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Pacing: due times of messages without drift, and the published clock."""

import itertools
import random

import pytest
from helpers import START_NS

from ratslam_ros.recordings.pacing import Pacing


class Clock:
    """Monotonic clock that the test advances."""

    def __init__(self) -> None:
        self.ns = 5_000_000_000

    def __call__(self) -> int:
        return self.ns

    def pass_s(self, seconds: float) -> None:
        self.ns += round(seconds * 1e9)


@pytest.mark.parametrize('rate', [0.5, 1.0, 3.0, 100.0])
def test_due_times_follow_recording_at_given_rate(rate: float) -> None:
    clock = Clock()
    pacing = Pacing(START_NS, rate, clock)
    assert pacing.wait_s(START_NS) == 0.0
    for i in range(1, 50):
        log_ns = START_NS + i * 33_333_333
        clock.pass_s(pacing.wait_s(log_ns))
        pacing.published(log_ns)
        assert clock.ns - 5_000_000_000 == pytest.approx(i * 33_333_333 / rate, abs=20)


def test_long_sleeps_cause_no_drift() -> None:
    clock = Clock()
    pacing = Pacing(START_NS, 1.0, clock)
    for i in range(10_000):
        log_ns = START_NS + i * 10_000_000
        clock.pass_s(pacing.wait_s(log_ns) + 0.001)  # The sleep ends late.
        pacing.published(log_ns)
    assert clock.ns - 5_000_000_000 == pytest.approx(9_999 * 10_000_000 + 1_000_000, abs=100)


def test_late_messages_are_caught_up() -> None:
    clock = Clock()
    pacing = Pacing(START_NS, 1.0, clock)
    clock.pass_s(1.0)  # Reading was slow.
    waits = [pacing.wait_s(START_NS + i * 100_000_000) for i in range(13)]
    assert waits[:11] == [0.0] * 11
    assert waits[11:] == pytest.approx([0.1, 0.2], abs=1e-6)


def test_rate_zero_never_waits() -> None:
    pacing = Pacing(START_NS, 0.0, Clock())
    assert [pacing.wait_s(START_NS + i * 10**9) for i in range(5)] == [0.0] * 5


def test_clock_advances_up_to_next_message() -> None:
    clock = Clock()
    pacing = Pacing(START_NS, 2.0, clock)
    assert pacing.time_ns() == START_NS
    pacing.published(START_NS)
    pacing.wait_s(START_NS + 1_000_000_000)
    clock.pass_s(0.25)
    assert pacing.time_ns() == START_NS + 500_000_000
    clock.pass_s(10.0)  # The message is late, and so is the clock.
    assert pacing.time_ns() == START_NS + 1_000_000_000
    assert pacing.played_s == 0.0
    pacing.published(START_NS + 1_000_000_000)
    assert pacing.played_s == 1.0


def test_clock_at_rate_zero_is_last_message() -> None:
    clock = Clock()
    pacing = Pacing(START_NS, 0.0, clock)
    pacing.wait_s(START_NS + 10**9)
    clock.pass_s(1.0)
    assert pacing.time_ns() == START_NS
    pacing.published(START_NS + 10**9)
    assert pacing.time_ns() == START_NS + 10**9


@pytest.mark.parametrize('seed', range(20))
def test_clock_is_monotonic(seed: int) -> None:
    chance, clock = random.Random(seed), Clock()
    pacing = Pacing(START_NS, chance.choice([0.0, 0.3, 1.0, 7.0]), clock)
    log_ns, times = START_NS, []
    for _ in range(300):
        log_ns += chance.choice([0, 1, 10_000_000, 500_000_000])
        wait_s = pacing.wait_s(log_ns)
        times.append(pacing.time_ns())
        clock.pass_s(wait_s * chance.random())
        times.append(pacing.time_ns())
        clock.pass_s(wait_s + chance.choice([0.0, 2.0]))
        times.append(pacing.time_ns())
        pacing.published(log_ns)
        times.append(pacing.time_ns())
        assert times[-1] == log_ns
    assert all(earlier <= later for earlier, later in itertools.pairwise(times))
