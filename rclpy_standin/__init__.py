# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""A stand-in for rclpy on machines without ROS, built on Cyclone DDS from PyPI.

Nodes written for rclpy run unchanged and communicate with real ROS 2 nodes. Unsupported features
(actions, lifecycle, multi-threading, deadlines, lifespans, liveliness, parameters without a
default) raise an exception when they are requested.
"""

from __future__ import annotations

__all__ = ['StandaloneUnavailable', 'install']


class StandaloneUnavailable(RuntimeError):  # noqa: N818
    """The stand-in cannot run here; the message says what to install."""


def install() -> bool:
    """Make ``import rclpy`` work, without shadowing a real installation.

    Returns:
        Whether rclpy is the stand-in.

    Raises:
        StandaloneUnavailable: neither rclpy nor the dependencies of the stand-in are installed.
    """
    try:
        import rclpy

        return type(rclpy).__module__ == f'{__name__}.modules'
    except ImportError:
        pass
    try:
        import cyclonedds.internal  # noqa: F401
        import rosbags.typesys  # noqa: F401
    except Exception as error:
        raise StandaloneUnavailable(
            f'running live needs ROS 2 (source /opt/ros/jazzy/setup.bash), or the package '
            f'cyclonedds: pip install "cyclonedds>=11.0,<11.1"; if there is no wheel for this '
            f'platform, as on Linux aarch64, install ROS 2 or build cyclonedds ({error})'
        ) from None
    from rclpy_standin.modules import install_finder

    install_finder()
    return True
