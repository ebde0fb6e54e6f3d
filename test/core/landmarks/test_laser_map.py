# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Landmark map from odometry and laser scans."""

from __future__ import annotations

import math

import numpy as np
import pytest
from laser_rooms import CORNERS, ROOM, noisy_scan

from ratslam_ros.core.common.odometry import Motion, moved
from ratslam_ros.core.common.pose import Pose, composed, inverse
from ratslam_ros.core.landmarks.laser_map import LaserMap
from ratslam_ros.messages.json_schema import encode
from ratslam_ros.messages.landmarks import LandmarksPayload

START = Pose(-1.0, 0.0, 0.0)


class Drive:
    """A robot that circles in the room, with odometry that measures turns badly."""

    def __init__(self, seed: int = 1) -> None:
        self.map = LaserMap()
        self.pose = self.dead_reckoning = START
        self.rng = np.random.default_rng(seed)
        self.tick = 0

    def go(self, steps: int, people: bool = False, speed_m: float = 0.05) -> None:
        for _ in range(steps):
            self.tick += 1
            motion = Motion(0.1, speed_m, speed_m)
            self.pose = moved(self.pose, motion)
            measured = Motion(0.1, speed_m * 1.01, speed_m * 1.03)
            self.dead_reckoning = moved(self.dead_reckoning, measured)
            self.map.integrate(measured)
            angle = 0.12 * self.tick
            at = (0.5 * math.cos(angle), 1.0 + 0.8 * math.sin(angle))
            self.map.scan(
                noisy_scan(ROOM, self.pose, self.rng, people=(at,) if people else (), beams=181,
                           stamp_ns=self.tick * 10**8)
            )

    def error_m(self, estimate: Pose) -> float:
        return math.dist(estimate[:2], composed(inverse(START), self.pose)[:2])

    def corner_errors_m(self) -> list[float]:
        """Return the distance of every landmark from the nearest corner of the room."""
        positions = self.map.memory.map.features().positions_m
        return [
            float(np.hypot(*(CORNERS - (x + START.x_m, y + START.y_m)).T).min())
            for x, y in positions
        ]


def test_map_holds_the_corners_and_corrects_the_odometry() -> None:
    drive = Drive()
    drive.go(500)
    assert 8 <= len(drive.map) <= 30
    assert max(drive.corner_errors_m()) < 0.12
    by_odometry = composed(inverse(START), drive.dead_reckoning)
    assert drive.error_m(drive.map.pose) < 0.08
    assert drive.error_m(by_odometry) > 0.3


def test_people_who_walk_about_leave_no_landmarks() -> None:
    drive = Drive()
    drive.go(400, people=True)
    assert len(drive.map) >= 8
    assert max(drive.corner_errors_m()) < 0.15
    assert drive.error_m(drive.map.pose) < 0.1


def test_standing_robot_uses_one_scan() -> None:
    drive = Drive()
    drive.go(50, speed_m=0.0)
    assert drive.map.scan_count == 1 and len(drive.map) == 0


def test_lost_robot_finds_its_place_again() -> None:
    drive = Drive()
    drive.go(400)
    count = len(drive.map)
    drive.map.integrate(Motion(5.0, 0.0, 0.0, is_known=False))
    drive.pose = Pose(0.5, -1.0, 2.0)  # Carried.
    assert drive.map.is_lost
    drive.go(60)
    assert not drive.map.is_lost and drive.map.relocated_count == 1
    assert drive.error_m(drive.map.pose) < 0.2
    assert len(drive.map) <= count + 6


def test_relocated_robot_continues_to_map() -> None:
    drive = Drive()
    drive.go(60)
    count = len(drive.map)
    drive.map.integrate(Motion(5.0, 0.0, 0.0, is_known=False))
    drive.pose = Pose(0.5, -1.0, 2.0)
    drive.go(240)
    assert drive.map.relocated_count == 1 and len(drive.map) >= count + 3
    assert max(drive.corner_errors_m()) < 0.12


def test_switching_mapping_off_adds_nothing() -> None:
    drive = Drive()
    drive.map.mapping = False
    drive.go(50)
    assert len(drive.map) == 0


def test_restored_map_continues_identically() -> None:
    drive, other = Drive(), Drive()
    drive.go(120)
    other.go(120)
    state = other.map.state()
    other.map = LaserMap()
    other.map.restore(state)
    drive.go(60)
    other.go(60)
    texts = [encode(LandmarksPayload.of(1, one.map, 'map')) for one in (drive, other)]
    assert texts[0] == texts[1] and len(drive.map) > 0


def test_scans_without_landmarks_change_nothing_but_the_count() -> None:
    laser_map = LaserMap()
    from rooms import scan_of_ranges

    for ranges in ([], [math.nan] * 9, [-1.0] * 9):
        laser_map.integrate(Motion(1.0, 1.0, 0.0))
        assert laser_map.scan(scan_of_ranges(ranges))
    assert laser_map.pose == pytest.approx((3.0, 0.0, 0.0)) and len(laser_map) == 0
