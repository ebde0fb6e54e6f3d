# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Lockstep: predicts exactly the actions that the nodes can publish by then."""

import math
import random

import numpy as np
import pytest
from helpers import PERIOD_NS, START_NS

from ratslam_ros.core.common.odometry import Odometry, Twist
from ratslam_ros.core.common.pose import Pose
from ratslam_ros.core.config import Config
from ratslam_ros.images import Frame
from ratslam_ros.live.lockstep import Lockstep
from ratslam_ros.pipeline.items import ViewStep
from ratslam_ros.pipeline.ratslam import RatSLAM
from ratslam_ros.recordings import (
    Event,
    ImageEvent,
    OdometryEvent,
    Orientation,
    ScanEvent,
    TemplateEvent,
)

MS = 1_000_000


def image(stamp_ns: int) -> ImageEvent:
    return ImageEvent(stamp_ns, stamp_ns, Frame(np.zeros((2, 2), np.uint8)))


def odometry(stamp_ns: int, speed: float = 1.0) -> OdometryEvent:
    return OdometryEvent(
        stamp_ns, stamp_ns, speed, 0.0, 0.0, 0.0, Orientation(0.0, 0.0, 0.0, 1.0)
    )


def test_image_is_processed_once_odometry_reaches_its_stamp() -> None:
    lockstep = Lockstep(odometry_is_played=True)
    assert lockstep.publish(odometry(START_NS)) == []
    assert lockstep.publish(image(START_NS + 10 * MS)) == []
    assert lockstep.publish(odometry(START_NS + 20 * MS)) == [START_NS + 10 * MS]
    assert lockstep.publish(odometry(START_NS + 40 * MS)) == []
    assert lockstep.publish(image(START_NS + 40 * MS)) == [START_NS + 40 * MS]


def test_images_faster_than_odometry_wait_for_odometry() -> None:
    lockstep = Lockstep(odometry_is_played=True)
    lockstep.publish(odometry(START_NS))
    stamps = [START_NS + i * 30 * MS for i in range(1, 8)]
    assert [lockstep.publish(image(stamp)) for stamp in stamps] == [[]] * 7
    assert lockstep.publish(odometry(START_NS + 200 * MS)) == stamps[:6]


def test_refused_image_gives_no_action() -> None:
    lockstep = Lockstep(odometry_is_played=True)
    lockstep.publish(odometry(START_NS))
    assert lockstep.publish(image(START_NS)) == [START_NS]
    assert lockstep.publish(image(START_NS)) == []  # the same stamp again
    assert lockstep.publish(image(START_NS - 10 * MS)) == []
    assert lockstep.publish(odometry(START_NS + 100 * MS)) == []


def test_refused_odometry_releases_nothing() -> None:
    lockstep = Lockstep(odometry_is_played=True)
    lockstep.publish(odometry(START_NS))
    lockstep.publish(image(START_NS + 10 * MS))
    assert lockstep.publish(odometry(START_NS + 20 * MS, math.nan)) == []
    assert lockstep.publish(odometry(START_NS + 30 * MS)) == [START_NS + 10 * MS]


def test_stamps_that_jump_ahead_are_released_after_confirmation() -> None:
    lockstep = Lockstep(odometry_is_played=True)
    lockstep.publish(odometry(START_NS))
    lockstep.publish(image(START_NS))
    jumped_ns = START_NS + 3600 * 10**9
    predicted = []
    for i in range(12):
        predicted += lockstep.publish(odometry(jumped_ns + i * PERIOD_NS))
        got = lockstep.publish(image(jumped_ns + i * PERIOD_NS))
        assert not got or i >= 9
        predicted += got
    assert predicted == [jumped_ns + i * PERIOD_NS for i in range(12)]


def test_visual_odometry_releases_the_previous_image() -> None:
    lockstep = Lockstep(odometry_is_played=False)
    stamps = [START_NS + i * PERIOD_NS for i in range(4)]
    assert [lockstep.publish(image(stamp)) for stamp in stamps] == [
        [], [stamps[0]], [stamps[1]], [stamps[2]],
    ]


def test_recorded_templates_are_awaited() -> None:
    lockstep = Lockstep(odometry_is_played=True)
    lockstep.publish(TemplateEvent(START_NS, START_NS, '{}'))
    assert lockstep.publish(odometry(START_NS)) == [START_NS]


def test_scans_release_nothing() -> None:
    lockstep = Lockstep(odometry_is_played=True)
    lockstep.publish(image(START_NS))
    ranges_m = np.ones(3, np.float32)
    scan = ScanEvent(START_NS + PERIOD_NS, START_NS, 0.0, 0.1, 0.1, 8.0, ranges_m)
    assert lockstep.publish(scan) == []
    assert lockstep.publish(odometry(START_NS)) == [START_NS]


def test_second_pass_starts_over() -> None:
    lockstep = Lockstep(odometry_is_played=True)
    stamps = [START_NS + i * PERIOD_NS for i in range(60)]
    for _ in range(2):
        predicted = []
        for stamp in stamps:
            predicted += lockstep.publish(odometry(stamp))
            predicted += lockstep.publish(image(stamp))
    assert predicted[-20:] == stamps[-20:]
    assert len(predicted) >= 50


@pytest.mark.parametrize('seed', range(4))
def test_predictions_are_subset_of_processed_views(seed: int) -> None:
    """For random orders of stamps and arrival; RatSLAM has its default bound on lateness."""
    chance = random.Random(seed)
    slam, lockstep = RatSLAM(Config()), Lockstep(odometry_is_played=True)
    acted, predicted = set(), []
    events: list[Event] = []
    for i in range(300):
        events.append(image(START_NS + i * PERIOD_NS + chance.choice([0, 0, 5, -300 * MS])))
        for k in range(chance.choice([0, 1, 1, 3])):
            late_ns = chance.choice([0, 0, 80 * MS])
            events.append(odometry(START_NS + i * PERIOD_NS + k * 30 * MS - late_ns))
    grey = np.random.default_rng(seed).integers(0, 256, (24, 64), dtype=np.uint8)
    for event in events:
        predicted += lockstep.publish(event)
        if isinstance(event, ImageEvent):
            steps = slam.image(event.stamp_ns, grey)
        else:
            assert isinstance(event, OdometryEvent)
            steps = slam.odometry(
                Odometry(event.stamp_ns, Twist(event.linear_x, 0.0), Pose(0.0, 0.0, 0.0))
            )
        acted |= {step.stamp_ns for step in steps if isinstance(step, ViewStep)}
        assert set(predicted) <= acted
    assert len(predicted) > 200
