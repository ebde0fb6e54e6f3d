# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Changes of the map: a mirror that receives them equals the map."""

from __future__ import annotations

from dataclasses import asdict

import numpy as np
import pytest
from graphs import new_map
from helpers import ahead, turning
from hypothesis import given, settings
from hypothesis import strategies as st
from states import differences

from ratslam_ros.core.common.odometry import Motion
from ratslam_ros.core.common.turn_correction import TurnCorrection
from ratslam_ros.core.mapping.experience_map import ExperienceMap
from ratslam_ros.core.mapping.link_learning import TIMED_OUT
from ratslam_ros.core.mapping.map_changes import MapChangeTracker, MapMirror
from ratslam_ros.core.pose_cells.map_action import NO_EXPERIENCE, MapAction
from ratslam_ros.core.pose_cells.torus import Place

GAP = Motion(1.0, 0.0, 0.0, is_known=False)
TOLERANCE = 1.001e-3
MAX_EXPERIENCES = 12

STEPS = st.lists(
    st.one_of(
        st.tuples(st.just('create'), st.just(0)),
        st.tuples(st.sampled_from(['prune', 'link', 'view']), st.integers(0, 30)),
        st.tuples(
            st.sampled_from(['gap', 'block', 'turn', 'correct', 'restart', 'send']), st.just(0)
        ),
    ),
    max_size=60,
)


def do(graph: ExperienceMap, step: str, number: int) -> None:
    """Execute one step of a random sequence; steps that are impossible do nothing."""
    count = len(graph)
    graph.integrate(ahead(0.5))
    target = count if step == 'create' and count < MAX_EXPERIENCES else number % max(count, 1)
    place = Place(float(number), 0.0, 0.0)
    recognised, spacing_m = NO_EXPERIENCE, 0.0
    if step == 'view':
        recognised, spacing_m = (number + 5) % max(count, 1), 0.5
    if step in ('create', 'prune') and (step == 'create' or count):
        action = MapAction('create', graph.current_id, target, 100 + number, 0.0, place)
    elif step in ('link', 'view') and count:
        action = MapAction(
            'link', graph.current_id, target, graph.labels[target][0], 0.0, place,
            recognised_id=recognised, agreement=1.0, view_spacing_m=spacing_m,
        )
    else:
        if step == 'gap':
            graph.integrate(GAP)
        elif step == 'turn':
            graph.integrate(turning(2.0))
        elif step == 'block':
            graph.unlearn_blocked('ahead', graph.pose.heading_rad)
        elif step == 'correct':
            graph.correct_turns(TurnCorrection(1.0, 0.0), TurnCorrection(1.02, 0.01))
        return
    graph.apply(action, 'ahead' if number % 2 else '')


def expected_confidences(graph: ExperienceMap) -> dict[tuple[int, int], float]:
    """Return the confidence of every link: equation (9), one link after the other."""
    links, table = graph.links(), graph.link_table
    found = {}
    for link, failed, share in zip(links, table.failures, table.shares.tolist(), strict=True):
        total = sum(
            other.count for other in links
            if link.behaviour and (other.source_id, other.behaviour)
            == (link.source_id, link.behaviour)
        ) or link.count
        value = link.count / (total + int(failed[TIMED_OUT]))
        found[link.source_id, link.target_id] = value * share
    return found


def check_equal(mirror: MapMirror, graph: ExperienceMap) -> None:
    assert mirror.pending == 0
    assert len(mirror) == len(graph)
    assert mirror.current_id == graph.current_id
    np.testing.assert_allclose(mirror.poses, graph.poses, rtol=0.0, atol=TOLERANCE)
    assert mirror.template_ids.tolist() == [template for template, _ in graph.labels]
    assert mirror.components.tolist() == graph.components
    rows = mirror.link_rows
    used = {tuple(ends): row for row, ends in enumerate(rows.ends.tolist()) if ends[0] >= 0}
    expected = expected_confidences(graph)
    assert used.keys() == expected.keys()
    for link in graph.links():
        ends = link.source_id, link.target_id
        row = used[ends]
        assert mirror.link_row(*ends) == row
        shape = link.distance_m, link.heading_rad, link.facing_rad
        assert rows.shapes[row] == pytest.approx(shape, rel=0.0, abs=TOLERANCE)
        assert rows.durations_s[row] == pytest.approx(link.duration_s, rel=0.0, abs=0.011)
        assert rows.confidences[row] == pytest.approx(expected[ends], rel=0.0, abs=0.011)
        assert rows.counts[row] == link.count
        assert rows.recognised[row] == link.recognised
        assert rows.behaviours[row] == link.behaviour


@settings(max_examples=50, deadline=None)
@given(STEPS, st.integers(2, 40), st.booleans())
def test_mirror_of_changes_equals_the_map(
    steps: list[tuple[str, int]], limit: int, sends: bool
) -> None:
    graph = new_map(exp_try_radius_m=1.0, exp_recent_tries=1, exp_loops=3)
    tracker, again, mirror = MapChangeTracker(), MapChangeTracker(), MapMirror()

    def send() -> int:
        change = tracker.next_change(graph, 7, limit)
        assert len(change) <= limit
        repeated = again.next_change(graph, 7, limit)
        assert list(differences(asdict(change), asdict(repeated))) == []
        mirror.apply(change)
        return change.pending

    send()
    for step, number in steps:
        if step == 'restart':
            tracker.restart()
            again.restart()
        elif step == 'send':
            send()
        else:
            do(graph, step, number)
            if sends:
                send()
    for _ in range(1000):
        if not send():
            break
    check_equal(mirror, graph)
    assert len(tracker.next_change(graph, 7, limit)) == 0


def chain(count: int) -> ExperienceMap:
    graph = new_map()
    for _ in range(count):
        graph.apply(MapAction(
            'create', graph.current_id, len(graph), 3, 0.0, Place(0.0, 0.0, 0.0)
        ))
        graph.integrate(ahead(1.0))
    return graph


def test_small_motions_are_not_sent() -> None:
    graph, tracker = chain(5), MapChangeTracker()
    assert len(tracker.next_change(graph, 0)) == 9
    graph._poses.values[:5] += 0.0004
    assert len(tracker.next_change(graph, 0)) == 0
    graph._poses.values[3] += 0.002
    change = tracker.next_change(graph, 0)
    assert change.experiences.ids.tolist() == [3]
    assert (len(change.links), change.pending) == (0, 0)


def test_all_experiences_take_turns_while_all_move() -> None:
    graph, tracker = chain(10), MapChangeTracker()
    tracker.next_change(graph, 0)
    sent = []
    for _ in range(10):
        graph._poses.values[:10] += 0.1
        graph.link_table.average(2, graph.links()[2])
        change = tracker.next_change(graph, 0, 4)
        sent += change.experiences.ids.tolist()
        assert change.links.ends.tolist() == [[2, 3]]
    assert sent == [*range(10)] * 3


def test_new_experience_is_sent_before_moved_ones() -> None:
    graph, tracker = chain(10), MapChangeTracker()
    tracker.next_change(graph, 0)
    graph._poses.values[:10] += 0.1
    graph.apply(MapAction('create', 9, 10, 3, 0.0, Place(0.0, 0.0, 0.0)))
    assert tracker.next_change(graph, 0, 2).experiences.ids.tolist() == [10]


def test_restart_and_another_map_send_everything() -> None:
    graph, tracker = chain(4), MapChangeTracker()
    assert tracker.next_change(graph, 0).is_restart
    assert not tracker.next_change(graph, 0).is_restart
    tracker.restart()
    change = tracker.next_change(graph, 0)
    assert change.is_restart and len(change) == 7
    change = tracker.next_change(chain(2), 0)
    assert change.is_restart and change.experience_count == 2 and len(change) == 3
