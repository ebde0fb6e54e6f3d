# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""A stand-in for rclpy on machines without ROS: the same nodes, over Cyclone DDS from PyPI.

Nodes that were written for rclpy run unchanged, and talk to real ones. What is not offered
(actions, lifecycle, several threads, deadlines, lifespans, liveliness) raises at once.
"""

from __future__ import annotations

__all__ = ['StandaloneUnavailable', 'install']


class StandaloneUnavailable(RuntimeError):  # noqa: N818
    """The stand-in lacks something; the text says what running live needs here."""


def install() -> bool:
    """Make ``import rclpy`` work; return whether that is by the stand-in.

    A real rclpy is never shadowed.

    Raises:
        StandaloneUnavailable: there is neither rclpy nor what the stand-in needs.
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
            f'cyclonedds: pip install "cyclonedds>=11.0,<11.1"; where there is no wheel of it, as '
            f'on Linux aarch64, install ROS 2 or build cyclonedds ({error})'
        ) from None
    from ratslam_ros.standalone.modules import serve

    serve()
    return True
