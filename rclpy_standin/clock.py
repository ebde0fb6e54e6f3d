# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Times, durations and clocks, including a clock driven by /clock."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable
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


class ClockChange(IntEnum):
    """Whether a jump switches simulated time on or off."""

    ROS_TIME_NO_CHANGE = 1
    ROS_TIME_ACTIVATED = 2
    ROS_TIME_DEACTIVATED = 3
    SYSTEM_TIME_NO_CHANGE = 4


def _check_range(value: int) -> int:
    if not _MIN_NS <= value <= _MAX_NS:
        raise OverflowError('Total nanoseconds value is too large to store in C storage.')
    return value


@total_ordering
class Duration:
    """A duration, in nanoseconds."""

    __slots__ = ('nanoseconds',)

    def __init__(self, *, seconds: float = 0, nanoseconds: int = 0) -> None:
        self.nanoseconds = _check_range(int(seconds * S_TO_NS) + int(nanoseconds))

    def __eq__(self, other: object) -> bool:
        if isinstance(other, Duration):
            return self.nanoseconds == other.nanoseconds
        return NotImplemented

    def __lt__(self, other: object) -> bool:
        if isinstance(other, Duration):
            return self.nanoseconds < other.nanoseconds
        return NotImplemented

    def __hash__(self) -> int:
        return hash(self.nanoseconds)

    def __repr__(self) -> str:
        return f'Duration(nanoseconds={self.nanoseconds})'

    def __str__(self) -> str:
        return f'{self.nanoseconds} nanoseconds'

    def to_msg(self) -> Any:
        """Return the equivalent builtin_interfaces message."""
        sec, nanosec = divmod(self.nanoseconds, S_TO_NS)
        return message_class('builtin_interfaces/msg/Duration')(sec=sec, nanosec=nanosec)

    @classmethod
    def from_msg(cls, msg: Any) -> Duration:
        """Return the duration in a builtin_interfaces message."""
        if type(msg) is not message_class('builtin_interfaces/msg/Duration'):
            raise TypeError('Must pass a builtin_interfaces.msg.Duration object')
        return cls(seconds=msg.sec, nanoseconds=msg.nanosec)


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


class JumpThreshold:
    """Time jumps that trigger a callback."""

    def __init__(
        self,
        *,
        min_forward: Duration | None,
        min_backward: Duration | None,
        on_clock_change: bool = True,
    ) -> None:
        if min_forward is not None and min_forward.nanoseconds <= 0:
            raise ValueError('min_forward must be a positive non-zero duration')
        if min_backward is not None and min_backward.nanoseconds >= 0:
            raise ValueError('min_backward must be a negative non-zero duration')
        if not on_clock_change and min_forward is None and min_backward is None:
            raise ValueError('At least one jump threshold must be enabled')
        self.min_forward = min_forward
        self.min_backward = min_backward
        self.on_clock_change = on_clock_change

    def crossed_by(self, jump: TimeJump) -> bool:
        """Return whether a jump triggers the callback."""
        if jump.clock_change != ClockChange.ROS_TIME_NO_CHANGE:
            return self.on_clock_change
        return (self.min_forward is not None and jump.delta >= self.min_forward) or (
            self.min_backward is not None and jump.delta <= self.min_backward
        )


class TimeJump:
    """A jump of a clock's time."""

    def __init__(self, clock_change: ClockChange, delta: Duration) -> None:
        self.clock_change = clock_change
        self.delta = delta


class JumpHandle:
    """Registration of callbacks for time jumps."""

    def __init__(
        self,
        clock: Clock,
        threshold: JumpThreshold,
        pre_callback: Callable[[], None] | None,
        post_callback: Callable[[TimeJump], None] | None,
    ) -> None:
        if pre_callback is None and post_callback is None:
            raise ValueError('One of pre_callback or post_callback must be callable')
        self._clock = clock
        self.threshold = threshold
        self.pre_callback = pre_callback
        self.post_callback = post_callback

    def unregister(self) -> None:
        """Remove the callbacks from the clock."""
        self._clock._jumps.pop(id(self), None)

    def __enter__(self) -> JumpHandle:
        return self

    def __exit__(self, *_: object) -> None:
        self.unregister()


class Clock:
    """A clock; clocks of type ROS_TIME can be simulated."""

    def __new__(cls, *, clock_type: ClockType = ClockType.SYSTEM_TIME) -> Clock:
        """Create a ROSClock for ROS_TIME, a Clock otherwise."""
        if not isinstance(clock_type, ClockType):
            raise TypeError('Clock type must be a ClockType enum')
        return super().__new__(ROSClock if clock_type == ClockType.ROS_TIME else cls)

    def __init__(self, *, clock_type: ClockType = ClockType.SYSTEM_TIME) -> None:
        self.clock_type = clock_type
        self._jumps: dict[int, JumpHandle] = {}
        self.timers: set[Any] = set()
        """Timers to notify of jumps, in addition to the registered callbacks."""

    def __repr__(self) -> str:
        return f'Clock(clock_type={self.clock_type.name})'

    @property
    def is_simulated(self) -> bool:
        """Whether the time is set from outside."""
        return False

    def now_ns(self) -> int:
        """Return the current time in ns."""
        return time.monotonic_ns() if self.clock_type == ClockType.STEADY_TIME else time.time_ns()

    def now(self) -> Time:
        """Return the current time."""
        return Time(nanoseconds=self.now_ns(), clock_type=self.clock_type)

    def create_jump_callback(
        self,
        threshold: JumpThreshold,
        *,
        pre_callback: Callable[[], None] | None = None,
        post_callback: Callable[[TimeJump], None] | None = None,
    ) -> JumpHandle:
        """Register callbacks for before and after a jump; they stay until ``unregister``."""
        handle = JumpHandle(self, threshold, pre_callback, post_callback)
        self._jumps[id(handle)] = handle
        return handle


class ROSClock(Clock):
    """A clock of ROS time: system time, or simulated time."""

    def __new__(cls, **_: Any) -> ROSClock:
        """Create a ROSClock."""
        return object.__new__(cls)

    def __init__(self, **_: Any) -> None:
        super().__init__(clock_type=ClockType.ROS_TIME)
        self._active = False
        self._override_ns = 0
        self._lock = threading.Lock()

    @property
    def ros_time_is_active(self) -> bool:
        """Whether simulated time is active."""
        return self._active

    @property
    def is_simulated(self) -> bool:
        """Whether the time is set from outside."""
        return self._active

    def now_ns(self) -> int:
        """Return the current time in ns; 0 if simulated time has not been set yet."""
        return self._override_ns if self._active else time.time_ns()

    def set_ros_time_override(self, time: Time) -> None:
        """Set the simulated time; it is used while simulated time is active."""
        if not isinstance(time, Time):
            raise TypeError(f'Time must be specified as rclpy.time.Time. Received type: {time!r}')
        if not self._active:
            self._override_ns = time.nanoseconds
            return
        delta = Duration(nanoseconds=time.nanoseconds - self._override_ns)
        jump = TimeJump(ClockChange.ROS_TIME_NO_CHANGE, delta)
        self._jump(jump, lambda: setattr(self, '_override_ns', time.nanoseconds))

    def _set_ros_time_is_active(self, enabled: bool) -> None:
        if enabled == self._active:
            return
        change = ClockChange.ROS_TIME_ACTIVATED if enabled else ClockChange.ROS_TIME_DEACTIVATED
        self._jump(TimeJump(change, Duration()), lambda: setattr(self, '_active', enabled))

    def _jump(self, jump: TimeJump, change: Callable[[], None]) -> None:
        handles = [h for h in list(self._jumps.values()) if h.threshold.crossed_by(jump)]
        for handle in handles:
            if handle.pre_callback is not None:
                handle.pre_callback()
        before_ns = self.now_ns()
        with self._lock:
            change()
        for timer in list(self.timers):
            timer.on_jump(jump, before_ns)
        for handle in handles:
            if handle.post_callback is not None:
                handle.post_callback(jump)
