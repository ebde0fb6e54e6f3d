# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""What the module rclpy itself offers."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from ratslam_ros.standalone import arguments
from ratslam_ros.standalone.context import (
    Context,
    SignalHandlerOptions,
    get_default_context,
    install_signal_handlers,
    uninstall_signal_handlers,
)
from ratslam_ros.standalone.executors import get_global_executor
from ratslam_ros.standalone.node import Node
from ratslam_ros.standalone.types import decode, encode


def init(
    *,
    args: Sequence[str] | None = None,
    context: Context | None = None,
    domain_id: int | None = None,
    signal_handler_options: SignalHandlerOptions | None = None,
) -> Context:
    """Join the domain; handle signals, unless told otherwise or in a context of one's own.

    Raises:
        RuntimeError: this has been done before, or there are arguments that ROS does not know.
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
        context.init(args, domain_id=domain_id)
    except BaseException:
        if not context.ok():
            uninstall_signal_handlers()
        raise
    return context


def ok(*, context: Context | None = None) -> bool:
    """Tell whether the context was initialised and not shut down."""
    return (get_default_context() if context is None else context).ok()


def shutdown(*, context: Context | None = None, uninstall_handlers: bool | None = None) -> None:
    """Shut down; raises RuntimeError where that has been done."""
    context = get_default_context() if context is None else context
    context.shutdown()
    _ended(context, uninstall_handlers)


def try_shutdown(
    *, context: Context | None = None, uninstall_handlers: bool | None = None
) -> None:
    """Shut down unless that has been done."""
    context = get_default_context() if context is None else context
    context.try_shutdown()
    _ended(context, uninstall_handlers)


def _ended(context: Context, uninstall_handlers: bool | None) -> None:
    context.end()
    if uninstall_handlers or (uninstall_handlers is None and context is get_default_context()):
        uninstall_signal_handlers()


def create_node(node_name: str, **options: Any) -> Node:
    """Create a node; see Node."""
    return Node(node_name, **options)


def spin(node: Node, executor: Any = None) -> None:
    """Run a node's callbacks until shutdown.

    Raises:
        ExternalShutdownException: the context was shut down while it waited.
    """
    executor = get_global_executor() if executor is None else executor
    try:
        executor.add_node(node)
        while executor.context.ok():
            executor.spin_once()
    finally:
        executor.remove_node(node)


def spin_once(node: Node, *, executor: Any = None, timeout_sec: float | None = None) -> None:
    """Run one of a node's callbacks, or wait until the timeout for one."""
    executor = get_global_executor() if executor is None else executor
    try:
        executor.add_node(node)
        executor.spin_once(timeout_sec=timeout_sec)
    finally:
        executor.remove_node(node)


def spin_until_future_complete(
    node: Node, future: Any, executor: Any = None, timeout_sec: float | None = None
) -> None:
    """Run a node's callbacks until a future is done, or the time is over."""
    executor = get_global_executor() if executor is None else executor
    try:
        executor.add_node(node)
        executor.spin_until_future_complete(future, timeout_sec)
    finally:
        executor.remove_node(node)


def remove_ros_args(args: Sequence[str] | None = None) -> list[str]:
    """Return a command line without what is meant for ROS."""
    import sys

    return arguments.remove_ros_args(sys.argv if args is None else args)


def serialize_message(message: Any) -> bytes:
    """Return a message as CDR."""
    return bytes(encode(message))


def deserialize_message(serialized_message: bytes, message_type: Any) -> Any:
    """Return the message that CDR holds; raises ValueError."""
    return decode(serialized_message, message_type)


def get_message(identifier: str) -> Any:
    """Return the class of a message type such as ``std_msgs/msg/String``."""
    return _imported(identifier, 'msg')


def get_service(identifier: str) -> Any:
    """Return the class of a service type such as ``std_srvs/srv/Trigger``."""
    return _imported(identifier, 'srv')


def _imported(identifier: str, kind: str) -> Any:
    from importlib import import_module

    parts = identifier.split('/')
    if len(parts) not in (2, 3) or not all(parts) or (len(parts) == 3 and parts[1] != kind):
        raise ValueError(f'{identifier!r}: expected package/{kind}/Name')
    return getattr(import_module(f'{parts[0]}.{kind}'), parts[-1])
