# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Errors against the truth: the figures of evo on a fabricated drive, and invariants."""

import json
import math
import re

import numpy as np
import pytest
from helpers import START_NS, real_recording

from ratslam_ros.errors import UnusableInput, UnusableParameter
from ratslam_ros.results.evaluation import Transform2D, associate, evaluate, fit
from ratslam_ros.results.trajectory import Trajectory, read_tum


def write_drive(path, offset_s=0.0, n=630, period_s=0.2, wobble=0.0, scale=1.0, headings=True):
    """Write laps of a figure of eight; with a wobble, also rotated, shifted, drifting, scaled."""
    lines = ['# t x y z qx qy qz qw']
    for i in range(n):
        t = i * period_s
        x, y = 8.0 * math.sin(0.1 * t), 5.0 * math.sin(0.2 * t)
        heading = math.atan2(math.cos(0.2 * t), 0.8 * math.cos(0.1 * t))
        if wobble:
            x += wobble * math.sin(0.37 * t) + 0.002 * t
            y += wobble * math.cos(0.23 * t)
            c, s = math.cos(0.7), math.sin(0.7)
            x, y = scale * (c * x - s * y) + 3.0, scale * (s * x + c * y) - 2.0
            heading += 0.7 + 0.1 * wobble * math.sin(1.3 * t)
        stamp_ns = START_NS + round((t + offset_s) * 1e9)
        qz, qw = (math.sin(heading / 2), math.cos(heading / 2)) if headings else (0, 1)
        lines.append(f'{stamp_ns // 10**9}.{stamp_ns % 10**9:09d} '
                     f'{x:.9f} {y:.9f} 0 0 0 {qz:.9f} {qw:.9f}')
    path.write_text('\n'.join(lines) + '\n')
    return path


@pytest.fixture
def truth(tmp_path):
    return read_tum(write_drive(tmp_path / 'truth.tum'))


@pytest.fixture
def points(tmp_path):
    return read_tum(write_drive(tmp_path / 'points.tum', headings=False))


@pytest.fixture
def drive(tmp_path):
    return read_tum(write_drive(tmp_path / 'drive.tum', 0.013, 1250, 0.1, 0.4, 1.1))


def line_of(*x_m, stamps_s=None):
    stamps_s = range(len(x_m)) if stamps_s is None else stamps_s
    stamp_ns = np.array([round(s * 1e9) for s in stamps_s], np.int64)
    position_m = np.column_stack((x_m, np.zeros(len(x_m)))).astype(float)
    return Trajectory(stamp_ns, position_m, np.zeros(len(x_m)), True)


# Printed by evo 1.38.1 for truth.tum, points.tum and drive.tum as written above: rmse, mean,
# median, std, min, max.
EVO = {
    # evo_ape tum truth.tum drive.tum -a --t_max_diff 0.05 [-as, no -a]
    'ape -a': (0.718834, 0.654098, 0.675729, 0.298125, 0.067582, 1.292093),
    'ape -as': (0.402183, 0.383927, 0.391746, 0.119796, 0.012732, 0.654140),
    'ape': (6.049641, 5.472120, 5.728226, 2.579546, 0.187019, 9.411944),
    # evo_rpe tum truth.tum drive.tum -d 1 -u m --t_max_diff 0.05
    'rpe': (0.173421, 0.158487, 0.161387, 0.070402, 0.026633, 0.335408),
    # the same with --pairs_from_reference, and: -as; -r angle_rad
    'rpe ref': (0.190808, 0.170855, 0.175031, 0.084948, 0.024113, 0.409414),
    'rpe ref -as': (0.161569, 0.149747, 0.146828, 0.060665, 0.023121, 0.305082),
    'rpe ref angle': (0.041333, 0.037069, 0.035993, 0.018282, 0.000429, 0.073647),
    # evo_rpe tum points.tum drive.tum -d 1 -u m --pairs_from_reference -r point_distance
    'rpe chord': (0.146728, 0.118157, 0.108477, 0.086994, 0.001481, 0.379456),
}


def agrees(errors, name, count):
    ours = (errors.rmse, errors.mean, errors.median, errors.std, errors.min, errors.max)
    assert ours == pytest.approx(EVO[name], abs=1e-6)
    assert errors.count == count


@pytest.mark.parametrize(('align', 'name'), [('se2', 'ape -a'), ('sim2', 'ape -as'),
                                             ('none', 'ape')])
def test_ate_agrees_with_evo(drive, truth, points, align, name):
    agrees(evaluate(drive, truth, align).ate, name, 625)
    agrees(evaluate(drive, points, align).ate, name, 625)


def test_rpe_agrees_with_evo(drive, truth, points):
    agrees(evaluate(drive, truth).rpe, 'rpe ref', 99)
    agrees(evaluate(drive, truth, 'sim2').rpe, 'rpe ref -as', 99)
    agrees(evaluate(drive, truth).rpe_heading_rad, 'rpe ref angle', 99)
    chord = evaluate(drive, points)
    agrees(chord.rpe, 'rpe chord', 99)
    assert (chord.rpe_of, chord.rpe_heading_rad) == ('chord', None)


def test_transformed_copy_has_no_error(truth):
    moved = Transform2D(5.0, -3.0, 2.0)
    copy = Trajectory(truth.stamp_ns, moved.apply(truth.position_m), truth.heading_rad + 2.0, True)
    result = evaluate(copy, truth)
    assert result.ate.max < 1e-9
    assert result.rpe.max < 1e-9
    assert result.rpe_heading_rad.max < 1e-7
    assert result.transform.heading_rad == pytest.approx(-2.0)
    np.testing.assert_allclose(result.transform.apply(copy.position_m), truth.position_m,
                               atol=1e-9)


def test_fit_recovers_similarity_transform():
    source = np.random.default_rng(0).normal(size=(50, 2))
    expected = Transform2D(1.0, 2.0, -2.5, 0.3)
    found = fit(source, expected.apply(source), scale=True)
    assert (found.x_m, found.y_m, found.heading_rad, found.scale) == pytest.approx(
        (1.0, 2.0, -2.5, 0.3))


def test_mirror_image_is_not_aligned(truth):
    mirrored = Trajectory(truth.stamp_ns, truth.position_m * [1, -1], -truth.heading_rad, True)
    assert evaluate(mirrored, truth).ate.rmse > 1.0


def test_association_takes_nearest_or_earlier_stamp():
    truth_ns = np.array([0, 10, 20], np.int64)
    stamp_ns = np.array([-3, 5, 6, 16, 99], np.int64)[:2]
    assert [a.tolist() for a in associate(stamp_ns, truth_ns, 1.0)] == [[0, 1], [0, 0]]
    assert [a.tolist() for a in associate(np.array([6, 16]), truth_ns, 1.0)] == [[0, 1], [1, 2]]
    assert [a.tolist() for a in associate(truth_ns, np.array([19]), 1e-9)] == [[2], [0]]
    assert [len(a) for a in associate(truth_ns, np.array([15]), 1e-9)] == [0, 0]


def test_rpe_pairs_do_not_overlap_and_need_delta():
    truth = line_of(0, 0.4, 0.8, 1.2, 1.6, 2.0, 2.4, 2.8)
    assert evaluate(truth, truth).rpe.count == 2
    short = evaluate(line_of(0, 0.4), line_of(0, 0.4))
    assert short.rpe is None
    assert 'no RPE' in short.format()


def test_heading_error_is_wrapped():
    truth = line_of(0, 1, 2)
    almost = Trajectory(truth.stamp_ns, truth.position_m,
                        np.array([math.pi - 0.01, -math.pi + 0.01, math.pi - 0.01]), True)
    assert evaluate(almost, truth, 'none').rpe_heading_rad.max == pytest.approx(0.02)


def test_json_and_table_contain_the_figures(drive, truth):
    result = evaluate(drive, truth)
    payload = json.loads(result.to_json())
    assert payload['schema_version'] == 1
    assert payload['ate']['rmse'] == result.ate.rmse
    assert 'stamp_ns' not in payload
    assert re.search(r'ATE \(se2\) +m +0\.719 +0\.654 +0\.676 +1\.292 +625', result.format())
    assert max(map(len, result.format().splitlines())) <= 80


def test_incomparable_trajectories_are_rejected(truth):
    later = Trajectory(truth.stamp_ns + 10**12, truth.position_m, truth.heading_rad, True)
    with pytest.raises(UnusableInput, match='same clock'):
        evaluate(later, truth)
    with pytest.raises(UnusableInput, match='do not move'):
        evaluate(line_of(1, 1, 1), line_of(1, 1, 1))
    assert evaluate(line_of(1, 1, 1), line_of(1, 1, 1), 'none').ate.max == 0.0
    with pytest.raises(UnusableParameter, match='se2, sim2 or none'):
        evaluate(truth, truth, 'se3')


def test_lecture_hall_dead_reckoning_error_is_thirteen_metres():
    folder = real_recording('lecture_hall')
    odometry, points = [], []
    for line in (folder / 'Lecture_Hall_Input.txt').read_text().splitlines():
        if line.startswith('odom2'):
            odometry.append([float(value) for value in line.split()[1:5]])
    for line in (folder / 'Lecture_Hall_GT.txt').read_text().splitlines():
        points.append([float(value) for value in line.split()[1:4]])
    points = points[:len(points) // 2]  # the second half repeats the stamps with other values
    t, v, _, w = np.array(odometry).T
    dt = np.diff(t, prepend=t[0])
    heading = np.cumsum(w * dt)
    middle = heading - w * dt / 2
    x, y = np.cumsum(v * dt * np.cos(middle)), np.cumsum(v * dt * np.sin(middle))
    done = Trajectory(np.round(t * 1e9).astype(np.int64), np.column_stack((x, y)), heading, True)
    points = np.array(points)
    truth = Trajectory(np.round(points[:, 0] * 1e9).astype(np.int64), points[:, 1:],
                       np.zeros(len(points)), False)
    result = evaluate(done, truth)
    assert result.ate.rmse == pytest.approx(13.0, abs=0.2)
    assert result.ate.max == pytest.approx(27.0, abs=1.0)
    assert result.rpe_of == 'chord'
    assert result.rpe.median < 0.1
