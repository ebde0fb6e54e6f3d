# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Scan alignment: two scans of one place tell how the robot stood, and of two places nothing."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from rooms import Line, corridor, scan_in

from ratslam_ros.core.common.odometry import Motion
from ratslam_ros.core.common.pose import Pose, composed, inverse
from ratslam_ros.core.common.scan import points_of
from ratslam_ros.core.config import ExperienceMapParameters
from ratslam_ros.core.mapping import icp
from ratslam_ros.core.mapping.experience_map import ExperienceMap
from ratslam_ros.core.mapping.scan_matching import VIEW_SD_M, ScanMatch, ScanMatcher
from ratslam_ros.core.pose_cells.map_action import NO_EXPERIENCE, Action, MapAction
from ratslam_ros.core.pose_cells.torus import Place

ROOM: list[Line] = [
    [(-2.0, -1.5), (4.0, -1.5), (4.0, 2.0), (1.0, 2.0), (1.0, 3.5), (-2.0, 3.5), (-2.0, -1.5)],
    [(2.0, -0.5), (2.6, -0.5), (2.6, 0.3), (2.0, 0.3), (2.0, -0.5)],
]
"""With an alcove and a table."""

HALL: list[Line] = [[(-1.0, -7.0), (5.0, -4.0), (6.0, 7.0), (-3.0, 5.0), (-1.0, -7.0)]]
TICK_NS = 100_000_000
HERE = Pose(0.0, 0.0, 0.0)


def points(walls: list[Line], pose: Pose) -> np.ndarray:
    return points_of(scan_in(walls, pose, beams=181))


def align(place: np.ndarray, here: np.ndarray, guess: Pose) -> Pose | None:
    found = icp.align(place, here, guess, VIEW_SD_M)
    return None if found is None else found.pose


def off(found: Pose | None, true: Pose) -> tuple[float, float]:
    """Return how far a pose is from the true one, and how far it is turned."""
    assert found is not None
    turned = math.remainder(found.heading_rad - true.heading_rad, math.tau)
    return math.dist(found[:2], true[:2]), abs(turned)


@given(
    st.floats(-0.4, 0.4), st.floats(-0.4, 0.4), st.floats(-0.2, 0.2), st.floats(-0.08, 0.08),
    st.integers(0, 2**32 - 1),
)  # fmt: skip
def test_in_a_room_the_pose_is_found(
    x: float, y: float, heading: float, guessed: float, seed: int
) -> None:
    true = Pose(x, y, heading)
    place, here = points(ROOM, HERE), points(ROOM, true)
    here = here + np.random.default_rng(seed).normal(0.0, 0.01, here.shape)
    away_m, turned_rad = off(align(place, here, Pose(0.0, 0.0, heading + guessed)), true)
    assert away_m < 0.05
    assert turned_rad < 0.03


def test_along_a_bare_corridor_the_guess_stays() -> None:
    true = Pose(0.3, 0.2, 0.1)
    found = align(points(corridor(1.0), HERE), points(corridor(1.0), true), HERE)
    assert found is not None
    assert found.x_m == pytest.approx(0.0, abs=0.05)  # nothing tells
    assert found.y_m == pytest.approx(0.2, abs=0.02)
    assert found.heading_rad == pytest.approx(0.1, abs=0.02)


def test_two_places_do_not_fit() -> None:
    assert align(points(ROOM, HERE), points(HALL, HERE), HERE) is None


def test_somebody_who_stands_there_does_not_matter() -> None:
    person: Line = [(1.0, 0.2), (1.2, 0.5), (1.4, 0.2), (1.0, 0.2)]
    true = Pose(0.2, -0.1, 0.05)
    away_m, turned_rad = off(
        align(points(ROOM, HERE), points([*ROOM, person], true), HERE), true
    )
    assert away_m < 0.05
    assert turned_rad < 0.03


def test_too_few_points_tell_nothing() -> None:
    assert align(points(ROOM, HERE)[:20], points(ROOM, HERE), HERE) is None
    assert align(points(ROOM, HERE), np.empty((0, 2)), HERE) is None


def action(kind: Action, target: int, relative_rad: float = 0.0) -> MapAction:
    return MapAction(kind, 0, target, target, relative_rad, Place(0.0, 0.0, 0.0))


def there(scans: ScanMatcher, tick: int, done: MapAction) -> Pose | None:
    """Return what the scans say of the action's experience."""
    return scans.locate(tick * TICK_NS, done, -1, HERE).from_target


def drive(
    scans: ScanMatcher, walls: list[Line], start: Pose, tick: int, ticks: int,
    still: bool = False,
) -> tuple[Pose, int]:  # fmt: skip
    """Drive on a curve, with odometry at each tick and a scan between them; return where."""
    motion = Motion(0.1, 0.0, 0.0) if still else Motion(0.1, 0.05, 0.06)
    pose = start
    for _ in range(ticks):
        half = composed(pose, Pose(motion.distance_m / 2, 0.0, motion.turn_rad / 2))
        scans.scan(scan_in(walls, half, tick * TICK_NS + TICK_NS // 2, beams=181))
        tick += 1
        pose = composed(pose, Pose(motion.distance_m, 0.0, motion.turn_rad))
        scans.integrate(tick * TICK_NS, motion)
    return pose, tick


def test_a_scan_is_moved_to_where_the_action_is() -> None:
    scans = ScanMatcher()
    made_at, tick = drive(scans, ROOM, HERE, 0, 5)
    told = scans.locate(tick * TICK_NS, action('create', 0), -1, HERE)
    assert told == ScanMatch(fits=told.fits)
    seen_at, tick = drive(scans, ROOM, Pose(-0.1, 0.2, 0.1), tick, 5)
    found = there(scans, tick, action('link', 0, 0.1))
    away_m, turned_rad = off(found, composed(inverse(made_at), seen_at))
    assert away_m < 0.03
    assert turned_rad < 0.02


def test_the_frame_of_an_experience_is_turned_as_its_view_was() -> None:
    scans = ScanMatcher()
    _, tick = drive(scans, ROOM, HERE, 0, 4, still=True)
    there(scans, tick, action('create', 0, 0.15))
    _, tick = drive(scans, ROOM, HERE, tick, 4, still=True)
    away_m, turned_rad = off(
        there(scans, tick, action('link', 0, 0.1)), Pose(0.0, 0.0, 0.15)
    )
    assert away_m < 0.01
    assert turned_rad < 0.01


def test_without_a_fresh_scan_nothing_is_told() -> None:
    scans = ScanMatcher()
    there(scans, 0, action('create', 0))
    _, tick = drive(scans, ROOM, HERE, 0, 4, still=True)
    assert there(scans, tick, action('link', 0)) is None  # made without one
    there(scans, tick, action('create', 1))
    assert there(scans, tick, action('link', 1)) is not None
    assert there(scans, tick, action('none', 1)) is None
    assert there(scans, tick + 10, action('link', 1)) is None
    scans.restart()
    assert there(scans, tick, action('link', 1)) is None


def known_in_a_corridor(scans: ScanMatcher, metres: float) -> int:
    """Be at a known place in a bare corridor, and drive on for some metres; return the tick."""
    _, tick = drive(scans, corridor(1.0), HERE, 0, 4, still=True)
    there(scans, tick, action('create', 0))
    for n in range(1, 40):  # long enough there for the map to be sure
        scans.locate(tick * TICK_NS, action('link', 0), n, HERE, HERE)
    scans.integrate(tick * TICK_NS, Motion(0.1, metres, 0.0))
    _, tick = drive(scans, corridor(1.0), HERE, tick, 4, still=True)
    return tick


@pytest.mark.parametrize(
    ('metres', 'expected_m', 'least_m', 'most_m'),
    [
        (1.0, 0.6, 0.45, 0.6),  # it was at a known place just now
        (100.0, 0.6, 0.1, 0.3),  # long ago
        (1.0, 4.0, -0.05, 0.05),  # the map is wrong
    ],
)
def test_along_a_bare_corridor_view_and_map_tell_together(
    metres: float, expected_m: float, least_m: float, most_m: float
) -> None:
    scans = ScanMatcher()
    tick = known_in_a_corridor(scans, metres)
    expected = Pose(expected_m, 0.0, 0.0)
    found = scans.locate(tick * TICK_NS, action('link', 0), -1, HERE, expected).from_target
    assert found is not None
    assert least_m <= found.x_m <= most_m


def test_what_the_map_refused_tells_nothing_of_how_sure_it_is() -> None:
    found = []
    for undo_last in (False, True):
        scans = ScanMatcher()
        tick = known_in_a_corridor(scans, 300.0)
        if undo_last:
            scans.locate(tick * TICK_NS, action('link', 0), -1, HERE, Pose(50.0, 0.0, 0.0))
            scans.undo_last()
        expected = Pose(0.6, 0.0, 0.0)
        match = scans.locate(tick * TICK_NS, action('link', 0), -1, HERE, expected)
        found.append(match.from_target)
    assert found[0] is not None
    assert found[0] == found[1]


@pytest.mark.parametrize(
    ('metres', 'expected', 'least_m', 'most_m'),
    [
        (1.0, Pose(0.6, 0.0, 0.1), 0.45, 0.6),
        (100.0, Pose(0.6, 0.0, 0.1), 0.1, 0.3),
        (1.0, Pose(4.0, 0.0, 0.1), math.nan, math.nan),
        (1.0, Pose(0.6, 0.0, 1.5), math.nan, math.nan),
    ],
)
def test_where_scans_do_not_fit_view_and_map_tell_where_it_is(
    metres: float, expected: Pose, least_m: float, most_m: float
) -> None:
    """A view from a metre before its place does not carry a robot there that knows where it is."""
    scans = ScanMatcher()
    tick = known_in_a_corridor(scans, metres)
    _, tick = drive(scans, HALL, HERE, tick, 4, still=True)
    found = scans.locate(tick * TICK_NS, action('link', 0), -1, HERE, expected).from_target
    if math.isnan(least_m):
        assert found is None
    else:
        assert found is not None
        assert least_m <= found.x_m <= most_m
        assert 0.0 < found.heading_rad <= 0.1
    later_ns = (tick + 10) * TICK_NS
    assert scans.locate(later_ns, action('link', 0), -1, HERE, expected) == ScanMatch()


def test_a_view_that_nothing_confirms_leaves_the_map_unsure() -> None:
    scans = ScanMatcher()
    tick = known_in_a_corridor(scans, 0.0)
    assert scans.locate((tick + 10) * TICK_NS, action('link', 0), -1, HERE) == ScanMatch()
    _, tick = drive(scans, corridor(1.0), HERE, tick + 10, 4, still=True)
    expected = Pose(0.6, 0.0, 0.0)
    found = scans.locate(tick * TICK_NS, action('link', 0), -1, HERE, expected).from_target
    assert found is not None
    assert 0.2 < found.x_m < 0.4


def test_a_robot_that_was_carried_believes_the_view() -> None:
    scans = ScanMatcher()
    tick = known_in_a_corridor(scans, 0.0)
    scans.restart()
    _, tick = drive(scans, corridor(1.0), HERE, tick, 4, still=True)
    expected = Pose(0.6, 0.0, 0.0)
    found = scans.locate(tick * TICK_NS, action('link', 0), -1, HERE, expected).from_target
    assert found is not None
    assert abs(found.x_m) < 0.05


def test_the_way_from_the_last_experience_is_told_too() -> None:
    scans = ScanMatcher()
    made_at, tick = drive(scans, ROOM, HERE, 0, 5)
    there(scans, tick, action('create', 0))
    here, tick = drive(scans, ROOM, made_at, tick, 5)
    true = composed(inverse(made_at), here)
    slipped = Pose(true.x_m + 0.02, true.y_m, true.heading_rad + 0.1)
    found = scans.locate(tick * TICK_NS, action('create', 1), 0, slipped)
    assert found.from_target is None
    away_m, turned_rad = off(found.from_current, true)
    assert away_m < 0.02
    assert turned_rad < 0.01


def test_a_number_that_means_another_place_has_its_scan() -> None:
    scans = ScanMatcher()
    _, tick = drive(scans, HALL, HERE, 0, 4, still=True)
    there(scans, tick, action('create', 0))
    _, tick = drive(scans, ROOM, HERE, tick, 4, still=True)
    assert there(scans, tick, action('link', 0)) is None
    there(scans, tick, action('create', 0))
    assert there(scans, tick, action('set', 0)) is not None


def test_what_is_kept_survives() -> None:
    scans = ScanMatcher()
    _, tick = drive(scans, ROOM, HERE, 0, 4, still=True)
    there(scans, tick, action('create', 0))
    _, tick = drive(scans, HALL, HERE, tick, 4, still=True)
    there(scans, tick, action('create', 7))
    again = ScanMatcher()
    again.restore(scans.state())
    ends = []
    for one in (scans, again):
        one.restart()
        pose, end = drive(one, HALL, Pose(0.1, 0.1, 0.1), tick, 4, still=True)
        ends.append(there(one, end, action('link', 7)))
    assert ends[0] == ends[1]
    assert off(ends[0], pose)[0] < 0.03
    empty = ScanMatcher()
    empty.restore(ScanMatcher().state())
    assert there(empty, 0, action('link', 0)) is None


def fits(walls: list[Line], then: list[Line], wrong_m: float = 0.0) -> bool:
    """Whether what is seen in ``then`` fits a place in ``walls``, said to be so far from it."""
    scans = ScanMatcher()
    made_at, tick = drive(scans, walls, HERE, 0, 5)
    scans.locate(tick * TICK_NS, action('create', 0), -1, HERE)
    seen_at, tick = drive(scans, then, Pose(-0.1, 0.2, 0.1), tick, 5)
    said = composed(inverse(made_at), seen_at)
    told = scans.locate(tick * TICK_NS, action('link', 5), 5, HERE).fits
    assert told is not None
    return told(0, said._replace(x_m=said.x_m + wrong_m))


def test_a_scan_tells_whether_the_robot_is_where_it_believes_to_be() -> None:
    assert fits(ROOM, ROOM)
    assert fits(ROOM, ROOM, 0.2)
    assert not fits(ROOM, ROOM, 1.0)
    assert not fits(ROOM, HALL)


def test_along_a_bare_corridor_no_scan_tells_that() -> None:
    assert not fits(corridor(1.0), corridor(1.0))


def test_nothing_tells_it_without_a_scan_or_of_a_place_without() -> None:
    scans = ScanMatcher()
    assert scans.locate(0, action('link', 0), 0, HERE).fits is None
    _, tick = drive(scans, ROOM, HERE, 0, 4, still=True)
    told = scans.locate(tick * TICK_NS, action('link', 0), 0, HERE).fits
    assert told is not None
    assert not told(0, HERE)


def test_scans_that_begin_again_are_those_of_now() -> None:
    scans = ScanMatcher()
    _, tick = drive(scans, ROOM, HERE, 50, 4, still=True)
    there(scans, tick, action('create', 0))
    _, tick = drive(scans, HALL, HERE, 0, 4, still=True)
    assert there(scans, tick, action('link', 0)) is None


def test_the_map_takes_what_the_scans_tell() -> None:
    place = Place(0.0, 0.0, 0.0)
    graph = ExperienceMap(ExperienceMapParameters(exp_initial_em_deg=0.0))
    graph.apply(MapAction('create', NO_EXPERIENCE, 0, 0, 0.0, place))
    graph.integrate(Motion(1.0, 1.0, 0.0))
    graph.apply(MapAction('create', 0, 1, 1, 0.0, place))
    graph.integrate(Motion(1.0, -0.8, 0.0))
    scan_match = ScanMatch(Pose(-0.9, 0.0, 0.0), Pose(0.1, 0.0, 0.0))
    graph.apply(MapAction('link', 1, 0, 0, 0.0, place), scan_match=scan_match)
    assert graph.pose == pytest.approx((0.1, 0.0, 0.0))
    assert graph.link_shapes[1] == pytest.approx((1.0, math.pi, 0.0))  # no contradiction
    graph.settle()
    assert graph.poses == pytest.approx(np.array([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0]]))
