# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""ROS or the stand-in for it, in this process and in others."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import pytest
from processes import Commands


@pytest.fixture(scope='session')
def ros() -> None:
    """Have rclpy or the stand-in in this process; skip where there is neither."""
    from ratslam_ros.errors import UnusableInput
    from ratslam_ros.live.ros import require

    try:
        require()
    except UnusableInput as error:
        pytest.skip(str(error))


@pytest.fixture
def commands(ros: None, tmp_path: Path) -> Iterator[Commands]:
    running = Commands(tmp_path)
    yield running
    running.close()
