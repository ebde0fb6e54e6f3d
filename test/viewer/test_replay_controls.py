# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Parameters of a replay that is repeated with others."""

from __future__ import annotations

from collections.abc import Sequence

from ratslam_ros.core.config import Config
from ratslam_ros.viewer.replay_controls import ReplayControls

SHIFT, THRESHOLD = 'local_view.vt_shift_match', 'local_view.vt_match_threshold'


def controls_of(requests: list[Sequence[str]]) -> ReplayControls:
    return ReplayControls(Config(), requests.append)


def test_changed_parameters_become_settings_of_next_replay() -> None:
    requests: list[Sequence[str]] = []
    controls = controls_of(requests)
    assert controls.set_parameter(SHIFT, 3).success
    assert controls.parameters[SHIFT] == 3
    assert controls.run_again().success
    assert requests == [[f'{SHIFT}=3']]


def test_parameters_of_a_finished_replay_keep_the_changes() -> None:
    controls = controls_of([])
    controls.set_parameter(SHIFT, 3)
    controls.use(Config().with_values({THRESHOLD: 0.07, SHIFT: 4}))
    assert controls.parameters[THRESHOLD] == 0.07
    assert controls.parameters[SHIFT] == 3
