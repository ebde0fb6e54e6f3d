# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""When routes are sent to a controller that follows whole paths."""

from __future__ import annotations

import math

import numpy as np
import pytest

from ratslam_ros.core.common.pose import Pose
from ratslam_ros.core.driving.path_requests import NO_ROUTE, PathRequests

ROUTE = np.array([(0.0, 0.0), (1.0, 0.0), (2.0, 0.0), (2.0, 1.0)])


def test_changed_route_is_sent_and_rest_kept() -> None:
    requests = PathRequests()
    assert requests.on_route(ROUTE) == 'send'
    assert requests.on_route(ROUTE) == 'keep'
    assert requests.on_route(ROUTE[2:] + 0.01) == 'keep'
    assert requests.on_route(ROUTE + 0.1) == 'send'
    assert requests.on_route(np.vstack([ROUTE, ROUTE])) == 'send'


def test_route_is_sent_again_after_driving_has_ended() -> None:
    requests = PathRequests()
    requests.on_route(ROUTE)
    requests.is_driving = False
    assert requests.on_route(ROUTE) == 'send'


def test_empty_route_cancels_only_while_driving() -> None:
    requests = PathRequests()
    assert requests.on_route(NO_ROUTE) == 'keep'
    requests.on_route(ROUTE)
    assert requests.on_route(NO_ROUTE) == 'cancel'
    assert requests.on_route(NO_ROUTE) == 'keep'
    assert not requests.is_driving


def test_blocked_direction_leads_along_the_rest_of_the_route() -> None:
    requests = PathRequests()
    assert requests.blocked_direction_rad(Pose(0.0, 0.0, 0.5)) == 0.5  # no route yet
    requests.on_route(ROUTE)
    assert requests.blocked_direction_rad(Pose(0.5, 0.0, 3.0)) == pytest.approx(0.0)
    assert requests.blocked_direction_rad(Pose(2.0, 0.0, 3.0)) == pytest.approx(math.pi / 2)
    assert requests.blocked_direction_rad(Pose(2.0, 1.0, 0.25)) == 0.25  # at its end
