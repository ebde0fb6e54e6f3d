# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Late join: map and pose cells start and restart in any order, and messages are lost."""

from __future__ import annotations

import math
from dataclasses import replace

import pytest
from helpers import ahead, circles_of_actions

from ratslam_ros.core.config import ExperienceMapParameters
from ratslam_ros.core.mapping.experience_map import ExperienceMap
from ratslam_ros.core.mapping.late_join import LateJoin
from ratslam_ros.core.pose_cells.map_action import Action, MapAction
from ratslam_ros.core.pose_cells.torus import Place
from ratslam_ros.messages.mapping import encode_map

MEMORY_NS = 7
STEP_M = 1.0


def action(kind: Action, source: int, target: int) -> MapAction:
    return MapAction(kind, source, target, max(target, 0), 0.0, Place(1.0, 2.0, 3.0))


def new_map() -> tuple[ExperienceMap, LateJoin]:
    graph = ExperienceMap(ExperienceMapParameters(exp_initial_em_deg=0.0))
    return graph, LateJoin(graph)


def apply(
    graph: ExperienceMap, joining: LateJoin, item: MapAction, sequence: int,
    memory_ns: int = MEMORY_NS,
) -> None:
    translated = joining.translate(item, sequence, memory_ns)
    if translated is not None:
        graph.apply(translated)


def drive(
    graph: ExperienceMap, joining: LateJoin, actions: list[tuple[int, MapAction]],
    memory_ns: int = MEMORY_NS,
) -> None:
    """Drive ``STEP_M`` before each of the actions, given with their sequence numbers."""
    for sequence, item in actions:
        graph.integrate(ahead(STEP_M))
        apply(graph, joining, item, sequence, memory_ns)


def test_late_map_creates_unknown_experiences() -> None:
    graph, joining = new_map()
    actions = list(circles_of_actions(5, 3))
    drive(graph, joining, actions[7:])
    assert len(graph) == 5
    assert joining.first_sequence == joining.missed == 7
    assert [link.source_id for link in graph.links()] == [0, 1, 2, 3, 4]
    assert all(link.distance_m == pytest.approx(STEP_M) for link in graph.links())


def test_recognition_of_an_unknown_experience_is_dropped() -> None:
    graph, joining = new_map()
    drive(graph, joining, [(5, action('create', 4, 5)), (6, action('create', 5, 6))])
    recognitions = [
        replace(action('none', 6, 6), recognised_id=known, agreement=1.0, view_spacing_m=1.0)
        for known in (2, 5)
    ]
    translated = [joining.translate(one, 7 + n, MEMORY_NS) for n, one in enumerate(recognitions)]
    assert [one and one.recognised_id for one in translated] == [-1, 0]


def test_late_map_ignores_action_none() -> None:
    graph, joining = new_map()
    apply(graph, joining, action('none', 40, 40), 99)
    assert (len(graph), graph.current_id) == (0, -1)


def test_restarted_pose_cells_extend_map_at_current_pose() -> None:
    graph, joining = new_map()
    drive(graph, joining, [(n, action('create', n - 1, n)) for n in range(3)])
    drive(graph, joining, [(n, action('create', n - 1, n)) for n in range(3)], memory_ns=99)
    assert joining.restarts == 1
    assert [e.pose.x_m for e in graph.experiences()] == pytest.approx([1, 2, 3, 4, 5, 6])
    assert [(link.source_id, link.target_id) for link in graph.links()] == [
        (n, n + 1) for n in range(5)
    ]


def test_lost_action_is_counted_and_geometry_stays_correct() -> None:
    graph, joining = new_map()
    actions = [(n, action('create', n - 1, n)) for n in range(6)]
    drive(graph, joining, actions[:3])
    graph.integrate(ahead(STEP_M))  # the motion of the lost action
    drive(graph, joining, actions[4:])
    assert joining.missed == 1
    assert [e.pose.x_m for e in graph.experiences()] == pytest.approx([1, 2, 3, 5, 6])


def test_localising_map_creates_no_unknown_experiences() -> None:
    graph, joining = new_map()
    drive(graph, joining, list(circles_of_actions(4, 1)))
    before = encode_map(1, graph)
    graph.mapping = False
    drive(graph, joining, [(4, action('create', 3, 4)), (5, action('set', 4, 1))])
    assert graph.current_id == 1
    assert len(graph) == 4
    graph.mapping = True
    after = encode_map(1, graph)
    assert after.replace('"current_experience_id":1', '"current_experience_id":3') == before
    drive(graph, joining, [(6, action('create', 1, 4))])
    assert len(graph) == 5
    assert not math.isnan(graph.pose.x_m)


def test_create_of_known_experience_becomes_a_link() -> None:
    graph, joining = new_map()
    drive(graph, joining, list(circles_of_actions(4, 1)))
    drive(graph, joining, [(4, action('create', 3, 1))])
    assert (len(graph), graph.current_id) == (4, 1)


def test_known_id_with_another_label_becomes_a_create() -> None:
    graph, joining = new_map()
    drive(graph, joining, list(circles_of_actions(4, 1)))
    replacing = MapAction('link', 3, 1, 9, 0.0, Place(4.0, 2.0, 3.0))
    translated = joining.translate(replacing, 4, MEMORY_NS)
    assert translated is not None
    assert (translated.action, translated.source_id, translated.target_id) == ('create', 3, 1)
    update = graph.apply(translated)
    assert update.pruned is not None
    assert update.pruned.experience_id == 1
    assert graph.labels[1] == (9, replacing.place)
