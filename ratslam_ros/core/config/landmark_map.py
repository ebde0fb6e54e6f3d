# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Parameters of the stochastic map of landmarks."""

from __future__ import annotations

from dataclasses import dataclass

from ratslam_ros.core.config.parameter import Section, parameter


@dataclass(frozen=True)
class LandmarkMapParameters(Section):
    """Stochastic mapping of landmarks by an extended Kalman filter (Smith et al. 1990)."""

    lm_max_odom_gap_s: float = parameter(
        60.0, 's; 60: off', 0.01, 60.0,
        'As max_odom_gap_s: after a longer interval between two odometry messages the robot is '
        'lost until the landmarks around it are found on the map.',
        'odometry messages are normally further apart',
        'odometry has gaps in which the robot moves',
    )  # fmt: skip
    lm_odom_position_sd_m: float = parameter(
        0.05, 'm', 1e-6, 10.0,
        'Standard deviation of the odometry in each coordinate, without the effect of the '
        'heading, after 1 m. The variance is proportional to the distance.',
        'the wheels slip, or landmarks that are seen again are rejected as outliers',
        'the odometry measures distances well',
    )  # fmt: skip
    lm_odom_drift_sd_rad: float = parameter(
        0.02, 'rad', 0.0, 3.0,
        "Standard deviation of the odometry's heading after 1 m. The variance is proportional to "
        'the distance.',
        'by odometry, straight paths are bent', 'a gyroscope measures the heading',
    )  # fmt: skip
    lm_odom_turn_sd_rad: float = parameter(
        0.05, 'rad', 0.0, 3.0,
        "Standard deviation of the odometry's heading after a turn of 1 rad. The variance is "
        'proportional to the angle.',
        'the heading by odometry is wrong after turns', 'a gyroscope measures the heading',
    )  # fmt: skip
    lm_range_sd_m: float = parameter(
        0.1, 'm', 1e-6, 10.0, 'Standard deviation of the range of an observed landmark.',
        'the sensor is less accurate', 'the sensor is more accurate',
    )  # fmt: skip
    lm_bearing_sd_rad: float = parameter(
        0.0175, 'rad', 1e-6, 1.0, 'Standard deviation of the bearing of an observed landmark.',
        'the sensor is less accurate', 'the sensor is more accurate',
    )  # fmt: skip
    lm_direction_sd_rad: float = parameter(
        0.035, 'rad', 1e-6, 1.0, 'Standard deviation of the direction of an observed bar.',
        'the sensor is less accurate', 'the sensor is more accurate',
    )  # fmt: skip
    lm_length_sd_m: float = parameter(
        0.1, 'm', 1e-6, 10.0, 'Standard deviation of the length of an observed bar.',
        'the sensor is less accurate', 'the sensor is more accurate',
    )  # fmt: skip
    lm_outlier_probability: float = parameter(
        0.001, '', 1e-12, 0.5,
        'Probability that a correct observation of a known landmark is rejected as an outlier, '
        'by a chi-square test of its innovation.',
        'wrong observations distort the map', 'correct observations are rejected',
    )  # fmt: skip
    lm_repeat_m: float = parameter(
        0.0, 'm', 0.0, 1000.0,
        'Travel after which a landmark that is seen again updates the map, where a turn of 1 rad '
        'counts as 1 m. Observations from nearly the same place repeat the same error of the '
        'sensor, and the filter assumes independent errors. 0: every observation counts.',
        'the robot often stands still, or the map is less accurate than its covariance',
        "the sensor's errors are independent",
    )  # fmt: skip
    lm_local_m: float = parameter(
        1.0, 'm', 0.0, 1000.0,
        'Distance for which the local map, the input of relocalisation, keeps a landmark that is '
        'not seen again.',
        'too few landmarks are in view at a time to recognise a place',
        'the odometry is inaccurate',
    )  # fmt: skip
    lm_max: int = parameter(
        0, 'landmarks; 0: any number', 0, 1_000_000,
        'Limit of the number of landmarks. At the limit, landmarks are removed by their freshness '
        '(forget_share, forget_after_s and forget_robust_visits) before new ones are added.',
        'landmarks are forgotten that are still needed',
        'updates, whose time is quadratic in the number of landmarks, take too long',
    )  # fmt: skip
    map_frame: str = parameter(
        'landmark_map', '', 0, 0, 'Live only: frame of the landmarks.',
        'set to a unique name for each robot that shares a TF tree',
        'leave as it is for a single robot',
    )  # fmt: skip
    odom_frame: str = parameter(
        'auto', '', 0, 0, 'Live only: frame of the odometry; odom_frame -> map_frame is on /tf. '
        'auto: the frame_id of its messages.',
        'set if the messages name another frame than the TF tree',
        'leave as it is for most robots',
    )  # fmt: skip
    publish_tf: bool = parameter(
        True, '', 0, 1, 'Live only: publish odom_frame -> map_frame on /tf.',
        'RViz should show the landmarks with the robot',
        'another node connects the frame of the landmarks',
    )  # fmt: skip
    map_period_s: float = parameter(
        1.0, 's', 0.0, 3600.0,
        'Live only: minimum time between two messages with all landmarks; the latest are always '
        'sent.',
        'many landmarks take too much network bandwidth', 'the map should be shown sooner',
    )  # fmt: skip
