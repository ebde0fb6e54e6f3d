# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""ROS as the tests import it: the real one if ROS 2 is installed, else the stand-in."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from rclpy_standin import StandaloneUnavailable, install

ROOT = Path(__file__).parents[1]
UNAVAILABLE = ''
IS_STAND_IN = False
try:
    IS_STAND_IN = install()
except StandaloneUnavailable as error:
    UNAVAILABLE = str(error)


class UnavailableModule(pytest.Module):
    """A file of tests that import ROS, where there is none."""

    def collect(self) -> Iterator[pytest.Item]:
        pytest.skip(UNAVAILABLE)


def pytest_pycollect_makemodule(module_path: Path, parent: pytest.Collector) -> Any:
    """Skip a file if there is no ROS; a hook for the folders whose tests import it."""
    return UnavailableModule.from_parent(parent, path=module_path) if UNAVAILABLE else None
