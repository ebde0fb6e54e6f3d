# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The video of a replay: content of a frame, and rejected names."""

import math

import cv2
import numpy as np
import pytest

from ratslam_ros.core.common.pose import Pose
from ratslam_ros.errors import UnusableInput
from ratslam_ros.offline.replay_video import SIZE_PX, VERMILLION, check_path, compose

CAMERA = np.full((120, 160, 3), (10, 200, 30), np.uint8)
VIEW = np.arange(200, dtype=np.uint8).reshape(10, 20)
NOWHERE = np.empty((0, 2))
ORIGIN = Pose(0.0, 0.0, 0.0)


def one_cell(at=(9, 5, 10)):
    plane, headings = np.zeros((11, 21)), np.zeros(36)
    headings[at[0]] = plane[at[1:]] = 1.0
    return plane, headings


def places(n=50):
    angle = np.linspace(0.0, 5.0, n)
    return np.column_stack((10.0 * np.cos(angle), 6.0 * np.sin(angle)))


def middle_of(frame, colour):
    """Return the mean (x, y) px of the pixels of exactly this colour."""
    y, x = np.nonzero(np.all(frame == colour, axis=2))
    return float(x.mean()), float(y.mean())


def test_camera_is_top_left_and_map_right():
    frame = compose(CAMERA, VIEW, *one_cell(), places(), ORIGIN, 'a caption')
    assert frame.shape == (SIZE_PX[1], SIZE_PX[0], 3)
    x, y = middle_of(frame, CAMERA[0, 0])
    assert x < 300
    assert y < 300
    assert middle_of(frame, VERMILLION)[0] > 480


def test_template_is_enlarged_without_smoothing():
    view = np.array([[0, 77], [77, 0]], np.uint8)
    frame = compose(CAMERA, view, *one_cell(), NOWHERE, ORIGIN, '')
    greys = np.unique(frame[80:220, 315:465].reshape(-1, 3), axis=0)
    assert {tuple(grey) for grey in greys.tolist()} == {(0, 0, 0), (77, 77, 77)}


def test_packet_is_drawn_at_its_position():
    def brightest(at):
        frame = compose(CAMERA * 0, None, *one_cell(at), NOWHERE, ORIGIN, '')
        return middle_of(frame, cv2.applyColorMap(np.uint8([[255]]), cv2.COLORMAP_VIRIDIS)[0, 0])

    x, y = brightest((9, 5, 10))
    left, up = brightest((9, 9, 3))
    assert left < x - 20
    assert up < y - 20


def test_map_has_positive_y_up_and_x_right():
    corners = np.array([[-5.0, -5.0], [5.0, 5.0]])
    first = compose(CAMERA, None, *one_cell(), corners, ORIGIN, '')
    second = compose(CAMERA, None, *one_cell(), corners, Pose(4.0, 3.0, math.pi / 2), '')
    x, y = middle_of(first, VERMILLION)
    right, up = middle_of(second, VERMILLION)
    assert right > x + 20
    assert up < y - 20


@pytest.mark.parametrize('positions', [NOWHERE, np.zeros((1, 2)), 1e9 * places()])
def test_any_map_can_be_drawn(positions):
    nothing = np.zeros((3, 5)), np.zeros(4)
    assert compose(CAMERA, None, *nothing, positions, ORIGIN, 'π × 2').any()


@pytest.mark.parametrize(('name', 'complaint'), [
    ('run.txt', 'expected a name that ends in .mp4'),
    ('run', 'expected a name that ends in .mp4'),
    ('no/run.mp4', 'no does not exist'),
    ('folder.mp4', 'is a folder'),
])
def test_unusable_file_is_rejected_in_one_line(tmp_path, name, complaint):
    (tmp_path / 'folder.mp4').mkdir()
    with pytest.raises(UnusableInput, match=complaint) as caught:
        check_path(tmp_path / name)
    assert '\n' not in str(caught.value)
