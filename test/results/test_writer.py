# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Trajectories of a run, with and without pruned experiences."""

from __future__ import annotations

import random
from pathlib import Path

import pytest
from helpers import seen

from ratslam_ros.core.common.odometry import Motion
from ratslam_ros.core.common.pose import Pose
from ratslam_ros.core.config import Config
from ratslam_ros.core.mapping.experience_map import ExperienceMap
from ratslam_ros.core.pose_cells.pose_cells import PoseCells
from ratslam_ros.pipeline.items import OdometryStep, ViewStep
from ratslam_ros.results.writer import Results


def poses_of(path: Path) -> list[list[float]]:
    return [[float(word) for word in line.split()] for line in path.read_text().splitlines()]


@pytest.mark.parametrize('limit', [0, 25])
def test_final_trajectory_without_relaxation_equals_first(limit: int, tmp_path: Path) -> None:
    """With the limit, most experiences that the poses refer to are pruned at the end."""
    config = Config().with_values({
        'pose_cells.exp_max': limit, 'pose_cells.exp_delta_pc_threshold': 1.0,
        'experience_map.exp_loops': 0,
    })
    pose_cells, graph = PoseCells(config.pose_cells), ExperienceMap(config.experience_map)
    results, rng = Results(tmp_path, config), random.Random(1)
    pruned_count = 0
    for n in range(300):
        motion = Motion(0.5, rng.uniform(0.2, 1.5), rng.uniform(-0.6, 0.6))
        pose_cells.integrate(motion)
        graph.integrate(motion)
        origin = Pose(0.0, 0.0, 0.0)
        results.add(OdometryStep(n, graph.pose, origin, graph.current_id, graph.offset))
        match = seen(rng.randrange(15))
        action = pose_cells.view(match)
        pruned = graph.apply(action).pruned
        pruned_count += pruned is not None
        results.add(ViewStep(n, match, action, pruned))
    results.finish(graph, {})
    assert (pruned_count > 100) == (limit > 0)
    assert results.experiences == len(graph)
    first, final = (poses_of(tmp_path / name) for name in (
        'trajectory.tum', 'trajectory_final.tum'
    ))
    assert len(first) == 300
    for a, b in zip(first, final, strict=True):
        assert a == pytest.approx(b, abs=2e-9)
