# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Parameters of the map of landmarks."""

from __future__ import annotations

from dataclasses import dataclass

from ratslam_ros.core.config.parameter import Section, parameter


@dataclass(frozen=True)
class LandmarkMapParameters(Section):
    """Stochastic mapping of landmarks by an extended Kalman filter (Smith et al. 1990)."""

    lm_max: int = parameter(
        0,
        'Limit of the number of landmarks. At the limit, landmarks are removed by their '
        'freshness (forget_share and forget_after_s) before new ones are added.',
        unit='landmarks; 0: any number', low=0, high=1_000_000,
        raise_if='landmarks are forgotten that are still needed',
        lower_if='updates, whose time is quadratic in the number of landmarks, take too long',
    )
    map_frame: str = parameter(
        'landmark_map', 'Live only: frame of the landmarks.',
        raise_if='set to a unique name for each robot that shares a TF tree',
        lower_if='leave as it is for a single robot',
    )
