# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Pacing: every message at its time, whatever happened before, and a clock that fits."""

import itertools
import random

import pytest

from ratslam_ros.live.pacing import Pacing

START_NS = 1_700_000_000_000_000_000


class Clock:
    """A steady clock that goes on only when it is told to."""

    def __init__(self) -> None:
        self.ns = 5_000_000_000

    def __call__(self) -> int:
        return self.ns

    def pass_s(self, seconds: float) -> None:
        self.ns += round(seconds * 1e9)


@pytest.mark.parametrize('rate', [0.5, 1.0, 3.0, 100.0])
def test_messages_are_due_when_the_recording_says_at_its_rate(rate: float) -> None:
    clock = Clock()
    pacing = Pacing(START_NS, rate, clock)
    assert pacing.wait_s(START_NS) == 0.0
    for i in range(1, 50):
        log_ns = START_NS + i * 33_333_333
        clock.pass_s(pacing.wait_s(log_ns))
        pacing.published(log_ns)
        assert clock.ns - 5_000_000_000 == pytest.approx(i * 33_333_333 / rate, abs=20)


def test_sleeping_too_long_every_time_adds_no_drift() -> None:
    clock = Clock()
    pacing = Pacing(START_NS, 1.0, clock)
    for i in range(10_000):
        log_ns = START_NS + i * 10_000_000
        clock.pass_s(pacing.wait_s(log_ns) + 0.001)  # a sleep that ends late
        pacing.published(log_ns)
    assert clock.ns - 5_000_000_000 == pytest.approx(9_999 * 10_000_000 + 1_000_000, abs=100)


def test_what_is_late_is_caught_up() -> None:
    clock = Clock()
    pacing = Pacing(START_NS, 1.0, clock)
    clock.pass_s(1.0)  # a slow reader
    waits = [pacing.wait_s(START_NS + i * 100_000_000) for i in range(13)]
    assert waits[:11] == [0.0] * 11
    assert waits[11:] == pytest.approx([0.1, 0.2], abs=1e-6)


def test_rate_0_never_waits() -> None:
    pacing = Pacing(START_NS, 0.0, Clock())
    assert [pacing.wait_s(START_NS + i * 10**9) for i in range(5)] == [0.0] * 5


def test_the_clock_runs_between_messages_and_never_past_the_next() -> None:
    clock = Clock()
    pacing = Pacing(START_NS, 2.0, clock)
    assert pacing.time_ns() == START_NS
    pacing.published(START_NS)
    pacing.wait_s(START_NS + 1_000_000_000)
    clock.pass_s(0.25)
    assert pacing.time_ns() == START_NS + 500_000_000
    clock.pass_s(10.0)  # the message is late: so is its time
    assert pacing.time_ns() == START_NS + 1_000_000_000
    assert pacing.played_s == 0.0
    pacing.published(START_NS + 1_000_000_000)
    assert pacing.played_s == 1.0


def test_the_clock_at_rate_0_is_that_of_the_last_message() -> None:
    clock = Clock()
    pacing = Pacing(START_NS, 0.0, clock)
    pacing.wait_s(START_NS + 10**9)
    clock.pass_s(1.0)
    assert pacing.time_ns() == START_NS
    pacing.published(START_NS + 10**9)
    assert pacing.time_ns() == START_NS + 10**9


@pytest.mark.parametrize('seed', range(20))
def test_the_clock_never_goes_back(seed: int) -> None:
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
