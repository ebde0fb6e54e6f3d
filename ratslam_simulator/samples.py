# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Sensor samples of the simulated robot, each with the true pose at its stamp."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ratslam_ros.core.common.pose import Pose
from ratslam_simulator.robot import OdometryReading


@dataclass(frozen=True)
class OdometrySample:
    """A reading of the wheel odometry."""

    stamp_ns: int
    odometry: OdometryReading
    truth: Pose


@dataclass(frozen=True)
class ScanSample:
    """A laser scan: (beams,) float32 ranges in m from right to left, inf beyond the range.

    laser: its number; 1 is the rear laser.
    """

    stamp_ns: int
    ranges_m: NDArray[np.float32]
    truth: Pose
    laser: int = 0


@dataclass(frozen=True)
class ImageSample:
    """A camera image: (height, width) uint8."""

    stamp_ns: int
    image: NDArray[np.uint8]
    truth: Pose


@dataclass(frozen=True)
class SonarSample:
    """Ranges of all sonars in m: (sonars,) float32, inf without an echo."""

    stamp_ns: int
    ranges_m: NDArray[np.float32]
    truth: Pose


Sample = OdometrySample | ScanSample | ImageSample | SonarSample
