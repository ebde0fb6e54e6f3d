# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""TUM files: read exactly, thinned evenly, and rejected with the line that is invalid."""

import math

import numpy as np
import pytest

from ratslam_ros.core.common.pose import Pose
from ratslam_ros.errors import UnusableInput
from ratslam_ros.results.trajectory import parse_stamp_ns, read_tum, thinned, tum_line


def test_stamps_are_exact_to_the_nanosecond(tmp_path):
    path = tmp_path / 't.tum'
    path.write_text('\ufeff999999999.999999999 0 0 0 0 0 0 1\n1000000000.000000001 0 0 0 0 0 0 1\n'
                    '1.0000000010e9 1 0 0 0 0 0 1\n')
    assert read_tum(path).stamp_ns.tolist() == [
        999_999_999_999_999_999, 1_000_000_000_000_000_001, 1_000_000_001_000_000_000]


def test_stamps_out_of_range_are_rejected():
    for text in ('1700000000000000000', '1e400', 'nan', 'inf', '12:30', '-1e99', '1e999999999'):
        with pytest.raises(UnusableInput, match=r'^here: '):
            parse_stamp_ns(text, 'here')


@pytest.mark.parametrize(('text', 'complaint'), [
    ('', 'no poses'),
    ('# only a comment\n', 'no poses'),
    ('0 0 0 0 0 0 0 1\n1 0 0\n', 'line 2: 3 columns, expected 8'),
    ('0,0,0,0,0,0,0,1\n', 'replace the commas'),
    ('0 0 0 0 0 0 0 1\n\n1 nan 0 0 0 0 0 1\n', 'line 3: NaN'),
    ('0 0 zero 0 0 0 0 1\n', 'not eight numbers'),
    ('0 0 0 0 0 0 0 0\n', 'quaternion'),
    ('1 0 0 0 0 0 0 1\n0 0 0 0 0 0 0 1\n', 'line 2: the stamp 0 is not after'),
    ('1 0 0 0 0 0 0 1\n1.0 0 0 0 0 0 0 1\n', 'line 2: the stamp 1.0 is not after'),
])
def test_invalid_file_is_reported_in_one_line(tmp_path, text, complaint):
    path = tmp_path / 'bad.tum'
    path.write_text(text)
    with pytest.raises(UnusableInput, match=complaint) as caught:
        read_tum(path)
    assert str(path) in str(caught.value)
    assert '\n' not in str(caught.value)


def test_missing_or_binary_file_is_rejected(tmp_path):
    with pytest.raises(UnusableInput, match='No such file'):
        read_tum(tmp_path / 'none.tum')
    (tmp_path / 'binary.tum').write_bytes(b'\xff\xfe\x00\x80')
    with pytest.raises(UnusableInput, match='not a text file'):
        read_tum(tmp_path / 'binary.tum')


def test_thinning_is_even_and_bounded(tmp_path):
    assert thinned(range(5), 5) == [0, 1, 2, 3, 4]
    assert thinned(range(6), 5) == [0, 2, 4]
    assert thinned(range(1000), 10) == list(range(0, 1000, 128))
    path = tmp_path / 'long.tum'
    path.write_text(''.join(f'{i} 0 0 0 0 0 0 1\n' for i in range(1000)))
    assert len(read_tum(path, at_most=100)) == 63


def test_heading_does_not_depend_on_quaternion_sign(tmp_path):
    path = tmp_path / 't.tum'
    path.write_text('0 0 0 0 0 0 0.7071068 0.7071068\n1 0 0 0 0 0 -0.7071068 -0.7071068\n')
    np.testing.assert_allclose(read_tum(path).heading_rad, math.pi / 2)


def test_written_line_is_read_back(tmp_path):
    path = tmp_path / 't.tum'
    path.write_text(tum_line(1_700_000_000_000_000_001, Pose(1.5, -2.25, -2.0)))
    assert path.read_text() == (
        '1700000000.000000001 1.500000000 -2.250000000 0 0 0 -0.841470985 0.540302306\n')
    trajectory = read_tum(path)
    assert trajectory.stamp_ns.tolist() == [1_700_000_000_000_000_001]
    assert trajectory.position_m.tolist() == [[1.5, -2.25]]
    assert trajectory.heading_rad == pytest.approx([-2.0], abs=1e-8)
