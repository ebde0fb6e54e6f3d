# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Requests to send messages again, and messages in the log of a map file."""

import json
import math
from typing import Any

import numpy as np
import pytest

from ratslam_ros.core.common.odometry import Odometry, Twist
from ratslam_ros.core.common.pose import Pose
from ratslam_ros.core.common.scan import Scan
from ratslam_ros.messages.json_schema import MalformedMessage, decode, encode
from ratslam_ros.messages.logged import (
    decode_odometry,
    decode_scan,
    encode_odometry,
    encode_scan,
)
from ratslam_ros.messages.resending import (
    MAX_ENTRIES,
    ResendAnswer,
    ResendRequest,
    resent_topic,
)

REQUEST = ResendRequest(7, 'local_view', {'image': 5, 'odom': 0}, ('template',), 6)
ANSWER = ResendAnswer(7, 'player', {'image': 12}, False)


def test_request_and_answer_are_decoded_as_encoded() -> None:
    assert decode(ResendRequest, encode(REQUEST)) == REQUEST
    assert decode(ResendAnswer, encode(ANSWER)) == ANSWER


@pytest.mark.parametrize('changes', [
    {'number': -1}, {'number': '7'}, {'node': 3}, {'node': 'n' * 300}, {'after': []},
    {'after': {'image': -1}}, {'after': {'image': 1.5}}, {'after': {'image': True}},
    {'after': {str(i): 0 for i in range(MAX_ENTRIES + 1)}}, {'repeats': [1]},
    {'repeats': ['x'] * (MAX_ENTRIES + 1)}, {'since': 2**63}, {'done': 1},
], ids=lambda changes: str(changes)[:40])  # fmt: skip
def test_malformed_request_is_refused(changes: dict[str, Any]) -> None:
    fields = json.loads(encode(REQUEST))
    with pytest.raises(MalformedMessage):
        decode(ResendRequest, json.dumps({**fields, **changes}))


@pytest.mark.parametrize('changes', [
    {'number': 2**63}, {'counts': {'image': 'many'}}, {'complete': 'yes'},
    {'counts': {'image\nnode: another line of the log': 'many'}},
])  # fmt: skip
def test_malformed_answer_is_refused(changes: dict[str, Any]) -> None:
    fields = json.loads(encode(ANSWER))
    with pytest.raises(MalformedMessage, match=r'^ratslam/resent: .*\Z'):
        decode(ResendAnswer, json.dumps({**fields, **changes}))


def test_logged_odometry_keeps_every_bit() -> None:
    for known, sideways in ((False, 0.0), (True, -1e-300)):
        twist = Twist(0.1, math.nan, sideways)
        odometry = Odometry(
            1_700_000_000_123_456_789, twist, Pose(1 / 3, -1e300, 5e-324), known
        )
        assert repr(decode_odometry(encode_odometry(odometry))) == repr(odometry)


def test_logged_scan_keeps_every_bit() -> None:
    scan = Scan(5, -1.5, 0.1, np.array([0.1, math.inf, 3.0]), 0.3, -0.2)
    found = decode_scan(encode_scan(scan))
    assert (found.stamp_ns, found.angle_min_rad, found.angle_increment_rad) == (5, -1.5, 0.1)
    assert (found.x_m, found.y_m) == (0.3, -0.2)
    assert found.ranges_m.tobytes() == scan.ranges_m.tobytes()


@pytest.mark.parametrize('size', [0, 39, 40, 47, 50])
def test_log_entry_of_another_size_is_refused(size: int) -> None:
    with pytest.raises(MalformedMessage, match='expected'):
        decode_odometry(bytes(size))
    with pytest.raises(MalformedMessage, match='expected'):
        decode_scan(bytes(size))


def test_resent_topic_of_an_absolute_name_is_valid() -> None:
    assert resent_topic('/scan_rear') == resent_topic('scan_rear')
