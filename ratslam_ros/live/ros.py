# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""ROS 2 client library of the commands: rclpy if it is installed, otherwise its stand-in."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from importlib.util import find_spec
from typing import Any

from ratslam_ros.errors import UnusableInput


def require() -> None:
    """Make ``import rclpy`` work.

    Raises:
        UnusableInput: neither rclpy nor the package that its stand-in needs is installed.
    """
    from rclpy_standin import StandaloneUnavailable, install

    try:
        install()
    except StandaloneUnavailable as error:
        raise UnusableInput(str(error)) from None


def check() -> None:
    """Check quickly, without importing rclpy, that ``require`` will succeed.

    Raises:
        UnusableInput: as ``require`` does.
    """
    if find_spec('rclpy') is None and find_spec('cyclonedds') is None:
        require()


@contextmanager
def node(name: str, ros_arguments: Sequence[str]) -> Iterator[Any]:
    """Create a node for the duration of the context; SIGINT raises KeyboardInterrupt.

    Args:
        name: name of the node.
        ros_arguments: what follows ``--ros-args``.

    Raises:
        UnusableInput: ROS rejects the arguments.
    """
    import rclpy
    from rclpy.signals import SignalHandlerOptions

    arguments = ['--ros-args', *ros_arguments] if ros_arguments else []
    try:
        rclpy.init(args=arguments, signal_handler_options=SignalHandlerOptions.NO)
    except (RuntimeError, ValueError) as error:
        raise UnusableInput(f'--ros-args {" ".join(ros_arguments)}: {str(error)[:300]}') from None
    try:
        made = rclpy.create_node(name, start_parameter_services=False, enable_rosout=False)
        try:
            yield made
        finally:
            made.destroy_node()
    finally:
        rclpy.try_shutdown()


def found(find: Callable[[str], Any], kind: str, what: str, example: str) -> Any:
    """Return the class of a message or service type.

    Raises:
        UnusableInput: the type is not installed.
    """
    try:
        return find(kind)
    except (ImportError, AttributeError, ValueError, LookupError):
        raise UnusableInput(
            f'the {what} type {kind} is not installed: expected one such as {example}'
        ) from None
