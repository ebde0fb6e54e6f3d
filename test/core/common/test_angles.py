# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from ratslam_ros.core.common.angles import wrap


@given(st.floats(-1e6, 1e6))
def test_wrap_any_angle_returns_equal_angle_in_range(angle: float) -> None:
    wrapped = wrap(angle)
    assert -math.pi < wrapped <= math.pi
    turns = (angle - wrapped) / (2.0 * math.pi)
    assert abs(turns - round(turns)) < 1e-9


def test_wrap_half_turn_returns_positive_pi() -> None:
    assert wrap(math.pi) == wrap(-math.pi) == math.pi
    assert wrap(math.nextafter(-math.pi, 0.0)) < 0.0
    assert wrap(math.nextafter(-math.pi, -4.0)) > 0.0


@given(st.floats(-3.1, 3.1))
def test_wrap_angle_in_range_is_unchanged(angle: float) -> None:
    assert wrap(angle) == angle


@pytest.mark.parametrize('turns', range(-5, 6))
def test_wrap_removes_whole_turns(turns: int) -> None:
    assert wrap(0.5 + turns * 2.0 * math.pi) == pytest.approx(0.5, abs=1e-12)
