# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
import math

import numpy as np
import pytest
from numpy.typing import NDArray

from ratslam_ros.core.common.rotation_gain import Estimate, scale_of_turns, systematic_errors
from ratslam_ros.core.common.turn_correction import UNCORRECTED, TurnCorrection

Floats = NDArray[np.float64]


def random(seed: int = 0) -> np.random.Generator:
    return np.random.Generator(np.random.PCG64(seed))


def loops(
    rng: np.random.Generator, count: int, gain: float, per_m_rad: float = 0.0, noise: float = 0.02
) -> tuple[Floats, Floats, Floats]:
    """Return measured turns, lengths and heading differences of loops with k of -1, 1 and 2."""
    whole = 2.0 * math.pi * rng.choice([-1.0, 1.0, 1.0, 2.0], count)
    differences = rng.normal(0.0, 0.1, count)
    lengths = np.abs(whole) * rng.uniform(2.0, 20.0, count)
    turns = (whole + differences - per_m_rad * lengths) / gain
    return turns * (1.0 + rng.normal(0.0, noise, count)), lengths, differences


def errors(world: tuple[Floats, Floats, Floats]) -> Estimate:
    estimate = systematic_errors(*world)
    assert estimate is not None
    return estimate


def scale(turns_rad: Floats, low: float = 0.6, high: float = 4.0) -> Estimate:
    estimate = scale_of_turns(turns_rad, low, high)
    assert estimate is not None
    return estimate


# Turns in a known unit


@pytest.mark.parametrize('gain', [0.975, 1.025])
def test_small_gain_is_estimated_from_noisy_loops(gain: float) -> None:
    estimate = errors(loops(random(), 40, gain))
    assert estimate.correction.gain == pytest.approx(gain, rel=0.015)
    assert estimate.share > 0.9


def test_loops_of_two_laps_each_do_not_halve_the_gain() -> None:
    turns = np.full(40, 4.0 * math.pi / 1.03)
    estimate = errors((turns, np.full(40, 20.0), np.zeros(40)))
    assert estimate.correction.gain == pytest.approx(1.03, abs=0.01)


@pytest.mark.parametrize('seed', range(2))
@pytest.mark.parametrize('gain', [0.975, 1.025])
def test_false_loops_do_not_disturb_small_errors(seed: int, gain: float) -> None:
    rng = random(seed)
    turns, lengths, differences = loops(rng, 40, gain)
    turns[rng.permutation(40)[:12]] = rng.uniform(-8.0, 8.0, 12)
    estimate = errors((turns, lengths, differences))
    assert estimate.correction.gain == pytest.approx(gain, rel=0.025)
    assert estimate.share < 0.95


@pytest.mark.parametrize('seed', range(3))
def test_errors_are_searched_together_on_long_loops(seed: int) -> None:
    """Without its turn per metre, a loop of 400 m is 137 degrees off, and other gains suit it."""
    rng = random(seed)
    whole = 2.0 * math.pi * rng.integers(-6, 7, 60)
    lengths, differences = rng.uniform(20.0, 400.0, 60), rng.normal(0.0, 0.1, 60)
    turns = (whole + differences + 0.006 * lengths) / 0.985 + rng.normal(0.0, 0.2, 60)
    turns[:12] = rng.uniform(-40.0, 40.0, 12)
    estimate = errors((turns, lengths, differences))
    assert estimate.correction.gain == pytest.approx(0.985, abs=0.012)
    assert estimate.correction.per_m_rad == pytest.approx(-0.006, abs=0.0012)


def test_both_wheel_errors_are_estimated_from_loops_of_different_shapes() -> None:
    estimate = errors(loops(random(), 200, 0.97, 0.006, noise=0.005))
    assert estimate.correction.gain == pytest.approx(0.97, abs=0.015)
    assert estimate.correction.per_m_rad == pytest.approx(0.006, abs=0.002)


def test_equal_loops_are_closed_by_both_errors_together() -> None:
    turns, lengths = np.full(50, 2.0 * math.pi / 0.95), np.full(50, 40.0)
    correction = errors((turns, lengths, np.zeros(50))).correction
    assert correction.corrected(turns[0], 40.0) == pytest.approx(2.0 * math.pi, abs=0.08)
    assert 0.95 < correction.gain < 1.0
    assert correction.per_m_rad < 0.0


def test_figure_eight_confirms_the_gain() -> None:
    turns = random().normal(0.0, 0.1, 100)
    correction = errors((turns, np.full(100, 20.0), np.zeros(100))).correction
    assert correction.gain == pytest.approx(1.0, abs=0.02)
    assert correction.per_m_rad == pytest.approx(0.0, abs=0.002)


@pytest.mark.parametrize('count', [0, 1, 3])
def test_few_loops_give_no_estimate(count: int) -> None:
    world = loops(random(), count, 1.0)
    assert systematic_errors(*world) is None
    assert scale_of_turns(world[0], 0.6, 4.0) is None


def test_inconsistent_loops_give_no_estimate() -> None:
    rng = random()
    for count in (10, 30, 100):
        turns = rng.uniform(-8.0, 8.0, count)
        assert systematic_errors(turns, np.full(count, 20.0), np.zeros(count)) is None
        assert scale_of_turns(turns, 0.6, 4.0) is None


# Turns in an unknown unit


@pytest.mark.parametrize('gain', [0.7, 0.975, 1.5, 2.6, 3.5])
def test_scale_is_estimated_from_noisy_loops(gain: float) -> None:
    estimate = scale(loops(random(), 40, gain, noise=0.05)[0])
    assert estimate.correction.gain == pytest.approx(gain, rel=0.03)
    assert estimate.share > 0.8


@pytest.mark.parametrize('low, high', [(0.6, 0.9), (1.1, 4.0)])
def test_scale_outside_the_range_gives_no_estimate(low: float, high: float) -> None:
    turns = loops(random(), 40, 1.0)[0]
    estimate = scale_of_turns(turns, low, high)
    assert estimate is None or estimate.correction.gain == pytest.approx(2.0, rel=0.02)


def test_figure_eight_tells_nothing_about_the_scale() -> None:
    assert scale_of_turns(random().normal(0.0, 0.2, 100), 0.6, 4.0) is None


def test_correction_is_inverted_by_measured() -> None:
    correction = TurnCorrection(1.3, -0.02)
    assert correction.measured(correction.corrected(0.7, 2.0), 2.0) == pytest.approx(0.7)
    assert UNCORRECTED.corrected(0.7, 2.0) == 0.7
