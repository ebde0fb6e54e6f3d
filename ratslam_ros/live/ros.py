# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""ROS 2 client library of the commands: rclpy if it is installed, otherwise its stand-in."""

from __future__ import annotations

import time
from collections.abc import Iterator, Sequence
from contextlib import ExitStack, contextmanager
from importlib.util import find_spec
from typing import Any

from ratslam_ros.errors import UnusableInput

SEND_TIMEOUT_S = 30.0
RETRY_S = 0.002


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
    with ExitStack() as stack:
        stack.callback(rclpy.try_shutdown)
        made = rclpy.create_node(name, start_parameter_services=False, enable_rosout=False)
        stack.callback(made.destroy_node)
        yield made


def send(publisher: Any, message: Any, timeout_s: float = SEND_TIMEOUT_S) -> None:
    """Publish a message; repeat it while the middleware refuses it.

    Fast DDS waits 0.1 s for slow subscribers, and then refuses the message.

    Raises:
        UnusableInput: the message is still refused after `timeout_s`.
    """
    end_s = time.monotonic() + timeout_s
    while True:
        try:
            publisher.publish(message)
        except RuntimeError as error:
            if time.monotonic() > end_s:
                raise UnusableInput(
                    f'{publisher.topic_name}: publishing failed for {timeout_s:g} s ({error}); '
                    'look for a subscriber that hangs'
                ) from None
            time.sleep(RETRY_S)
        else:
            return
