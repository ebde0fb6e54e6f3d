# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
import math

import numpy as np
import pytest
from numpy.typing import NDArray

from ratslam_ros.core.common.pose import Pose, corrected_arc
from ratslam_ros.core.common.rotation_gain import Estimate, scale_of_turns
from ratslam_ros.core.common.turn_correction import UNCORRECTED, TurnCorrection

Floats = NDArray[np.float64]


def random(seed: int = 0) -> np.random.Generator:
    return np.random.Generator(np.random.PCG64(seed))


def loops(rng: np.random.Generator, count: int, gain: float, noise: float = 0.05) -> Floats:
    """Return measured turns of loops with k of -1, 1 and 2."""
    turns = 2.0 * math.pi * rng.choice([-1.0, 1.0, 1.0, 2.0], count) / gain
    return turns * (1.0 + rng.normal(0.0, noise, count))


def scale(turns_rad: Floats, low: float = 0.6, high: float = 4.0) -> Estimate:
    estimate = scale_of_turns(turns_rad, low, high)
    assert estimate is not None
    return estimate


@pytest.mark.parametrize('gain', [0.7, 0.975, 1.5, 2.6, 3.5])
def test_scale_is_estimated_from_noisy_loops(gain: float) -> None:
    estimate = scale(loops(random(), 40, gain))
    assert estimate.gain == pytest.approx(gain, rel=0.03)


@pytest.mark.parametrize('seed', range(5))
def test_false_loops_do_not_disturb_the_scale(seed: int) -> None:
    rng = random(seed)
    turns = loops(rng, 40, 1.8)
    turns[rng.permutation(40)[:12]] = rng.uniform(-8.0, 8.0, 12)
    assert scale(turns).gain == pytest.approx(1.8, rel=0.03)


def test_loops_of_one_turn_are_likelier_than_loops_of_two() -> None:
    assert scale(np.full(40, math.pi)).gain == pytest.approx(2.0, rel=0.01)


@pytest.mark.parametrize('low, high', [(0.6, 0.9), (1.1, 4.0)])
def test_scale_outside_the_range_gives_no_estimate(low: float, high: float) -> None:
    estimate = scale_of_turns(loops(random(), 40, 1.0, 0.02), low, high)
    assert estimate is None or estimate.gain == pytest.approx(2.0, rel=0.02)


@pytest.mark.parametrize('count', [0, 1, 3])
def test_few_loops_give_no_estimate(count: int) -> None:
    assert scale_of_turns(loops(random(), count, 1.0), 0.6, 4.0) is None


@pytest.mark.parametrize('count', [10, 30, 100])
def test_inconsistent_loops_give_no_estimate(count: int) -> None:
    assert scale_of_turns(random().uniform(-8.0, 8.0, count), 0.6, 4.0) is None


def test_figure_eight_tells_nothing_about_the_scale() -> None:
    assert scale_of_turns(random().normal(0.0, 0.2, 100), 0.6, 4.0) is None


def test_corrections_are_undone_and_composed() -> None:
    first, second = TurnCorrection(1.3, -0.02), TurnCorrection(0.9, 0.1)
    corrected = first.corrected(0.7, 2.0)
    assert first.measured(corrected, 2.0) == pytest.approx(0.7)
    assert first.inverse.corrected(corrected, 2.0) == pytest.approx(0.7)
    both = second.after(first).corrected(0.7, 2.0)
    assert both == pytest.approx(second.corrected(corrected, 2.0))
    assert UNCORRECTED.corrected(0.7, 2.0) == 0.7


def test_corrected_arc_has_half_of_its_turn_as_direction() -> None:
    measured = Pose(2.0 * math.cos(0.2), 2.0 * math.sin(0.2), 0.4)
    x_m, y_m, turn_rad = corrected_arc(measured, TurnCorrection(1.5, 0.1))
    assert (math.hypot(x_m, y_m), math.atan2(y_m, x_m), turn_rad) == pytest.approx((2.0, 0.4, 0.8))
