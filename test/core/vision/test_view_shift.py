# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The shift of a view as a relative heading."""

from __future__ import annotations

import math

import numpy as np
import pytest
from helpers import extended

from ratslam_ros.core.vision.local_view import LocalView


@pytest.mark.parametrize('columns', [-2, -1, 0, 1, 2])
def test_view_shift_gives_relative_heading(columns: int) -> None:
    parameters = extended(
        'local_view', template_x_size=20, vt_shift_match=3, vt_shift_fov_deg=50.0
    )
    rng = np.random.default_rng(1)
    wide = rng.integers(0, 256, (10, 40)).astype(np.uint8)
    view = LocalView(parameters)
    view.match(wide[:, 10:30])
    # After a left turn the image content moves to the right.
    match = view.match(wide[:, 10 - columns : 30 - columns])
    assert not match.is_new
    assert match.relative_rad == pytest.approx(math.radians(columns * 50.0 / 20))


def test_view_shift_without_field_of_view_is_ignored() -> None:
    view = LocalView(extended('local_view', template_x_size=20, vt_shift_match=3))
    wide = np.random.default_rng(1).integers(0, 256, (10, 40)).astype(np.uint8)
    view.match(wide[:, 10:30])
    assert view.match(wide[:, 11:31]).relative_rad == 0.0
