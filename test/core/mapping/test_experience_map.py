# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Links are what was driven, and relaxation spreads what does not fit."""

import math

import numpy as np
import pytest
from helpers import ahead, restored, turning
from hypothesis import given, settings
from hypothesis import strategies as st

from ratslam_ros.core.common.angles import wrap
from ratslam_ros.core.common.odometry import Motion, moved
from ratslam_ros.core.common.pose import Pose, composed
from ratslam_ros.core.config import ExperienceMapParameters
from ratslam_ros.core.mapping.experience_map import ExperienceMap, Link
from ratslam_ros.core.pose_cells.map_action import MapAction
from ratslam_ros.core.pose_cells.torus import Place

NONE = MapAction('none', 0, 0, 0, 0.0, Place(0.0, 0.0, 0.0))


def new_map(loops: int = 0, correction: float = 0.5, heading_deg: float = 0.0) -> ExperienceMap:
    return ExperienceMap(ExperienceMapParameters(
        exp_loops=loops, exp_correction=correction, exp_initial_em_deg=heading_deg,
    ))  # fmt: skip


def arrive(
    graph: ExperienceMap, target: int, relative_rad: float = 0.0, behaviour: str = ''
) -> None:
    """Let the map create the target if it is new, or go to it."""
    action = 'create' if target == len(graph) else 'link'
    place = Place(float(target), 0.0, 0.0)
    graph.apply(
        MapAction(action, graph.current_id, target, 10 + target, relative_rad, place), behaviour
    )


def drive(graph: ExperienceMap, *motions: Motion) -> None:
    for motion in motions:
        graph.integrate(motion)


def near(pose: Pose, x: float, y: float, heading: float, tolerance: float = 1e-12) -> bool:
    return (
        math.hypot(pose.x_m - x, pose.y_m - y) < tolerance
        and abs(wrap(pose.heading_rad - heading)) < tolerance
    )


def angles_fit(link: Link, heading: float, facing: float) -> bool:
    return (
        abs(wrap(link.heading_rad - heading)) < 1e-12
        and abs(wrap(link.facing_rad - facing)) < 1e-12
    )


# The first experience


def test_motion_before_the_first_experience_counts_once() -> None:
    """The original counts it twice."""
    graph = new_map(heading_deg=90.0)
    drive(graph, ahead(2.0), turning(-math.pi / 2), ahead(1.0))
    before = graph.pose
    assert near(before, 1.0, 2.0, 0.0)
    arrive(graph, 0)
    assert near(graph.pose_of(0), 1.0, 2.0, 0.0)
    assert near(graph.pose, *before)
    drive(graph, ahead(1.0))
    assert near(graph.pose, 2.0, 2.0, 0.0)


@pytest.mark.parametrize('relative_rad', [0.0, 0.8, -3.0])
def test_the_pose_is_continuous_when_an_experience_is_created(relative_rad: float) -> None:
    graph = new_map()
    drive(graph, ahead(1.0), turning(0.5))
    for number in range(4):
        before = graph.pose
        arrive(graph, number, relative_rad)
        assert near(graph.pose, *before)
        assert near(graph.pose_of(number), before.x_m, before.y_m,
                    before.heading_rad - relative_rad)  # fmt: skip
        drive(graph, turning(0.4), ahead(1.0))


def test_the_map_starts_at_the_initial_heading() -> None:
    assert near(new_map(heading_deg=140.0).pose, 0.0, 0.0, math.radians(140.0))
    assert near(new_map(heading_deg=-270.0).pose, 0.0, 0.0, math.pi / 2)


def test_the_first_experience_has_no_link() -> None:
    graph = new_map()
    arrive(graph, 0)
    assert graph.link_count == 0
    assert len(graph) == 1


# Links


def test_a_link_tells_distance_direction_turn_and_time() -> None:
    graph = new_map(heading_deg=35.0)
    arrive(graph, 0)
    drive(graph, turning(math.pi / 2, 0.5), ahead(3.0, 2.0), turning(-0.2, 0.25))
    arrive(graph, 1, behaviour='left wall')
    (link,) = graph.links()
    assert (link.source_id, link.target_id, link.count) == (0, 1, 1)
    assert link.distance_m == pytest.approx(3.0)
    assert angles_fit(link, math.pi / 2, math.pi / 2 - 0.2)
    assert link.duration_s == pytest.approx(2.75)
    assert link.behaviour == 'left wall'


def test_durations_restart_when_the_current_experience_changes() -> None:
    """The original never restarts them: every link takes as long as the whole drive so far."""
    graph = new_map()
    drive(graph, ahead(1.0, 7.0))
    arrive(graph, 0)
    for number, dt_s in enumerate([1.0, 2.0, 0.5], 1):
        drive(graph, ahead(1.0, dt_s))
        arrive(graph, number)
    drive(graph, ahead(-1.0, 4.0))
    arrive(graph, 2)
    assert [link.duration_s for link in graph.links()] == pytest.approx([1.0, 2.0, 0.5, 4.0])


def test_actions_of_none_let_motion_and_time_go_on() -> None:
    graph = new_map()
    arrive(graph, 0)
    for _ in range(3):
        drive(graph, ahead(0.5, 0.2))
        graph.apply(NONE)
    arrive(graph, 1)
    (link,) = graph.links()
    assert link.distance_m == pytest.approx(1.5)
    assert link.duration_s == pytest.approx(0.6)


def test_a_repeated_transition_averages_the_link_in_polar_form() -> None:
    """Equation (6): half the difference, angles the short way across half a turn."""
    graph = new_map()
    arrive(graph, 0)
    drive(graph, turning(3.1, 0.0), ahead(2.0, 1.0))
    arrive(graph, 1)
    drive(graph, ahead(-2.0, 1.0))
    arrive(graph, 0)
    drive(graph, turning(-3.1, 0.0), ahead(4.0, 3.0))
    arrive(graph, 1)
    out, back = graph.links()
    assert out.count == 2
    assert back.count == 1
    assert out.distance_m == pytest.approx(3.0)
    assert angles_fit(out, math.pi, math.pi)
    assert out.duration_s == pytest.approx(2.0)
    # A third time: the mean of old and new, not of all three.
    drive(graph, ahead(1.0))
    arrive(graph, 0)
    drive(graph, turning(math.pi - 0.4, 0.0), ahead(5.0, 8.0))
    arrive(graph, 1)
    out = graph.links()[0]
    assert out.count == 3
    assert out.distance_m == pytest.approx(4.0)
    assert angles_fit(out, math.pi - 0.2, math.pi - 0.2)
    assert out.duration_s == pytest.approx(5.0)


def test_there_and_back_are_two_links() -> None:
    graph = new_map()
    arrive(graph, 0)
    drive(graph, ahead(1.0))
    arrive(graph, 1)
    drive(graph, turning(math.pi), ahead(1.0))
    arrive(graph, 0, math.pi)
    assert [(k.source_id, k.target_id) for k in graph.links()] == [(0, 1), (1, 0)]
    back = graph.links()[1]
    assert angles_fit(back, math.pi, 0.0)


@given(st.floats(-3.1, 3.1), st.floats(-3.1, 3.1), st.floats(0.1, 5.0))
def test_arriving_at_a_relative_heading_faces_the_experience_not_the_robot(
    turn: float, relative_rad: float, distance: float
) -> None:
    """Facing is the turn less the relative heading, from which the motion restarts."""
    graph = new_map()
    arrive(graph, 0)
    drive(graph, turning(turn), ahead(distance))
    robot = graph.pose
    arrive(graph, 1, relative_rad)
    (link,) = graph.links()
    assert angles_fit(link, turn, turn - relative_rad)
    assert graph.offset == Pose(0.0, 0.0, relative_rad)
    assert near(graph.pose, *robot, 1e-9)


def test_a_behaviour_once_known_is_kept_when_the_next_has_none() -> None:
    graph = new_map()
    arrive(graph, 0)
    drive(graph, ahead(1.0))
    arrive(graph, 1, behaviour='wander')
    drive(graph, ahead(-1.0))
    arrive(graph, 0)
    drive(graph, ahead(1.0))
    arrive(graph, 1)
    assert [k.behaviour for k in graph.links()] == ['wander', '']


def test_more_experiences_and_links_than_were_foreseen_are_kept() -> None:
    graph = new_map()
    for number in range(300):
        arrive(graph, number)
        drive(graph, ahead(1.0))
    assert len(graph) == len(graph.experiences()) == 300
    assert graph.link_count == len(graph.links()) == 299
    assert near(graph.pose_of(299), 299.0, 0.0, 0.0, 1e-9)
    assert graph.experiences()[123].template_id == 133
    assert graph.experiences()[123].place == Place(123.0, 0.0, 0.0)


# The pose between experiences


def test_motion_since_the_experience_turns_with_it() -> None:
    """The original leaves it where it was when relaxation turns the current experience."""
    graph = new_map(loops=0)
    arrive(graph, 0)
    drive(graph, ahead(1.0))
    arrive(graph, 1)
    drive(graph, turning(1.0), ahead(1.0))
    arrive(graph, 0)  # wrong odometry: nothing fits
    drive(graph, ahead(1.0))
    arrive(graph, 1)
    drive(graph, ahead(2.0), turning(0.3))
    graph = restored(graph, ExperienceMapParameters(exp_relaxation='sweep', exp_loops=30))
    base = graph.pose_of(1)
    graph.apply(NONE)
    turned = graph.pose_of(1)
    assert abs(wrap(turned.heading_rad - base.heading_rad)) > 0.1
    assert near(graph.pose, *composed(turned, Pose(2.0, 0.0, 0.3)))
    assert near(graph.pose, turned.x_m + 2.0 * math.cos(turned.heading_rad),
                turned.y_m + 2.0 * math.sin(turned.heading_rad),
                turned.heading_rad + 0.3)  # fmt: skip


def test_the_pose_is_exact_between_experiences() -> None:
    graph = new_map(heading_deg=20.0)
    truth = graph.pose
    for step in range(500):
        motion = Motion(0.1, 0.05, 0.3 * math.sin(0.05 * step))
        truth = moved(truth, motion)
        drive(graph, motion)
        if step % 20 == 0:
            arrive(graph, len(graph))
        assert near(graph.pose, *truth, 1e-9)


# Relaxation


def polygon(
    sides: int, turn: float, loops: int, correction: float = 0.5, laps: int = 1
) -> ExperienceMap:
    """Drive a polygon with a turn at each corner and close it at experience 0."""
    graph = new_map(loops, correction)
    arrive(graph, 0)
    for side in range(1, laps * sides + 1):
        drive(graph, ahead(1.0), turning(turn))
        arrive(graph, side % sides)
    return graph


@pytest.mark.parametrize('sides', [3, 4, 7, 12])
@pytest.mark.parametrize('sense', [1.0, -1.0])
@pytest.mark.parametrize('correction', [0.1, 0.5])
def test_a_loop_that_fits_is_left_as_it_is(sides: int, sense: float, correction: float) -> None:
    turn = sense * 2.0 * math.pi / sides
    unrelaxed, relaxed = (polygon(sides, turn, loops, correction) for loops in (0, 50))
    assert np.abs(unrelaxed.poses - relaxed.poses).max() < 1e-9
    assert np.hypot(*np.diff(relaxed.poses[:, :2], axis=0).T) == pytest.approx(1.0)


def test_experience_0_never_moves() -> None:
    graph = polygon(6, 2.0 * math.pi / 6 + 0.1, 40, laps=3)
    assert graph.poses[0].tolist() == [0.0, 0.0, 0.0]
    started = new_map(5, heading_deg=90.0)
    drive(started, ahead(3.0))
    arrive(started, 0)
    for target in (1, 2, 0, 2, 1, 0):
        drive(started, ahead(1.0), turning(0.7))
        arrive(started, target)
    assert near(started.pose_of(0), 0.0, 3.0, math.pi / 2)


def errors(graph: ExperienceMap) -> np.ndarray:
    """Return (links, 3): how much each link disagrees with the poses."""
    out = []
    for link in graph.links():
        i, j = graph.pose_of(link.source_id), graph.pose_of(link.target_id)
        end = composed(i, Pose(
            link.distance_m * math.cos(link.heading_rad),
            link.distance_m * math.sin(link.heading_rad), link.facing_rad,
        ))  # fmt: skip
        out.append((j.x_m - end.x_m, j.y_m - end.y_m, wrap(j.heading_rad - end.heading_rad)))
    return np.array(out)


def test_the_error_of_a_loop_is_spread_over_its_links() -> None:
    before = errors(polygon(12, 2.0 * math.pi / 12 + 0.03, 0))
    assert np.abs(before[:-1]).max() < 1e-9
    assert abs(before[-1, 2]) == pytest.approx(12 * 0.03)
    graph = polygon(12, 2.0 * math.pi / 12 + 0.03, 0)
    graph = restored(graph, ExperienceMapParameters(exp_relaxation='sweep', exp_loops=100))
    for _ in range(20):
        graph.apply(NONE)
    after = errors(graph)
    assert np.abs(after[:, 2]).max() < 0.2 * abs(before[-1, 2])
    assert np.hypot(*after[:, :2].T).max() < 0.3 * np.hypot(*before[-1, :2])
    assert (np.abs(after[:, 2]) > 1e-3).sum() >= 10


def test_relaxation_ends_where_equation_7_is_zero() -> None:
    """With small corrections: the least squares of the headings, an equal share a link."""
    graph = polygon(8, 2.0 * math.pi / 8 + 0.02, 0)
    sweeping = ExperienceMapParameters(
        exp_relaxation='sweep', exp_loops=10_000, exp_correction=0.002
    )
    graph = restored(graph, sweeping)
    for _ in range(3):
        graph.apply(NONE)
    e = errors(graph)
    assert e[:, 2] == pytest.approx(np.full(8, e[:, 2].mean()), abs=2e-4)
    assert abs(e[:, 2].sum()) == pytest.approx(8 * 0.02, abs=1e-9)
    for axis in range(3):  # what comes in is what goes out, at all but the fixed experience
        for k in range(1, 8):
            assert e[k - 1, axis] == pytest.approx(e[k, axis], abs=1e-3)


@settings(max_examples=25)
@given(st.integers(0, 10_000), st.integers(3, 25))
def test_consistent_links_bring_a_disturbed_map_back(seed: int, number: int) -> None:
    """Headings across half a turn and links over each other; no number becomes NaN."""
    rng = np.random.default_rng(seed)
    graph = new_map(0)
    truth = Pose(0.0, 0.0, 0.0)
    poses = []
    for i in range(number):
        arrive(graph, i)
        poses.append(truth)
        motion = Motion(0.1, float(rng.uniform(0.2, 2.0)), float(rng.uniform(-3, 3)))
        drive(graph, motion)
        truth = moved(truth, motion)
    arrive(graph, number)
    expected = graph.poses
    disturbed = expected.copy()
    disturbed[1:] += rng.normal(scale=0.3, size=(number, 3))
    sweeping = ExperienceMapParameters(exp_relaxation='sweep', exp_loops=10_000)
    graph = restored(graph, sweeping, poses=disturbed)
    graph.apply(NONE)
    assert np.isfinite(graph.poses).all()
    assert (np.abs(graph.poses[:, 2]) <= math.pi).all()
    assert np.hypot(*(graph.poses - expected)[:, :2].T).max() < 0.02 * number
    assert max(abs(wrap(d)) for d in (graph.poses - expected)[:, 2]) < 0.01


def test_headings_across_half_a_turn_are_corrected_the_short_way() -> None:
    graph = new_map(0)
    arrive(graph, 0)
    drive(graph, turning(math.pi - 0.05), ahead(1.0))
    arrive(graph, 1)
    drive(graph, turning(math.pi - 0.05), ahead(1.0))  # 0.1 short of a full turn
    arrive(graph, 0)
    sweeping = ExperienceMapParameters(
        exp_relaxation='sweep', exp_loops=200, exp_correction=0.05
    )
    graph = restored(graph, sweeping)
    for _ in range(5):
        graph.apply(NONE)
    assert abs(wrap(graph.pose_of(1).heading_rad - math.pi)) < 0.01
    assert np.abs(errors(graph)[:, 2]).max() < 0.06


def test_with_no_sweeps_nothing_moves() -> None:
    graph = polygon(5, 1.0, 0)
    before = graph.poses
    graph.apply(NONE)
    assert np.array_equal(graph.poses, before)


def test_an_action_of_none_sweeps_too() -> None:
    graph = polygon(5, 1.0, 0)
    graph = restored(graph, ExperienceMapParameters(exp_relaxation='sweep', exp_loops=1))
    before = graph.poses
    graph.apply(NONE)
    assert not np.array_equal(graph.poses, before)


def test_the_poses_given_out_are_a_copy() -> None:
    graph = polygon(5, 1.0, 0)
    graph.poses[:] = 99.0
    assert graph.pose_of(0) == Pose(0.0, 0.0, 0.0)


@given(st.floats(-5, 5), st.floats(-5, 5), st.floats(-3, 3), st.floats(-5, 5), st.floats(-3, 3))
def test_composition_is_that_of_motions(
    x: float, y: float, heading: float, distance: float, turn: float
) -> None:
    base = Pose(x, y, heading)
    motion = Motion(0.1, distance, turn)
    end = moved(base, motion)
    assert near(composed(base, moved(Pose(0.0, 0.0, 0.0), motion)), *end, 1e-9)
