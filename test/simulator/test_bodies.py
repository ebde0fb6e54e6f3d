# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
import math

import numpy as np
import pytest
from floor_clearance import clearance_m
from hypothesis import given, settings
from hypothesis import strategies as st

from ratslam_simulator.bodies import fits, room_for, slide
from ratslam_simulator.floor_plan import office, parse_floor_plan

NO_DISCS = np.empty((0, 2))
PLAN = parse_floor_plan('#######\n#.....#\n#..#..#\n#.....#\n#######', cell_m=1.0)


def test_fits_agrees_with_wall_distance():
    plan = office()
    for x_m, y_m in np.random.Generator(np.random.PCG64(0)).uniform((0, 0), plan.size_m, (400, 2)):
        nearest_wall_m = clearance_m(plan, x_m, y_m)
        assert fits(plan.solid, plan.cell_m, x_m, y_m, nearest_wall_m * 0.999 + 1e-12)
        assert not fits(plan.solid, plan.cell_m, x_m, y_m, nearest_wall_m + 1e-6)


def test_slide_along_wall_and_corner_keeps_contact():
    # Along the southern wall at y = 1, moving down and to the right.
    x_m, y_m, touched = slide(PLAN.solid, 1.0, NO_DISCS, 0.0, 2.0, 1.25, 2.1, 1.15, 0.2)
    assert (x_m, y_m, touched) == (pytest.approx(2.1), pytest.approx(1.2), True)
    # Onto the corner of the block at (3, 2): pushed out along the line from the corner.
    x_m, y_m, touched = slide(PLAN.solid, 1.0, NO_DISCS, 0.0, 2.8, 1.8, 2.9, 1.9, 0.2)
    assert touched
    assert math.hypot(3.0 - x_m, 2.0 - y_m) == pytest.approx(0.2)
    assert 3.0 - x_m == pytest.approx(2.0 - y_m)


def test_slide_into_disc_stops_at_contact():
    discs = np.array([(2.0, 1.5)])
    x_m, y_m, touched = slide(PLAN.solid, 1.0, discs, 0.25, 1.5, 1.5, 1.7, 1.5, 0.2)
    assert (x_m, y_m, touched) == (pytest.approx(1.55), pytest.approx(1.5), True)
    free = slide(PLAN.solid, 1.0, discs, 0.25, 1.5, 1.5, 1.54, 1.5, 0.2)
    assert free == (1.54, 1.5, False)


@settings(max_examples=80, deadline=None)
@given(
    st.floats(1.21, 5.79), st.floats(1.21, 3.79), st.floats(-0.1, 0.1), st.floats(-0.1, 0.1),
    st.floats(1.0, 6.0), st.floats(1.0, 4.0),
)
def test_slide_random_moves_never_overlap(x_m, y_m, dx_m, dy_m, other_x_m, other_y_m):
    discs = np.array([(other_x_m, other_y_m)])
    apart_m = math.hypot(other_x_m - x_m, other_y_m - y_m)
    if not fits(PLAN.solid, 1.0, x_m, y_m, 0.2) or apart_m < 0.45:
        return
    to_x_m, to_y_m, touched = slide(
        PLAN.solid, 1.0, discs, 0.25, x_m, y_m, x_m + dx_m, y_m + dy_m, 0.2
    )
    assert clearance_m(PLAN, to_x_m, to_y_m) >= 0.2 - 1e-8
    assert math.hypot(other_x_m - to_x_m, other_y_m - to_y_m) >= 0.45 - 1e-8
    assert touched or (to_x_m, to_y_m) == (x_m + dx_m, y_m + dy_m)


def test_room_for_returns_cells_where_disc_fits():
    assert room_for(PLAN.solid, 1.0, 0.4).tolist() == (~PLAN.solid).tolist()
    assert not room_for(PLAN.solid, 1.0, 0.6).any()
