# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Plots of temporal maps, and routes on a map.json."""

from __future__ import annotations

import json
from pathlib import Path

import cv2
import numpy as np
import pytest

from ratslam_ros.core.common.odometry import Motion
from ratslam_ros.core.config import ExperienceMapParameters, GoalRecallParameters
from ratslam_ros.core.mapping.experience_map import ExperienceMap
from ratslam_ros.core.navigation.goals import Goal
from ratslam_ros.core.navigation.route_planner import RoutePlanner
from ratslam_ros.core.pose_cells.map_action import MapAction
from ratslam_ros.core.pose_cells.torus import Place
from ratslam_ros.errors import UnreachableGoal, UnusableInput
from ratslam_ros.messages.mapping import encode_map
from ratslam_ros.results.goal_plots import draw_temporal_map, draw_times
from ratslam_ros.results.map_json import read_map_json

VERMILLION_BGR = (0x00, 0x5E, 0xD5)


def square() -> ExperienceMap:
    """Return the map of a drive round a square of 4 m, with one unlinked experience."""
    graph = ExperienceMap(ExperienceMapParameters(exp_initial_em_deg=0.0))
    for n in range(16):
        graph.integrate(Motion(2.0, 1.0, 0.0))
        graph.integrate(Motion(0.5, 0.0, 0.0 if n % 4 else np.pi / 2))
        action = MapAction('create', n - 1, n, n, 0.0, Place(0.0, 0.0, 0.0))
        graph.apply(action)
    graph.apply(MapAction('create', -1, 16, 16, 0.0, Place(0.0, 0.0, 0.0)))
    graph.apply(MapAction('set', -1, 15, 15, 0.0, Place(0.0, 0.0, 0.0)))
    return graph


def route_pixels(path: Path) -> int:
    picture = cv2.imread(str(path)).astype(int)
    return int((np.abs(picture - VERMILLION_BGR).max(axis=2) < 30).sum())


def test_route_is_drawn_on_the_temporal_map(tmp_path: Path) -> None:
    graph = square()
    times = RoutePlanner(GoalRecallParameters(), graph).temporal_map()
    route = graph.poses[[15, 14, 13, 12, 11], :2]
    draw_temporal_map(graph, times, tmp_path / 'a.png', route, [Goal(11, name='kitchen')])
    draw_temporal_map(graph, times, tmp_path / 'c.png')
    assert route_pixels(tmp_path / 'a.png') > 500 > route_pixels(tmp_path / 'c.png')


def test_read_map_gives_same_routes(tmp_path: Path) -> None:
    graph = square()
    (tmp_path / 'map.json').write_text(encode_map(0, graph))
    _, again = read_map_json(tmp_path / 'map.json')
    assert encode_map(0, again) == encode_map(0, graph)
    planners = [RoutePlanner(GoalRecallParameters(), each) for each in (again, graph)]
    assert planners[0].route_to(3) == planners[1].route_to(3)
    assert route_pixels(draw_times(tmp_path, None, 3)) > 500
    with pytest.raises(UnreachableGoal, match='no link leads from experience 2 to 16'):
        draw_times(tmp_path, 2, 16)
    with pytest.raises(UnusableInput, match='no experience 99 to start from'):
        draw_times(tmp_path, 99, None)


def test_read_map_rejects_other_files(tmp_path: Path) -> None:
    with pytest.raises(UnusableInput, match='ratslam replay'):
        read_map_json(tmp_path / 'map.json')
    payload = json.loads(encode_map(0, square()))
    wrong = [
        {'components': [0]}, {'current_experience_id': 17}, {'experiences': payload['links']},
        {'links': [payload['links'][0] | {'target_id': 99}]},
        {'experiences': payload['experiences'][1:]},
    ]
    for text in ('{}', 'no', '[1]', *(json.dumps(payload | one) for one in wrong)):
        (tmp_path / 'map.json').write_text(text)
        with pytest.raises(UnusableInput, match='not a map'):
            read_map_json(tmp_path / 'map.json')
