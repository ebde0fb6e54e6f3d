# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""DDS entities: participant, readers, writers and wait sets of Cyclone DDS.

Samples are raw CDR. Parts of cyclonedds' private API are used, so its minor version is pinned.
"""

from __future__ import annotations

import ctypes as ct
import threading
from collections.abc import Callable
from contextlib import suppress
from functools import cache
from typing import Any, Generic, NamedTuple, TypeVar

import numpy as np
from cyclonedds import _clayer
from cyclonedds.builtin import (
    BuiltinDataReader,
    BuiltinTopicDcpsParticipant,
    BuiltinTopicDcpsPublication,
    BuiltinTopicDcpsSubscription,
)
from cyclonedds.builtin_types import cqos_to_qos, endpoint_constructor
from cyclonedds.core import DDSException, InstanceState, SampleState, ViewState
from cyclonedds.domain import DomainParticipant
from cyclonedds.idl import make_idl_struct, types
from cyclonedds.internal import dds_c_t
from cyclonedds.qos import Policy, Qos, _CQos
from cyclonedds.topic import Topic

from rclpy_standin import dds_functions as c
from rclpy_standin.dds_domains import enter_domain, leave_domain
from rclpy_standin.definitions import Field, fields_of, type_hash
from rclpy_standin.exceptions import RCLError

idl: Any = types  # its generics are not understood by type checkers
Value = TypeVar('Value')

INFINITE_NS = 2**63 - 1
SERVICE_HEADER_BYTES = 16
"""Client ID and sequence number before the body of a request or reply."""
_MAX_BLOCKING_NS = 100_000_000
"""Longest blocking call; Python handles signals between calls."""
_ANY = SampleState.Any | ViewState.Any | InstanceState.Any


# Types


@cache
def _idl_struct(name: str, in_service: bool) -> Any:
    """Return the XTypes description of a message type."""
    package, kind, short = name.split('/')
    fields: dict[str, Any] = {}
    if in_service:
        fields = {'client_id': idl.uint64, 'sequence_number': idl.int64}
    for field in fields_of(name):
        fields[field.name] = _idl_type(field)
    if not fields_of(name):
        fields['structure_needs_at_least_one_member'] = idl.uint8
    return make_idl_struct(f'{short}_', f'{package}.{kind}.dds_.{short}_', fields)


def _idl_type(field: Field) -> Any:
    one: Any
    if field.is_message:
        one = _idl_struct(field.base, False)
    elif field.base == 'string':
        one = idl.bounded_str[field.bound] if field.bound else str
    elif field.base == 'bool':
        one = bool
    else:
        one = getattr(idl, {'char': 'uint8'}.get(field.base, field.base))
    if field.size is None:
        return one
    if field.is_fixed:
        return idl.array[one, field.size]
    return idl.sequence[one, field.size] if field.size else idl.sequence[one]


# Quality of service


class EndpointQos(NamedTuple):
    """QoS policies of an endpoint that ROS uses; history is KEEP_ALL if ``depth`` is None."""

    depth: int | None
    reliable: bool
    transient_local: bool
    lifespan_ns: int | None = None


def _policies(qos: EndpointQos, user_data: str) -> Qos:
    history = Policy.History.KeepAll if qos.depth is None else Policy.History.KeepLast(qos.depth)
    policies: list[Any] = [
        Policy.WriterDataLifecycle(autodispose=False),
        history,
        Policy.Reliability.Reliable(_MAX_BLOCKING_NS)
        if qos.reliable
        else Policy.Reliability.BestEffort,
        Policy.DataRepresentation(use_cdrv0_representation=True, use_xcdrv2_representation=False),
        Policy.Userdata(user_data.encode()),
    ]
    if qos.transient_local:
        # DDS configures the history for late joiners separately from the history of the writer.
        policies += [
            Policy.Durability.TransientLocal,
            Policy.DurabilityService(0, history, -1, -1, -1),
        ]
    if qos.lifespan_ns is not None:
        policies.append(Policy.Lifespan(qos.lifespan_ns))
    return Qos(*policies)


def _endpoint_qos(qos: Qos) -> EndpointQos:
    history = qos[Policy.History]
    return EndpointQos(
        getattr(history, 'depth', None) if history is not None else 1,
        qos[Policy.Reliability] != Policy.Reliability.BestEffort,
        qos[Policy.Durability] == Policy.Durability.TransientLocal,
    )


def user_value(data: str, key: str) -> str:
    """Return the value of a key in USER_DATA; '' if it is missing."""
    for part in data.split(';'):
        name, equals, value = part.partition('=')
        if equals and name == key:
            return value
    return ''


def _user_data(qos: Qos) -> str:
    policy = qos[Policy.Userdata]
    return bytes(policy.data).decode(errors='replace') if policy is not None else ''


# Entities


class Entity:
    """A DDS entity, deleted at most once."""

    def __init__(self, reference: int) -> None:
        self.reference = reference
        self._lock = threading.RLock()  # reentrant: a signal handler may interrupt a holder
        self._alive = True

    def close(self) -> None:
        """Delete the entity; further calls do nothing."""
        with self._lock:
            alive, self._alive = self._alive, False
        if alive:
            with suppress(RCLError):  # deleting the participant deletes its entities
                c.delete(self.reference)

    @property
    def is_open(self) -> bool:
        """Whether the entity has not been deleted."""
        return self._alive

    @property
    def gid(self) -> bytes:
        """Globally unique identifier, 16 bytes."""
        out = (ct.c_uint8 * 16)()
        c.get_guid(self.reference, out)
        return bytes(out)

    @property
    def handle(self) -> int:
        """Instance handle, an unsigned 64-bit integer."""
        out = ct.c_uint64()
        c.get_handle(self.reference, ct.byref(out))
        return out.value


class Guard(Entity):
    """A guard condition; any thread may trigger it."""

    def __init__(self, participant: Participant) -> None:
        super().__init__(c.create_guard(participant.reference))

    def set(self) -> None:
        """Trigger the condition, which ends the current or the next wait."""
        with self._lock:
            if self._alive:
                c.set_guard(self.reference, True)

    def take(self) -> None:
        """Reset the condition."""
        c.take_guard(self.reference, ct.byref(ct.c_bool()))


class StatusChange(NamedTuple):
    """Counts of a communication status and their changes since it was last taken."""

    total: int
    total_change: int
    policy: int


class Endpoint(Entity):
    """A DDS reader or writer."""

    _get_matched: Callable[..., int]
    _get_data: Callable[..., Any]
    """Functions that return the matched endpoints, and the description of one of them."""

    def __init__(self, reference: int, name: str) -> None:
        super().__init__(reference)
        self.name = name
        c.set_mask(reference, 0)

    def watch(self, *statuses: str) -> None:
        """Trigger the wait set this endpoint is attached to when one of the statuses changes."""
        c.set_mask(self.reference, sum(c.STATUSES[status][0] for status in statuses))

    def take_status(self, status: str) -> StatusChange:
        """Return a status and its changes since the last call."""
        out = c.STATUSES[status][1]()
        c.get_status[status](self.reference, ct.byref(out))
        return StatusChange(
            out.total_count,
            out.total_count_change,
            getattr(out, 'last_policy_id', 0),
        )

    @property
    def matched(self) -> list[int]:
        """Instance handles of the matched endpoints."""
        capacity = 16
        while True:
            out = (ct.c_uint64 * capacity)()
            count = self._get_matched(self.reference, out, capacity)
            if count <= capacity:
                return list(out[:count])
            capacity = count

    def user_data_of(self, handle: int) -> str | None:
        """Return the USER_DATA of a matched endpoint; None if it is gone."""
        found = self._get_data(self.reference, handle, endpoint_constructor, cqos_to_qos)
        return None if found is None else _user_data(found.qos)


class Writer(Endpoint):
    """Writer of serialised samples; thread-safe."""

    _get_matched = staticmethod(c.matched_readers)
    _get_data = staticmethod(_clayer.ddspy_get_matched_subscription_data)

    def write(self, data: bytes | bytearray) -> None:
        """Write a sample.

        Blocks while a reliable KEEP_ALL reader cannot accept more samples.

        Args:
            data: CDR with its 4-byte header; the length must be a multiple of 4.
        """
        start = np.frombuffer(data, np.uint8)
        sample = c.Sample(start.ctypes.data, len(data))
        while not c.completed('dds_write', c.write(self.reference, ct.byref(sample))):
            pass  # each attempt times out, so that Python can handle signals

    def wait_for_acks(self, timeout_ns: int) -> bool:
        """Wait until all readers acknowledged all samples; return False after the timeout."""
        while True:
            blocking_ns = min(_MAX_BLOCKING_NS, timeout_ns)
            if c.completed('dds_wait_for_acks', c.wait_for_acks(self.reference, blocking_ns)):
                return True
            timeout_ns -= blocking_ns
            if timeout_ns <= 0:
                return False


class TakenSample(NamedTuple, Generic[Value]):
    """A converted sample and its origin."""

    value: Value
    publication_handle: int


class Reader(Endpoint):
    """Reader of serialised samples."""

    _get_matched = staticmethod(c.matched_writers)
    _get_data = staticmethod(_clayer.ddspy_get_matched_publication_data)

    def __init__(self, reference: int, name: str) -> None:
        super().__init__(reference, name)
        self.condition = c.create_condition(reference, _ANY)

    def take(self, convert: Callable[[memoryview], Value]) -> TakenSample[Value] | None:
        """Take and convert the oldest sample.

        Args:
            convert: function of the sample's bytes. Neither its result nor an exception may refer
                to that memory, which is released afterwards.

        Returns:
            The converted sample; None if there is no sample.
        """
        sample, info = ct.c_void_p(), dds_c_t.sample_info()
        while self._alive:
            try:
                if not c.take(self.reference, ct.byref(sample), 1, ct.byref(info), _ANY):
                    break
            except RCLError:
                if self._alive:
                    raise
                break
            try:
                if info.valid_data:
                    value = _converted(sample, convert)
                    return TakenSample(value, info.publication_handle)
            finally:
                c.release_sample(sample)
        return None


def _converted(sample: ct.c_void_p, convert: Callable[[memoryview], Value]) -> Value:
    region = c.Bytes()
    held = c.sample_bytes(sample, 0, c.sample_size(sample), ct.byref(region))
    try:
        return convert(memoryview((ct.c_uint8 * region.size).from_address(region.data)).cast('B'))
    finally:
        c.release_bytes(held, ct.byref(region))


class WaitSet(Entity):
    """A wait set: waits for several conditions and endpoints at once."""

    def __init__(self, participant: Participant) -> None:
        super().__init__(c.create_waitset(participant.reference))
        self._attached: set[int] = set()

    def attach(self, reference: int) -> None:
        """Attach a condition or an endpoint, whose watched statuses then end a wait."""
        c.attach(self.reference, reference, reference)
        self._attached.add(reference)

    def detach(self, reference: int) -> None:
        """Detach a condition or endpoint, which may already be deleted."""
        self._attached.discard(reference)
        with suppress(RCLError):
            c.detach(self.reference, reference)

    def wait(self, timeout_ns: int) -> set[int]:
        """Wait, and return the triggered references; an empty set after the timeout."""
        capacity = len(self._attached) + 1
        out = (ct.c_ssize_t * capacity)()
        count = c.wait(self.reference, out, capacity, timeout_ns)
        return set(out[: min(count, capacity)])


class DiscoveredEndpoint(NamedTuple):
    """A discovered reader or writer."""

    gid: bytes
    topic: str
    type: str
    qos: EndpointQos
    user_data: str


class Participant(Entity):
    """A DDS participant, with the endpoints that it discovered in its domain."""

    def __init__(self, domain_id: int) -> None:
        self.domain_id = domain_id
        self._domain = enter_domain(domain_id)
        try:
            self._participant = DomainParticipant(domain_id, Qos(Policy.Userdata(b'enclave=/;')))
        except DDSException as error:
            leave_domain(domain_id)
            raise RCLError(f'no participant in domain {domain_id}: {error}') from None
        super().__init__(self._participant._ref)
        self._topics: dict[str, Any] = {}
        self._services = 0
        self._graph_lock = threading.Lock()
        self._builtin = {
            kind: BuiltinDataReader(self._participant, topic)
            for kind, topic in (
                ('participant', BuiltinTopicDcpsParticipant),
                ('writer', BuiltinTopicDcpsPublication),
                ('reader', BuiltinTopicDcpsSubscription),
            )
        }
        self._discovered: dict[str, dict[bytes, Any]] = {kind: {} for kind in self._builtin}

    def writer(
        self, topic: str, kind: str, qos: EndpointQos, role: str = '', in_service: bool = False
    ) -> Writer:
        """Create a writer.

        Args:
            topic: name of the DDS topic.
            kind: full name of the message type, such as ``std_msgs/msg/String``.
            qos: QoS policies.
            role: USER_DATA to put before the type hash.
            in_service: whether a service header precedes the body.
        """
        return Writer(self._endpoint(c.create_writer, topic, kind, qos, role, in_service), topic)

    def reader(
        self, topic: str, kind: str, qos: EndpointQos, role: str = '', in_service: bool = False
    ) -> Reader:
        """Create a reader; see ``writer`` for the arguments."""
        return Reader(self._endpoint(c.create_reader, topic, kind, qos, role, in_service), topic)

    def service_id(self) -> str:
        """Return a new unique ID for the two endpoints of a service or client."""
        with self._lock:
            self._services += 1
            number = self._services
        return '.'.join(f'{byte:x}' for byte in self.gid[:12] + number.to_bytes(4, 'big'))

    def endpoints(self, kind: str) -> list[DiscoveredEndpoint]:
        """Return all endpoints in the domain; ``kind`` is writer or reader."""
        with self._graph_lock:
            self._update(kind)
            return list(self._discovered[kind].values())

    def participants(self) -> set[bytes]:
        """Return the GUID prefixes (12 bytes) of all participants in the domain."""
        with self._graph_lock:
            self._update('participant')
            return {gid[:12] for gid in self._discovered['participant']}

    def close(self) -> None:
        """Delete the participant and all its entities; further calls do nothing."""
        if not self._alive:
            return
        self._alive = False
        with self._graph_lock:
            for reader in self._builtin.values():
                reader.__del__()
            self._builtin.clear()
        for topic in self._topics.values():
            topic.__del__()
        self._participant.__del__()
        leave_domain(self.domain_id)

    def _endpoint(
        self,
        create: Callable[..., int],
        topic: str,
        kind: str,
        qos: EndpointQos,
        role: str,
        in_service: bool,
    ) -> int:
        user_data = f'{role}typehash={type_hash(kind)};'
        cqos = _CQos.qos_to_cqos(_policies(qos, user_data))
        try:
            return create(self.reference, self._topic(topic, kind, in_service), cqos, None)
        finally:
            _CQos.cqos_destroy(cqos)  # type: ignore[no-untyped-call]

    def _topic(self, name: str, kind: str, in_service: bool) -> int:
        # One object per name and type: a further Topic would register a new type description.
        key = f'{name} {kind}'
        with self._lock:
            if key not in self._topics:
                try:
                    self._topics[key] = Topic(
                        self._participant, name, _idl_struct(kind, in_service)
                    )
                except DDSException as error:
                    raise RCLError(f'topic {name} of type {kind}: {error}') from None
            return int(self._topics[key]._ref)

    def _update(self, kind: str) -> None:
        reader, endpoints = self._builtin.get(kind), self._discovered[kind]
        while reader is not None and (samples := reader.take(N=100)):
            for sample in samples:
                gid, info = sample.key.bytes, sample.sample_info
                if not info.valid_data or info.instance_state != InstanceState.Alive:
                    endpoints.pop(gid, None)
                elif kind == 'participant':
                    endpoints[gid] = True
                else:
                    endpoints[gid] = DiscoveredEndpoint(
                        gid,
                        sample.topic_name,
                        sample.type_name,
                        _endpoint_qos(sample.qos),
                        _user_data(sample.qos),
                    )
