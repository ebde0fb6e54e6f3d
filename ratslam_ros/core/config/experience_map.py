# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The parameters of the experience map."""

from __future__ import annotations

from dataclasses import dataclass

from ratslam_ros.core.config.inputs import OdometryInput
from ratslam_ros.core.config.parameter import parameter


@dataclass(frozen=True)
class ExperienceMapParameters(OdometryInput):
    """The graph of experiences, and how it is relaxed."""

    exp_relaxation: str = parameter(
        'solve', '', 0, 0,
        'Solve for the poses at which all links are in balance, or go towards them by sweeps from '
        'link to link, exp_loops after each action, as OpenRatSLAM does.',
        'leave at solve', 'set to sweep to compare with OpenRatSLAM',
        choices=('solve', 'sweep'),
    )  # fmt: skip
    exp_correction: float = parameter(
        0.5, 'share of the error', 0.0, 0.5,
        "Share of a link's error that each end takes in a sweep; 0: the map is not relaxed.",
        'loops close too slowly', 'the map is restless')  # fmt: skip
    exp_loops: int = parameter(
        10, 'sweeps', 0, 10_000,
        'Sweeps over all links after each action, if exp_relaxation is sweep; 0: the map is not '
        'relaxed.',
        'loops close too slowly', 'large maps cost too much')  # fmt: skip
    exp_align_scans: bool = parameter(
        False, '', 0, 1,
        'Where there is a laser: places that the camera recognises are brought onto each other by '
        'their scans. Not in the papers.',
        'goals are reached half a metre beside where they are, and the robot has a laser',
        'the map shall hang on camera and odometry alone')  # fmt: skip
    exp_jump_drift: float = parameter(
        0.0, 'm per m; 0: all are believed', 0.0, 100.0,
        'A recognition that would move the robot on the map by more than 1 m and this share of '
        'the way, or turn it by more than 34 degrees and twice this in rad, is believed only '
        'after two metres, and makes no link. Not in the papers.',
        'loops are seen but not closed', 'places that look alike are taken for each other',
    )  # fmt: skip
    exp_confidence_threshold: float = parameter(
        0.25, 'share of the tries', 0.0, 1.0,
        'A link is unlearned when its confidence, the share of tries in which its transition was '
        'made, falls below this; 0: never. Only behaviours that have names are tries.',
        'the robot tries blocked ways for too long', 'ways are given up for people who pass',
    )  # fmt: skip
    exp_min_tries: int = parameter(
        8, 'tries', 1, 1_000_000,
        'A link is not unlearned before its behaviour has led elsewhere so many times since the '
        'link was last made; time-outs count at once.',
        'links between places that take turns are unlearned', 'wrong links stay for too long',
    )  # fmt: skip
    exp_recent_tries: int = parameter(
        3, 'times', 1, 1_000_000,
        'Times that a link was made that count against time-outs, at most: what was long ago is '
        'forgotten. With a threshold of 0.25 a link made once is unlearned by 4 time-outs, one '
        'made 3 times or more by 10.',
        'ways are given up for people who pass', 'the robot tries blocked ways for too long',
    )  # fmt: skip
    exp_try_radius_m: float = parameter(
        1.0, 'm', 0.01, 1000.0,
        'A time-out counts for the links that lead ahead within this distance of the robot.',
        'links beside an obstacle survive it', 'ways past an obstacle are unlearned with it',
    )  # fmt: skip
    exp_initial_em_deg: float = parameter(
        90.0, 'deg', -360.0, 360.0, 'Heading of the robot on the map at the start.',
        'the map should be turned counter-clockwise',
        'the map should be turned clockwise')  # fmt: skip
    map_frame: str = parameter(
        'map', '', 0, 0, 'Frame of the map, its poses and its routes.',
        'set to a name of its own for each robot that shares a TF tree',
        'leave as it is for a single robot',
    )  # fmt: skip
    odom_frame: str = parameter(
        'odom', '', 0, 0, 'Live only: frame of the odometry; map_frame -> odom_frame is on /tf.',
        'set to the name that the robot uses', 'leave as it is where nothing else names it',
    )  # fmt: skip
    base_frame: str = parameter(
        'base_link', '', 0, 0, 'Live only: frame of the robot, in which a goal may be given.',
        'set to the name that the robot uses', 'leave as it is where nothing else names it',
    )  # fmt: skip
    publish_tf: bool = parameter(
        True, '', 0, 1, 'Live only: publish map_frame -> odom_frame on /tf.',
        'RViz should show the robot on the map', 'something else locates the robot on the map',
    )  # fmt: skip
    map_period_s: float = parameter(
        1.0, 's', 0.0, 3600.0,
        'Live only: least time between two messages with the whole map; the last is always sent.',
        'large maps take too much of the network', 'the map should be shown sooner',
    )  # fmt: skip
