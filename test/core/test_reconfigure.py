# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Parameters that change during a run."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from helpers import PERIOD_NS, SMALL_IMAGES, START_NS, extended, picture

from ratslam_ros.core.common.odometry import Odometry, Twist
from ratslam_ros.core.common.pose import Pose
from ratslam_ros.core.config import SECTIONS
from ratslam_ros.core.vision.local_view import FIXED_THRESHOLD, LocalView
from ratslam_ros.errors import UnusableParameter
from ratslam_ros.pipeline.ratslam import RatSLAM

LAP = 40
CONFIG = extended().with_values({
    **SMALL_IMAGES, 'local_view.vt_recent_templates': 3,
    'pose_cells.exp_current_by': 'activity', 'experience_map.exp_gate_closures': True,
})
CHANGED = {
    'local_view.vt_match_threshold': 0.005, 'local_view.vt_match_ratio': 0.3,
    'local_view.vt_recent_templates': 20, 'local_view.vt_recent_threshold': 0.9,
    'local_view.vt_min_structure': 0.9,
    'pose_cells.vt_active_decay': 2.0, 'pose_cells.pc_vt_inject_energy': 0.5,
    'pose_cells.pc_vt_restore': 0.5, 'pose_cells.pc_vt_agree_views': 0.0,
    'pose_cells.pc_vt_agree_cells': 0.5, 'pose_cells.pc_vt_agree_spacing': 0.5,
    'pose_cells.exp_delta_pc_threshold': 2.0,
    'pose_cells.exp_activity_xy': 0.5, 'pose_cells.exp_activity_th': 0.5,
    'pose_cells.exp_activity_threshold': 1.5, 'experience_map.exp_gate_closures': False,
    'experience_map.exp_confidence_threshold': 0.9,
    'experience_map.exp_recent_tries': 1, 'experience_map.exp_try_radius_m': 5.0,
}
"""Another value of each parameter of the map that can change at a message."""


def drive(slam: RatSLAM, first: int, last: int) -> list[str]:
    """Drive along a circle; return what each message results in. Every lap is brighter."""
    steps = []
    for i in range(first, last):
        stamp_ns = START_NS + i * PERIOD_NS
        odometry = Odometry(stamp_ns, Twist(1.5, 0.16 + 0.02 * (i % 3)), Pose(0.0, 0.0, 0.0))
        steps += slam.odometry(odometry)
        brighter = picture(i % LAP, 24, 32).astype(np.int64) + 4 * (i // LAP)
        steps += slam.image(stamp_ns, np.minimum(brighter, 255).astype(np.uint8))
    return [repr(step) for step in steps]


def test_every_parameter_that_takes_effect_at_a_message_is_tested() -> None:
    settable = {
        f'{section}.{name}' for section in ('local_view', 'pose_cells', 'experience_map')
        for name, info, _ in SECTIONS[section].parameters() if info.runtime == 'at next message'
    }
    assert settable == set(CHANGED)


@pytest.mark.parametrize('section', ['local_view', 'pose_cells', 'experience_map'])
def test_change_at_a_stamp_equals_a_new_system_from_there(section: str) -> None:
    config = CONFIG.with_values(
        {key: value for key, value in CHANGED.items() if key.startswith(section)}
    )
    changing, first, second = RatSLAM(CONFIG), RatSLAM(CONFIG), RatSLAM(config)
    half = LAP + 5
    changing.reconfigure(config, START_NS + half * PERIOD_NS)
    before = drive(changing, 0, half)
    assert before == drive(first, 0, half)
    second.restore(first.state())
    assert drive(changing, half, 3 * LAP) == drive(second, half, 3 * LAP)


@pytest.mark.parametrize(
    'key', ['local_view.vt_match_threshold', 'pose_cells.pc_vt_inject_energy',
            'pose_cells.pc_vt_agree_views', 'local_view.vt_min_structure'],
)
def test_change_has_an_effect(key: str) -> None:
    changing, unchanged = RatSLAM(CONFIG), RatSLAM(CONFIG)
    changing.reconfigure(CONFIG.with_values({key: CHANGED[key]}), START_NS + LAP * PERIOD_NS)
    assert drive(changing, 0, 2 * LAP) != drive(unchanged, 0, 2 * LAP)


@pytest.mark.parametrize(
    ('key', 'value', 'reason'),
    [('pose_cells.pc_cell_x_size', 0.25, 'restart with 0.25'),
     ('local_view.vt_match_threshold', -1.0, 'it was not automatic at the start'),
     ('experience_map.exp_align_scans', True, 'cannot change while the map is built')],
)
def test_refused_change_changes_nothing(key: str, value: float, reason: str) -> None:
    slam, unchanged = RatSLAM(CONFIG), RatSLAM(CONFIG)
    config = CONFIG.with_values({key: value, 'pose_cells.pc_vt_inject_energy': 0.5})
    with pytest.raises(UnusableParameter, match=reason):
        slam.reconfigure(config)
    assert drive(slam, 0, LAP) == drive(unchanged, 0, LAP)


def test_automatic_threshold_can_be_set_and_returned_to_automatic() -> None:
    automatic = replace(CONFIG.local_view, vt_match_threshold=-1.0)
    view, other = LocalView(automatic), LocalView(automatic)
    views = [picture(i, 24, 32) for i in range(60)]
    for image in views[:30]:
        assert view.match(image) == other.match(image)
    view.reconfigure(replace(automatic, vt_match_threshold=0.0))
    assert view.match(views[30]).threshold == FIXED_THRESHOLD
    view.reconfigure(automatic)
    other.match(views[30])
    assert [view.match(image) for image in views[31:]] == [
        other.match(image) for image in views[31:]
    ]
