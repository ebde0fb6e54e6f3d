# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Announcements of restarted nodes."""

import json
from typing import Any

import pytest

from ratslam_ros.messages.json_schema import MalformedMessage, decode, encode
from ratslam_ros.messages.restarts import Restart, history_topic

RESTART = Restart(('local_view', 'pose_cells'), done=True)


def test_announcement_is_decoded_as_encoded() -> None:
    assert decode(Restart, encode(RESTART)) == RESTART


@pytest.mark.parametrize('changes', [
    {'nodes': 'local_view'}, {'nodes': [3]}, {'nodes': ['n' * 300]}, {'nodes': ['n'] * 21},
    {'done': 1}, {'heard': None},
])  # fmt: skip
def test_malformed_announcement_is_refused(changes: dict[str, Any]) -> None:
    fields = json.loads(encode(RESTART))
    with pytest.raises(MalformedMessage, match=r'^ratslam/restart: .*\Z'):
        decode(Restart, json.dumps({**fields, **changes}))


def test_history_of_an_absolute_name_is_a_valid_topic() -> None:
    assert history_topic('/scan_rear') == history_topic('scan_rear')
