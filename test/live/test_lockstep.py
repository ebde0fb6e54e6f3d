# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Lockstep: it waits for exactly the actions that the nodes can give by then."""

import math
import random

import numpy as np
import pytest
from helpers import PERIOD_NS, START_NS

from ratslam_ros.core.common.odometry import Odometry, Twist
from ratslam_ros.core.common.pose import Pose
from ratslam_ros.core.config import Config
from ratslam_ros.core.ratslam import RatSLAM, ViewStep
from ratslam_ros.images import Frame
from ratslam_ros.live.lockstep import Lockstep
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


def test_the_action_of_an_image_is_certain_once_odometry_has_reached_it() -> None:
    lockstep = Lockstep(odometry_is_played=True)
    assert lockstep.publish(odometry(START_NS)) == []
    assert lockstep.publish(image(START_NS + 10 * MS)) == []
    assert lockstep.publish(odometry(START_NS + 20 * MS)) == [START_NS + 10 * MS]
    assert lockstep.publish(odometry(START_NS + 40 * MS)) == []
    assert lockstep.publish(image(START_NS + 40 * MS)) == [START_NS + 40 * MS]


def test_images_faster_than_odometry_do_not_wait_for_what_cannot_come() -> None:
    lockstep = Lockstep(odometry_is_played=True)
    lockstep.publish(odometry(START_NS))
    stamps = [START_NS + i * 30 * MS for i in range(1, 8)]
    assert [lockstep.publish(image(stamp)) for stamp in stamps] == [[]] * 7
    assert lockstep.publish(odometry(START_NS + 200 * MS)) == stamps[:6]


def test_a_refused_image_gives_no_action() -> None:
    lockstep = Lockstep(odometry_is_played=True)
    lockstep.publish(odometry(START_NS))
    assert lockstep.publish(image(START_NS)) == [START_NS]
    assert lockstep.publish(image(START_NS)) == []  # the same stamp again
    assert lockstep.publish(image(START_NS - 10 * MS)) == []
    assert lockstep.publish(odometry(START_NS + 100 * MS)) == []


def test_odometry_that_the_nodes_refuse_lets_nothing_go() -> None:
    lockstep = Lockstep(odometry_is_played=True)
    lockstep.publish(odometry(START_NS))
    lockstep.publish(image(START_NS + 10 * MS))
    assert lockstep.publish(odometry(START_NS + 20 * MS, math.nan)) == []
    assert lockstep.publish(odometry(START_NS + 30 * MS)) == [START_NS + 10 * MS]


def test_an_image_that_leaps_ahead_is_waited_for_when_others_have_followed() -> None:
    lockstep = Lockstep(odometry_is_played=True)
    lockstep.publish(odometry(START_NS))
    lockstep.publish(image(START_NS))
    leapt = START_NS + 3600 * 10**9
    certain = []
    for i in range(12):
        certain += lockstep.publish(odometry(leapt + i * PERIOD_NS))
        got = lockstep.publish(image(leapt + i * PERIOD_NS))
        assert not got or i >= 9
        certain += got
    assert certain == [leapt + i * PERIOD_NS for i in range(12)]


def test_with_visual_odometry_the_image_before_is_certain() -> None:
    lockstep = Lockstep(odometry_is_played=False)
    stamps = [START_NS + i * PERIOD_NS for i in range(4)]
    assert [lockstep.publish(image(stamp)) for stamp in stamps] == [
        [], [stamps[0]], [stamps[1]], [stamps[2]],
    ]  # fmt: skip


def test_recorded_templates_are_waited_for_too() -> None:
    lockstep = Lockstep(odometry_is_played=True)
    lockstep.publish(TemplateEvent(START_NS, START_NS, '{}'))
    assert lockstep.publish(odometry(START_NS)) == [START_NS]


def test_scans_are_waited_for_by_nobody() -> None:
    lockstep = Lockstep(odometry_is_played=True)
    lockstep.publish(image(START_NS))
    ranges_m = np.ones(3, np.float32)
    scan = ScanEvent(START_NS + PERIOD_NS, START_NS, 0.0, 0.1, 0.1, 8.0, ranges_m)
    assert lockstep.publish(scan) == []
    assert lockstep.publish(odometry(START_NS)) == [START_NS]


def test_a_second_pass_is_followed() -> None:
    lockstep = Lockstep(odometry_is_played=True)
    stamps = [START_NS + i * PERIOD_NS for i in range(60)]
    for _ in range(2):
        certain = []
        for stamp in stamps:
            certain += lockstep.publish(odometry(stamp))
            certain += lockstep.publish(image(stamp))
    assert certain[-20:] == stamps[-20:]
    assert len(certain) >= 50


@pytest.mark.parametrize('seed', range(20))
def test_never_more_than_ratslam_itself_has_acted_on(seed: int) -> None:
    """Whatever the order of stamps and of arrival; RatSLAM here knows its bound on lateness."""
    chance = random.Random(seed)
    slam, lockstep = RatSLAM(Config()), Lockstep(odometry_is_played=True)
    acted, certain = set(), []
    events: list[Event] = []
    for i in range(300):
        events.append(image(START_NS + i * PERIOD_NS + chance.choice([0, 0, 5, -300 * MS])))
        for k in range(chance.choice([0, 1, 1, 3])):
            late_ns = chance.choice([0, 0, 80 * MS])
            events.append(odometry(START_NS + i * PERIOD_NS + k * 30 * MS - late_ns))
    grey = np.random.default_rng(seed).integers(0, 256, (12, 64), dtype=np.uint8)
    for event in events:
        certain += lockstep.publish(event)
        if isinstance(event, ImageEvent):
            steps = slam.image(event.stamp_ns, grey)
        else:
            assert isinstance(event, OdometryEvent)
            steps = slam.odometry(
                Odometry(event.stamp_ns, Twist(event.linear_x, 0.0), Pose(0.0, 0.0, 0.0))
            )
        acted |= {step.stamp_ns for step in steps if isinstance(step, ViewStep)}
        assert set(certain) <= acted
    assert len(certain) > 200
