# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
import cv2
import numpy as np

from ratslam_simulator.floor_plan import load_floor_plan
from ratslam_simulator.picture import draw_plan


def test_draw_plan_shows_trajectories_and_obstacles(tmp_path):
    plan = load_floor_plan('obstacle_loop')
    route = np.array([plan.places[name] for name in 'SXG'])
    bare = draw_plan(plan, tmp_path / 'bare.png')
    trajectories = {'there': route, 'back': route[::-1]}
    full = draw_plan(plan, tmp_path / 'full.png', trajectories, [(7.0, 17.0, 1.0, 2.0)])

    def share_of(path, blue, green, red):
        return (np.abs(cv2.imread(str(path)).astype(int) - (blue, green, red)).max(2) < 8).mean()

    # GREEN, the first trajectory; and grey walls, about half of the plan.
    assert share_of(bare, 0x73, 0x9E, 0x00) == 0.0 < share_of(full, 0x73, 0x9E, 0x00)
    assert 0.2 < share_of(bare, 196, 196, 196) < 0.7
