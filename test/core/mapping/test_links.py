# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Links: the geometry and duration of transitions, and the rows that store them."""

from __future__ import annotations

import math
import random

import numpy as np
import pytest
from graphs import arrive, drive, go, new_map, pose_is_near
from helpers import ahead, turning
from hypothesis import given
from hypothesis import strategies as st

from ratslam_ros.core.common.angles import wrap
from ratslam_ros.core.common.odometry import Motion
from ratslam_ros.core.common.pose import Pose, composed, inverse
from ratslam_ros.core.common.turn_correction import TurnCorrection
from ratslam_ros.core.mapping.experience_map import ExperienceMap
from ratslam_ros.core.mapping.links import Link, Links
from ratslam_ros.core.pose_cells.map_action import MapAction
from ratslam_ros.core.pose_cells.torus import Place


def unrelaxed_map(heading_deg: float = 0.0) -> ExperienceMap:
    return new_map(exp_loops=0, exp_initial_em_deg=heading_deg)


def angles_are_near(link: Link, heading_rad: float, facing_rad: float) -> bool:
    return (
        abs(wrap(link.heading_rad - heading_rad)) < 1e-12
        and abs(wrap(link.facing_rad - facing_rad)) < 1e-12
    )


# Links of transitions


def test_link_stores_geometry_duration_and_behaviour() -> None:
    graph = unrelaxed_map(35.0)
    arrive(graph, 0)
    drive(graph, turning(math.pi / 2, 0.5), ahead(3.0, 2.0), turning(-0.2, 0.25))
    arrive(graph, 1, behaviour='left wall')
    (link,) = graph.links()
    assert (link.source_id, link.target_id, link.count) == (0, 1, 1)
    assert link.distance_m == pytest.approx(3.0)
    assert angles_are_near(link, math.pi / 2, math.pi / 2 - 0.2)
    assert link.duration_s == pytest.approx(2.75)
    assert link.behaviour == 'left wall'


def test_link_duration_restarts_at_each_transition() -> None:
    """In OpenRatSLAM it never restarts: each link lasts as long as the drive until then."""
    graph = unrelaxed_map()
    go(graph, 0, ahead(1.0, 7.0))
    for target, dt_s in enumerate([1.0, 2.0, 0.5], 1):
        go(graph, target, ahead(1.0, dt_s))
    go(graph, 2, ahead(-1.0, 4.0))
    assert [link.duration_s for link in graph.links()] == pytest.approx([1.0, 2.0, 0.5, 4.0])


def test_repeated_transition_averages_link_in_polar_form() -> None:
    """Equation (6): half the difference, and the shorter difference of angles."""
    graph = unrelaxed_map()
    arrive(graph, 0)
    go(graph, 1, turning(3.1, 0.0), ahead(2.0, 1.0))
    go(graph, 0, ahead(-2.0, 1.0))
    go(graph, 1, turning(-3.1, 0.0), ahead(4.0, 3.0))
    out, back = graph.links()
    assert out.count == 2
    assert back.count == 1
    assert out.distance_m == pytest.approx(3.0)
    assert angles_are_near(out, math.pi, math.pi)
    assert out.duration_s == pytest.approx(2.0)
    # The third transition is averaged with the link, not with all transitions.
    go(graph, 0, ahead(1.0))
    go(graph, 1, turning(math.pi - 0.4, 0.0), ahead(5.0, 8.0))
    out = graph.links()[0]
    assert out.count == 3
    assert out.distance_m == pytest.approx(4.0)
    assert angles_are_near(out, math.pi - 0.2, math.pi - 0.2)
    assert out.duration_s == pytest.approx(5.0)


@given(st.floats(-3.1, 3.1), st.floats(-3.1, 3.1), st.floats(0.1, 5.0))
def test_link_facing_excludes_the_relative_heading(
    turn: float, relative_rad: float, distance: float
) -> None:
    """Facing is the turn minus the relative heading, and the relative heading is the offset."""
    graph = unrelaxed_map()
    arrive(graph, 0)
    drive(graph, turning(turn), ahead(distance))
    robot = graph.pose
    arrive(graph, 1, relative_rad)
    (link,) = graph.links()
    assert angles_are_near(link, turn, turn - relative_rad)
    assert graph.offset == Pose(0.0, 0.0, relative_rad)
    assert pose_is_near(graph.pose, *robot, 1e-9)


def test_repetition_without_behaviour_keeps_the_known_behaviour() -> None:
    graph = unrelaxed_map()
    arrive(graph, 0)
    go(graph, 1, ahead(1.0), behaviour='wander')
    go(graph, 0, ahead(-1.0))
    go(graph, 1, ahead(1.0))
    assert [k.behaviour for k in graph.links()] == ['wander', '']


# Rows


def random_link(rng: random.Random, source: int, target: int) -> Link:
    return Link(
        source, target, rng.uniform(0.1, 3.0), rng.uniform(-3.0, 3.0), rng.uniform(-3.0, 3.0),
        rng.uniform(0.1, 9.0), rng.choice(['', 'left_wall']), rng.randrange(1, 9),
    )


def test_link_rows_follow_additions_and_deletions() -> None:
    """Rows against a plain list, before and after the links are restored."""
    rng = random.Random(1)
    links, expected, highest = Links(), list[Link](), 0
    for _ in range(400):
        if expected and rng.random() < 0.05:
            rows = rng.sample(range(len(expected)), rng.randint(1, 1 + len(expected) // 4))
            links.delete(rows)
            expected = [link for row, link in enumerate(expected) if row not in rows]
        else:
            source, target = rng.sample(range(40), 2)
            if links.row(source, target) is None:
                expected.append(random_link(rng, source, target))
                links.append(expected[-1])
        highest = max(highest, len(expected))
        copy = Links()
        copy.restore(links.state())
        for one in (links, copy):
            assert [one[row] for row in range(len(one))] == expected
            assert [one.row(k.source_id, k.target_id) for k in expected] == [
                *range(len(expected))
            ]
            assert one.rows_at(3) == [
                row for row, k in enumerate(expected) if 3 in (k.source_id, k.target_id)
            ]
            assert one.rows_by(3, '').tolist() == [
                row for row, k in enumerate(expected) if (k.source_id, k.behaviour) == (3, '')
            ]
    assert highest > 64  # the initial capacity


def test_link_reversed_twice_is_the_same() -> None:
    link = Link(3, 5, 2.0, 0.4, -1.1, 7.0, 'left_wall', 4)
    back = link.reversed()
    assert (back.source_id, back.target_id, back.distance_m) == (5, 3, 2.0)
    again = back.reversed()
    assert (again.source_id, again.target_id) == (3, 5)
    assert again.relative_pose == pytest.approx(link.relative_pose)


@pytest.mark.parametrize(
    ('driven', 'expected'),
    [
        ([(0, 1), (1, 2)], [(0, 2)]),
        ([(2, 1), (1, 0)], [(2, 0)]),
        ([(0, 1), (1, 2), (2, 1), (1, 0)], [(0, 2), (2, 0)]),
        ([(1, 0), (1, 2)], [(0, 2)]),  # no path was driven throughout
        ([(0, 1), (1, 2), (2, 0)], []),  # linked already
    ],
)
def test_bypass_links_neighbours_in_driven_directions(
    driven: list[tuple[int, int]], expected: list[tuple[int, int]]
) -> None:
    x_m = [0.0, 1.0, 3.0]
    links = Links()
    for i, j in driven:
        heading_rad = 0.0 if x_m[j] > x_m[i] else math.pi
        links.append(Link(i, j, abs(x_m[j] - x_m[i]), heading_rad, 0.0, 1.0, '', 1))
    links.bypass(1)
    added = [links[row] for row in range(len(driven), len(links))]
    assert [(k.source_id, k.target_id) for k in added] == expected
    for link in added:
        assert link.relative_pose == pytest.approx(
            (x_m[link.target_id] - x_m[link.source_id], 0.0, 0.0), abs=1e-12
        )
        assert link.duration_s == 2.0
    assert np.array_equal(links.failures, np.zeros((len(links), 2)))


# Corrected turns


def test_corrected_map_is_that_of_corrected_odometry() -> None:
    """Links and the robot's pose; a link is an arc of constant curvature."""
    def driven(correction: TurnCorrection) -> ExperienceMap:
        graph = unrelaxed_map(20.0)
        for n in range(8):
            arrive(graph, n)
            drive(graph, Motion(1.0, 0.5, correction.corrected(0.12 - 0.03 * n, 0.5)))
        return graph

    before, now = TurnCorrection(0.9, 0.01), TurnCorrection(2.3, -0.02)
    graph, expected = driven(before), driven(now)
    graph.correct_turns(before, now)
    for found, right in zip(graph.links(), expected.links(), strict=True):
        assert abs(wrap(found.facing_rad - right.facing_rad)) < 2e-3
        assert abs(wrap(found.heading_rad - right.heading_rad)) < 1e-3
    assert np.abs(graph.poses - expected.poses).max() < 0.02
    assert np.abs(np.array(graph.pose) - np.array(expected.pose)).max() < 0.02


def test_experience_with_the_id_of_a_pruned_one_is_corrected_like_the_others() -> None:
    graph = unrelaxed_map()
    for n in (0, 1, 2, 3, 4, 1, 5):
        graph.apply(MapAction('create', graph.current_id, n, n, 0.0, Place(0.0, 0.0, 0.0)))
        drive(graph, Motion(1.0, 0.5, 0.1))
    graph.correct_turns(TurnCorrection(), TurnCorrection(2.0, 0.0))
    for source, target in ((3, 4), (4, 1), (1, 5)):
        x_m, y_m, turn_rad = composed(inverse(graph.pose_of(source)), graph.pose_of(target))
        assert math.hypot(x_m, y_m) == pytest.approx(0.5, abs=0.01)
        assert wrap(turn_rad) == pytest.approx(0.2)


def test_links_measured_by_scans_are_not_corrected() -> None:
    graph = new_map(exp_align_scans=True)
    for n in range(3):
        arrive(graph, n)
        drive(graph, Motion(1.0, 0.5, 0.1))
    before = graph.links()
    graph.correct_turns(TurnCorrection(), TurnCorrection(2.0, 0.0))
    assert graph.links() == before
