# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The map and the pose cells may be started, restarted and lose messages in any order."""

import math
from dataclasses import replace

import pytest
from helpers import ahead, circles_of_actions

from ratslam_ros.core.config import ExperienceMapParameters
from ratslam_ros.core.mapping.experience_map import ExperienceMap
from ratslam_ros.core.mapping.late_join import LateJoin
from ratslam_ros.core.pose_cells.map_action import MapAction
from ratslam_ros.core.pose_cells.torus import Place
from ratslam_ros.messages.mapping import encode_map

MEMORY_NS = 7
STEP_M = 1.0


def action(kind: str, source: int, target: int) -> MapAction:
    return MapAction(kind, source, target, max(target, 0), 0.0, Place(1.0, 2.0, 3.0))  # type: ignore[arg-type]


def new() -> tuple[ExperienceMap, LateJoin]:
    graph = ExperienceMap(ExperienceMapParameters(exp_initial_em_deg=0.0))
    return graph, LateJoin(graph)


def apply(
    graph: ExperienceMap, joining: LateJoin, item: MapAction, sequence: int,
    memory_ns: int = MEMORY_NS,
) -> None:  # fmt: skip
    translated = joining.translate(item, sequence, memory_ns)
    if translated is not None:
        graph.apply(translated)


def drive(graph: ExperienceMap, joining: LateJoin, actions: list[tuple[int, MapAction]],
          memory_ns: int = MEMORY_NS) -> None:  # fmt: skip
    for sequence, item in actions:
        graph.integrate(ahead(STEP_M))
        apply(graph, joining, item, sequence, memory_ns)


def test_with_both_there_from_the_start_every_action_is_applied_as_it_came() -> None:
    graph, joining = new()
    plain = ExperienceMap(ExperienceMapParameters(exp_initial_em_deg=0.0))
    for sequence, item in circles_of_actions(5, 3):
        for one in (graph, plain):
            one.integrate(ahead(STEP_M))
        apply(graph, joining, item, sequence)
        plain.apply(item)
    assert encode_map(1, graph) == encode_map(1, plain)
    assert (joining.missed, joining.restarts, joining.first_sequence) == (0, 0, 0)


def test_a_map_that_begins_late_makes_what_it_does_not_know() -> None:
    graph, joining = new()
    actions = list(circles_of_actions(5, 3))
    drive(graph, joining, actions[7:])
    assert len(graph) == 5
    assert joining.first_sequence == joining.missed == 7
    assert [link.source_id for link in graph.links()] == [0, 1, 2, 3, 4]
    assert all(link.distance_m == pytest.approx(STEP_M) for link in graph.links())


def test_a_late_map_does_nothing_for_none() -> None:
    graph, joining = new()
    apply(graph, joining, action('none', 40, 40), 99)
    assert (len(graph), graph.current_id) == (0, -1)


def test_after_pose_cells_restarted_the_map_goes_on_from_where_the_robot_is() -> None:
    graph, joining = new()
    drive(graph, joining, [(n, action('create', n - 1, n)) for n in range(3)])
    drive(graph, joining, [(n, action('create', n - 1, n)) for n in range(3)], memory_ns=99)
    assert joining.restarts == 1
    assert [e.pose.x_m for e in graph.experiences()] == pytest.approx([1, 2, 3, 4, 5, 6])
    assert [(link.source_id, link.target_id) for link in graph.links()] == [
        (n, n + 1) for n in range(5)
    ]


def test_what_never_came_is_counted_and_the_geometry_stays_right() -> None:
    graph, joining = new()
    actions = [(n, action('create', n - 1, n)) for n in range(6)]
    drive(graph, joining, actions[:3])
    graph.integrate(ahead(STEP_M))  # the motion of the lost action
    drive(graph, joining, actions[4:])
    assert joining.missed == 1
    assert [e.pose.x_m for e in graph.experiences()] == pytest.approx([1, 2, 3, 5, 6])


def test_while_only_localising_unknown_experiences_are_not_made() -> None:
    graph, joining = new()
    drive(graph, joining, list(circles_of_actions(4, 1)))
    before = encode_map(1, graph)
    graph.mapping = False
    drive(graph, joining, [(4, action('create', 3, 4)), (5, action('set', 4, 1))])
    assert graph.current_id == 1
    assert len(graph) == 4
    graph.mapping = True
    assert encode_map(1, graph).replace('"current_experience_id":1', '"current_experience_id":3'
                                        ) == before  # fmt: skip
    drive(graph, joining, [(6, action('create', 1, 4))])
    assert len(graph) == 5
    assert not math.isnan(graph.pose.x_m)


def test_a_second_creation_of_a_known_experience_is_a_link() -> None:
    graph, joining = new()
    drive(graph, joining, list(circles_of_actions(4, 1)))
    drive(graph, joining, [(4, replace(action('create', 3, 1)))])
    assert (len(graph), graph.current_id) == (4, 1)
