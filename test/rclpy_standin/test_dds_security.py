# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The stand-in has no DDS security, and does not start where it is required."""

from __future__ import annotations

import pytest


def test_required_security_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    pytest.importorskip('cyclonedds', reason='rclpy is installed; the stand-in is not used')
    from rclpy_standin.dds_domains import _configuration

    monkeypatch.setenv('ROS_SECURITY_ENABLE', 'true')
    assert '<CycloneDDS>' in _configuration()  # permissive, as in ROS 2
    monkeypatch.setenv('ROS_SECURITY_STRATEGY', 'Enforce')
    with pytest.raises(ValueError, match='no DDS security'):
        _configuration()
