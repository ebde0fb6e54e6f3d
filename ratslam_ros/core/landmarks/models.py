# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Models of the noise of robots, sensors and walls, with which landmarks are mapped."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class MapModel:
    """Noise of odometry and of a sensor of landmarks; the defaults are those of a wheeled robot.

    Attributes:
        odom_position_sd_m: standard deviation of the odometry in each coordinate after 1 m,
            without the effect of the heading. The variance is proportional to the distance.
        odom_drift_sd_rad: standard deviation of the heading of the odometry after 1 m, likewise.
        odom_turn_sd_rad: standard deviation of the heading of the odometry after a turn of 1 rad.
            The variance is proportional to the angle.
        range_sd_m, bearing_sd_rad: standard deviations of the position of an observed landmark,
            unless observations have variances of their own. The bearing is known to one degree.
        direction_sd_rad, length_sd_m: standard deviations of an observed bar, likewise.
        outlier_probability: probability that a correct observation of a known landmark is rejected
            as an outlier, by a chi-square test of its innovation.
        repeat_m: travel after which a landmark that is seen again updates the map, where a turn of
            1 rad counts as 1 m. Observations from nearly the same place repeat the same error of
            the sensor, and the filter assumes independent errors. 0: every observation counts.
        local_m: distance for which the local map, the input of relocalisation, keeps a landmark
            that is not seen again: long enough to see several, and short for the odometry.
    """

    odom_position_sd_m: float = 0.05
    odom_drift_sd_rad: float = 0.02
    odom_turn_sd_rad: float = 0.05
    range_sd_m: float = 0.1
    bearing_sd_rad: float = 0.0175
    direction_sd_rad: float = 0.035
    length_sd_m: float = 0.1
    outlier_probability: float = 0.001
    repeat_m: float = 0.0
    local_m: float = 1.0


@dataclass(frozen=True)
class LaserModel:
    """Noise of a laser and of the walls that it sees; the defaults are those of an indoor laser.

    Attributes:
        range_sd_m: standard deviation of a range.
        wall_sd_m: standard deviation of the position of a landmark that the noise of the laser
            does not explain: walls are not perfectly straight, and the robot moves during a scan.
        min_length_m: length of the shortest wall. A person is 0.5 m wide.
        max_range_m: ranges beyond it are ignored, because distant landmarks are inaccurate.
    """

    range_sd_m: float = 0.02
    wall_sd_m: float = 0.01
    min_length_m: float = 0.5
    max_range_m: float = 10.0
