# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""A robot that was carried, with and without a pose from the operator (`initialpose`)."""

import copy
import math

from test_several_lasers import FULL, LAP, along, driven

from ratslam_ros.core.common.pose import Pose, composed, inverse
from ratslam_ros.core.mapping.pose_hint import PoseHint

CARRIED_TO = Pose(3.5, 1.75, 0.0)
"""A pose on the first side of the lap, in m."""

SECONDS = 40.0


def joined_m(mapped_loop, given):
    """Carry the robot to another place of the map, and drive on there.

    Args:
        mapped_loop: the closed loop that has built the map; it stays unchanged.
        given: pose on the floor that the operator gives; None: none is given.

    Returns:
        The error in m after 0.5 s, the distance in m after which the estimate is right, and the
        closed loop.
    """
    loop = copy.deepcopy(mapped_loop)
    graph, simulator, mapped = loop.experience_map, loop.simulator, dict(loop.log.truth_of)

    def on_map(true):
        """Return where a pose on the floor is on the map, which has shifts of its own."""
        near = min(mapped, key=lambda number: math.dist(mapped[number][:2], true[:2]))
        return composed(graph.pose_of(near), composed(inverse(mapped[near]), true))

    def error_m():
        return math.dist(on_map(simulator.truth)[:2], graph.pose[:2])

    simulator.carry(CARRIED_TO)
    assert error_m() > 2.0
    if given is not None:
        hint = PoseHint(on_map(given), 0.25, 0.0, 0.25, 0.07)  # the variances of RViz
        loop.ratslam.suggest(simulator.stamp_ns, hint)
    begun_m, end_s, distances_m = simulator.odometer_m, loop.now_s + SECONDS, []

    def is_over():
        if not distances_m and error_m() < 0.5:
            distances_m.append(simulator.odometer_m - begun_m)
        return loop.now_s > end_s

    steer, given_s = along([*LAP[1:], *LAP], simulator), loop.now_s
    loop.run(steer, lambda: loop.now_s > given_s + 0.5)  # until its stamp is processed
    given_m = error_m()
    loop.run(steer, is_over)
    assert error_m() < 0.5
    assert loop.experience_map.localisation == 'localised'
    return given_m, distances_m[0], loop


def test_right_hint_holds_at_once_and_wrong_one_is_refuted():
    mapped = driven(FULL, values={'experience_map.exp_relocate': 'views'}, duration_s=90.0)
    carried_m, alone_m, _ = joined_m(mapped, None)
    hinted_m, _, _ = joined_m(mapped, CARRIED_TO)
    assert carried_m > 2.0 and hinted_m < 0.2
    wrong_m, misled_m, misled = joined_m(mapped, Pose(1.8, 3.5, math.pi / 2))
    assert wrong_m > 1.0
    assert misled_m <= alone_m + 1.0
    assert misled.experience_map.component_count == 1
