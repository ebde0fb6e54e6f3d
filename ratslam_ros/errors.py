# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Errors that a user can cause; the commands report them in one line and exit with code 2."""

import errno
import sys

DONE, NO_ANSWER, UNUSABLE, INTERRUPTED = 0, 1, 2, 130
"""Exit codes: success, nothing arrived in time, unusable input or wrong use, interrupted.

A fault of the program gives 1, as no answer does.
"""

DISK_FULL_ERRORS = (errno.ENOSPC, errno.EDQUOT, errno.EFBIG)
"""Numbers of the errors of the operating system that a full disk causes."""

OWN_PACKAGES = 'ratslam_ros', 'ratslam_simulator', 'ratslam_tuning', 'rclpy_standin'

PIP_NAMES = {'cv2': 'opencv-python-headless', 'yaml': 'pyyaml'}
"""Name of a package for pip by its module, where they differ."""


class RatslamError(Exception):
    """An error that the user can fix; the text names what was found, expected, and what to do."""

    def __init__(self, text: str = '') -> None:
        """Make the text one line, as it may quote others, such as those of SQLite and YAML."""
        super().__init__(' '.join(line.strip() for line in text.splitlines()))


class UnusableInput(RatslamError):  # noqa: N818
    """A recording, file or topic cannot be used."""


class UnusableParameter(RatslamError):  # noqa: N818
    """A parameter is unknown, of the wrong type, or out of its range."""


class UnreachableGoal(RatslamError):  # noqa: N818
    """A goal that is not on the map or in the goal memory, or that no link leads to."""


class NoAnswer(Exception):  # noqa: N818 - not an error: nothing arrived in time
    """No message or response arrived in time; the text names the topic or service."""


def missing_package(error: ModuleNotFoundError) -> UnusableInput:
    """Return the error that a package is not installed; raise that of a module of our own."""
    module = (error.name or '').partition('.')[0]
    if module in ('', *OWN_PACKAGES):
        raise error
    package = PIP_NAMES.get(module, module)
    return UnusableInput(
        f'ratslam_ros needs {package}, which this Python ({sys.executable}) does not have: build '
        'with the Python of the virtual environment, python3 -m colcon build (docs/ros.md); '
        f'without ROS, python3 -m pip install {package}'
    )
