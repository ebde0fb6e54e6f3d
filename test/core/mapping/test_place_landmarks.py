# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Landmarks of experiences: they are counted, follow the map, and their number is limited."""

from __future__ import annotations

import math

import numpy as np
import pytest

from ratslam_ros.core.common.pose import Pose, composed
from ratslam_ros.core.mapping import place_landmarks
from ratslam_ros.core.mapping.place_landmarks import PlaceLandmarks

HERE = Pose(0.0, 0.0, 0.0)
POSES = np.array([[0.0, 0.0, 0.0], [1.0, 0.0, 0.5], [9.0, 9.0, -1.0]])
CORNERS = np.array([[2.0, 1.0, 0.3, 0.0], [3.0, -1.0, -2.0, 0.0], [4.0, 0.0, 1.0, 0.0]])


def seen_from(pose: np.ndarray, shapes: np.ndarray = CORNERS) -> np.ndarray:
    """Return landmarks of the map in the frame of a pose."""
    c, s = math.cos(pose[2]), math.sin(pose[2])
    x, y = (shapes[:, :2] - pose[:2]).T
    return np.stack([c * x + s * y, c * y - s * x, shapes[:, 2] - pose[2], shapes[:, 3]], axis=1)


def learned() -> PlaceLandmarks:
    landmarks = PlaceLandmarks()
    for number in (0, 1):
        landmarks.add(number, HERE, seen_from(POSES[number]), POSES)
    return landmarks


def test_landmark_seen_twice_is_stored_once() -> None:
    landmarks = learned()
    assert len(landmarks) == 3
    assert landmarks.on_map(POSES) == pytest.approx(CORNERS)


def test_landmark_seen_once_is_not_used() -> None:
    landmarks = PlaceLandmarks()
    landmarks.add(0, HERE, CORNERS, POSES)
    assert len(landmarks) == 3
    assert len(landmarks.on_map(POSES)) == 0


def test_offset_of_the_robot_is_included() -> None:
    landmarks = PlaceLandmarks()
    for number in (0, 1):
        robot = np.array(composed(Pose(*POSES[number]), Pose(0.3, -0.1, 1.2)))
        landmarks.add(number, Pose(0.3, -0.1, 1.2), seen_from(robot), POSES)
    assert landmarks.on_map(POSES) == pytest.approx(CORNERS)


def test_landmarks_follow_their_experience() -> None:
    moved = POSES.copy()
    moved[0] = 5.0, 0.0, math.pi / 2
    found = learned().on_map(moved)
    assert found[:, :2] == pytest.approx(np.array([[4.0, 2.0], [6.0, 3.0], [5.0, 4.0]]))


def test_corner_and_end_of_a_wall_at_one_place_differ() -> None:
    landmarks = PlaceLandmarks()
    both = np.array([[1.0, 1.0, 0.0, 0.0], [1.0, 1.0, 0.8, 0.0]])
    for number in (0, 1):
        landmarks.add(number, HERE, seen_from(POSES[number], both), POSES)
    assert landmarks.on_map(POSES) == pytest.approx(both)


def test_pruned_experience_hands_its_landmarks_over() -> None:
    landmarks = learned()
    stand_in = Pose(*POSES[1])
    x, y, _ = stand_in
    c, s = math.cos(stand_in.heading_rad), math.sin(stand_in.heading_rad)
    landmarks.hand_over(0, 1, Pose(-c * x - s * y, s * x - c * y, -stand_in.heading_rad))
    assert landmarks.on_map(POSES) == pytest.approx(CORNERS)
    landmarks.hand_over(1, -1, HERE)
    assert len(landmarks) == 0


def test_landmarks_of_excluded_experiences_are_left_out() -> None:
    landmarks = learned()
    assert len(landmarks.on_map(POSES, {0})) == 0
    assert len(landmarks.on_map(POSES, {1, 2})) == 3
    landmarks.remove_owned({0})
    assert len(landmarks) == 0


def test_number_of_landmarks_is_limited(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(place_landmarks, 'MAX_LANDMARK_COUNT', 4)
    landmarks = learned()
    for n in range(5):  # each replaces the one that was seen least often: the one before
        landmarks.add(2, HERE, np.array([[n, 5.0, 0.0, 0.0]]), POSES)
    assert len(landmarks) == 4
    assert landmarks.on_map(POSES) == pytest.approx(CORNERS)
