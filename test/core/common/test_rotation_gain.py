# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
import math

import numpy as np
import pytest
from numpy.typing import NDArray

from ratslam_ros.core.common.rotation_gain import Estimate, estimate_correction
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


def estimated(world: tuple[Floats, Floats, Floats], expected: float | None) -> Estimate:
    estimate = estimate_correction(*world, expected)
    assert estimate is not None
    return estimate


@pytest.mark.parametrize('gain', [0.3, 0.6, 0.975, 1.025, 1.5, 2.6, 3.0])
def test_gain_is_estimated_from_noisy_loops(gain: float) -> None:
    estimate = estimated(loops(random(), 40, gain), None)
    assert estimate.correction.gain == pytest.approx(gain, rel=0.015)
    assert estimate.share > 0.9


@pytest.mark.parametrize('gain', [0.6, 0.975, 1.025, 1.5, 2.6, 3.0])
def test_gain_is_estimated_if_another_one_is_expected(gain: float) -> None:
    estimate = estimated(loops(random(), 40, gain), 1.0)
    assert estimate.correction.gain == pytest.approx(gain, rel=0.015)


def test_expected_gain_is_preferred_to_its_fractions() -> None:
    """Loops of two laps each are explained by half of the gain too."""
    turns = np.full(40, 4.0 * math.pi / 1.03)
    world = turns, np.full(40, 20.0), np.zeros(40)
    assert estimated(world, 1.0).correction.gain == pytest.approx(1.03, abs=0.01)
    assert estimated(world, None).correction.gain == pytest.approx(0.515, abs=0.005)


@pytest.mark.parametrize('seed', range(5))
@pytest.mark.parametrize('gain', [0.6, 1.025, 2.6])
def test_false_loops_do_not_disturb(seed: int, gain: float) -> None:
    rng = random(seed)
    turns, lengths, differences = loops(rng, 40, gain)
    turns[rng.permutation(40)[:12]] = rng.uniform(-8.0, 8.0, 12)
    estimate = estimated((turns, lengths, differences), 1.0)
    assert estimate.correction.gain == pytest.approx(gain, rel=0.025)
    assert estimate.share < 0.95


def test_both_wheel_errors_are_estimated_from_loops_of_different_shapes() -> None:
    estimate = estimated(loops(random(), 200, 0.97, 0.006, noise=0.005), 1.0)
    assert estimate.correction.gain == pytest.approx(0.97, abs=0.015)
    assert estimate.correction.per_m_rad == pytest.approx(0.006, abs=0.002)


def test_equal_loops_are_closed_by_both_errors_together() -> None:
    turns, lengths = np.full(50, 2.0 * math.pi / 0.95), np.full(50, 40.0)
    correction = estimated((turns, lengths, np.zeros(50)), 1.0).correction
    assert correction.corrected(turns[0], 40.0) == pytest.approx(2.0 * math.pi, abs=0.08)
    assert 0.95 < correction.gain < 1.0
    assert correction.per_m_rad < 0.0


def test_figure_eight_gives_no_estimate() -> None:
    turns = random().normal(0.0, 0.2, 100)
    assert estimate_correction(turns, np.full(100, 20.0), np.zeros(100)) is None
    assert estimate_correction(turns, np.full(100, 20.0), np.zeros(100), 1.0) is None


def test_figure_eight_does_not_disturb_other_loops() -> None:
    turns, lengths, differences = loops(random(), 40, 1.04)
    turns[:15] = differences[:15] / 1.04
    assert estimated((turns, lengths, differences), 1.0).correction.gain == pytest.approx(
        1.04, rel=0.02
    )


@pytest.mark.parametrize('count', [0, 1, 3, 5])
def test_few_loops_give_no_estimate(count: int) -> None:
    assert estimate_correction(*loops(random(), count, 1.0)) is None


def test_inconsistent_loops_give_no_estimate() -> None:
    rng = random()
    for count in (10, 30, 100):
        turns = rng.uniform(-8.0, 8.0, count)
        assert estimate_correction(turns, np.full(count, 20.0), np.zeros(count)) is None


def test_loops_closed_in_translation_select_the_gain() -> None:
    """Opposite places look alike, so that half of the loops have half of the turn."""
    turns = np.concatenate((np.full(30, math.pi), np.full(30, 2.0 * math.pi)))
    world = turns, np.full(60, 20.0), np.zeros(60)
    closed = {1.0: 0.02, 2.0: 0.4}
    tried = []

    def open_share(gain: float) -> float:
        tried.append(gain)
        return min(closed.items(), key=lambda item: abs(item[0] - gain))[1]

    estimate = estimate_correction(*world, None, open_share)
    assert estimate is not None
    assert estimate.correction.gain == pytest.approx(1.0, abs=0.02)
    assert max(tried) > 1.9


def test_correction_is_inverted_by_measured() -> None:
    correction = TurnCorrection(1.3, -0.02)
    assert correction.measured(correction.corrected(0.7, 2.0), 2.0) == pytest.approx(0.7)
    assert UNCORRECTED.corrected(0.7, 2.0) == 0.7
