# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
import math

import pytest
from helpers import twist
from hypothesis import given
from hypothesis import strategies as st

from ratslam_ros.core.common.angles import wrap
from ratslam_ros.core.common.odometry import (
    Motion,
    MotionFromOdometry,
    Odometry,
    Twist,
    moved,
    odometry_from_state,
    odometry_state,
)
from ratslam_ros.core.common.pose import Pose

SECOND = 10**9
START = Pose(1.0, -2.0, 0.7)


def end_of(pose: Pose, speed: float, rate: float, dt_s: float) -> Pose:
    """Return the end pose at constant speed and turn rate, in closed form."""
    if rate == 0.0:
        return Pose(
            pose.x_m + speed * dt_s * math.cos(pose.heading_rad),
            pose.y_m + speed * dt_s * math.sin(pose.heading_rad),
            pose.heading_rad,
        )
    radius = speed / rate
    end = pose.heading_rad + rate * dt_s
    return Pose(
        pose.x_m + radius * (math.sin(end) - math.sin(pose.heading_rad)),
        pose.y_m - radius * (math.cos(end) - math.cos(pose.heading_rad)),
        wrap(end),
    )


def assert_same(a: Pose, b: Pose, tolerance: float = 1e-12) -> None:
    assert math.hypot(a.x_m - b.x_m, a.y_m - b.y_m) < tolerance
    assert abs(wrap(a.heading_rad - b.heading_rad)) < tolerance


@given(st.floats(-3, 3), st.floats(-2.0, 2.0).filter(lambda w: w == 0 or abs(w) > 1e-3),
       st.floats(0.01, 2.0))
def test_moved_follows_the_exact_arc(speed: float, rate: float, dt_s: float) -> None:
    motion = Motion(dt_s, speed * dt_s, rate * dt_s)
    assert_same(moved(START, motion), end_of(START, speed, rate, dt_s), 1e-10)


def test_twist_applies_to_interval_before_its_stamp() -> None:
    """Twist n applies to (t[n-1], t[n]]; the first message gives no motion."""
    motion_of = MotionFromOdometry('twist')
    assert motion_of.update(twist(SECOND, 9.0, 9.0)) is None
    assert motion_of.update(twist(SECOND + SECOND // 4, 2.0, -1.0)) == Motion(0.25, 0.5, -0.25)
    assert motion_of.update(twist(2 * SECOND, 1.0, 0.0)) == Motion(0.75, 0.75, 0.0)


def test_interval_is_difference_of_integer_stamps() -> None:
    """Float seconds since the Unix epoch would lose the last 100 ns."""
    motion_of = MotionFromOdometry('twist')
    now = 1_700_000_000_123_456_789
    motion_of.update(twist(now))
    motion = motion_of.update(twist(now + 1_000_001, 1.0))
    assert motion is not None
    assert motion.dt_s == pytest.approx(0.001000001, rel=1e-12)


@given(st.lists(st.tuples(st.floats(-2, 2), st.floats(-3.0, 3.0)), min_size=1, max_size=20))
def test_pose_and_twist_give_equal_motions_on_arcs(twists: list[tuple[float, float]]) -> None:
    from_twist, from_pose = MotionFromOdometry('twist'), MotionFromOdometry('pose')
    wheel = Pose(4.0, 5.0, 3.0)
    a = b = START
    for n, (speed, rate) in enumerate([(0.0, 0.0), *twists]):
        if n > 0:
            wheel = moved(wheel, Motion(0.5, 0.5 * speed, 0.5 * rate))
        stamp = n * SECOND // 2
        motions = (
            from_twist.update(Odometry(stamp, Twist(speed, rate), wheel)),
            from_pose.update(Odometry(stamp, Twist(0.0, 0.0), wheel)),
        )
        if n == 0:
            assert motions == (None, None)
            continue
        assert motions[0] is not None
        assert motions[1] is not None
        a, b = moved(a, motions[0]), moved(b, motions[1])
    assert_same(a, b, 1e-9)


@given(st.floats(-2, 2), st.floats(-2, 2), st.sampled_from((-3.0, 0.0, 0.5)))
def test_sideways_arc_is_sum_of_both_components(ahead: float, left: float, rate: float) -> None:
    end, side = end_of(START, ahead, rate, 0.5), START._replace(heading_rad=0.7 + math.pi / 2.0)
    beside = end_of(side, left, rate, 0.5)
    end = Pose(end.x_m + beside.x_m - side.x_m, end.y_m + beside.y_m - side.y_m, end.heading_rad)
    for source in ('twist', 'pose'):
        motion_of = MotionFromOdometry(source)
        motion_of.update(Odometry(0, Twist(0.0, 0.0), START))
        message = Odometry(SECOND // 2, Twist(ahead, rate, left), end)
        motion = motion_of.update(odometry_from_state(odometry_state(message)))
        assert motion is not None
        assert_same(moved(START, motion), end, 1e-9)
        assert motion.distance_m * ahead >= -1e-9
        assert abs(motion.course_rad) <= math.pi / 2.0


@pytest.mark.parametrize('source', ['twist', 'pose'])
def test_gap_over_a_minute_gives_no_motion(source: str) -> None:
    motion_from = MotionFromOdometry(source)
    assert motion_from.update(twist(SECOND, 1.0)) is None
    assert motion_from.update(twist(SECOND + 60 * 10**9, 1.0)) is not None
    assert motion_from.update(twist(SECOND + 121 * 10**9, 1.0)) is None
    assert motion_from.update(twist(SECOND + 122 * 10**9, 1.0)) is not None


@pytest.mark.parametrize('source', ['twist', 'pose'])
def test_motion_after_a_gap_is_unknown(source: str) -> None:
    motions = MotionFromOdometry(source, 2.0)
    motions.update(twist(0, 1.0))
    assert motions.reaches(2 * SECOND)
    assert not motions.reaches(2 * SECOND + 1)
    motion = motions.update(twist(2 * SECOND, 1.0))
    assert motion is not None
    assert motion.is_known
    motion = motions.update(twist(4 * SECOND + 1, 1.0))
    assert motion == Motion(pytest.approx(2.0), 0.0, 0.0, is_known=False)
    motion = motions.update(twist(5 * SECOND + 1, 1.0))
    assert motion is not None
    assert motion.is_known


def test_gaps_of_the_default_are_stationary_after_a_minute() -> None:
    motions = MotionFromOdometry('twist', 60.0)
    assert motions.reaches(10**18)
    motions.update(twist(0, 1.0))
    assert motions.reaches(10**18)
    motion = motions.update(twist(60 * SECOND, 1.0))
    assert motion is not None
    assert motion.distance_m == pytest.approx(60.0)
    assert motions.update(twist(120 * SECOND + 1, 1.0)) is None


def test_queued_gap_leaves_the_pose_continuous() -> None:
    motions = MotionFromOdometry('twist', 2.0)
    motions.update(twist(0, 1.0))
    waiting = [twist(SECOND, 1.0), twist(9 * SECOND, 1.0), twist(10 * SECOND, 1.0)]
    assert_same(motions.ahead(waiting, START), moved(START, Motion(2.0, 2.0, 0.0)))
