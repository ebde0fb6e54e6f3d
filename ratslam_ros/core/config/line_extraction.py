# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Parameters of the extraction of walls and corners from laser scans."""

from __future__ import annotations

from dataclasses import dataclass

from ratslam_ros.core.config.parameter import Section, parameter


@dataclass(frozen=True)
class LineExtractionParameters(Section):
    """Walls, corners and edges from laser scans, by split and merge."""

    le_range_sd_m: float = parameter(
        0.02, 'm', 1e-4, 1.0, 'Standard deviation of a range of the laser.',
        'straight walls are split into pieces', 'corners of small steps in a wall are missed',
    )  # fmt: skip
    le_wall_sd_m: float = parameter(
        0.01, 'm', 1e-4, 1.0,
        'Standard deviation of the position of a landmark that the noise of the laser does not '
        'explain: walls are not perfectly straight, and the robot moves during a scan.',
        'landmarks that are seen again are rejected as outliers',
        'the walls are straight and the laser is fast',
    )  # fmt: skip
    le_min_length_m: float = parameter(
        0.5, 'm', 0.05, 100.0, 'Length of the shortest wall. A person is 0.5 m wide.',
        'furniture and people become landmarks', 'too few walls and corners are found',
    )  # fmt: skip
    le_max_range_m: float = parameter(
        10.0, 'm', 0.5, 50.0, 'Ranges beyond it are ignored.',
        'too few walls and corners are found', 'distant landmarks are inaccurate',
    )  # fmt: skip
    le_interval_m: float = parameter(
        0.2, 'm', 0.0, 100.0,
        'Travel between two scans whose landmarks enter the map, where a turn of 1 rad counts as '
        '1 m. Scans of one place repeat the errors of the walls and add no information.',
        'the map takes too much computing time', 'a fast laser should be used fully',
    )  # fmt: skip
