# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Definition of every parameter: name, unit, range, default and effect.

YAML files, ``--set``, the ROS parameter descriptors and docs/parameters.md are derived from these
dataclasses. Names follow OpenRatSLAM (Ball et al. 2013), so that its configurations can be used.
"""

from ratslam_ros.core.config.config import (
    DECLARATIONS,
    REMOVED,
    SECTIONS,
    SHARED,
    Config,
    declared,
    removal,
    section_of,
    stored_values,
)
from ratslam_ros.core.config.experience_map import ExperienceMapParameters
from ratslam_ros.core.config.goal_follower import GoalFollowerParameters
from ratslam_ros.core.config.goal_memory import GoalMemoryParameters
from ratslam_ros.core.config.goal_recall import GoalRecallParameters
from ratslam_ros.core.config.inputs import InputParameters
from ratslam_ros.core.config.landmark_map import LandmarkMapParameters
from ratslam_ros.core.config.local_view import LocalViewParameters
from ratslam_ros.core.config.memory import MemoryParameters
from ratslam_ros.core.config.parameter import (
    AUTOMATIC,
    WHOLE,
    ParameterInfo,
    Section,
    Value,
    parameter,
)
from ratslam_ros.core.config.pose_cells import LEAST_EXP_MAX, PoseCellsParameters
from ratslam_ros.core.config.visual_odometry import VisualOdometryParameters

__all__ = [
    'AUTOMATIC', 'DECLARATIONS', 'LEAST_EXP_MAX', 'REMOVED', 'SECTIONS', 'SHARED', 'WHOLE',
    'Config', 'ExperienceMapParameters', 'GoalFollowerParameters', 'GoalMemoryParameters',
    'GoalRecallParameters', 'InputParameters', 'LandmarkMapParameters',
    'LocalViewParameters', 'MemoryParameters', 'ParameterInfo',
    'PoseCellsParameters', 'Section', 'Value', 'VisualOdometryParameters', 'declared',
    'parameter', 'removal', 'section_of', 'stored_values',
]
