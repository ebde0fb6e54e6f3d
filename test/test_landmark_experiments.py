# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The functions of benchmarks/landmarks.py, on few seeds."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path

import landmarks as bench
import numpy as np
import pytest

from ratslam_ros.core.common.pose import Pose, composed, inverse


def test_map_is_consistent() -> None:
    found = [bench.mapping_run('normal', seed) for seed in (1, 2, 3)]
    # The errors of one map are correlated, so the mean over few maps varies widely.
    assert np.mean([row.within for row in found]) >= 0.85
    assert 0.8 <= np.mean([row.nees for row in found]) <= 1.3
    assert all(row.count > 60 and row.rms_m < 2.0 for row in found)


def test_kidnapped_robot_is_found() -> None:
    for rows in bench.memory_relocalisation_run(100, 1).values():
        assert len(rows) == bench.KIDNAPS_COUNT
        assert sum(row.outcome == 'right' for row in rows) >= len(rows) - 1
        assert not any(row.outcome == 'wrong' for row in rows)


def test_map_frame_is_found_by_alignment() -> None:
    result = bench.mapped(bench.scattered_drive(1))
    frame = bench.map_frame(result)
    assert math.hypot(frame.x_m, frame.y_m) < 3.0
    moved = replace(result, memory=bench.LandmarkMemory(0, bench.map_model(result.drive)))
    offset = Pose(3.0, -2.0, 0.7)
    start = composed(inverse(offset), result.drive.start)
    moved.memory.map.move_to(start, np.zeros((3, 3)))
    for index, step in enumerate(result.drive.steps):
        moved.memory.map.predict(*step.motion)
        moved.memory.observe(step.observations, index)
    assert bench.map_frame(moved) == pytest.approx(composed(frame, offset), abs=1e-6)


def test_plots_are_drawn(tmp_path: Path) -> None:
    result = bench.mapped(bench.scattered_drive(1), 30)
    figure = bench.new_figure(4.0, 4.0)
    axes = figure.subplots()
    bench.draw_mapped(axes, result)
    found = bench.Kidnapping('right', (0.0, 0.0, 0.0), Pose(1.0, 2.0, 0.0), Pose(1, 2, 0), 5, 9, 1)
    lost = replace(found, outcome='ambiguous', pose=None, error=(math.nan,) * 3)
    bench.draw_kidnappings(axes, [found, lost])
    assert len(axes.lines) >= 6
    assert bench.save_figure(figure, tmp_path / 'plot.png').stat().st_size > 5000
    assert '50.0%' in bench.outcomes([found, lost])


# Relocalisation


@pytest.mark.parametrize('case', ['distinct', 'normal, twice the noise'])
def test_kidnaps_are_right(case: str) -> None:
    rows = bench.relocalisation_run(case, 1)
    assert [row.outcome for row in rows] == ['right'] * bench.KIDNAPS_COUNT


def test_never_mapped_regions_are_not_here() -> None:
    rows = [
        *bench.unmapped_run('normal, twice the noise', 1),
        *bench.unmapped_plan_run('house', 1),
    ]
    assert {row.outcome for row in rows} == {'not here'}
