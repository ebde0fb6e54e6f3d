# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The behaviours of links."""

from __future__ import annotations

from ratslam_ros.core.common.odometry import Motion
from ratslam_ros.core.config import ExperienceMapParameters
from ratslam_ros.core.mapping.experience_map import ExperienceMap
from ratslam_ros.core.pose_cells.map_action import MapAction
from ratslam_ros.core.pose_cells.torus import Place


def step(graph: ExperienceMap, behaviour: str = '') -> None:
    """Drive 0.5 m and create an experience, linked by a behaviour."""
    graph.integrate(Motion(1.0, 0.5, 0.0))
    new = len(graph)
    action = MapAction('create', graph.current_id, new, new, 0.0, Place(0.0, 0.0, 0.0))
    graph.apply(action, behaviour)


def test_reversed_link_has_opposite_wall() -> None:
    graph = ExperienceMap(ExperienceMapParameters())
    step(graph)
    step(graph, behaviour='left_wall')
    step(graph, behaviour='turn')
    assert graph.behaviour_between(0, 1) == 'left_wall'
    assert graph.behaviour_between(1, 0) == 'right_wall'
    assert graph.behaviour_between(2, 1) == ''
    assert graph.behaviour_between(0, 2) == ''
