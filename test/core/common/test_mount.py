# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Place of a laser on the robot, and its scans in the frame of the ROBOT."""

from __future__ import annotations

import itertools
import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from laser_rooms import MOUNTS, ROBOT, ROOM, mounted_scan
from numpy.typing import NDArray
from rooms import scan_in

from ratslam_ros.core.common.mount import CENTRED, FrameTree, Mount, UnusableMount
from ratslam_ros.core.common.pose import quaternion_of
from ratslam_ros.core.common.scan import checked_scan, points_of

LEVEL = (0.0, 0.0, 0.0, 1.0)


def turned(yaw_rad: float, is_upside_down: bool = False) -> tuple[float, float, float, float]:
    z, w = quaternion_of(yaw_rad)
    return (w, z, 0.0, 0.0) if is_upside_down else (0.0, 0.0, z, w)


def tree(*transforms: tuple[str, str, tuple[float, ...], tuple[float, ...]]) -> FrameTree:
    made = FrameTree()
    for parent, child, translation, quaternion in transforms:
        made.add(parent, child, translation, quaternion)  # type: ignore[arg-type]
    return made


def test_chains_of_frames_are_followed_in_both_directions() -> None:
    frames = tree(
        ('base_footprint', 'base_link', (0.0, 0.0, 0.1), LEVEL),
        ('base_link', 'deck', (0.1, 0.0, 0.2), turned(math.pi / 2)),
        ('deck', 'laser', (0.0, 0.2, 0.05), turned(math.pi / 2)),
    )
    assert frames.mount_of('laser', 'base_footprint') == Mount(-0.1, 0.0, math.pi)
    assert frames.mount_of('laser', 'deck') == Mount(0.0, 0.2, round(math.pi / 2, 9))
    assert frames.mount_of('base_link', 'deck') == Mount(0.0, 0.1, round(-math.pi / 2, 9))
    assert frames.mount_of('/laser', '/base_link') == frames.mount_of('laser', 'base_link')


def test_unknown_frames_and_those_of_the_robot() -> None:
    frames = tree(('base_link', 'laser', (0.1, 0.0, 0.2), LEVEL), ('odom', 'x', (0, 0, 0), LEVEL))
    assert frames.mount_of('', 'base_link') == CENTRED
    assert frames.mount_of('base_link', 'base_link') == CENTRED
    assert frames.mount_of('other', 'base_link') is None
    assert frames.mount_of('x', 'base_link') is None


def test_damaged_transforms_are_ignored_and_the_first_one_stays() -> None:
    frames = tree(
        ('base_link', 'a', (math.nan, 0.0, 0.0), LEVEL),
        ('base_link', 'b', (0.0, 0.0, 0.0), (0.0, 0.0, 0.0, 0.0)),
        ('base_link', 'c', (0.1, 0.0, 0.0), LEVEL),
        ('base_link', 'c', (0.2, 0.0, 0.0), LEVEL),
    )
    assert 'a' not in frames and 'b' not in frames
    assert frames.mount_of('c', 'base_link') == Mount(0.1)


def test_a_cycle_of_frames_ends() -> None:
    frames = tree(('a', 'b', (0.1, 0, 0), LEVEL), ('b', 'a', (0.1, 0, 0), LEVEL))
    assert frames.mount_of('a', 'base_link') is None


@pytest.mark.parametrize('roll_deg', [30.0, 90.0, 150.0])
def test_tilted_lasers_are_refused(roll_deg: float) -> None:
    half = math.radians(roll_deg) / 2
    frames = tree(('base_link', 'laser', (0, 0, 0), (math.sin(half), 0.0, 0.0, math.cos(half))))
    with pytest.raises(UnusableMount, match=r'laser is tilted by (30|90) degrees'):
        frames.mount_of('laser', 'base_link')


@given(
    st.floats(-1.0, 1.0), st.floats(-1.0, 1.0),
    st.one_of(st.floats(-4.0, 4.0), st.sampled_from([math.pi, -math.pi, 0.0])), st.booleans(),
)
def test_a_mount_described_by_its_own_transform_is_the_same(
    x_m: float, y_m: float, yaw_rad: float, is_upside_down: bool
) -> None:
    first = tree(('b', 'l', (x_m, y_m, 0.3), turned(yaw_rad, is_upside_down))).mount_of('l', 'b')
    assert first is not None
    assert first.is_upside_down == is_upside_down
    assert math.cos(first.yaw_rad - yaw_rad) == pytest.approx(1.0)
    transform = (first.x_m, first.y_m, 0.0), turned(first.yaw_rad, first.is_upside_down)
    assert tree(('b', 'l', *transform)).mount_of('l', 'b') == first


@pytest.mark.parametrize('mount', MOUNTS)
def test_points_lie_on_the_walls_wherever_the_laser_is(mount: Mount) -> None:
    points = points_of(mounted_scan(mount))
    assert len(points) > 700
    c, s = math.cos(ROBOT.heading_rad), math.sin(ROBOT.heading_rad)
    on_map = points @ np.array([[c, s], [-s, c]]) + (ROBOT.x_m, ROBOT.y_m)
    assert _distance_to_walls_m(on_map).max() < 1e-6


def test_a_laser_that_looks_ahead_at_the_centre_is_unchanged() -> None:
    seen = scan_in(ROOM, ROBOT)
    given = 0, seen.angle_min_rad, seen.angle_increment_rad, 0.0, 8.0, seen.ranges_m
    scan = checked_scan(*given)
    assert (scan.x_m, scan.y_m, scan.angle_min_rad) == (0.0, 0.0, seen.angle_min_rad)


def _distance_to_walls_m(points: NDArray[np.float64]) -> NDArray[np.float64]:
    distances = []
    for line in ROOM:
        for start, end in itertools.pairwise(line):
            a, along = np.array(start), np.array(end) - start
            share = np.clip((points - a) @ along / (along @ along), 0.0, 1.0)
            distances.append(np.hypot(*(points - a - share[:, None] * along).T))
    nearest: NDArray[np.float64] = np.min(distances, axis=0)
    return nearest
