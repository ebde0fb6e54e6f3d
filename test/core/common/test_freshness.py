# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Freshness: the policy equals a simple model, survives a restore, and bounds a memory."""

from __future__ import annotations

import random
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from ratslam_ros.core.common.freshness import Freshness

S = 1_000_000_000
DECAY_S = 10


def split_mix(seed: int) -> Iterator[int]:
    """Yield the 64-bit numbers of SplitMix64."""
    state = seed
    while True:
        state = (state + 0x9E3779B97F4A7C15) % 2**64
        z = state
        z = (z ^ (z >> 30)) * 0xBF58476D1CE4E5B9 % 2**64
        z = (z ^ (z >> 27)) * 0x94D049BB133111EB % 2**64
        yield z ^ (z >> 31)


@dataclass
class Item:
    name: int
    fades: bool
    observed_s: int
    visits: int = 1


class Model:
    """The policy in words: a list of items, searched in full."""

    def __init__(self, share: float, seed: int) -> None:
        self.items: list[Item] = []
        self.now_s = 0
        self.share = share
        self.numbers = split_mix(seed)

    def draw(self) -> float:
        return (next(self.numbers) >> 11) / 2**53

    def add(self, name: int) -> None:
        self.items.append(Item(name, self.draw() < self.share, self.now_s))

    def observe(self, name: int) -> None:
        (item,) = (item for item in self.items if item.name == name)
        if self.now_s - item.observed_s >= DECAY_S / 10:
            item.visits += 1
        item.observed_s = self.now_s
        item.fades &= item.visits < 3

    def remove(self, name: int) -> None:
        row = [item.name for item in self.items].index(name)
        self.items[row] = self.items[-1]
        self.items.pop()

    def candidate(self, allowed: list[bool]) -> int | None:
        may_go = [item for item, free in zip(self.items, allowed, strict=True) if free]
        old = [item for item in may_go if self.now_s - item.observed_s >= DECAY_S]
        if faded := [item for item in old if item.fades]:
            return min(faded, key=lambda item: item.observed_s).name
        fading = [item for item in may_go if item.fades]
        recent = [item for item in self.items if self.now_s - item.observed_s < DECAY_S]
        if old and (not fading or len(recent) <= len(self.items) / 2):
            fewest = min(item.visits for item in old)
            old = [item for item in old if item.visits == fewest]
            return old[int(self.draw() * len(old))].name
        if fading:
            return min(fading, key=lambda item: item.observed_s).name
        return may_go[int(self.draw() * len(may_go))].name if may_go else None


@settings(max_examples=30, deadline=None)
@given(st.sampled_from((0.0, 0.3, 0.7, 1.0)), st.integers(0, 2**64 - 1))
def test_freshness_equals_simple_model(share: float, seed: int) -> None:
    rng = random.Random(seed)
    script = [
        (rng.choice(('wait', 'add', 'add', 'observe', 'forget')), rng.randrange(2**20))
        for _ in range(200)
    ]
    model = Model(share, seed)
    memory = Freshness(share, DECAY_S, seed)
    memory.advance(10**18)
    for number, (kind, choice) in enumerate(script):
        n = len(model.items)
        if kind == 'wait':
            model.now_s += choice % 3 if n else 0
            memory.advance(10**18 + model.now_s * S)
        elif kind == 'add':
            model.add(number)
            memory.add(number)
        elif kind == 'observe' and n > 0:
            name = model.items[choice % n].name
            model.observe(name)
            memory.observe(name)
        elif kind == 'forget':
            allowed = [bool(choice >> i % 20 & 1) for i in range(n)]
            name_or_none = model.candidate(allowed)
            assert memory.candidate(np.array(allowed, np.bool_)) == name_or_none
            if name_or_none is not None:
                model.remove(name_or_none)
                memory.remove(name_or_none)
        if choice % 7 == 0:  # a restored memory continues alike
            saved = memory.state()
            memory = Freshness(share, DECAY_S, seed)
            memory.restore(saved)
        assert memory.items.tolist() == [item.name for item in model.items]
        assert all(item.name in memory for item in model.items)
        state = memory.state()
        unseen_ns = (state['now_ns'] - state['observed_ns']).tolist()
        assert list(zip(unseen_ns, state['visits'], state['fades'], strict=True)) == [
            ((model.now_s - item.observed_s) * S, item.visits, item.fades)
            for item in model.items
        ]


def test_draws_are_those_of_split_mix_64() -> None:
    """The published sequence of the seed 1234567."""
    memory = Freshness(0.5, DECAY_S, seed=1234567)
    expected = [6457827717110365317, 3203168211198807973, 9817491932198370423]
    assert [memory._draw() for _ in expected] == [(n >> 11) / 2**53 for n in expected]


def explored(limit: int, share: float, count: int = 2000, step_s: int = 1) -> Freshness:
    """Return the memory of a robot that observes one new item in each step, within a limit."""
    memory = Freshness(share, 100.0)
    for name in range(count):
        memory.advance(name * step_s * S)
        if len(memory) == limit:
            chosen = memory.candidate()
            assert chosen is not None
            memory.remove(chosen)
        memory.add(name)
        assert len(memory) <= limit
    return memory


def test_old_regions_become_sparse_and_recent_ones_stay_dense() -> None:
    kept = explored(400, 0.5).items
    assert np.isin(np.arange(1900, 2000), kept).all()  # the last decay time
    old, older, oldest = (np.count_nonzero((kept >= at) & (kept < at + 500)) for at in (
        1400, 900, 400))
    assert 250 > old > older > oldest > 10  # the general shape of every region is kept


def test_part_of_a_repeated_route_longer_than_the_memory_is_kept() -> None:
    """The items that were not observed for the longest time are the next ones on the route."""
    memory, hits = Freshness(0.5, 1000.0), 0
    for step in range(800):
        memory.advance(step * S)
        name = step % 80
        hits += name in memory
        if name in memory:
            memory.observe(name)
            continue
        if len(memory) == 40:
            memory.remove(memory.candidate() or 0)
        memory.add(name)
    assert hits > 160  # of 320 possible ones


@pytest.mark.parametrize('stamps_s', [(500, 510, 0, 5), (0, 5, 1000, 900, 910)])
def test_time_does_not_go_back_with_the_stamps(stamps_s: tuple[int, ...]) -> None:
    memory = Freshness(1.0, 2000.0)
    memory.add(0)
    memory.advance(stamps_s[0] * S)
    expected, last = 0, stamps_s[0]
    memory.observe(0)
    for stamp_s in stamps_s[1:]:
        expected += max(stamp_s - last, 0)
        last = stamp_s
        memory.advance(stamp_s * S)
        state = memory.state()
        assert state['now_ns'] - state['observed_ns'] == expected * S


def test_no_item_is_selected_if_none_is_allowed() -> None:
    memory = Freshness(0.5, 1.0)
    assert memory.candidate() is None
    memory.add(4)
    assert memory.candidate(np.zeros(1, np.bool_)) is None
    assert memory.candidate() == 4
