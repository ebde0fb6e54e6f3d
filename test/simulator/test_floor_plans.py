# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
from itertools import pairwise
from pathlib import Path

import cv2
import numpy as np
import pytest
from floor_clearance import clearance_m
from scipy.ndimage import label

from ratslam_ros.errors import UnusableInput
from ratslam_simulator.bodies import room_for
from ratslam_simulator.floor_plan import (
    OFFICE,
    OFFICE_CELL_M,
    load_floor_plan,
    office,
    parse_floor_plan,
    shipped_plans,
)

UNIVERSITY, OBSTACLE = 'university_floor', 'obstacle_loop'
RING = 'SabcdefgS'
ROOT = Path(__file__).resolve().parents[2]
CLOSED_DOORS = ROOT / 'benchmarks/floors/ring.txt'


def length_m(plan, names):
    return sum(
        np.hypot(*np.subtract(plan.places[b], plan.places[a])) for a, b in pairwise(names)
    )


def along(plan, names, step_m=0.1):
    """Yield points at regular distances along the straight lines from place to place."""
    for a, b in pairwise(names):
        start, end = np.array(plan.places[a]), np.array(plan.places[b])
        for share in np.arange(0.0, 1.0, step_m / np.hypot(*(end - start))):
            yield start + share * (end - start)


def test_shipped_plans_load_by_name():
    assert shipped_plans() == [OBSTACLE, 'office', UNIVERSITY]
    assert np.array_equal(load_floor_plan('office').solid, office().solid)


def test_shipped_plans_are_package_data():
    setup = (ROOT / 'setup.py').read_text('utf-8')
    assert "'ratslam_simulator': ['py.typed', 'plans/*.txt']" in setup


@pytest.mark.parametrize('name', [UNIVERSITY, OBSTACLE])
def test_shipped_plans_are_connected_for_30_cm_radius(name):
    plan = load_floor_plan(name)
    room = room_for(plan.solid, plan.cell_m, 0.3)
    areas, count = label(room)
    assert count == 1
    for name, (x_m, y_m) in plan.places.items():
        assert areas[int(y_m / plan.cell_m), int(x_m / plan.cell_m)] == 1, name
        assert clearance_m(plan, x_m, y_m) >= 0.6, name
    # Areas out of reach of the robot are corners and niches, not rooms.
    beyond = label(~plan.solid & ~cv2.dilate(room.astype(np.uint8), np.ones((5, 5))).astype(bool))
    assert max(np.bincount(beyond[0].ravel())[1:], default=0) <= 4


def test_ring_plan_is_university_floor_with_closed_doors():
    ring, whole = load_floor_plan(str(CLOSED_DOORS)), load_floor_plan(UNIVERSITY)
    depth, width = ring.solid.shape
    assert not (~ring.solid & whole.solid[-depth:, :width]).any()
    assert set(ring.places) == set(RING)
    assert whole.size_m == pytest.approx((46.0, 22.0), abs=1.0)


@pytest.mark.parametrize('name', [UNIVERSITY, str(CLOSED_DOORS)])
def test_plan_has_a_ring_of_122_m(name):
    plan = load_floor_plan(name)
    assert length_m(plan, RING) == pytest.approx(122.0, abs=1.0)
    # The straight lines follow the middle of the corridor.
    clearances_m = [clearance_m(plan, x_m, y_m) for x_m, y_m in along(plan, RING)]
    assert min(clearances_m) > 0.65
    assert np.median(clearances_m) == pytest.approx(0.98)
    assert max(clearances_m) < 1.5
    # A ring stays connected after one cut, but not after two.
    solid = plan.solid.copy()
    for count, name in ((1, 'e'), (2, 'a')):
        x_m, y_m = plan.places[name]
        row, column = int(y_m / plan.cell_m), int(x_m / plan.cell_m)
        solid[row - 6 : row + 7, column - 6 : column + 7] = True
        assert label(~solid)[1] == count


def test_obstacle_loop_has_short_and_long_route():
    plan = load_floor_plan(OBSTACLE)
    assert length_m(plan, 'SXG') == pytest.approx(12.0, abs=0.5)
    assert 30.0 < length_m(plan, 'GbcS') < 40.0
    x_m, y_m = plan.places['X']
    assert x_m == pytest.approx((plan.places['S'][0] + plan.places['G'][0]) / 2, abs=plan.cell_m)
    assert min(clearance_m(plan, x, y) for x, y in along(plan, 'SGbcS')) > 0.65
    assert y_m == plan.places['S'][1] == plan.places['G'][1]


def write_picture(plan, path):
    cv2.imwrite(str(path), np.where(plan.solid, 30, 240).astype(np.uint8)[::-1])
    return path


def test_picture_loads_as_same_plan_as_text(tmp_path):
    plan = office()
    picture = write_picture(plan, tmp_path / 'office.png')
    loaded = load_floor_plan(picture, cell_m=plan.cell_m, places=plan.places)
    assert np.array_equal(loaded.solid, plan.solid)
    assert (loaded.cell_m, loaded.places) == (plan.cell_m, plan.places)


def test_text_file_header_sets_name_and_cell_size(tmp_path):
    path = tmp_path / 'mine.txt'
    path.write_text(f'name: mine\ncell_m: {OFFICE_CELL_M}\n\n{OFFICE.strip()}\n\n')
    plan = load_floor_plan(path)
    assert np.array_equal(plan.solid, office().solid)
    assert (plan.name, plan.cell_m, plan.places) == ('mine', OFFICE_CELL_M, office().places)


@pytest.mark.parametrize(
    ('text', 'message'),
    [
        ('cell_m: 1\n####\n#.##\n#..#\n###', 'line 5 has 3 characters, line 2 has 4'),
        ('cell_m: 1\n####\n#.x,\n####', "line 3 .*','"),
        ('cell_m: 1\n#####\n#A.A#\n#####', "line 3 .*'A'"),
        ('cell_m: 0\n###\n#.#\n###', "line 1 .*'?0"),
        ('cell_m: wide\n###\n#.#\n###', 'line 1 .*wide'),
        ('cells: 1\n###\n#.#\n###', "line 1 .*'cells: 1'"),
        ('cell_m: 1\n###\n#..\n###', 'closed'),
        ('cell_m: 1\n', 'drawing'),
        ('###\n#.#\n###', 'cell_m'),
    ],
)
def test_malformed_text_is_refused_with_line_number(text, message, tmp_path):
    path = tmp_path / 'plan.txt'
    path.write_text(text)
    with pytest.raises(UnusableInput, match=message) as refused:
        load_floor_plan(path)
    assert str(path) in str(refused.value)


def test_unusable_files_are_refused(tmp_path):
    picture = write_picture(office(), tmp_path / 'plan.png')
    with pytest.raises(UnusableInput, match='pixel of the picture in metres'):
        load_floor_plan(picture)
    with pytest.raises(UnusableInput, match='positive'):
        load_floor_plan(picture, cell_m=-1.0)
    with pytest.raises(UnusableInput, match='not on the free floor'):
        load_floor_plan(picture, cell_m=0.7, places={'A': (0.1, 0.1)})
    with pytest.raises(UnusableInput, match='not on the free floor'):
        load_floor_plan(picture, cell_m=0.7, places={'A': (50.0, 1.0)})
    open_plan = tmp_path / 'open.png'
    cv2.imwrite(str(open_plan), np.full((9, 9), 255, np.uint8))
    with pytest.raises(UnusableInput, match='closed'):
        load_floor_plan(open_plan, cell_m=0.1)
    (tmp_path / 'none.png').write_bytes(b'no picture')
    with pytest.raises(UnusableInput, match='as a picture'):
        load_floor_plan(tmp_path / 'none.png', cell_m=0.1)
    with pytest.raises(UnusableInput, match=r'no_such_plan.*office'):
        load_floor_plan('no_such_plan')
    (tmp_path / 'binary.txt').write_bytes(bytes(range(128, 256)))
    with pytest.raises(UnusableInput, match=r'binary\.txt'):
        load_floor_plan(tmp_path / 'binary.txt')


def test_parse_without_header_uses_given_cell_size():
    assert parse_floor_plan('###\n#.#\n###', cell_m=2.0).size_m == (6.0, 6.0)
