# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The benchmark on UTIAS MRCLAM: a small made-up folder, and one robot of the real data."""

from __future__ import annotations

import math
from dataclasses import astuple
from pathlib import Path

import mrclam
import numpy as np
import pytest
from helpers import real_recording

from ratslam_ros.core.common.odometry import Motion
from ratslam_ros.core.landmarks.place_search import RelocalisationParameters
from ratslam_ros.results.evaluation import Transform2D

LANDMARKS = {6 + k: (5.0 * math.cos(2.4 * k), 0.5 * k * math.sin(2.4 * k)) for k in range(15)}


def write(path: Path, rows: list[tuple[float, ...]]) -> None:
    path.write_text('# header\n' + '\n'.join('\t'.join(f'{v:.9f}' for v in row) for row in rows))


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """Return exact recordings of robots that drive circles of 1 m; one barcode is unknown."""
    write(tmp_path / 'Barcodes.dat', [(k, 100 + k) for k in range(1, 21)])
    truth = [(name, *position, 0.0, 0.0) for name, position in LANDMARKS.items()]
    write(tmp_path / 'Landmark_Groundtruth.dat', truth)
    start_s = 1_248_444_187.0
    times_s = np.arange(0.0, 30.0, 0.1)
    for robot in mrclam.ROBOTS:
        poses = [(math.sin(0.3 * t), 1.0 - math.cos(0.3 * t), 0.3 * t) for t in times_s]
        write(tmp_path / f'Robot{robot}_Odometry.dat', [(start_s + t, 0.3, 0.3) for t in times_s])
        write(
            tmp_path / f'Robot{robot}_Groundtruth.dat',
            [
                (start_s + t, x, y, math.remainder(h, math.tau))
                for t, (x, y, h) in zip(times_s, poses, strict=True)
            ],
        )
        seen: list[tuple[float, ...]] = []
        for t, (x, y, h) in list(zip(times_s, poses, strict=True))[5::5]:
            seen += [
                (
                    start_s + t, 100 + name, math.hypot(a - x, b - y),
                    math.remainder(math.atan2(b - y, a - x) - h, math.tau),
                )
                for name, (a, b) in LANDMARKS.items()
            ]
            seen += [(start_s + t, 101, 2.0, 0.0), (start_s + t, 999, 1.0, 0.0)]
        write(tmp_path / f'Robot{robot}_Measurement.dat', seen)
    return tmp_path


def test_exact_drive_gives_exact_map(folder: Path) -> None:
    logs, positions = mrclam.read_logs(folder)
    assert set(logs[1].measurements[:, 1]) == set(LANDMARKS)
    drive = mrclam.drive(logs[1], positions, mrclam.scaled(mrclam.FACTOR))
    assert drive.landmark_m < 1e-6
    assert drive.robot_m < 1e-3
    assert drive.outliers == 0.0
    assert mrclam.required_factor([drive], 1.0) < 0.01


def test_steps_between_two_times_cover_them_once(folder: Path) -> None:
    log = mrclam.read_logs(folder)[0][2]
    steps = list(log.steps(4.95, 15.02))
    motions = [step for _, step in steps if isinstance(step, Motion)]
    assert sum(motion.dt_s for motion in motions) == pytest.approx(15.02 - 4.95)
    assert sum(motion.distance_m for motion in motions) == pytest.approx(0.3 * (15.02 - 4.95))
    times_s = [time_s for time_s, step in steps if not isinstance(step, Motion)]
    assert times_s == pytest.approx(np.arange(5.0, 15.1, 0.5))


def test_cut_robot_is_found_without_barcodes(folder: Path) -> None:
    logs, positions = mrclam.read_logs(folder)
    parameters, search = mrclam.scaled(1.0), RelocalisationParameters()
    built = mrclam.StochasticMap(parameters)
    for _, step in logs[1].steps(end_s=15.0):
        if isinstance(step, Motion):
            mrclam.move(built, step)
        else:
            built.observe(step)
    features = built.features()
    frame = mrclam.alignment(features, positions)
    assert astuple(frame) == pytest.approx((0.0, 0.0, 0.0, 1.0), abs=1e-6)
    found = mrclam.relocation(logs[1], features, frame, parameters, search, 20.0)
    assert found.outcome == 'correct'
    assert found.error_m < 0.1
    moved = Transform2D(3.0)
    assert mrclam.relocation(logs[1], features, moved, parameters, search, 20.0).outcome == 'wrong'


def test_real_robot_maps_the_landmarks() -> None:
    """One robot of set 6, with the limits that the benchmark requires of all five."""
    logs, positions = mrclam.read_logs(real_recording('mrclam_6'), [1])
    drive = mrclam.drive(logs[1], positions, mrclam.scaled(mrclam.FACTOR))
    assert drive.landmark_m <= 0.20
    assert drive.robot_m <= 0.65
