# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Functions of the module rclpy and of its utilities."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from typing import Any

from rclpy_standin import arguments
from rclpy_standin.context import (
    Context,
    SignalHandlerOptions,
    get_default_context,
    install_signal_handlers,
    uninstall_signal_handlers,
)
from rclpy_standin.executors import get_global_executor
from rclpy_standin.node import Node
from rclpy_standin.types import decode, encode


def init(
    *,
    args: Sequence[str] | None = None,
    context: Context | None = None,
    signal_handler_options: SignalHandlerOptions | None = None,
) -> Context:
    """Initialise a context: join the domain of ROS_DOMAIN_ID and install signal handlers.

    Args:
        args: command line; ``sys.argv`` if None.
        context: context to initialise; the default context if None.
        signal_handler_options: signals that shut down; if None, all of them for the default
            context and none for any other context.

    Returns:
        The context.

    Raises:
        RuntimeError: the context is already initialised, or the ROS arguments are invalid.
    """
    context = get_default_context() if context is None else context
    if signal_handler_options is None:
        signal_handler_options = (
            SignalHandlerOptions.ALL
            if context is get_default_context()
            else SignalHandlerOptions.NO
        )
    install_signal_handlers(signal_handler_options)
    try:
        context.init(args)
    except BaseException:
        if not context.ok():
            uninstall_signal_handlers()
        raise
    return context


def ok(*, context: Context | None = None) -> bool:
    """Return whether the context is initialised and not shut down."""
    return (get_default_context() if context is None else context).ok()


def shutdown(*, context: Context | None = None) -> None:
    """Shut down a context; raises RuntimeError if it is not initialised."""
    context = get_default_context() if context is None else context
    context.shutdown()
    _finish_shutdown(context)


def try_shutdown(*, context: Context | None = None) -> None:
    """Shut down a context if it is initialised."""
    context = get_default_context() if context is None else context
    context.try_shutdown()
    _finish_shutdown(context)


def _finish_shutdown(context: Context) -> None:
    context.close_if_unused()
    if context is get_default_context():
        uninstall_signal_handlers()


def create_node(node_name: str, **options: Any) -> Node:
    """Create a node; see ``Node`` for the options."""
    return Node(node_name, **options)


def spin(node: Node, executor: Any = None) -> None:
    """Run a node's callbacks until shutdown.

    Raises:
        ExternalShutdownException: the context was shut down while the executor waited.
    """
    with _executor_of(node, executor) as spinning:
        while spinning.context.ok():
            spinning.spin_once()


def spin_once(node: Node, *, executor: Any = None, timeout_sec: float | None = None) -> None:
    """Run one callback of a node, waiting for it until the timeout."""
    with _executor_of(node, executor) as spinning:
        spinning.spin_once(timeout_sec=timeout_sec)


def spin_until_future_complete(
    node: Node, future: Any, executor: Any = None, timeout_sec: float | None = None
) -> None:
    """Run a node's callbacks until a future is done or the timeout has passed."""
    with _executor_of(node, executor) as spinning:
        spinning.spin_until_future_complete(future, timeout_sec)


@contextmanager
def _executor_of(node: Node, executor: Any) -> Iterator[Any]:
    """Add a node to an executor, by default to the global one, for the duration of a context."""
    executor = get_global_executor() if executor is None else executor
    try:
        executor.add_node(node)
        yield executor
    finally:
        executor.remove_node(node)


def remove_ros_args(args: Sequence[str] | None = None) -> list[str]:
    """Return a command line without its ROS arguments; ``sys.argv`` if None."""
    import sys

    return arguments.remove_ros_args(sys.argv if args is None else args)


def serialize_message(message: Any) -> bytes:
    """Return the CDR encoding of a message."""
    return bytes(encode(message))


def deserialize_message(serialized_message: bytes, message_type: Any) -> Any:
    """Decode a message from CDR; raises ValueError if the bytes are no such message."""
    return decode(serialized_message, message_type)


def get_message(identifier: str) -> Any:
    """Return the class of a message type such as ``std_msgs/msg/String``."""
    return _import_type(identifier, 'msg')


def get_service(identifier: str) -> Any:
    """Return the class of a service type such as ``std_srvs/srv/Trigger``."""
    return _import_type(identifier, 'srv')


def _import_type(identifier: str, kind: str) -> Any:
    from importlib import import_module

    parts = identifier.split('/')
    if len(parts) not in (2, 3) or not all(parts) or (len(parts) == 3 and parts[1] != kind):
        raise ValueError(f'{identifier!r}: expected package/{kind}/Name')
    return getattr(import_module(f'{parts[0]}.{kind}'), parts[-1])
