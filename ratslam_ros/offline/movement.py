# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""How far a robot moves by its odometry, and motions that no robot can make."""

from __future__ import annotations

from ratslam_ros.core.common.odometry import MotionFromOdometry, Odometry

FAST_MPS, FAST_RADPS = 100.0, 50.0
"""Speeds that no robot on the ground has: a fault of the driver, or other units."""

FAST_M, FAST_RAD = 0.5, 0.1
"""Shorter motions between two messages are not fast: their stamps are inexact."""


class Movement:
    """Sums over the messages of an odometry topic, in the order of the recording."""

    def __init__(self, source: str, topic: str) -> None:
        """Begin with no message of a topic, of which a part is used: twist or pose."""
        self._name, self._motion_of = f'{source} of {topic}', MotionFromOdometry(source)
        self.distance_m = self.turn_rad = 0.0
        """Length of the path, and sum of the turns in both directions."""
        self._count = self._fast_count = 0
        self._driven_s = self._first_s = self._most_m = self._most_rad = 0.0

    def add(self, message: Odometry) -> None:
        """Add the motion since the last message."""
        motion = self._motion_of.update(message) if self._motion_of.accepts(message) else None
        if motion is None:
            return
        moved_m, turned_rad, dt_s = abs(motion.distance_m), abs(motion.turn_rad), motion.dt_s
        self.distance_m += moved_m
        self.turn_rad += turned_rad
        self._count += 1
        self._driven_s += dt_s
        if dt_s > 0.0 and (  # the replay refuses stamps that do not increase
            moved_m > max(FAST_MPS * dt_s, FAST_M) or turned_rad > max(FAST_RADPS * dt_s, FAST_RAD)
        ):
            self._first_s = self._first_s or self._driven_s
            self._fast_count += 1
            self._most_m = max(self._most_m, moved_m)
            self._most_rad = max(self._most_rad, turned_rad)

    @property
    def warning(self) -> str:
        """A warning if some motions are faster than any robot, or ''."""
        if not self._fast_count:
            return ''
        return (
            f'the {self._name} jumps at {self._fast_count} of {self._count} messages, first at '
            f'{self._first_s:.1f} s, by up to {self._most_m:.3g} m and {self._most_rad:.3g} rad: '
            'expected m and rad (m/s and rad/s), and no jumps, after which the map is wrong; '
            'correct the driver or the units, replay a part without jumps with --start and '
            '--duration, or try --visual-odometry'
        )
