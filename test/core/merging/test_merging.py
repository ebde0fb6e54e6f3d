# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Merging maps of sessions that share places."""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from dataclasses import replace
from functools import cache
from typing import Any

import numpy as np
import pytest
from gap_drives import true_pose
from hypothesis import given, settings
from hypothesis import strategies as st
from shared_worlds import LAP, Robot, continued, size

from ratslam_ros.core.common.angles import wrap
from ratslam_ros.core.common.pose import Pose, composed, inverse
from ratslam_ros.core.common.rows import listed
from ratslam_ros.core.mapping.late_join import LateJoin
from ratslam_ros.core.merging.merge import MergedMap, merge_sessions
from ratslam_ros.core.merging.session import Session
from ratslam_ros.core.pose_cells.map_action import MapAction
from ratslam_ros.core.pose_cells.torus import Place, Torus
from ratslam_ros.errors import UnusableInput

VIEW_LINKS = {'pose_cells.exp_view_links': True}


def flat(value: Any) -> Any:
    """Return a state as nested tuples that can be compared."""
    if isinstance(value, dict):
        return tuple((key, flat(item)) for key, item in value.items())
    if isinstance(value, (list, tuple)):
        return tuple(flat(item) for item in value)
    if isinstance(value, np.ndarray):
        return value.dtype.str, value.shape, value.tobytes()
    return value


@cache
def robot(start: int, steps: int, floor: int = 1, noise: int = 1, links: bool = False) -> Robot:
    return Robot(start, floor, noise, **(VIEW_LINKS if links else {})).forward(steps)


def merged_of(*robots: Robot) -> MergedMap:
    return merge_sessions([one.session(f'session {i}') for i, one in enumerate(robots)])


def place_errors_m(merged: MergedMap, robots: Sequence[Robot], of: int) -> list[float]:
    """Return errors of distances between experiences of one session and those of the first.

    ``of``: number of a session in the order of the merge.
    """
    by_name = {f'session {i}': one for i, one in enumerate(robots)}
    poses = merged.states['experience_map']['core']['poses']

    def found(session: int, experience: int) -> Pose:
        own = Pose(*poses[merged.experience_ids[session][experience]].tolist())
        return composed(own, Pose(*merged.offsets[session][experience].tolist()))

    first, other = (by_name[merged.names[session]].places for session in (0, of))
    errors = []
    for (a, place), (b, other_place) in itertools.product(
        sorted(first.items())[::7], sorted(other.items())[::5]
    ):
        truth = composed(inverse(true_pose(place)), true_pose(other_place))
        at = composed(inverse(found(0, a)), found(of, b))
        errors.append(abs(math.hypot(at.x_m, at.y_m) - math.hypot(truth.x_m, truth.y_m)))
    return errors


@pytest.mark.parametrize('links', [False, True])
def test_sessions_on_one_track_become_one_map(links: bool) -> None:
    robots = robot(0, 100, links=links), robot(30, 100, noise=2, links=links)
    merged = merged_of(*robots)
    templates, experiences, components = size(merged)
    assert components == 1
    assert templates == LAP  # that of one session
    assert experiences <= 1.1 * max(merged.experiences)
    assert merged.joins[0].places > 30
    assert merged.joins[0].share > 0.9
    assert max(place_errors_m(merged, robots, 1)) < 0.6


def test_component_is_joined_through_another_session() -> None:
    first = Robot(0, noise=1).forward(30)
    first.carry(25)
    first.forward(18)
    assert first.slam.experience_map.component_count == 2
    merged = merged_of(first, robot(10, 65, noise=2))
    assert size(merged)[2] == 1


def test_other_floor_stays_a_component() -> None:
    merged = merged_of(robot(0, 100), robot(0, 100, floor=2))
    assert size(merged) == (160, sum(merged.experiences), 2)
    assert not any(join.refused == '' for join in merged.joins)


def test_floor_with_some_equal_views_is_refused() -> None:
    alike = Robot(0, noise=1, alike=8).forward(100)
    merged = merged_of(robot(0, 100), alike)
    assert size(merged)[2] == 2
    (join,) = merged.joins
    assert join.matched == 10
    assert join.refused.startswith('12 % of the 80 places')


def test_few_shared_places_are_refused() -> None:
    merged = merged_of(robot(0, 40), robot(37, 30, noise=2))
    (join,) = merged.joins
    assert join.refused == '2 places agree, but at least 6 are required'
    assert size(merged)[2] == 2


@settings(max_examples=4)
@given(st.permutations(range(4)))
def test_order_of_the_sessions_does_not_matter(order: list[int]) -> None:
    robots = robot(0, 60), robot(30, 60, noise=2), robot(0, 40, floor=2), robot(50, 50, noise=3)
    sessions = [one.session(f'{i}') for i, one in enumerate(robots)]
    expected = merge_sessions(sessions)
    merged = merge_sessions([sessions[i] for i in order])
    assert flat(merged.states) == flat(expected.states)
    assert merged.joins == expected.joins


@settings(max_examples=4)
@given(st.integers(0, LAP - 1), st.integers(2, 90), st.integers(1, 3))
def test_merging_a_map_with_itself_changes_nothing(start: int, steps: int, copies: int) -> None:
    session = Robot(start, noise=1).forward(steps).session('x')
    merged = merge_sessions([session, *[replace(session, name=f'{i}') for i in range(copies)]])
    assert flat(merged.states) == flat(session.states)


def test_merging_a_merged_map_changes_nothing() -> None:
    merged = merged_of(robot(0, 60), robot(30, 60, noise=2))
    one = Session('merged', merged.config, merged.states)
    assert flat(merge_sessions([one, one]).states) == flat(merged.states)


def test_merging_a_part_again_adds_nothing() -> None:
    robots = robot(0, 100, links=True), robot(30, 100, noise=2, links=True)
    merged = merged_of(*robots)
    again = merge_sessions([
        Session('merged', merged.config, merged.states), robots[1].session('again')
    ])
    assert size(again)[0] == size(merged)[0]
    assert size(again)[1] <= 1.02 * size(merged)[1]
    assert size(again)[2] == 1


def test_short_session_that_was_continued_is_recognised() -> None:
    one = Robot(0, noise=1).forward(3)
    short = one.session('short')
    merged = merge_sessions([short, one.forward(60).session('long')])
    assert size(merged)[:2] == (merged.templates[0], merged.experiences[0])
    assert size(merged)[2] == 1


@pytest.mark.parametrize('links', [False, True])
def test_robot_continues_on_the_merged_map(links: bool) -> None:
    robots = robot(0, 50, links=links), robot(35, 50, noise=2, links=links)
    merged = merged_of(*robots)
    slam = continued(merged)
    templates = len(slam.local_view)
    visitor = Robot.on(slam, start=20, noise=5)
    assert slam.experience_map.component_of(-1) != 0  # unknown at first
    visitor.forward(60)
    assert slam.experience_map.component_of(-1) == 0
    assert slam.experience_map.component_count == 1
    assert len(slam.local_view) == templates
    # From the second session, where the robot is now, back to a place of the first one.
    start = merged.names.index('session 0')
    experience = next(i for i, at in robots[0].places.items() if at == 10)
    goal = slam.experience_map.pose_of(int(merged.experience_ids[start][experience]))
    seen = composed(inverse(slam.pose), goal)
    truth = composed(inverse(true_pose(80)), true_pose(10))
    assert math.dist(seen[:2], truth[:2]) < 1.0


def test_places_in_the_pose_cells_agree_with_the_map() -> None:
    merged = merged_of(robot(0, 60), robot(30, 60, noise=2))
    cells, graph = (merged.states[part]['core'] for part in ('pose_cells', 'experience_map'))
    p = merged.config.pose_cells
    torus = Torus(p.pc_dim_x, p.pc_dim_y, p.pc_dim_th)
    assert listed(cells['experiences']) == listed(graph['labels'])
    places = {row[0]: Place(*row[1:4]) for row in cells['memories']}
    assert len(places) == size(merged)[0]
    for template, pose in zip(
        (row[0] for row in graph['labels']), graph['poses'].tolist(), strict=True
    ):
        x, y, heading_rad = pose
        place = Place(
            x / p.pc_cell_x_size % p.pc_dim_x, y / p.pc_cell_x_size % p.pc_dim_y,
            heading_rad * torus.planes_per_rad % p.pc_dim_th,
        )
        # An experience near that of its template: within the distance of a recognition.
        assert torus.distance(place, places[template]) < 2.5


def test_links_follow_fused_experiences() -> None:
    merged = merged_of(robot(0, 60), robot(30, 60, noise=2))
    core = merged.states['experience_map']['core']
    poses = [Pose(*row) for row in core['poses'].tolist()]
    ends = [tuple(pair) for pair in core['ends'].tolist()]
    assert len(set(ends)) == len(ends)
    assert all(i != j for i, j in ends)
    for (i, j), (distance_m, heading_rad, facing_rad) in zip(
        ends, core['shapes'].tolist(), strict=True
    ):
        x, y, turn = composed(inverse(poses[i]), poses[j])
        claimed = distance_m * math.cos(heading_rad), distance_m * math.sin(heading_rad)
        assert math.dist((x, y), claimed) < 0.3
        assert abs(wrap(turn - facing_rad)) < 0.1


def test_named_places_are_kept_and_named_apart() -> None:
    sessions = []
    for number, one in enumerate((robot(0, 60), robot(40, 60, noise=2))):
        states = one.slam.state()
        experience = next(i for i, at in one.places.items() if at == (50, 80)[number])
        states['experience_map']['goals'] = {'named': [['door', experience, 0.1, 0.0, 0.0]]}
        sessions.append(Session(f'session {number}', one.config, states))
    merged = merge_sessions(sessions)
    named = merged.states['experience_map']['goals']['named']
    assert [row[0] for row in named] == ['door', 'door_2']
    poses = [
        composed(Pose(*merged.states['experience_map']['core']['poses'][row[1]]), Pose(*row[2:]))
        for row in named
    ]
    truth = math.dist(true_pose(50)[:2], true_pose(80)[:2])
    assert math.dist(poses[0][:2], poses[1][:2]) == pytest.approx(truth, abs=1.0)


def test_limits_and_visits_are_merged() -> None:
    limits = {
        'local_view.vt_max': 200, 'pose_cells.exp_max': 200, 'pose_cells.exp_forget': 'freshness'
    }
    robots = [Robot(start, noise=start + 1, **limits).forward(50) for start in (0, 30)]
    merged = merged_of(*robots)
    slam = continued(merged)
    visitor = Robot.on(slam, start=60, noise=3).forward(60)
    assert visitor.slam.experience_map.component_count == 1
    visits = merged.states['pose_cells']['core']['visits']
    assert visits['counts'].sum() == sum(
        one.slam.pose_cells.state()['visits']['counts'].sum() for one in robots
    )


def test_session_of_restarted_nodes_keeps_its_templates() -> None:
    """The local view was restarted: the templates have other numbers in the pose cells."""
    one, other = robot(0, 60), robot(30, 60, noise=2)
    states = one.slam.state()
    cells, graph = states['pose_cells'], states['experience_map']
    core = cells['core']
    core['experiences'] = [[row[0] + 100, *row[1:]] for row in core['experiences']]
    core['memories'] = [[row[0] + 100, *row[1:]] for row in core['memories']]
    graph['core']['labels'] = [[row[0] + 100, *row[1:]] for row in graph['core']['labels']]
    cells['numbering'] = {'memory_ns': 7, 'forgotten': 1, 'base': 100, 'end': 200}
    merged = merge_sessions([Session('restarted', one.config, states), other.session('other')])
    assert size(merged) == size(merged_of(one, other))


def test_nodes_continue_with_the_ids_of_the_merged_map() -> None:
    merged = merged_of(robot(0, 60), robot(30, 60, noise=2))
    slam = continued(merged)
    join = LateJoin(slam.experience_map)
    join.restore(merged.states['experience_map']['joining'])
    template, place = slam.experience_map.labels[3]
    action = MapAction('set', -1, 3, template, 0.0, place)
    sequence = merged.states['pose_cells']['sequence']
    memory_ns = merged.states['pose_cells']['memory_ns']
    assert join.translate(action, sequence, memory_ns) == action
    assert join.missed == join.restarts == 0


def test_other_encoding_without_scans_is_refused_in_one_line() -> None:
    other = Robot(0, noise=2, **{'local_view.vt_patch_normalise': 2}).forward(40)
    with pytest.raises(UnusableInput, match=r'vt_patch_normalise is \d, expected \d') as error:
        merged_of(robot(0, 60), other)
    assert '\n' not in str(error.value)


def test_incomplete_map_is_refused() -> None:
    session = robot(0, 60).session('half')
    states = {part: state for part, state in session.states.items() if part != 'pose_cells'}
    with pytest.raises(UnusableInput, match='half has no pose_cells'):
        merge_sessions([replace(session, states=states)])


@pytest.mark.parametrize(
    ('part', 'key', 'value'),
    [('pose_cells', 'memories', [[1, 2]]), ('experience_map', 'labels', None),
     ('local_view', 'templates', 7), ('pose_cells', 'unrolled', {})],
)
def test_damaged_map_is_refused_in_one_line(part: str, key: str, value: object) -> None:
    session = robot(0, 60).session('broken')
    core = {**session.states[part]['core'], key: value}
    states = {**session.states, part: {**session.states[part], 'core': core}}
    with pytest.raises(UnusableInput, match='broken is damaged') as error:
        merge_sessions([replace(session, states=states)])
    assert '\n' not in str(error.value)


def test_no_map_is_refused() -> None:
    with pytest.raises(UnusableInput, match='no map to merge'):
        merge_sessions([])


def test_empty_map_adds_nothing() -> None:
    empty = Robot(0, noise=1)
    states = type(empty.slam)(empty.config).state()
    session = robot(0, 60).session('full')
    merged = merge_sessions([Session('empty', empty.config, states), session])
    assert flat(merged.states) == flat(session.states)
