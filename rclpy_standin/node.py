# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Nodes."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from typing import Any

from rclpy_standin import logging
from rclpy_standin.arguments import Arguments, Names, overrides
from rclpy_standin.clock import Clock, ROSClock, Time
from rclpy_standin.context import Context, get_default_context
from rclpy_standin.dds import EndpointQos
from rclpy_standin.events import SubscriptionEventCallbacks
from rclpy_standin.exceptions import NotInitializedException
from rclpy_standin.graph import NamesAndTypes, TopicEndpointInfo
from rclpy_standin.handle import NodeHandle
from rclpy_standin.node_parts import NodePart, check_arguments
from rclpy_standin.parameter_services import create_parameter_services
from rclpy_standin.parameters import Parameter, Parameters
from rclpy_standin.qos import (
    DurabilityPolicy,
    QoSProfile,
    qos_profile_parameter_events,
    qos_profile_parameters,
    qos_profile_services_default,
    to_profile,
)
from rclpy_standin.services import Client, Service
from rclpy_standin.time_source import TimeSource
from rclpy_standin.timer import Timer
from rclpy_standin.topics import Publisher, Subscription
from rclpy_standin.types import message_class

_ROSOUT = QoSProfile(depth=1000, durability=DurabilityPolicy.TRANSIENT_LOCAL)
_ROSOUT_DDS = EndpointQos(1000, True, True, lifespan_ns=10_000_000_000)


class Node:
    """A ROS node: its publishers, subscriptions, services, clients, timers and parameters."""

    def __init__(
        self,
        node_name: str,
        *,
        context: Context | None = None,
        namespace: str | None = None,
        use_global_arguments: bool = True,
        enable_rosout: bool = True,
        start_parameter_services: bool = True,
        automatically_declare_parameters_from_overrides: bool = False,
    ) -> None:
        context = get_default_context() if context is None else context
        if not context.ok():
            raise NotInitializedException('cannot create node')
        shared = [context.arguments] if use_global_arguments else []
        self.__handle = NodeHandle(context, Names(node_name, namespace or '/', shared))
        self.__clock = ROSClock()
        try:
            self.__prepare(shared, automatically_declare_parameters_from_overrides)
            if start_parameter_services:
                create_parameter_services(self, self.__parameters, qos_profile_parameters)
            if enable_rosout and context.arguments.to_rosout:
                self.__publish_logs()
        except BaseException:
            self.__handle.close()  # do not announce a node that cannot be created
            raise

    def __prepare(self, arguments: Sequence[Arguments], declare_all: bool) -> None:
        """Set up parameters and time."""
        self.__events = self.create_publisher(
            message_class('rcl_interfaces/msg/ParameterEvent'),
            '/parameter_events',
            qos_profile_parameter_events,
        )
        full_name = self.get_fully_qualified_name()
        values = overrides(full_name, arguments)
        self.__parameters = Parameters(full_name, values, self.__publish_event)
        if declare_all:
            for name in values:
                self.declare_parameter(name, values[name])
        TimeSource(self, self.__clock).attach()

    # Identity

    @property
    def context(self) -> Context:
        """Context of the node."""
        return self.__handle.context

    @property
    def handle(self) -> NodeHandle:
        """Internal state of the node."""
        return self.__handle

    @property
    def executor(self) -> Any:
        """Executor that runs the callbacks; None if the node is in no executor."""
        return self.__handle.executor

    @executor.setter
    def executor(self, new_executor: Any) -> None:
        old_executor, self.__handle.executor = self.__handle.executor, new_executor
        if old_executor is not None and old_executor is not new_executor:
            old_executor.remove_node(self)
        if new_executor is not None:
            new_executor.add_node(self)

    def get_name(self) -> str:
        """Return the name without the namespace."""
        return self.__handle.names.node

    def get_namespace(self) -> str:
        """Return the namespace."""
        return self.__handle.names.namespace

    def get_fully_qualified_name(self) -> str:
        """Return the name with the namespace."""
        return self.__handle.names.full

    def get_clock(self) -> Clock:
        """Return the clock, which follows /clock if use_sim_time is set."""
        return self.__clock

    def get_logger(self) -> logging.RcutilsLogger:
        """Return the logger."""
        return self.__handle.logger

    def resolve_topic_name(self, topic: str) -> str:
        """Return the full name of a topic after remapping."""
        return self.__handle.names.resolve(topic)

    def resolve_service_name(self, service: str) -> str:
        """Return the full name of a service after remapping."""
        return self.__handle.names.resolve(service, is_service=True)

    # Publishers, subscriptions, services, clients and timers

    def create_publisher(
        self,
        msg_type: Any,
        topic: str,
        qos_profile: QoSProfile | int,
    ) -> Publisher:
        """Create a publisher.

        Raises:
            InvalidTopicNameException: the name is invalid.
        """
        _check_message_type(msg_type)
        qos = to_profile(qos_profile)
        return self.__handle.add(
            Publisher(self.__handle, msg_type, topic, qos)
        )

    def create_subscription(
        self,
        msg_type: Any,
        topic: str,
        callback: Callable[..., Any],
        qos_profile: QoSProfile | int,
        *,
        event_callbacks: SubscriptionEventCallbacks | None = None,
        raw: bool = False,
    ) -> Subscription:
        """Create a subscription.

        The callback takes the message; with ``raw`` set, its CDR as bytes.

        Raises:
            InvalidTopicNameException: the name is invalid.
        """
        _check_message_type(msg_type)
        subscription = Subscription(
            self.__handle,
            msg_type,
            topic,
            callback,
            to_profile(qos_profile),
            event_callbacks or SubscriptionEventCallbacks(),
            raw,
        )
        return self.__handle.add(subscription)

    def create_service(
        self,
        srv_type: Any,
        srv_name: str,
        callback: Callable[[Any, Any], Any],
        *,
        qos_profile: QoSProfile = qos_profile_services_default,
    ) -> Service:
        """Create a service; the callback takes the request and an empty response to return.

        Raises:
            InvalidServiceNameException: the name is invalid.
        """
        _check_service_type(srv_type)
        return self.__handle.add(
            Service(self.__handle, srv_type, srv_name, callback, qos_profile)
        )

    def create_client(
        self,
        srv_type: Any,
        srv_name: str,
        *,
        qos_profile: QoSProfile = qos_profile_services_default,
    ) -> Client:
        """Create a client of a service.

        Raises:
            InvalidServiceNameException: the name is invalid.
        """
        _check_service_type(srv_type)
        return self.__handle.add(
            Client(self.__handle, srv_type, srv_name, qos_profile)
        )

    def create_timer(
        self,
        timer_period_sec: float,
        callback: Callable[[], Any] | None,
        clock: Clock | None = None,
    ) -> Timer:
        """Create a timer; it uses the clock of the node if ``clock`` is None."""
        if callback is not None:
            check_arguments(callback, 0)
        period_ns = int(float(timer_period_sec) * 1e9)
        clock = self.__clock if clock is None else clock
        return self.__handle.add(
            Timer(self.__handle, callback, period_ns, clock)
        )

    @property
    def publishers(self) -> Iterator[Publisher]:
        """Publishers of the node."""
        return self.__handle.parts(Publisher)

    @property
    def subscriptions(self) -> Iterator[Subscription]:
        """Subscriptions of the node."""
        return self.__handle.parts(Subscription)

    @property
    def services(self) -> Iterator[Service]:
        """Services of the node."""
        return self.__handle.parts(Service)

    @property
    def clients(self) -> Iterator[Client]:
        """Service clients of the node."""
        return self.__handle.parts(Client)

    def destroy_publisher(self, part: NodePart) -> bool:
        """Destroy a publisher or another part; return whether it belonged to the node."""
        return self.__handle.discard(part)

    destroy_subscription = destroy_service = destroy_client = destroy_publisher
    destroy_timer = destroy_publisher

    def destroy_node(self) -> None:
        """Destroy the node and all its parts; further calls do nothing."""
        if self.executor is not None:
            self.executor.remove_node(self)
        self.__handle.close()

    # Logs

    def __publish_logs(self) -> None:
        """Publish the records of the node's logger on /rosout."""
        kind = message_class('rcl_interfaces/msg/Log')
        publisher = Publisher(self.__handle, kind, '/rosout', _ROSOUT, qos=_ROSOUT_DDS)
        self.__handle.add(publisher)

        def publish(record: logging.Record) -> None:
            if not self.__handle.context.ok():
                return
            stamp = Time(nanoseconds=record.stamp_ns).to_msg()
            publisher.publish(
                kind(
                    stamp=stamp,
                    level=int(record.level),
                    name=record.name,
                    msg=record.text,
                    file=record.file,
                    function=record.function,
                    line=record.line,
                )
            )

        logging.set_publisher(self.__handle.logger.name, publish)

    # Parameters

    def declare_parameter(
        self, name: str, value: Any = None, descriptor: Any = None, ignore_override: bool = False
    ) -> Parameter:
        """Declare a parameter.

        Args:
            name: name of the parameter.
            value: default, which determines the type.
            descriptor: rcl_interfaces/ParameterDescriptor.
            ignore_override: use the default even if there is an override.

        Returns:
            The parameter with its initial value.

        Raises:
            ParameterAlreadyDeclaredException: the parameter is already declared.
            InvalidParameterException: the name is invalid.
            InvalidParameterTypeException: the override has another type.
            InvalidParameterValueException: the value was rejected.
        """
        return self.__parameters.declare(name, value, descriptor, ignore_override)

    def declare_parameters(
        self, namespace: str, parameters: Sequence[Sequence[Any]], ignore_override: bool = False
    ) -> list[Parameter]:
        """Declare parameters below a namespace, by name, default and descriptor."""
        prefix = f'{namespace}.' if namespace else ''
        rows = ((name, value, *rest, None) for name, value, *rest in parameters)
        return [
            self.declare_parameter(f'{prefix}{name}', value, descriptor, ignore_override)
            for name, value, descriptor, *_ in rows
        ]

    def undeclare_parameter(self, name: str) -> None:
        """Undeclare a parameter."""
        self.__parameters.undeclare(name)

    def has_parameter(self, name: str) -> bool:
        """Return whether a parameter is declared."""
        return self.__parameters.has(name)

    def get_parameter(self, name: str) -> Parameter:
        """Return a parameter; raises ParameterNotDeclaredException."""
        return self.__parameters.get(name)

    def get_parameters(self, names: Sequence[str]) -> list[Parameter]:
        """Return parameters; raises ParameterNotDeclaredException."""
        return [self.__parameters.get(name) for name in names]

    def get_parameters_by_prefix(self, prefix: str) -> dict[str, Parameter]:
        """Return the parameters below a prefix, by name relative to it."""
        return self.__parameters.by_prefix(prefix)

    def set_parameters(self, parameter_list: Sequence[Parameter]) -> list[Any]:
        """Set parameters one by one; return a SetParametersResult for each."""
        return [self.__parameters.set([parameter]) for parameter in parameter_list]

    def set_parameters_atomically(self, parameter_list: Sequence[Parameter]) -> Any:
        """Set all parameters or none; return a SetParametersResult."""
        return self.__parameters.set(parameter_list)

    def list_parameters(self, prefixes: Sequence[str], depth: int) -> Any:
        """Return the names below the prefixes, at most ``depth`` levels deep (0: all)."""
        return self.__parameters.list(prefixes, depth)

    def describe_parameters(self, names: Sequence[str]) -> list[Any]:
        """Return the descriptors of parameters; raises ParameterNotDeclaredException."""
        return [self.__parameters.describe(name) for name in names]

    def add_on_set_parameters_callback(self, callback: Callable[..., Any]) -> None:
        """Add a callback that accepts or rejects new values; the newest callback runs first."""
        self.__parameters.callbacks.insert(0, callback)

    def __publish_event(self, event: Any) -> None:
        event.stamp = self.__clock.now().to_msg()
        if self.__handle.is_open:
            self.__events.publish(event)

    # The graph

    def get_node_names(self) -> list[str]:
        """Return the names of all nodes."""
        return [node.name for node in self.__handle.context.graph.nodes()]

    def get_node_names_and_namespaces(self) -> list[tuple[str, str]]:
        """Return the names and namespaces of all nodes."""
        return [(name, namespace) for name, namespace in self.__handle.context.graph.nodes()]

    def get_topic_names_and_types(self) -> NamesAndTypes:
        """Return all topics and their types."""
        return self.__handle.context.graph.topics()

    def get_service_names_and_types(self) -> NamesAndTypes:
        """Return all services and their types."""
        return self.__handle.context.graph.services()

    def count_publishers(self, topic_name: str) -> int:
        """Return the number of publishers of a topic."""
        return self.__handle.context.graph.count(
            f'rt{self.resolve_topic_name(topic_name)}', 'writer'
        )

    def count_subscribers(self, topic_name: str) -> int:
        """Return the number of subscriptions of a topic."""
        return self.__handle.context.graph.count(
            f'rt{self.resolve_topic_name(topic_name)}', 'reader'
        )

    def get_publishers_info_by_topic(self, topic_name: str) -> list[TopicEndpointInfo]:
        """Return the publishers of a topic, with their nodes and QoS profiles."""
        return self.__endpoints(topic_name, 'writer')

    def get_subscriptions_info_by_topic(self, topic_name: str) -> list[TopicEndpointInfo]:
        """Return the subscriptions of a topic, with their nodes and QoS profiles."""
        return self.__endpoints(topic_name, 'reader')

    def __endpoints(self, topic: str, kind: str) -> list[TopicEndpointInfo]:
        name = f'rt{self.resolve_topic_name(topic)}'
        return self.__handle.context.graph.endpoints(name, kind)


def _check_message_type(msg_type: Any) -> None:
    if not hasattr(msg_type, '__msgtype__'):
        raise TypeError(f'{msg_type!r}: expected a message type such as std_msgs.msg.String')


def _check_service_type(srv_type: Any) -> None:
    if not hasattr(srv_type, '__srvtype__'):
        raise TypeError(f'{srv_type!r}: expected a service type such as std_srvs.srv.Trigger')
