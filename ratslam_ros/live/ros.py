# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""A ROS 2 client library for the commands: rclpy where it is installed, else the stand-in."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from importlib.util import find_spec
from typing import Any

from ratslam_ros.errors import UnusableInput


class Silence(Exception):  # noqa: N818 - no error of anybody's: nothing came in time
    """No message or answer came in time; the text says from whom."""


def require() -> None:
    """Make ``import rclpy`` work.

    Raises:
        UnusableInput: there is neither rclpy nor what the stand-in needs.
    """
    from ratslam_ros.standalone import StandaloneUnavailable, install

    try:
        install()
    except StandaloneUnavailable as error:
        raise UnusableInput(str(error)) from None


def look() -> None:
    """Say early, and quickly, what ``require`` would say; raises as it does."""
    if find_spec('rclpy') is None and find_spec('cyclonedds') is None:
        require()


@contextmanager
def node(name: str, ros_arguments: Sequence[str]) -> Iterator[Any]:
    """Give a node for as long as it is needed; an interrupt is Python's own KeyboardInterrupt.

    Raises:
        UnusableInput: arguments that ROS does not understand.
    """
    import rclpy
    from rclpy.signals import SignalHandlerOptions

    arguments = ['--ros-args', *ros_arguments] if ros_arguments else []
    try:
        rclpy.init(args=arguments, signal_handler_options=SignalHandlerOptions.NO)
    except (RuntimeError, ValueError) as error:
        told = ' '.join(str(error).split())[:300]
        raise UnusableInput(f'--ros-args {" ".join(ros_arguments)}: {told}') from None
    try:
        made = rclpy.create_node(name, start_parameter_services=False, enable_rosout=False)
        try:
            yield made
        finally:
            made.destroy_node()
    finally:
        rclpy.try_shutdown()
