# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
import numpy as np
import pytest
from floor_clearance import clearance_m

from ratslam_simulator.floor_plan import office, parse_floor_plan
from ratslam_simulator.world import EAST, NORTH, SOUTH, WEST, WorldOptions, build_world


def rng(seed):
    return np.random.Generator(np.random.PCG64(seed))


def test_plan_first_line_is_north():
    plan = parse_floor_plan('#####\n#B..#\n#..A#\n#####', cell_m=2.0)
    assert plan.size_m == (10.0, 8.0)
    assert plan.places == {'A': (7.0, 3.0), 'B': (3.0, 5.0)}
    assert list(plan.places) == ['A', 'B']  # sorted from the south
    assert clearance_m(plan, 5.0, 4.0) == pytest.approx(2.0)
    assert clearance_m(plan, 1.0, 1.0) == 0.0


def test_panels_continue_across_cells_as_seen():
    plan = parse_floor_plan('######\n#....#\n#....#\n#....#\n#....#\n######', cell_m=0.7)
    world = build_world(plan, rng(0), WorldOptions(aliasing=0.0))
    begin, middle = 0.0, np.float32(0.7)
    # Left to right as seen from the room is west to east on the north wall only.
    assert world.panel_u_m[5, 1:5, SOUTH].tolist() == [begin, middle, begin, middle]
    assert world.panel_u_m[0, 1:5, NORTH].tolist() == [middle, begin, middle, begin]
    assert world.panel_u_m[1:5, 0, EAST].tolist() == [begin, middle, begin, middle]
    assert world.panel_u_m[1:5, 5, WEST].tolist() == [middle, begin, middle, begin]
    assert world.panel[5, 1, SOUTH] == world.panel[5, 2, SOUTH] != world.panel[5, 3, SOUTH]


def test_aliasing_sets_share_of_house_style_walls():
    plan = office()
    shares = []
    for aliasing in (0.0, 1.0):
        world = build_world(plan, rng(3), WorldOptions(aliasing=aliasing))
        shares.append(np.isin(world.panel, world.library.house_style).mean())
    assert shares[0] < shares[1]
    # With full aliasing, opposite corners look the same.
    assert np.array_equal(world.panel[0, 1:4, NORTH], world.panel[-1, -2:-5:-1, SOUTH])
