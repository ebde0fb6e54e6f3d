# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from ratslam_ros.core.common.angles import wrap


@given(st.floats(-1e6, 1e6))
def test_the_result_is_the_same_angle_and_in_range(angle: float) -> None:
    wrapped = wrap(angle)
    assert -math.pi < wrapped <= math.pi
    turns = (angle - wrapped) / (2.0 * math.pi)
    assert abs(turns - round(turns)) < 1e-9


def test_half_a_turn_is_positive_from_either_side() -> None:
    assert wrap(math.pi) == wrap(-math.pi) == math.pi
    assert wrap(math.nextafter(-math.pi, 0.0)) < 0.0
    assert wrap(math.nextafter(-math.pi, -4.0)) > 0.0


@given(st.floats(-3.1, 3.1))
def test_an_angle_in_range_keeps_its_bits(angle: float) -> None:
    assert wrap(angle) == angle


@pytest.mark.parametrize('turns', range(-5, 6))
def test_whole_turns_vanish(turns: int) -> None:
    assert wrap(0.5 + turns * 2.0 * math.pi) == pytest.approx(0.5, abs=1e-12)
