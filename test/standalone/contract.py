# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""What the tests run on: the stand-in, or where ROS 2 is installed the real rclpy."""

from pathlib import Path

from ratslam_ros.standalone import StandaloneUnavailable, install

ROOT = Path(__file__).parents[2]
WHY_NOT = ''
IS_STAND_IN = False
try:
    IS_STAND_IN = install()
except StandaloneUnavailable as error:
    WHY_NOT = str(error)
