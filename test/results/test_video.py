# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The video: content of a frame, the written file, and rejected arguments."""

import math

import cv2
import numpy as np
import pytest

from ratslam_ros.errors import UnusableInput
from ratslam_ros.results.video import VERMILLION, Activity, check_path, compose

SIZE = (640, 360)
CAMERA = np.full((120, 160, 3), (10, 200, 30), np.uint8)
VIEW = np.arange(200, dtype=np.uint8).reshape(10, 20)
NOWHERE = np.empty((0, 2))


def one_cell(n_theta=36, n_y=11, n_x=21, at=(9, 5, 10)):
    plane, headings = np.zeros((n_y, n_x)), np.zeros(n_theta)
    headings[at[0]] = plane[at[1:]] = 1.0
    return Activity(plane, headings)


def places(n=50):
    angle = np.linspace(0.0, 5.0, n)
    return np.column_stack((10.0 * np.cos(angle), 6.0 * np.sin(angle)))


def middle_of(frame, colour):
    """Return the mean (x, y) px of the pixels of exactly this colour."""
    y, x = np.nonzero(np.all(frame == colour, axis=2))
    return float(x.mean()), float(y.mean())


def test_camera_is_top_left_and_map_right():
    frame = compose(SIZE, CAMERA, VIEW, one_cell(), places(), (0.0, 0.0, 0.0), 'a caption')
    assert frame.shape == (360, 640, 3)
    x, y = middle_of(frame, CAMERA[0, 0])
    assert x < 200
    assert y < 200
    assert middle_of(frame, VERMILLION)[0] > 320


def test_template_is_enlarged_without_smoothing():
    view = np.array([[0, 77], [77, 0]], np.uint8)
    frame = compose(SIZE, CAMERA, view, one_cell(), NOWHERE, None)
    greys = np.unique(frame[60:150, 210:310].reshape(-1, 3), axis=0)
    assert {tuple(grey) for grey in greys.tolist()} <= {(0, 0, 0), (77, 77, 77), (255, 255, 255)}


def test_packet_is_drawn_at_its_position():
    def brightest(at):
        frame = compose(SIZE, CAMERA * 0, None, one_cell(at=at), NOWHERE, None)
        return middle_of(frame, cv2.applyColorMap(np.uint8([[255]]), cv2.COLORMAP_VIRIDIS)[0, 0])

    x, y = brightest((9, 5, 10))
    left, up = brightest((9, 9, 3))
    assert left < x - 20
    assert up < y - 20


def test_map_has_positive_y_up_and_x_right():
    corners = np.array([[-5.0, -5.0], [5.0, 5.0]])
    first = compose(SIZE, CAMERA, None, one_cell(), corners, (0.0, 0.0, 0.0))
    second = compose(SIZE, CAMERA, None, one_cell(), corners, (4.0, 3.0, math.pi / 2))
    x, y = middle_of(first, VERMILLION)
    right, up = middle_of(second, VERMILLION)
    assert right > x + 20
    assert up < y - 20


@pytest.mark.parametrize('robot', [None, (0.0, 0.0, 0.0), (math.nan, 0.0, 0.0)])
@pytest.mark.parametrize('positions', [NOWHERE, np.zeros((1, 2)), places(), 1e9 * places()])
@pytest.mark.parametrize('size', [(320, 180), (1280, 720)])
def test_any_map_and_pose_can_be_drawn(robot, positions, size):
    nothing = Activity(np.zeros((3, 5)), np.zeros(4))
    frame = compose(size, CAMERA[:, :, 0], None, nothing, positions, robot, 'π × 2')
    assert frame.shape == (size[1], size[0], 3)


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
