# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""ROS or its stand-in, in this process and in others."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from pathlib import Path

import pytest
from helpers import live_environment
from processes import Commands

from ratslam_ros.cli import main


@pytest.fixture(scope='session')
def ros() -> None:
    """Make rclpy or its stand-in importable; skip the test if neither is installed."""
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


@pytest.fixture
def here(
    ros: None, signals: None, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> Callable[..., tuple[int, str, str]]:
    """Return a function that runs a command in this process.

    It returns the exit code, the output and the errors.
    """
    for name, value in live_environment().items():
        monkeypatch.setenv(name, value)

    def run(*words: str) -> tuple[int, str, str]:
        code = main(words)
        return code, *capfd.readouterr()

    return run
