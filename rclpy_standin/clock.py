# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Times, durations and clocks, including a clock driven by /clock."""

from __future__ import annotations

import time
from dataclasses import dataclass
from enum import IntEnum
from functools import total_ordering
from typing import Any

from rclpy_standin.types import message_class

S_TO_NS = 1_000_000_000
_MIN_NS, _MAX_NS = -(2**63), 2**63 - 1


class ClockType(IntEnum):
    """Time base of a clock."""

    UNINITIALIZED = 0
    ROS_TIME = 1
    SYSTEM_TIME = 2
    STEADY_TIME = 3


def _check_range(value: int) -> int:
    if not _MIN_NS <= value <= _MAX_NS:
        raise OverflowError('Total nanoseconds value is too large to store in C storage.')
    return value


@dataclass(init=False, order=True, unsafe_hash=True)
class Duration:
    """A duration, in nanoseconds."""

    nanoseconds: int

    def __init__(self, *, seconds: float = 0, nanoseconds: int = 0) -> None:
        self.nanoseconds = _check_range(int(seconds * S_TO_NS) + int(nanoseconds))

    def to_msg(self) -> Any:
        """Return the equivalent builtin_interfaces message."""
        sec, nanosec = divmod(self.nanoseconds, S_TO_NS)
        return message_class('builtin_interfaces/msg/Duration')(sec=sec, nanosec=nanosec)


@total_ordering
class Time:
    """A point in time, in nanoseconds, with the type of its clock."""

    __slots__ = ('clock_type', 'nanoseconds')

    def __init__(
        self,
        *,
        seconds: float = 0,
        nanoseconds: int = 0,
        clock_type: ClockType = ClockType.SYSTEM_TIME,
    ) -> None:
        if not isinstance(clock_type, ClockType):
            raise TypeError('Clock type must be a ClockType enum')
        if seconds < 0 or nanoseconds < 0:
            raise ValueError('Seconds and nanoseconds must not be negative')
        self.nanoseconds = _check_range(int(seconds * S_TO_NS) + int(nanoseconds))
        self.clock_type = clock_type

    def seconds_nanoseconds(self) -> tuple[int, int]:
        """Return the whole seconds and the remaining nanoseconds."""
        return divmod(self.nanoseconds, S_TO_NS)

    def _other_ns(self, other: Time) -> int:
        if other.clock_type != self.clock_type:
            raise TypeError("Can't use times with different clock types")
        return other.nanoseconds

    def __add__(self, other: object) -> Time:
        if isinstance(other, Duration):
            return Time(
                nanoseconds=self.nanoseconds + other.nanoseconds, clock_type=self.clock_type
            )
        return NotImplemented

    __radd__ = __add__

    def __sub__(self, other: object) -> Any:
        if isinstance(other, Time):
            return Duration(nanoseconds=self.nanoseconds - self._other_ns(other))
        if isinstance(other, Duration):
            return Time(
                nanoseconds=self.nanoseconds - other.nanoseconds, clock_type=self.clock_type
            )
        return NotImplemented

    def __eq__(self, other: object) -> bool:
        if isinstance(other, Time):
            return self.nanoseconds == self._other_ns(other)
        return NotImplemented

    def __lt__(self, other: object) -> bool:
        if isinstance(other, Time):
            return self.nanoseconds < self._other_ns(other)
        return NotImplemented

    def __hash__(self) -> int:
        return hash((self.nanoseconds, self.clock_type))

    def __repr__(self) -> str:
        return f'Time(nanoseconds={self.nanoseconds}, clock_type={self.clock_type.name})'

    def to_msg(self) -> Any:
        """Return the equivalent builtin_interfaces message."""
        sec, nanosec = self.seconds_nanoseconds()
        return message_class('builtin_interfaces/msg/Time')(sec=sec, nanosec=nanosec)

    @classmethod
    def from_msg(cls, msg: Any, clock_type: ClockType = ClockType.ROS_TIME) -> Time:
        """Return the time in a builtin_interfaces message."""
        if type(msg) is not message_class('builtin_interfaces/msg/Time'):
            raise TypeError('Must pass a builtin_interfaces.msg.Time object')
        return cls(seconds=msg.sec, nanoseconds=msg.nanosec, clock_type=clock_type)


class Clock:
    """A clock; clocks of type ROS_TIME can be simulated."""

    is_simulated = False
    """Whether the time is set from outside."""

    def __init__(self, *, clock_type: ClockType = ClockType.SYSTEM_TIME) -> None:
        if not isinstance(clock_type, ClockType):
            raise TypeError('Clock type must be a ClockType enum')
        self.clock_type = clock_type
        self.timers: set[Any] = set()
        """Timers to notify of jumps."""

    def __repr__(self) -> str:
        return f'Clock(clock_type={self.clock_type.name})'

    def now_ns(self) -> int:
        """Return the current time in ns."""
        return time.monotonic_ns() if self.clock_type == ClockType.STEADY_TIME else time.time_ns()

    def now(self) -> Time:
        """Return the current time."""
        return Time(nanoseconds=self.now_ns(), clock_type=self.clock_type)


class ROSClock(Clock):
    """A clock of ROS time: system time, or simulated time."""

    def __init__(self) -> None:
        super().__init__(clock_type=ClockType.ROS_TIME)
        self._simulated_ns = 0

    def now_ns(self) -> int:
        """Return the current time in ns; 0 if simulated time has not been set yet."""
        return self._simulated_ns if self.is_simulated else time.time_ns()

    def simulate(self, time_ns: int) -> None:
        """Set the simulated time; it is used while simulated time is active."""
        before_ns, self._simulated_ns = self.now_ns(), time_ns
        if self.is_simulated:
            self._notify(False, before_ns)

    def set_simulated(self, enabled: bool) -> None:
        """Use simulated time, or system time again."""
        if enabled != self.is_simulated:
            before_ns, self.is_simulated = self.now_ns(), enabled
            self._notify(True, before_ns)

    def _notify(self, is_switch: bool, before_ns: int) -> None:
        for timer in list(self.timers):
            timer.on_jump(is_switch, before_ns)
