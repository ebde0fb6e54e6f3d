# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Nodes."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from typing import Any

from ratslam_ros.standalone import logging
from ratslam_ros.standalone.arguments import Arguments, Names, overrides, parse
from ratslam_ros.standalone.clock import Clock, ROSClock, Time
from ratslam_ros.standalone.context import Context, get_default_context
from ratslam_ros.standalone.dds import EndpointQos
from ratslam_ros.standalone.exceptions import NotInitializedException
from ratslam_ros.standalone.graph import NamesAndTypes, TopicEndpointInfo
from ratslam_ros.standalone.handle import NodeHandle
from ratslam_ros.standalone.node_parts import CallbackGroup, NodePart, callable_with
from ratslam_ros.standalone.parameter_services import offer_services
from ratslam_ros.standalone.parameters import Parameter, Parameters
from ratslam_ros.standalone.qos import (
    DurabilityPolicy,
    QoSProfile,
    qos_profile_parameter_events,
    qos_profile_parameters,
    qos_profile_services_default,
    to_profile,
)
from ratslam_ros.standalone.services import Client, Service
from ratslam_ros.standalone.time_source import TimeSource
from ratslam_ros.standalone.timer import Timer
from ratslam_ros.standalone.topics import Publisher, Subscription
from ratslam_ros.standalone.types import message_class

_ROSOUT = QoSProfile(depth=1000, durability=DurabilityPolicy.TRANSIENT_LOCAL)
_ROSOUT_DDS = EndpointQos(1000, True, True, lifespan_ns=10_000_000_000)


class Node:
    """Something with a name that publishes, subscribes, and offers services."""

    def __init__(
        self,
        node_name: str,
        *,
        context: Context | None = None,
        cli_args: Sequence[str] | None = None,
        namespace: str | None = None,
        use_global_arguments: bool = True,
        enable_rosout: bool = True,
        start_parameter_services: bool = True,
        parameter_overrides: Sequence[Parameter] | None = None,
        allow_undeclared_parameters: bool = False,
        automatically_declare_parameters_from_overrides: bool = False,
        enable_logger_service: bool = False,
    ) -> None:
        if enable_logger_service:
            raise NotImplementedError('the stand-in for rclpy does not offer logger services')
        context = get_default_context() if context is None else context
        if not context.ok():
            raise NotInitializedException('cannot create node')
        own = [parse(['--ros-args', *_without_start(cli_args)])] if cli_args else []
        given = [context.arguments] if use_global_arguments else []
        self.__handle = NodeHandle(context, Names(node_name, namespace or '/', [*own, *given]))
        self.__clock = ROSClock()
        try:
            self.__prepare(
                {parameter.name: parameter.value for parameter in parameter_overrides or ()},
                [*given, *own],
                allow_undeclared_parameters,
                automatically_declare_parameters_from_overrides,
            )
            if start_parameter_services:
                offer_services(self, self.__parameters, qos_profile_parameters)
            if enable_rosout and context.arguments.to_rosout:
                self.__publish_logs()
        except BaseException:
            self.__handle.close()  # a node that cannot be made leaves nothing behind
            raise

    def __prepare(
        self,
        parameters: dict[str, Any],
        arguments: Sequence[Arguments],
        allow_undeclared: bool,
        declare_all: bool,
    ) -> None:
        """Set up parameters and time; ``parameters`` count more than those of ``arguments``."""
        self.__events = self.create_publisher(
            message_class('rcl_interfaces/msg/ParameterEvent'),
            '/parameter_events',
            qos_profile_parameter_events,
        )
        full_name = self.get_fully_qualified_name()
        values = overrides(full_name, arguments) | parameters
        self.__parameters = Parameters(full_name, values, allow_undeclared, self.__tell_change)
        if declare_all:
            self.declare_parameters('', [(n, v) for n, v in values.items()], ignore_override=True)
        TimeSource(self, self.__clock).attach()

    # What it is

    @property
    def context(self) -> Context:
        """The context that it lives in."""
        return self.__handle.context

    @property
    def default_callback_group(self) -> CallbackGroup:
        """The group of callbacks without one of their own."""
        return self.__handle.default_callback_group

    @property
    def handle(self) -> NodeHandle:
        """What is behind it."""
        return self.__handle

    @property
    def executor(self) -> Any:
        """The executor that runs its callbacks, None if there is none."""
        return self.__handle.executor

    @executor.setter
    def executor(self, new_executor: Any) -> None:
        before, self.__handle.executor = self.__handle.executor, new_executor
        if before is not None and before is not new_executor:
            before.remove_node(self)
        if new_executor is not None:
            new_executor.add_node(self)

    def get_name(self) -> str:
        """Return its name, without namespace."""
        return self.__handle.names.node

    def get_namespace(self) -> str:
        """Return its namespace."""
        return self.__handle.names.namespace

    def get_fully_qualified_name(self) -> str:
        """Return its name in its namespace."""
        return self.__handle.names.full

    def get_clock(self) -> Clock:
        """Return its clock, which follows /clock with use_sim_time."""
        return self.__clock

    def get_logger(self) -> logging.RcutilsLogger:
        """Return its logger."""
        return self.__handle.logger

    def resolve_topic_name(self, topic: str, *, only_expand: bool = False) -> str:
        """Return the full name of a topic, remapped unless told otherwise."""
        return self.__handle.names.resolve(topic, only_expand=only_expand)

    def resolve_service_name(self, service: str, *, only_expand: bool = False) -> str:
        """Return the full name of a service, remapped unless told otherwise."""
        return self.__handle.names.resolve(service, is_service=True, only_expand=only_expand)

    # What it has

    def create_publisher(
        self,
        msg_type: Any,
        topic: str,
        qos_profile: QoSProfile | int,
        *,
        callback_group: CallbackGroup | None = None,
        event_callbacks: Any = None,
        qos_overriding_options: None = None,
        publisher_class: None = None,
    ) -> Publisher:
        """Create a publisher.

        Raises:
            InvalidTopicNameException: ROS does not allow the name.
            NotImplementedError: the profile asks for what is not offered.
        """
        _refuse(qos_overriding_options=qos_overriding_options, publisher_class=publisher_class)
        _check_message_type(msg_type)
        qos = to_profile(qos_profile)
        return self.__handle.add(
            Publisher(self.__handle, msg_type, topic, qos, event_callbacks, callback_group)
        )

    def create_subscription(
        self,
        msg_type: Any,
        topic: str,
        callback: Callable[..., Any],
        qos_profile: QoSProfile | int,
        *,
        callback_group: CallbackGroup | None = None,
        event_callbacks: Any = None,
        qos_overriding_options: None = None,
        raw: bool = False,
    ) -> Subscription:
        """Create a subscription; its callback takes the message, and if it can, a dict of times.

        Raises:
            InvalidTopicNameException: ROS does not allow the name.
            NotImplementedError: the profile asks for what is not offered.
        """
        _refuse(qos_overriding_options=qos_overriding_options)
        _check_message_type(msg_type)
        made = Subscription(
            self.__handle,
            msg_type,
            topic,
            callback,
            to_profile(qos_profile),
            event_callbacks,
            callback_group,
            raw,
        )
        return self.__handle.add(made)

    def create_service(
        self,
        srv_type: Any,
        srv_name: str,
        callback: Callable[[Any, Any], Any],
        *,
        qos_profile: QoSProfile = qos_profile_services_default,
        callback_group: CallbackGroup | None = None,
    ) -> Service:
        """Create a service; its callback takes a request and an empty response, and returns one.

        Raises:
            InvalidServiceNameException: ROS does not allow the name.
        """
        _check_service_type(srv_type)
        return self.__handle.add(
            Service(self.__handle, srv_type, srv_name, callback, qos_profile, callback_group)
        )

    def create_client(
        self,
        srv_type: Any,
        srv_name: str,
        *,
        qos_profile: QoSProfile = qos_profile_services_default,
        callback_group: CallbackGroup | None = None,
    ) -> Client:
        """Create a client of a service.

        Raises:
            InvalidServiceNameException: ROS does not allow the name.
        """
        _check_service_type(srv_type)
        return self.__handle.add(
            Client(self.__handle, srv_type, srv_name, qos_profile, callback_group)
        )

    def create_timer(
        self,
        timer_period_sec: float,
        callback: Callable[[], Any] | None,
        callback_group: CallbackGroup | None = None,
        clock: Clock | None = None,
        autostart: bool = True,
    ) -> Timer:
        """Call something every so often, by the node's clock or another one."""
        if callback is not None:
            callable_with(callback, 0)
        period_ns = int(float(timer_period_sec) * 1e9)
        clock = self.__clock if clock is None else clock
        return self.__handle.add(
            Timer(self.__handle, callback, period_ns, clock, callback_group, autostart)
        )

    @property
    def publishers(self) -> Iterator[Publisher]:
        """Its publishers."""
        return self.__handle.parts(Publisher)

    @property
    def subscriptions(self) -> Iterator[Subscription]:
        """Its subscriptions."""
        return self.__handle.parts(Subscription)

    @property
    def services(self) -> Iterator[Service]:
        """Its services."""
        return self.__handle.parts(Service)

    @property
    def clients(self) -> Iterator[Client]:
        """Its clients of services."""
        return self.__handle.parts(Client)

    @property
    def timers(self) -> Iterator[Timer]:
        """Its timers."""
        return self.__handle.parts(Timer)

    def destroy_publisher(self, part: NodePart) -> bool:
        """Take back a publisher, or another part; return whether it was there."""
        return self.__handle.discard(part)

    destroy_subscription = destroy_service = destroy_client = destroy_publisher
    destroy_timer = destroy_publisher

    def destroy_node(self) -> None:
        """Take back everything, and the node itself; a second time does nothing."""
        if self.executor is not None:
            self.executor.remove_node(self)
        self.__handle.close()

    # Logs

    def __publish_logs(self) -> None:
        kind = message_class('rcl_interfaces/msg/Log')
        publisher = Publisher(self.__handle, kind, '/rosout', _ROSOUT, None, None, qos=_ROSOUT_DDS)
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

        logging.publish_with(self.__handle.logger.name, publish)

    # Parameters

    def declare_parameter(
        self, name: str, value: Any = None, descriptor: Any = None, ignore_override: bool = False
    ) -> Parameter:
        """Declare a parameter with its default (or type); return it with the value it has.

        Raises:
            ParameterAlreadyDeclaredException, InvalidParameterException,
            InvalidParameterTypeException, InvalidParameterValueException: see their names.
        """
        return self.__parameters.declare('', [(name, value, descriptor)], ignore_override)[0]

    def declare_parameters(
        self, namespace: str, parameters: Sequence[Sequence[Any]], ignore_override: bool = False
    ) -> list[Parameter]:
        """Declare parameters, each a name and maybe a default (or type) and a descriptor."""
        return self.__parameters.declare(namespace, parameters, ignore_override)

    def undeclare_parameter(self, name: str) -> None:
        """Forget a parameter."""
        self.__parameters.undeclare(name)

    def has_parameter(self, name: str) -> bool:
        """Tell whether a parameter is declared."""
        return self.__parameters.has(name)

    def get_parameter(self, name: str) -> Parameter:
        """Return a parameter; raises ParameterNotDeclaredException."""
        return self.__parameters.get(name)

    def get_parameters(self, names: Sequence[str]) -> list[Parameter]:
        """Return parameters; raises ParameterNotDeclaredException."""
        return [self.__parameters.get(name) for name in names]

    def get_parameter_or(self, name: str, alternative_value: Parameter | None = None) -> Parameter:
        """Return a parameter, or another one where it has no value."""
        return self.__parameters.get_or(name, alternative_value)

    def get_parameters_by_prefix(self, prefix: str) -> dict[str, Parameter]:
        """Return the parameters whose names begin so, by the rest of their names."""
        return self.__parameters.by_prefix(prefix)

    def set_parameters(self, parameter_list: Sequence[Parameter]) -> list[Any]:
        """Set parameters one by one; return a result for each."""
        return [self.__parameters.set([parameter]) for parameter in parameter_list]

    def set_parameters_atomically(self, parameter_list: Sequence[Parameter]) -> Any:
        """Set all parameters or none; return the result."""
        return self.__parameters.set(parameter_list)

    def list_parameters(self, prefixes: Sequence[str], depth: int) -> Any:
        """Return the names below prefixes, no deeper than so many dots."""
        return self.__parameters.list(prefixes, depth)

    def describe_parameter(self, name: str) -> Any:
        """Return a parameter's descriptor; raises ParameterNotDeclaredException."""
        return self.__parameters.describe(name)

    def describe_parameters(self, names: Sequence[str]) -> list[Any]:
        """Return parameters' descriptors; raises ParameterNotDeclaredException."""
        return [self.__parameters.describe(name) for name in names]

    def add_on_set_parameters_callback(self, callback: Callable[..., Any]) -> None:
        """Let a function refuse what is to be set; the newest one is asked first."""
        self.__parameters.callbacks.insert(0, callback)

    def add_post_set_parameters_callback(self, callback: Callable[..., Any]) -> None:
        """Tell a function of what was set."""
        self.__parameters.post_callbacks.insert(0, callback)

    def remove_on_set_parameters_callback(self, callback: Callable[..., Any]) -> None:
        """Undo ``add_on_set_parameters_callback``."""
        self.__parameters.callbacks.remove(callback)

    def remove_post_set_parameters_callback(self, callback: Callable[..., Any]) -> None:
        """Undo ``add_post_set_parameters_callback``."""
        self.__parameters.post_callbacks.remove(callback)

    def __tell_change(self, event: Any) -> None:
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

    def get_topic_names_and_types(self, no_demangle: bool = False) -> NamesAndTypes:
        """Return all topics and their types."""
        return self.__handle.context.graph.topics(no_demangle)

    def get_service_names_and_types(self) -> NamesAndTypes:
        """Return all services and their types."""
        return self.__handle.context.graph.services()

    def count_publishers(self, topic_name: str) -> int:
        """Return how many publishers a topic has."""
        return self.__handle.context.graph.count(
            f'rt{self.resolve_topic_name(topic_name)}', 'writer'
        )

    def count_subscribers(self, topic_name: str) -> int:
        """Return how many subscriptions a topic has."""
        return self.__handle.context.graph.count(
            f'rt{self.resolve_topic_name(topic_name)}', 'reader'
        )

    def get_publishers_info_by_topic(
        self, topic_name: str, no_mangle: bool = False
    ) -> list[TopicEndpointInfo]:
        """Return who publishes a topic, and how."""
        return self.__endpoints(topic_name, no_mangle, 'writer')

    def get_subscriptions_info_by_topic(
        self, topic_name: str, no_mangle: bool = False
    ) -> list[TopicEndpointInfo]:
        """Return who subscribes to a topic, and how."""
        return self.__endpoints(topic_name, no_mangle, 'reader')

    def __endpoints(self, topic: str, no_mangle: bool, kind: str) -> list[TopicEndpointInfo]:
        name = topic if no_mangle else f'rt{self.resolve_topic_name(topic)}'
        return self.__handle.context.graph.endpoints(name, kind)


def _without_start(args: Sequence[str]) -> list[str]:
    return list(args[1:]) if args and args[0] == '--ros-args' else list(args)


def _refuse(**options: Any) -> None:
    for name, value in options.items():
        if value is not None:
            raise NotImplementedError(f'the stand-in for rclpy does not offer {name}')


def _check_message_type(msg_type: Any) -> None:
    if not hasattr(msg_type, '__msgtype__'):
        raise TypeError(f'{msg_type!r}: expected a message type such as std_msgs.msg.String')


def _check_service_type(srv_type: Any) -> None:
    if not hasattr(srv_type, '__srvtype__'):
        raise TypeError(f'{srv_type!r}: expected a service type such as std_srvs.srv.Trigger')
