# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""All additions to the published algorithm, and the parameters that select them.

tools/without_additions.py runs the tests of the others without each of them.
"""

from __future__ import annotations

from ratslam_ros.core.common.addition import Addition
from ratslam_ros.core.config.local_view import LocalViewParameters
from ratslam_ros.core.config.parameter import AUTOMATIC


def uses_odometry(parameters: LocalViewParameters) -> bool:
    """Return whether a local view with these parameters follows the robot by odometry."""
    p = parameters
    return p.vt_match_threshold == AUTOMATIC and p.vt_match_ratio == AUTOMATIC


# Local view

AUTOMATIC_RECOGNITION = Addition(
    'vision.automatic_recognition', 'AutomaticRecognition', 'local_view',
    lambda p: AUTOMATIC in (p.vt_match_threshold, p.vt_recent_templates),
)
MATCH_THRESHOLD = Addition(
    'vision.match_threshold', 'MatchThreshold', 'local_view', AUTOMATIC_RECOGNITION.is_selected
)
SEQUENCES = Addition(
    'vision.sequence_matcher', 'SequenceMatcher', 'local_view', AUTOMATIC_RECOGNITION.is_selected
)
LOOK_ALIKES = Addition('vision.look_alikes', 'LookAlikes', 'local_view', uses_odometry)
STRUCTURE = Addition(
    'vision.structure', 'structure', 'local_view', lambda p: p.vt_min_structure > 0.0
)

# Pose cells

AUTOMATIC_LENGTHS = Addition(
    'pose_cells.automatic_lengths', 'AutomaticLengths', 'pose_cells', lambda p: AUTOMATIC in (
        p.pc_cell_x_size, p.pc_vt_agree_cells, p.pc_vt_agree_spacing, p.exp_delta_pc_threshold,
    ),
)
AGREEMENT = Addition(
    'pose_cells.agreement', 'Agreement', 'pose_cells', lambda p: p.pc_vt_agree_views > 0.0
)
RECOGNITIONS = Addition(
    'pose_cells.view_links', 'Recognitions', 'pose_cells',
    lambda p: p.exp_view_links or p.exp_weigh_links,
)
EXPERIENCE_CHAINS = Addition(
    'pose_cells.view_links', 'ExperienceChains', 'pose_cells', lambda p: p.exp_view_links
)
CALIBRATION = Addition(
    'pose_cells.odometry_calibration', 'OdometryCalibration', 'pose_cells',
    lambda p: p.odom_calibration,
)
JOINING = Addition(
    'pose_cells.registration', 'registered', 'inputs', lambda p: p.max_odom_gap_s < 60.0
)

# Goal memory

GOAL_ROUTES = Addition(
    'goal_memory.goal_routes', 'GoalRoutes', 'goal_memory',
    lambda p: p.goal_memory and p.goal_memory_update == 'cell',
)

# Experience map

CORRECTED_TURNS = Addition(
    'mapping.corrected_turns', 'correct_turns', 'pose_cells', CALIBRATION.is_selected
)
RECOGNISED_LINKS = Addition(
    'mapping.recognised_links', 'RecognisedLinks', 'pose_cells', RECOGNITIONS.is_selected
)
GATED_CLOSURES = Addition(
    'mapping.gated_closures', 'GatedClosures', 'experience_map',
    lambda p: p.exp_gate_closures or p.exp_align_scans,
)
SCANS = Addition(
    'mapping.scan_matching', 'ScanMatcher', 'experience_map', lambda p: p.exp_align_scans
)
RELOCATION = Addition(
    'mapping.relocator', 'Relocator', 'experience_map',
    lambda p: p.exp_align_scans and p.exp_relocate != 'views',
)

ADDITIONS = tuple(one for one in globals().values() if isinstance(one, Addition))
