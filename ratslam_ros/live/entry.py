# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Entry points of ``ros2 run ratslam_ros NODE``; without ROS 2 they print advice."""

from __future__ import annotations

import atexit
import signal
import sys
from functools import partial
from importlib.util import find_spec

from ratslam_ros.errors import UNUSABLE, UnusableInput, missing_package
from ratslam_ros.live.run import NODES, run


def _main(node: str) -> int:
    # ros2 launch may repeat Ctrl-C while the process ends.
    atexit.register(signal.signal, signal.SIGINT, signal.SIG_IGN)
    try:
        if find_spec('rclpy') is None:
            raise UnusableInput(
                'rclpy is not installed; source ROS 2 (source /opt/ros/jazzy/setup.bash), or use '
                f'"ratslam run {node}", which runs without ROS'
            )
        return run(node, None)
    except (UnusableInput, ModuleNotFoundError) as error:
        reason = error if isinstance(error, UnusableInput) else missing_package(error)
        print(f'{node}: {reason}', file=sys.stderr)
        return UNUSABLE


# setup.py names one function of this module for each node.
globals().update({node: partial(_main, node) for node in NODES})
