# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""A bus in memory in place of DDS, for the stand-in for rclpy: same interface, seeded faults.

Reliable writers lose nothing between running processes: a lost packet is sent again, which delays
it and those after it. Best-effort writers lose messages, which the reader counts. Every pair of a
writer and a reader keeps its order; different pairs are delayed independently. A process that was
killed stays visible until its lease ends.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterable
from dataclasses import dataclass, field
from typing import Any
from zlib import crc32

from virtual_time import MS, Process, S, Scheduler, Task

from rclpy_standin.dds import EndpointQos, StatusChange, TakenSample
from rclpy_standin.graph import NodeName, TopicEndpointInfo, TopicEndpointTypeEnum
from rclpy_standin.qos import from_dds

LEASE_NS = 10 * S
"""Time for which a killed process stays visible, as in DDS."""

UNTRACED = '/diagnostics', '/rosout', '/parameter_events'
"""Topics whose texts name the temporary folder."""

POLL_NS = 2 * MS
STALL_NS = 300 * MS
"""Longest time for which a process does not run, as on a machine with other load."""


@dataclass(frozen=True)
class BusFaults:
    """Faults of the bus.

    spike: probability that a message is delayed by up to ``spike_ns``, besides ``delay_ns`` at
    most. loss: probability that a best-effort message is lost. depth: limit of the messages that
    a pair of endpoints holds; 0: that of the QoS. discovery_ns: longest time until endpoints
    match. stall: probability that a process that waits does not run for a while.
    """

    delay_ns: int = 2 * MS
    spike: float = 0.0
    spike_ns: int = 300 * MS
    loss: float = 0.0
    depth: int = 0
    discovery_ns: int = 100 * MS
    stall: float = 0.0


class Bus:
    """All endpoints of a simulation."""

    def __init__(self, scheduler: Scheduler, faults: BusFaults) -> None:
        self.scheduler, self.faults = scheduler, faults
        self.participants: list[Participant] = []
        self._number = 0
        self._writers: dict[str, list[Writer]] = {}
        self._readers: dict[str, list[Reader]] = {}

    def number(self) -> int:
        """Return a new number for an entity."""
        self._number += 1
        return self._number

    def drawn_delay(self) -> int:
        """Return the delay of a message."""
        chance, faults = self.scheduler.chance, self.faults
        if faults.spike and chance.random() < faults.spike:
            return chance.randrange(faults.spike_ns)
        return chance.randrange(MS // 10, faults.delay_ns)

    def add(self, endpoint: Writer | Reader) -> None:
        """Let a new endpoint match the others on its topic, each after a time."""
        if isinstance(endpoint, Writer):
            self._writers.setdefault(endpoint.name, []).append(endpoint)
            pairs = [(endpoint, other) for other in self._readers.get(endpoint.name, ())]
        else:
            self._readers.setdefault(endpoint.name, []).append(endpoint)
            pairs = [(other, endpoint) for other in self._writers.get(endpoint.name, ())]
        for writer, reader in pairs:
            if _is_compatible(writer.qos, reader.qos) and writer.kind == reader.kind:
                delay_ns = 1 + self.scheduler.chance.randrange(self.faults.discovery_ns)
                if writer.participant is reader.participant:
                    delay_ns = 1
                self.scheduler.at(
                    self.scheduler.now_ns + delay_ns, lambda w=writer, r=reader: w.match(r)
                )

    def remove(self, endpoint: Writer | Reader) -> None:
        """Forget an endpoint that was deleted, or whose process is dead for the lease."""
        table: Any = self._writers if isinstance(endpoint, Writer) else self._readers
        if endpoint in table.get(endpoint.name, ()):
            table[endpoint.name].remove(endpoint)

    def endpoints(self, topic: str, kind: str) -> list[Any]:
        """Return the visible endpoints on a topic."""
        table: Any = self._writers if kind == 'writer' else self._readers
        now_ns = self.scheduler.now_ns
        return [one for one in table.get(topic, ()) if one.visible_ns <= now_ns]

    def kill(self, process: Process) -> None:
        """Silence the participants of a killed process; they stay visible until the lease ends."""
        for participant in self.participants:
            if participant.process is process:
                participant.is_dead = True
                self.scheduler.at(self.scheduler.now_ns + LEASE_NS, participant.close)


def _is_compatible(offered: EndpointQos, wanted: EndpointQos) -> bool:
    return offered.reliable >= wanted.reliable and (
        offered.transient_local >= wanted.transient_local
    )


class Participant:
    """A process on the bus."""

    def __init__(self, bus: Bus) -> None:
        self.bus, self.domain_id = bus, 0
        self.process = bus.scheduler.current.process
        self.reference = bus.number()
        self.gid = self.reference.to_bytes(16, 'big')
        self.is_dead = False
        self.active: set[int] = set()
        """References that are triggered."""
        self.waiting: Task | None = None
        self.nodes: dict[NodeName, set[bytes]] = {}
        self._entities: list[Writer | Reader] = []
        bus.participants.append(self)

    def trigger(self, reference: int) -> None:
        """Trigger an entity, which ends a wait."""
        self.active.add(reference)
        if self.waiting is not None:
            self.bus.scheduler.wake(self.waiting)

    def writer(
        self, topic: str, kind: str, qos: EndpointQos, role: str = '', in_service: bool = False
    ) -> Writer:
        """Create a writer."""
        return self._added(Writer(self, topic, kind, qos, role))

    def reader(
        self, topic: str, kind: str, qos: EndpointQos, role: str = '', in_service: bool = False
    ) -> Reader:
        """Create a reader."""
        return self._added(Reader(self, topic, kind, qos, role))

    def service_id(self) -> str:
        """Return a new unique id."""
        return str(self.bus.number())

    def close(self) -> None:
        """Delete all entities."""
        for entity in self._entities:
            entity.close()
        if self in self.bus.participants:
            self.bus.participants.remove(self)

    def _added(self, endpoint: Any) -> Any:
        self._entities.append(endpoint)
        self.bus.add(endpoint)
        return endpoint


class Endpoint:
    """A reader or writer."""

    def __init__(
        self, participant: Participant, topic: str, kind: str, qos: EndpointQos, role: str
    ) -> None:
        bus = participant.bus
        self.participant, self.name, self.kind, self.qos = participant, topic, kind, qos
        self.role = role
        self.reference = self.handle = bus.number()
        self.gid = self.reference.to_bytes(16, 'big')
        self.visible_ns = bus.scheduler.now_ns + bus.scheduler.chance.randrange(
            bus.faults.discovery_ns
        )
        self.is_open = True
        self.others: dict[Any, Link] = {}
        self._lost = self._lost_taken = 0
        self._watched: tuple[str, ...] = ()

    def watch(self, *statuses: str) -> None:
        """Trigger a wait when one of the statuses changes."""
        self._watched = statuses

    def take_status(self, status: str) -> StatusChange:
        """Return a status and its changes since the last call."""
        self.participant.active.discard(self.reference)
        if status != 'sample_lost':
            return StatusChange(0, 0, 0)
        change, self._lost_taken = self._lost - self._lost_taken, self._lost
        return StatusChange(self._lost, change, 0)

    def lose(self) -> None:
        """Count a lost message."""
        self._lost += 1
        if 'sample_lost' in self._watched:
            self.participant.trigger(self.reference)

    @property
    def matched(self) -> list[int]:
        """Handles of the matched endpoints."""
        return [other.handle for other in self.others]

    def user_data_of(self, handle: int) -> str | None:
        """Return the USER_DATA of a matched endpoint."""
        return next((one.role for one in self.others if one.handle == handle), None)

    def close(self) -> None:
        """Delete the endpoint."""
        if self.is_open:
            self.is_open = False
            for other in self.others:
                other.others.pop(self, None)
            self.others = {}
            self.participant.bus.remove(self)  # type: ignore[arg-type]


@dataclass
class Link:
    """What a writer has sent to a reader."""

    last_ns: int = 0
    flying: deque[bytes] = field(default_factory=deque)


class Reader(Endpoint):
    """Reader of samples."""

    def __init__(self, *values: Any) -> None:
        super().__init__(*values)
        self.condition = self.participant.bus.number()
        self.queue: deque[tuple[bytes, int]] = deque()

    def take(self, convert: Callable[[memoryview], Any]) -> TakenSample[Any] | None:
        """Take and convert the oldest sample."""
        if not self.queue or not self.is_open:
            return None
        data, writer = self.queue.popleft()
        if not self.queue:
            self.participant.active.discard(self.condition)
        return TakenSample(convert(memoryview(data)), writer)

    def receive(self, data: bytes, writer: int) -> None:
        """Queue a message; a queue with a depth drops the oldest without notice, as in DDS."""
        if self.qos.depth is not None and len(self.queue) >= self.qos.depth:
            self.queue.popleft()
        self.queue.append((data, writer))
        self.participant.trigger(self.condition)


class Writer(Endpoint):
    """Writer of samples."""

    def __init__(self, *values: Any) -> None:
        super().__init__(*values)
        self._history: deque[bytes] = deque(maxlen=self.qos.depth)

    def match(self, reader: Reader) -> None:
        """Start sending to a reader, as both have discovered each other."""
        if not (self.is_open and reader.is_open) or self.participant.is_dead:
            return
        link = self.others[reader] = reader.others[self] = Link()
        if self.qos.transient_local and reader.qos.transient_local:
            for data in self._history:
                self._send(reader, link, data)

    def write(self, data: bytes | bytearray) -> None:
        """Send a message to all matched readers."""
        if self.participant.is_dead or not self.is_open:
            return
        scheduler = self.participant.bus.scheduler
        data = bytes(data)
        if not self.name.endswith(UNTRACED):
            scheduler.note(f'{self.name} {crc32(data):08x}')
        if self.qos.transient_local:
            self._history.append(data)
        for reader, link in list(self.others.items()):
            if self.qos.depth is None and reader.qos.depth is None and self.qos.reliable:
                self._wait_for_room(reader, link)
            self._send(reader, link, data)

    def wait_for_acks(self, timeout_ns: int) -> bool:
        """Wait until all messages have arrived."""
        scheduler = self.participant.bus.scheduler
        end_ns = scheduler.now_ns + timeout_ns
        while any(link.flying for reader, link in self.others.items() if reader.is_open):
            if scheduler.now_ns >= end_ns:
                return False
            scheduler.sleep(POLL_NS)
        return True

    def _wait_for_room(self, reader: Reader, link: Link) -> None:
        """Block while a reader that keeps everything has no room, as DDS does."""
        depth, scheduler = self.participant.bus.faults.depth, self.participant.bus.scheduler
        while (
            depth and not reader.participant.is_dead and reader.is_open
            and len(reader.queue) + len(link.flying) >= depth
        ):
            scheduler.sleep(POLL_NS)

    def _send(self, reader: Reader, link: Link, data: bytes) -> None:
        bus = self.participant.bus
        scheduler, faults = bus.scheduler, bus.faults
        if reader.participant.is_dead:
            return
        if not self.qos.reliable and faults.loss and scheduler.chance.random() < faults.loss:
            reader.lose()
            return
        limits = [one for one in (self.qos.depth, faults.depth) if one]
        if self.qos.depth is not None and len(link.flying) >= min(limits):
            link.flying.popleft()  # The writer has replaced a message that was not acknowledged.
            reader.lose()
        link.flying.append(data)
        link.last_ns = max(link.last_ns, scheduler.now_ns + bus.drawn_delay())

        def deliver() -> None:
            if any(one is data for one in link.flying):
                link.flying.remove(data)
                if reader.is_open and not reader.participant.is_dead:
                    reader.receive(data, self.handle)

        scheduler.at(link.last_ns, deliver)


class Guard:
    """A guard condition."""

    def __init__(self, participant: Participant) -> None:
        self._participant = participant
        self.reference = participant.bus.number()

    def set(self) -> None:
        """Trigger the condition."""
        self._participant.trigger(self.reference)

    def take(self) -> None:
        """Reset the condition."""
        self._participant.active.discard(self.reference)

    def close(self) -> None:
        """Delete the condition."""


class WaitSet:
    """A wait set."""

    def __init__(self, participant: Participant) -> None:
        self._participant = participant
        self._attached: set[int] = set()

    def attach(self, reference: int) -> None:
        """Attach an entity."""
        self._attached.add(reference)

    def detach(self, reference: int) -> None:
        """Detach an entity."""
        self._attached.discard(reference)

    def wait(self, timeout_ns: int) -> set[int]:
        """Wait for an attached entity, and return those that are triggered."""
        participant, scheduler = self._participant, self._participant.bus.scheduler
        # A wait of no length takes some time too; otherwise a thread that polls never ends.
        end_ns = scheduler.now_ns + max(timeout_ns, POLL_NS // 100)
        stall = participant.bus.faults.stall
        if stall and scheduler.chance.random() < stall:
            scheduler.sleep(scheduler.chance.randrange(STALL_NS))
        while not (found := self._attached & participant.active) and scheduler.now_ns < end_ns:
            participant.waiting = scheduler.current
            scheduler.block(end_ns)
            participant.waiting = None
        return found

    def close(self) -> None:
        """Delete the wait set."""


class Graph:
    """The nodes and endpoints that are visible on the bus."""

    def __init__(self, participant: Participant) -> None:
        self._participant = participant
        self._bus = participant.bus

    def close(self) -> None:
        """Leave the bus."""

    def add_node(self, node: NodeName) -> None:
        """Announce a node."""
        self._participant.nodes[node] = set()

    def remove_node(self, node: NodeName) -> None:
        """Withdraw a node."""
        self._participant.nodes.pop(node, None)

    def add(
        self, node: NodeName, readers: Iterable[bytes] = (), writers: Iterable[bytes] = ()
    ) -> None:
        """Announce endpoints of a node."""
        self._participant.nodes[node].update(readers, writers)

    def remove(self, node: NodeName, gids: Iterable[bytes]) -> None:
        """Withdraw endpoints."""

    def nodes(self) -> list[NodeName]:
        """Return all nodes."""
        return [node for one in self._bus.participants for node in one.nodes]

    def count(self, topic: str, kind: str) -> int:
        """Return the number of endpoints on a topic."""
        return len(self._bus.endpoints(topic, kind))

    def endpoints(self, topic: str, kind: str) -> list[TopicEndpointInfo]:
        """Return the endpoints on a topic."""
        which = TopicEndpointTypeEnum(1 if kind == 'writer' else 2)
        found = []
        for one in self._bus.endpoints(topic, kind):
            owner = next((n for n, g in one.participant.nodes.items() if one.gid in g), None)
            name = owner or NodeName('unknown', '/')
            found.append(
                TopicEndpointInfo(*name, one.kind, which, list(one.gid), from_dds(one.qos))
            )
        return found
