# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Odometry shows which views are of different places although they look alike."""

from __future__ import annotations

import math
from dataclasses import replace

import cv2
import numpy as np
import pytest
from helpers import extended
from states import differences

from ratslam_ros.core.common.odometry import Odometry, Twist
from ratslam_ros.core.common.pose import Pose
from ratslam_ros.core.config import AUTOMATIC
from ratslam_ros.core.vision import look_alikes
from ratslam_ros.core.vision.encoder import Image
from ratslam_ros.core.vision.local_view import LocalView, ViewMatch
from ratslam_ros.core.vision.look_alikes import LookAlikes
from ratslam_ros.core.vision.match_threshold import RELATED_RATIO

HEIGHT, WIDTH, STEP_PX = 36, 48, 5
PERIOD_NS = 200_000_000
COUNT, REPEAT = 300, 100

PARAMETERS = extended(
    'local_view', vt_descriptor='gradients', template_x_size=12, template_y_size=9,
    vt_shift_match=1, vt_match_threshold=AUTOMATIC, vt_match_ratio=AUTOMATIC,
    vt_recent_templates=AUTOMATIC,
)


def wall(period: int, count: int = COUNT) -> list[Image]:
    """Return the views along a wall whose pattern repeats after a number of views."""
    rng = np.random.default_rng(5)
    pattern = np.tile(rng.normal(size=(HEIGHT, period * STEP_PX)), -(-count // period) + 3)
    smooth = cv2.GaussianBlur(pattern, (0, 0), 2.0)
    smooth = 128.0 + 50.0 * smooth / smooth.std()
    return [
        (smooth[:, x : x + WIDTH] + rng.normal(size=(HEIGHT, WIDTH))).clip(0, 255).astype(np.uint8)
        for x in range(0, count * STEP_PX, STEP_PX)
    ]


def message(index: int, turn_radps: float = 0.0) -> Odometry:
    return Odometry(1 + index * PERIOD_NS, Twist(1.0, turn_radps), Pose(0.0, 0.0, 0.0))


def drive(
    local_view: LocalView, images: list[Image], turn_radps: float = 0.0, scale_known: bool = True
) -> list[ViewMatch]:
    matches = []
    for index, image in enumerate(images):
        odometry = message(index, turn_radps)
        local_view.follow(replace(odometry, scale_known=scale_known))
        matches.append(local_view.match(image))
    return matches


def recognised(matches: list[ViewMatch]) -> int:
    """Return how many views of the second and third pattern match one of the first."""
    first = max(match.template_id for match in matches[:REPEAT])
    return sum(0 <= m.template_id <= first for m in matches[REPEAT + 5 :])


def test_look_alikes_along_a_straight_wall_are_told_apart() -> None:
    local_view = LocalView(PARAMETERS)
    matches = drive(local_view, wall(REPEAT))
    assert recognised(matches) == 0
    assert matches[-1].threshold < 0.5 * matches[REPEAT // 2].threshold


def test_images_alone_cannot_tell_them_apart() -> None:
    local_view = LocalView(PARAMETERS)
    assert recognised([local_view.match(image) for image in wall(REPEAT)]) > 150


def test_odometry_of_unknown_scale_cannot_tell_them_apart() -> None:
    images = wall(REPEAT)
    alone = LocalView(PARAMETERS)
    expected = [alone.match(image) for image in images]
    assert drive(LocalView(PARAMETERS), images, scale_known=False) == expected


def test_rounds_on_a_circle_are_recognised() -> None:
    """With a wrong gain of turns, a round is open by 0.44 of its length, and no look-alike."""
    turn_radps = 0.65 * 2.0 * math.pi / (REPEAT * PERIOD_NS * 1e-9)
    matches = drive(LocalView(PARAMETERS), wall(REPEAT), turn_radps)
    assert recognised(matches) > 150


def test_a_wall_without_repetition_keeps_the_threshold() -> None:
    images = wall(COUNT + 20)
    fixed = LocalView(replace(PARAMETERS, vt_match_ratio=RELATED_RATIO))
    expected = [fixed.match(image) for image in images]
    found = drive(LocalView(PARAMETERS), images)
    assert found[-1].threshold == pytest.approx(expected[-1].threshold, rel=0.1)


def test_a_robot_that_was_carried_may_be_anywhere() -> None:
    local_view = LocalView(PARAMETERS)
    images = wall(COUNT + 20)
    drive(local_view, images[:REPEAT])
    local_view.relocated()
    assert not local_view.match(images[20]).is_new


def test_a_restored_local_view_continues_the_estimate() -> None:
    images = wall(REPEAT)
    one, other = LocalView(PARAMETERS), LocalView(PARAMETERS)
    drive(one, images[:250])
    other.restore(one.state())
    one.follow(message(250)), other.follow(message(250))
    for image in images[250:]:
        assert one.match(image) == other.match(image)
    saved, again = one.state()['look_alikes'], other.state()['look_alikes']
    assert list(differences(saved, again)) == []


def test_memory_is_bounded_by_thinning(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(look_alikes, 'MAX_VIEW_COUNT', 100)
    encoder = LocalView(PARAMETERS)
    found = LookAlikes(encoder._layout)
    view = encoder.encode(wall(REPEAT, 5)[0])
    assert view is not None
    follow = LocalView(PARAMETERS)._recognition.motion
    for index in range(300):
        motion = follow.update(message(index))
        if motion is not None:
            found.move(motion)
        found.see(view)
    assert 40 < len(found.state()['views']) < 100
