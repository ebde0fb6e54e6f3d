# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Pose cells: visual evidence, and the action for each template message."""

import math

import numpy as np
import pytest
from helpers import STILL, ahead, around, centroid, extended, seen, turning
from hypothesis import given, settings
from hypothesis import strategies as st

from ratslam_ros.core.common.odometry import Motion
from ratslam_ros.core.pose_cells.map_action import MapAction
from ratslam_ros.core.pose_cells.pose_cells import PoseCells
from ratslam_ros.core.pose_cells.torus import Place, Torus
from ratslam_ros.core.vision.local_view import UNDECODABLE

PLANE_RAD = 2.0 * math.pi / 36


def cells(**changes: float) -> PoseCells:
    """Return pose cells in which every recognised view injects its full energy."""
    return PoseCells(extended('pose_cells', **{'pc_vt_agree_views': 0.0, **changes}))


def drive(
    pose_cells: PoseCells, templates: list[int], distance_m: float = 1.5
) -> list[MapAction]:
    """Move straight ahead before each view; return the actions."""
    actions = []
    for template_id in templates:
        pose_cells.integrate(ahead(distance_m))
        actions.append(pose_cells.view(seen(template_id)))
    return actions


# Actions


def test_view_before_first_odometry_gives_none() -> None:
    pose_cells = cells()
    action = pose_cells.view(seen(0))
    assert (action.action, action.source_id, action.target_id) == ('none', -1, -1)
    assert action.place == pose_cells.peak
    pose_cells.integrate(STILL)
    action = pose_cells.view(seen(0))
    assert (action.action, action.source_id, action.target_id) == ('create', -1, 0)


def test_same_view_near_its_experience_gives_none() -> None:
    actions = drive(cells(), [0, 0, 0, 0], 0.3)
    assert [a.action for a in actions] == ['create', 'none', 'none', 'none']
    assert all(a.target_id == 0 for a in actions)


def test_same_view_beyond_threshold_creates_experience() -> None:
    actions = drive(cells(exp_delta_pc_threshold=2.0), [0, 0, 0, 0, 0], 0.7)
    assert [a.action for a in actions] == ['create', 'none', 'none', 'create', 'none']
    assert actions[-1].target_id == 1


def test_transition_is_link_first_and_set_later() -> None:
    """Alternate between two places: each direction is a separate transition."""
    pose_cells = cells(exp_delta_pc_threshold=0.8)
    actions = []
    for step in range(8):
        pose_cells.integrate(ahead(1.5 if step % 2 else -1.5))
        actions.append(pose_cells.view(seen(step % 2)))
    assert [(a.action, a.source_id, a.target_id) for a in actions] == [
        ('create', -1, 0), ('create', 0, 1), ('link', 1, 0), ('set', 0, 1),
        ('set', 1, 0), ('set', 0, 1), ('set', 1, 0), ('set', 0, 1),
    ]


def test_template_with_several_experiences_selects_nearest() -> None:
    """A corridor where one view repeats every 5 cells."""
    pose_cells = cells(pc_dim_x=60)
    drive(pose_cells, [7, 7, 7], 5.0)
    drive(pose_cells, [8], 4.6)
    back = drive(pose_cells, [7], -4.0)[0]
    assert (back.action, back.source_id, back.target_id) == ('link', 3, 2)


def test_known_view_far_from_its_experiences_creates_one() -> None:
    pose_cells = cells(pc_dim_x=60)
    drive(pose_cells, [0, 1], 2.0)
    far = drive(pose_cells, [0], 10.0)[0]
    assert (far.action, far.target_id, far.template_id) == ('create', 2, 0)


def test_one_decision_per_odometry_message() -> None:
    pose_cells = cells()
    drive(pose_cells, [0])
    pose_cells.integrate(ahead(1.5))
    assert pose_cells.view(seen(1)).action == 'create'
    assert pose_cells.view(seen(2)).action == 'none'
    pose_cells.integrate(ahead(1.5))
    assert pose_cells.view(seen(2)).action == 'create'


def test_decision_none_uses_up_the_odometry_message() -> None:
    pose_cells = cells()
    assert [a.action for a in drive(pose_cells, [0, 0], 1.0)] == ['create', 'none']
    assert pose_cells.view(seen(5)).action == 'none'
    pose_cells.integrate(ahead(0.1))
    assert pose_cells.view(seen(5)).action == 'create'


@pytest.mark.parametrize('relative_rad', [0.0, 1.0, -2.5, math.pi])
def test_place_has_heading_of_view_not_of_robot(relative_rad: float) -> None:
    pose_cells = cells()
    pose_cells.integrate(STILL)
    action = pose_cells.view(seen(0, relative_rad))
    assert action.relative_rad == relative_rad
    expected = pose_cells.peak.theta - relative_rad / PLANE_RAD
    assert around(action.place.theta - expected, 36) == pytest.approx(0.0, abs=1e-12)
    assert 0.0 <= action.place.theta < 36.0


def test_turning_in_place_with_panoramic_view_keeps_experience() -> None:
    """The heading of the view is compared, not that of the robot."""
    pose_cells = cells()
    pose_cells.integrate(STILL)
    pose_cells.view(seen(0))
    for step in range(1, 60):
        pose_cells.integrate(turning(0.1))
        action = pose_cells.view(seen(0, math.remainder(0.1 * step, 2 * math.pi)))
        assert (action.action, action.target_id) == ('none', 0)


# Stationary robot


def test_stationary_robot_with_new_templates_creates_nothing() -> None:
    """OpenRatSLAM creates an experience for every template that a stationary robot sees."""
    pose_cells = cells()
    drive(pose_cells, [0, 1])
    for template_id in range(2, 40):
        pose_cells.integrate(STILL)
        action = pose_cells.view(seen(template_id, is_new=True))
        assert (action.action, action.target_id) == ('none', 1)


def test_stationary_robot_with_odometry_noise_creates_nothing() -> None:
    pose_cells = cells()
    drive(pose_cells, [0])
    for step in range(60):
        sign = 1 if step % 2 else -1
        pose_cells.integrate(Motion(0.1, 0.002 * sign, 0.0005 * sign))
        assert pose_cells.view(seen(step + 1)).action == 'none'


def test_template_changed_while_stationary_creates_experience_after_motion() -> None:
    pose_cells = cells()
    drive(pose_cells, [0])
    pose_cells.integrate(STILL)
    assert pose_cells.view(seen(1)).action == 'none'
    action = drive(pose_cells, [1], 0.2)[0]
    assert (action.action, action.source_id, action.target_id) == ('create', 0, 1)


def test_turning_in_place_is_not_stationary() -> None:
    pose_cells = cells()
    drive(pose_cells, [0])
    pose_cells.integrate(turning(0.3))
    assert pose_cells.view(seen(1)).action == 'create'


# Lost messages and undecodable images


def test_skipped_template_ids_are_associated_when_first_seen() -> None:
    """A message was lost or the node started late: no error, as in OpenRatSLAM."""
    actions = drive(cells(), [57, 60, 3, 1_000_000, 57])
    assert [a.action for a in actions] == ['create'] * 5
    assert [a.template_id for a in actions] == [57, 60, 3, 1_000_000, 57]


@pytest.mark.parametrize('spare', [True, False])
def test_newest_templates_inject_unless_published(spare: bool) -> None:
    pose_cells = cells(pc_dim_x=60, pc_vt_spare_newest=spare)
    drive(pose_cells, [0, 1], 5.0)
    pose_cells.integrate(ahead(5.0))
    pose_cells.view(seen(0))
    assert len(pose_cells.injections) == (0 if spare else 1)


@pytest.mark.parametrize('moved', [0.0, 0.3, 0.7])
def test_published_injection_enters_one_cell(moved: float) -> None:
    """Nearby, it is the nearest cell of the packet's lattice, which lies between other cells."""
    packets: dict[bool, np.ndarray] = {}
    for interpolate in (True, False):
        pose_cells = cells(pc_vt_interpolate=interpolate, pc_vt_spare_newest=False)
        pose_cells.integrate(ahead(0.4))
        pose_cells.view(seen(0))
        pose_cells.integrate(ahead(moved))
        before = pose_cells.state()['packets']
        pose_cells.view(seen(1))
        pose_cells.view(seen(0))
        (packet,), (old,) = pose_cells.state()['packets'], before
        assert np.array_equal(packet['frame'], old['frame'])
        assert np.array_equal(packet['box'], old['box'])
        packets[interpolate] = packet['cells'] - old['cells']
    energy = 0.15 / 30.0 * (30.0 - math.exp(1.2))
    assert np.count_nonzero(packets[False]) == 1
    assert packets[False].max() == pytest.approx(energy)
    assert packets[True].sum() == pytest.approx(energy)
    nearest = np.unravel_index(packets[True].argmax(), packets[True].shape)
    assert packets[False][nearest] == pytest.approx(energy)
    assert np.count_nonzero(packets[True]) > 1 or moved == 0.0


def test_undecodable_image_injects_nothing_and_gives_none() -> None:
    pose_cells = cells()
    drive(pose_cells, list(range(15)))
    pose_cells.integrate(ahead(1.5))
    before = pose_cells.activity()
    action = pose_cells.view(UNDECODABLE)
    assert (action.action, action.template_id) == ('none', -1)
    assert action.source_id == action.target_id == 14
    assert np.array_equal(pose_cells.activity(), before)
    # The odometry message is still available for the next image.
    assert pose_cells.view(seen(15)).action == 'create'


@settings(max_examples=25)
@given(st.lists(
    st.tuples(st.integers(-1, 14), st.floats(-1.5, 1.5), st.booleans()), max_size=60,
))
def test_actions_are_consistent_for_any_messages(
    steps: list[tuple[int, float, bool]],
) -> None:
    pose_cells = cells()
    created = 0
    links: set[tuple[int, int]] = set()
    current = -1
    for template_id, distance, odometry in steps:
        if odometry:
            pose_cells.integrate(ahead(distance))
        action = pose_cells.view(seen(template_id))
        assert action.template_id == template_id
        assert action.source_id == current
        if action.action == 'create':
            assert action.target_id == created
            created += 1
        elif action.action == 'none':
            assert action.target_id == current
        else:
            transition = (current, action.target_id)
            assert action.target_id not in (-1, current)
            assert action.target_id < created
            assert (action.action == 'set') == (transition in links)
        if action.action != 'none':
            links.add((current, action.target_id))
        assert odometry or template_id == -1 or action.action in ('none', 'create')
        current = action.target_id
        assert current == pose_cells.current_experience
        assert abs(pose_cells.activity().sum()) < 100.0


# Injection


def known(templates: int = 12, **changes: float) -> PoseCells:
    """Return pose cells that have learned templates 0, 1, ... one cell apart."""
    pose_cells = cells(pc_dim_x=60, **changes)
    drive(pose_cells, list(range(templates)), 1.0)
    return pose_cells


def injected(pose_cells: PoseCells, template_id: int, relative_rad: float = 0.0) -> float:
    before = pose_cells.activity().sum()
    pose_cells.view(seen(template_id, relative_rad))
    return float(pose_cells.activity().sum() - before)


def test_ten_newest_templates_inject_nothing() -> None:
    pose_cells = known(13)
    for template_id in range(3, 13):
        assert injected(pose_cells, template_id) == 0.0
    for template_id in range(3):
        assert injected(pose_cells, template_id) > 0.01


def test_newest_templates_are_determined_by_order_not_id() -> None:
    pose_cells = cells(pc_dim_x=60)
    drive(pose_cells, [99, *range(10)], 1.0)
    assert injected(pose_cells, 99) > 0.01
    assert injected(pose_cells, 0) == 0.0


@settings(max_examples=40)
@given(
    st.lists(st.sampled_from([0, 0, 0, 1, 2, 11, -1]), min_size=1, max_size=60),
    st.floats(0.3, 2.0), st.floats(0.0, 1.5), st.floats(0.01, 0.5),
)
def test_injected_energy_equals_formula_for_any_history(
    views: list[int], active: float, restore: float, energy: float
) -> None:
    pose_cells = known(13, vt_active_decay=active, pc_vt_restore=restore,
                       pc_vt_inject_energy=energy)
    decays = dict.fromkeys(range(13), active)
    last = 12
    for template_id in views:
        expected = 0.0
        if template_id in (0, 1, 2):  # the others are among the ten newest
            if template_id == last:
                decays[template_id] += active
            raw = energy / 30.0 * (30.0 - math.exp(1.2 * decays[template_id]))
            expected = max(raw, 0.0)
        assert injected(pose_cells, template_id) == pytest.approx(expected, abs=1e-12)
        if template_id == -1:
            continue  # an undecodable image changes nothing
        decays = {k: max(active, decay - restore) for k, decay in decays.items()}
        last = template_id


@pytest.mark.parametrize('active', [1.0, 100.0])
def test_long_repeated_view_does_not_overflow(active: float) -> None:
    """The exponential of the decay must not overflow after a minute of messages."""
    pose_cells = known(13, vt_active_decay=active)
    for _ in range(1500):
        pose_cells.view(seen(0))
    pose_cells.integrate(STILL)
    assert pose_cells.activity().sum() == pytest.approx(1.0, abs=1e-12)


@pytest.mark.parametrize('turn', [0.0, 0.35, 1.0, -2.0])
def test_injection_is_turned_by_relative_heading(turn: float) -> None:
    """OpenRatSLAM adds the relative heading where it should subtract it."""
    pose_cells = known()
    before = pose_cells.activity()
    pose_cells.view(seen(0, turn))
    added = pose_cells.activity() - before
    place = (18.0 + turn / PLANE_RAD, 10.0, 29.0)
    found = centroid(added, place)
    assert np.abs(around(np.array(found) - place, np.array([36, 21, 60]))).max() < 0.1


def test_view_learned_at_relative_heading_keeps_own_heading() -> None:
    pose_cells = cells(pc_dim_x=60)
    pose_cells.integrate(STILL)
    # The node started late: the view was learned 5 planes before.
    pose_cells.view(seen(0, 5 * PLANE_RAD))
    drive(pose_cells, list(range(1, 12)), 1.0)
    before = pose_cells.activity()
    pose_cells.view(seen(0))
    found = centroid(pose_cells.activity() - before, (13.0, 10.0, 30.0))
    assert found[0] == pytest.approx(13.0, abs=0.1)


def test_injection_between_cells_spreads_over_eight_cells() -> None:
    """OpenRatSLAM truncates to one cell, which costs a quarter of its recall."""
    pose_cells = cells(pc_dim_x=60)
    for _ in range(5):
        pose_cells.integrate(STILL)
    pose_cells.integrate(Motion(0.1, -0.4, 0.3 * PLANE_RAD))
    pose_cells.view(seen(0))
    remembered = pose_cells.peak
    drive(pose_cells, list(range(1, 12)), 1.5)
    before = pose_cells.activity()
    pose_cells.view(seen(0))
    added = pose_cells.activity() - before
    assert (added > 1e-9).sum() >= 8
    found = centroid(added, (remembered.theta, remembered.y, remembered.x))
    assert found[2] == pytest.approx(remembered.x, abs=0.05)
    assert found[0] == pytest.approx(remembered.theta, abs=0.05)


def test_injection_does_not_change_peak_before_odometry() -> None:
    pose_cells = known(pc_vt_inject_energy=10.0)
    before = pose_cells.peak
    pose_cells.view(seen(0))
    assert pose_cells.peak == before
    pose_cells.integrate(STILL)
    assert pose_cells.peak.x == pytest.approx(29.0, abs=0.2)


# Agreement of views


def moved_by(pose_cells: PoseCells, before: Place) -> float:
    return Torus(60, 21, 36).distance(pose_cells.peak, before)


def test_packet_moves_only_after_several_agreeing_recognitions() -> None:
    for energy in (0.05, 0.15, 0.3):
        pose_cells = known(30, pc_vt_agree_views=3.0, pc_vt_inject_energy=energy)
        pose_cells.view(seen(0))
        for _ in range(10):
            pose_cells.integrate(STILL)
        assert moved_by(pose_cells, Place(0.0, 10.0, 18.0)) < 0.5
        # The robot is carried back to the start and drives the same route again.
        for template_id in range(20):
            pose_cells.integrate(ahead(1.0))
            pose_cells.view(seen(template_id))
        assert moved_by(pose_cells, Place(30.0 - 20.0, 10.0, 18.0)) < 3.0


def test_agreeing_views_inject_more_than_single_one() -> None:
    full = injected(known(30), 0)
    pose_cells = known(30, pc_vt_agree_views=3.0)
    energies = []
    for template_id in range(14):
        energies.append(injected(pose_cells, template_id))
        pose_cells.integrate(ahead(1.0))
    assert 0.0 <= energies[0] < 0.5 * full
    assert max(energies) >= 0.9 * full


# The torus


@given(st.floats(-100, 100), st.floats(-100, 100), st.floats(-100, 100))
def test_distance_is_shortest_on_torus(x: float, y: float, theta: float) -> None:
    torus = Torus(30, 17, 36)
    a, b = Place(x, y, theta), Place(3.0, 4.0, 5.0)
    expected = math.hypot(around(x - 3.0, 30), around(y - 4.0, 17), around(theta - 5.0, 36))
    assert torus.distance(a, b) == pytest.approx(expected, abs=1e-9)
    assert torus.distance(b, a) == torus.distance(a, b)
