# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""All that touches Cyclone DDS, its private layer among it.

Samples are raw CDR. Whatever may block goes through ctypes, which releases the interpreter's lock.
"""

from __future__ import annotations

import ctypes as ct
import threading
from collections.abc import Callable
from contextlib import suppress
from functools import cache
from typing import Any, Generic, NamedTuple, TypeVar

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

from ratslam_ros.standalone import dds_functions as c
from ratslam_ros.standalone.dds_domains import enter_domain, leave_domain
from ratslam_ros.standalone.definitions import Field, fields_of, type_hash
from ratslam_ros.standalone.exceptions import RCLError

idl: Any = types  # generic in a way of its own
Value = TypeVar('Value')

INFINITE_NS = 2**63 - 1
SERVICE_HEADER = 16
_ROUND_NS = 100_000_000
_ANY = SampleState.Any | ViewState.Any | InstanceState.Any


# Types


@cache
def _idl_struct(name: str, in_service: bool) -> Any:
    """Return a message type as the library describes types to others (XTypes)."""
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
    """What ROS asks of an endpoint; ``depth`` None keeps all."""

    depth: int | None
    reliable: bool
    transient_local: bool
    lifespan_ns: int | None = None


def _policies(qos: EndpointQos, user_data: str) -> Qos:
    history = Policy.History.KeepAll if qos.depth is None else Policy.History.KeepLast(qos.depth)
    policies: list[Any] = [
        Policy.WriterDataLifecycle(autodispose=False),
        history,
        Policy.Reliability.Reliable(_ROUND_NS) if qos.reliable else Policy.Reliability.BestEffort,
        Policy.DataRepresentation(use_cdrv0_representation=True, use_xcdrv2_representation=False),
        Policy.Userdata(user_data.encode()),
    ]
    if qos.transient_local:
        # What is kept for late joiners is set apart from what is kept until it is acknowledged.
        policies += [
            Policy.Durability.TransientLocal,
            Policy.DurabilityService(0, history, -1, -1, -1),
        ]
    if qos.lifespan_ns is not None:
        policies.append(Policy.Lifespan(qos.lifespan_ns))
    return Qos(*policies)


def _endpoint_qos(qos: Qos) -> EndpointQos:
    history, lifespan = qos[Policy.History], qos[Policy.Lifespan]
    return EndpointQos(
        getattr(history, 'depth', None) if history is not None else 1,
        qos[Policy.Reliability] != Policy.Reliability.BestEffort,
        qos[Policy.Durability] == Policy.Durability.TransientLocal,
        lifespan.lifespan if lifespan is not None and lifespan.lifespan < INFINITE_NS else None,
    )


def user_value(data: str, key: str) -> str:
    """Return one value of USER_DATA, '' where it is not there."""
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
    """Something with a handle, deleted once."""

    def __init__(self, reference: int) -> None:
        self.reference = reference
        self._lock = threading.RLock()  # a signal's handler may come in between
        self._alive = True

    def close(self) -> None:
        """Delete it; a second time does nothing."""
        with self._lock:
            alive, self._alive = self._alive, False
        if alive:
            with suppress(RCLError):  # what it belongs to may be gone, and it too
                c.delete(self.reference)

    @property
    def gid(self) -> bytes:
        """Globally unique identifier, 16 bytes."""
        out = (ct.c_uint8 * 16)()
        c.get_guid(self.reference, out)
        return bytes(out)

    @property
    def handle(self) -> int:
        """Instance handle, unsigned."""
        out = ct.c_uint64()
        c.get_handle(self.reference, ct.byref(out))
        return out.value


class Guard(Entity):
    """A condition that any thread may set."""

    def __init__(self, participant: Participant) -> None:
        super().__init__(c.create_guard(participant.reference))

    def set(self) -> None:
        """End the wait of whoever waits, now or at the next time."""
        with self._lock:
            if self._alive:
                c.set_guard(self.reference, True)

    def take(self) -> None:
        """Reset it."""
        c.take_guard(self.reference, ct.byref(ct.c_bool()))


class Happened(NamedTuple):
    """Change of a status."""

    total: int
    total_change: int
    current: int
    current_change: int
    policy: int


class Endpoint(Entity):
    """A reader or writer."""

    def __init__(self, reference: int, name: str) -> None:
        super().__init__(reference)
        self.name = name
        c.set_mask(reference, 0)

    def watch(self, *statuses: str) -> None:
        """Let a waitset that this is attached to wake up at changes of statuses."""
        c.set_mask(self.reference, sum(c.STATUSES[status][0] for status in statuses))

    def take_status(self, status: str) -> Happened:
        """Return what changed since the last time."""
        out = c.STATUSES[status][1]()
        c.get_status[status](self.reference, ct.byref(out))
        return Happened(
            out.total_count,
            out.total_count_change,
            getattr(out, 'current_count', 0),
            getattr(out, 'current_count_change', 0),
            getattr(out, 'last_policy_id', 0),
        )

    def _matched(self, function: Callable[..., int]) -> list[int]:
        room = 16
        while True:
            out = (ct.c_uint64 * room)()
            found = function(self.reference, out, room)
            if found <= room:
                return list(out[:found])
            room = found


class Writer(Endpoint):
    """Writes serialised samples, from any thread."""

    def write(self, data: bytearray) -> None:
        """Write a sample, four bytes of header and a length that is a multiple of 4.

        Blocks while a reliable reader that keeps all cannot take more.
        """
        start = ct.c_uint8.from_buffer(data)
        sample = c.Sample(ct.addressof(start), len(data))
        while not c.done('dds_write', c.write(self.reference, ct.byref(sample))):
            pass  # in rounds, so that an interrupt is noticed

    def wait_for_acks(self, timeout_ns: int) -> bool:
        """Wait until all is acknowledged; return whether that came about in time."""
        while True:
            round_ns = min(_ROUND_NS, timeout_ns)
            if c.done('dds_wait_for_acks', c.wait_for_acks(self.reference, round_ns)):
                return True
            timeout_ns -= round_ns
            if timeout_ns <= 0:
                return False

    @property
    def matched(self) -> list[int]:
        """Handles of the readers that it writes to."""
        return self._matched(c.matched_readers)

    def user_data_of(self, handle: int) -> str | None:
        """Return what a matched reader tells of itself, None where it is gone."""
        found = _clayer.ddspy_get_matched_subscription_data(
            self.reference, handle, endpoint_constructor, cqos_to_qos
        )
        return None if found is None else _user_data(found.qos)


class Taken(NamedTuple, Generic[Value]):
    """What a sample was made into, and where it comes from."""

    value: Value
    source_timestamp_ns: int
    publication_handle: int


class Reader(Endpoint):
    """Takes serialised samples."""

    def __init__(self, reference: int, name: str) -> None:
        super().__init__(reference, name)
        self.condition = c.create_condition(reference, _ANY)

    def take(self, use: Callable[[memoryview], Value]) -> Taken[Value] | None:
        """Take the oldest sample, and return what ``use`` makes of it; None if there is none.

        What ``use`` returns or raises must not refer to the memory that it is given.
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
                    value = _used(sample, use)
                    return Taken(value, info.source_timestamp, info.publication_handle)
            finally:
                c.release_sample(sample)
        return None

    @property
    def matched(self) -> list[int]:
        """Handles of the writers that it reads from."""
        return self._matched(c.matched_writers)

    def user_data_of(self, handle: int) -> str | None:
        """Return what a matched writer tells of itself, None where it is gone."""
        found = _clayer.ddspy_get_matched_publication_data(
            self.reference, handle, endpoint_constructor, cqos_to_qos
        )
        return None if found is None else _user_data(found.qos)


def _used(sample: ct.c_void_p, use: Callable[[memoryview], Value]) -> Value:
    found = c.Bytes()
    held = c.sample_bytes(sample, 0, c.sample_size(sample), ct.byref(found))
    try:
        return use(memoryview((ct.c_uint8 * found.size).from_address(found.data)).cast('B'))
    finally:
        c.release_bytes(held, ct.byref(found))


class WaitSet(Entity):
    """Waits for many things at once."""

    def __init__(self, participant: Participant) -> None:
        super().__init__(c.create_waitset(participant.reference))
        self._attached: set[int] = set()

    def attach(self, reference: int) -> None:
        """Wait for a condition, or for an endpoint's statuses as well."""
        c.attach(self.reference, reference, reference)
        self._attached.add(reference)

    def detach(self, reference: int) -> None:
        """Wait for it no longer; it may have been deleted."""
        self._attached.discard(reference)
        with suppress(RCLError):
            c.detach(self.reference, reference)

    def wait(self, timeout_ns: int) -> set[int]:
        """Return the references of what was triggered, none after the timeout."""
        room = len(self._attached) + 1
        out = (ct.c_ssize_t * room)()
        found = c.wait(self.reference, out, room, timeout_ns)
        return set(out[: min(found, room)])


class Discovered(NamedTuple):
    """An endpoint that somebody has."""

    gid: bytes
    topic: str
    type: str
    qos: EndpointQos
    user_data: str


class Participant(Entity):
    """One process in one domain."""

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
        self._found: dict[str, dict[bytes, Any]] = {kind: {} for kind in self._builtin}

    def writer(
        self, topic: str, kind: str, qos: EndpointQos, role: str = '', in_service: bool = False
    ) -> Writer:
        """Return a new writer; ``role`` is what USER_DATA says besides the type's hash."""
        return Writer(self._endpoint(c.create_writer, topic, kind, qos, role, in_service), topic)

    def reader(
        self, topic: str, kind: str, qos: EndpointQos, role: str = '', in_service: bool = False
    ) -> Reader:
        """Return a new reader; see ``writer``."""
        return Reader(self._endpoint(c.create_reader, topic, kind, qos, role, in_service), topic)

    def service_id(self) -> str:
        """Return a new name for the two endpoints of a service or client."""
        with self._lock:
            self._services += 1
            number = self._services
        return '.'.join(f'{byte:x}' for byte in self.gid[:12] + number.to_bytes(4, 'big'))

    def endpoints(self, kind: str) -> list[Discovered]:
        """Return all ``writer`` or ``reader`` endpoints in the domain."""
        with self._graph_lock:
            self._update(kind)
            return list(self._found[kind].values())

    def participants(self) -> set[bytes]:
        """Return the first twelve bytes of the gid of all that are in the domain."""
        with self._graph_lock:
            self._update('participant')
            return {gid[:12] for gid in self._found['participant']}

    def close(self) -> None:
        """Delete it with all that belongs to it."""
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
        # One object a name and type: the library would make a new description every time.
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
        reader, found = self._builtin.get(kind), self._found[kind]
        while reader is not None and (samples := reader.take(N=100)):
            for sample in samples:
                gid, info = sample.key.bytes, sample.sample_info
                if not info.valid_data or info.instance_state != InstanceState.Alive:
                    found.pop(gid, None)
                elif kind == 'participant':
                    found[gid] = True
                else:
                    found[gid] = Discovered(
                        gid,
                        sample.topic_name,
                        sample.type_name,
                        _endpoint_qos(sample.qos),
                        _user_data(sample.qos),
                    )
