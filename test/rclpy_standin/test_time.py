# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Timers, clocks, times, and simulated time."""

import time

import pytest
from builtin_interfaces.msg import Time as TimeMessage
from rclpy.clock import Clock, ClockType
from rclpy.duration import Duration
from rclpy.parameter import Parameter
from rclpy.time import Time
from rosgraph_msgs.msg import Clock as ClockMessage


def test_timer_runs_periodically_until_cancelled(ros) -> None:
    node, called = ros.node(), []
    timer = node.create_timer(0.01, lambda: called.append(time.monotonic()))
    ros.until(lambda: len(called) >= 5)
    assert called[4] - called[0] >= 0.03
    timer.cancel()
    count = len(called)
    ros.spin(0.05)
    assert len(called) == count
    timer.reset()
    ros.until(lambda: len(called) > count)
    assert node.destroy_timer(timer)
    count = len(called)
    ros.spin(0.05)
    assert len(called) == count


def test_timer_skips_missed_periods(ros) -> None:
    node, called = ros.node(), []
    node.create_timer(0.02, lambda: called.append(1))
    time.sleep(0.3)
    ros.executor.spin_once(timeout_sec=0.0)
    ros.executor.spin_once(timeout_sec=0.0)
    assert len(called) <= 2


def test_spin_once_runs_one_callback_or_times_out(ros) -> None:
    node, called = ros.node(), []
    start_s = time.monotonic()
    ros.executor.spin_once(timeout_sec=0.2)
    assert time.monotonic() - start_s < 10.0
    node.create_timer(0.0, lambda: called.append(1))
    ros.executor.spin_once(timeout_sec=5.0)
    assert called == [1]


def test_exception_in_callback_propagates_from_spin(ros) -> None:
    node = ros.node()

    def fail() -> None:
        raise ZeroDivisionError

    node.create_timer(0.01, fail)
    with pytest.raises(ZeroDivisionError):
        ros.until(lambda: False)


def test_time_and_duration_arithmetic() -> None:
    time_ = Time(seconds=2, nanoseconds=5)
    assert time_.nanoseconds == 2_000_000_005 and time_.seconds_nanoseconds() == (2, 5)
    assert time_ + Duration(seconds=1.5) == Time(nanoseconds=3_500_000_005)
    assert time_ - Time(seconds=1) == Duration(nanoseconds=1_000_000_005)
    assert time_ - Duration(seconds=2) == Time(nanoseconds=5)
    assert time_.to_msg() == TimeMessage(sec=2, nanosec=5)
    assert Time.from_msg(TimeMessage(sec=3)).nanoseconds == 3_000_000_000
    assert Duration(seconds=1) > Duration(nanoseconds=1)
    assert Duration(seconds=1.25).to_msg().nanosec == 250_000_000
    with pytest.raises(TypeError):
        assert time_ < Time(clock_type=ClockType.ROS_TIME)
    steady = Clock(clock_type=ClockType.STEADY_TIME)
    assert steady.now() <= steady.now() and steady.clock_type == ClockType.STEADY_TIME
    assert abs(Clock().now().nanoseconds - time.time_ns()) < 10e9


class ClockPublisher:
    """Publisher of /clock."""

    def __init__(self, ros) -> None:
        self._publisher = ros.node('clock_publisher').create_publisher(ClockMessage, '/clock', 10)

    def publish(self, seconds: float) -> None:
        message = ClockMessage()
        message.clock.sec = int(seconds)
        message.clock.nanosec = round(seconds % 1 * 1e9)
        self._publisher.publish(message)

    def is_matched(self) -> bool:
        return self._publisher.get_subscription_count() > 0


def now_s(node) -> float:
    return node.get_clock().now().nanoseconds / 1e9


def test_clock_and_timers_follow_simulated_time(make_ros) -> None:
    ros = make_ros('--ros-args', '-p', 'use_sim_time:=true')
    node, called, steady = ros.node(), [], []
    clock = ClockPublisher(ros)
    assert now_s(node) == 0.0
    node.create_timer(1.0, lambda: called.append(now_s(node)))
    node.create_timer(
        0.02, lambda: steady.append(1), clock=Clock(clock_type=ClockType.STEADY_TIME)
    )
    ros.until(clock.is_matched)
    ros.spin(0.1)
    assert called == [] and steady
    clock.publish(10.0)
    ros.until(lambda: now_s(node) == 10.0)
    ros.until(lambda: called == [10.0])
    clock.publish(10.5)
    ros.until(lambda: now_s(node) == 10.5)
    ros.spin(0.05)
    assert called == [10.0]
    clock.publish(11.2)
    ros.until(lambda: called == [10.0, 11.2])
    clock.publish(100.0)
    ros.until(lambda: called == [10.0, 11.2, 100.0])
    clock.publish(3.0)
    ros.until(lambda: now_s(node) == 3.0)
    clock.publish(4.5)
    ros.until(lambda: called == [10.0, 11.2, 100.0, 4.5])


def test_use_sim_time_parameter_switches_clock(ros) -> None:
    node = ros.node()
    assert now_s(node) > 1e9
    node.set_parameters([Parameter('use_sim_time', value=True)])
    assert now_s(node) < 1e9
    node.set_parameters([Parameter('use_sim_time', value=False)])
    assert now_s(node) > 1e9
