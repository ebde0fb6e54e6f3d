# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""What nodes are made of: publishers, subscriptions, services, clients, timers."""

from __future__ import annotations

import inspect
import itertools
import struct
import threading
import time
from collections.abc import Callable
from typing import Any, NamedTuple

from ratslam_ros.standalone.clock import Clock, ClockChange, Duration, TimeJump
from ratslam_ros.standalone.dds import INFINITE_NS, SERVICE_HEADER, Writer, user_value
from ratslam_ros.standalone.events import Events
from ratslam_ros.standalone.exceptions import InvalidHandle, RCLError
from ratslam_ros.standalone.qos import QoSProfile, to_dds
from ratslam_ros.standalone.task import Future
from ratslam_ros.standalone.types import decode_or_none, encode

_CLIENT_READER_S = 0.1
"""How long a reply waits until its receiver is known; after that nobody would get it."""
_POLL_S = 0.01
_CDR_HEADER = 4
_UNREADABLE = 'what came is left out, as it is no'


class Source(NamedTuple):
    """Something an executor waits for, and what it then calls."""

    reference: int
    run: Callable[[], bool]
    """Returns whether there was anything to do."""


class CallbackGroup:
    """Which callbacks may run at the same time: none, as there is one thread."""


class MutuallyExclusiveCallbackGroup(CallbackGroup):
    """Callbacks one at a time."""


class ReentrantCallbackGroup(CallbackGroup):
    """Callbacks that could run at the same time, if there were more than one thread."""


class NodePart:
    """Something that belongs to a node until it is destroyed."""

    def __init__(self, node: Any, callback_group: CallbackGroup | None = None) -> None:
        self._node = node
        self._closed = False
        self.callback_group = callback_group or node.default_callback_group

    def sources(self) -> list[Source]:
        """Return what to wait for."""
        return []

    def gids(self) -> tuple[list[bytes], list[bytes]]:
        """Return the readers and writers that the graph is told of."""
        return [], []

    def close(self) -> None:
        """Let go of what DDS holds."""

    def destroy(self) -> None:
        """Take it from its node."""
        self._node.discard(self)

    def _check_alive(self) -> None:
        if self._closed:
            raise InvalidHandle('cannot use it because destruction was requested')
        if not self._node.context.ok():
            raise RCLError("the node's context is invalid: it was shut down")


def callable_with(callback: Any, *counts: int) -> int:
    """Return how many of ``counts`` arguments a callback takes, the first that fits.

    Raises:
        RuntimeError: it takes another number of them.
        NotImplementedError: it is a coroutine.
    """
    if inspect.iscoroutinefunction(callback):
        raise NotImplementedError('the stand-in for rclpy does not offer async callbacks')
    try:
        signature = inspect.signature(callback)
    except (TypeError, ValueError):
        return counts[0]
    for count in counts:
        try:
            signature.bind(*[None] * count)
        except TypeError:
            continue
        return count
    raise RuntimeError(
        f'{callback!r}: expected a function of {" or ".join(map(str, counts))} arguments'
    )


class Publisher(NodePart):
    """Sends messages; any thread may."""

    def __init__(
        self,
        node: Any,
        msg_type: Any,
        topic: str,
        qos_profile: QoSProfile,
        callbacks: Any,
        callback_group: CallbackGroup | None,
        qos: Any = None,
    ) -> None:
        super().__init__(node, callback_group)
        self.msg_type = msg_type
        self.topic, self.topic_name = topic, node.names.resolve(topic)
        self.qos_profile = qos_profile
        self._writer: Writer = node.context.participant.writer(
            _dds_name(self.topic_name, qos_profile),
            msg_type.__msgtype__,
            qos or to_dds(qos_profile),
        )
        self._events = Events(self._writer, callbacks, node.logger, self.topic_name)

    def publish(self, msg: Any) -> None:
        """Send a message, or its CDR as bytes.

        Blocks while a subscription that keeps all cannot take more.

        Raises:
            TypeError: it is of another type, or a field of it is.
        """
        self._check_alive()
        if isinstance(msg, self.msg_type):
            data = encode(msg)
        elif isinstance(msg, bytes | bytearray | memoryview):
            data = bytearray(msg)
            data += bytes(-len(data) % 4)
        else:
            raise TypeError(f'Expected {self.msg_type}, got {type(msg)}')
        self._writer.write(data)

    def get_subscription_count(self) -> int:
        """Return how many subscriptions it sends to."""
        return 0 if self._closed else len(self._writer.matched)

    def wait_for_all_acked(self, timeout: Duration = Duration(nanoseconds=-1)) -> bool:  # noqa: B008
        """Wait until all reliable subscriptions have all messages; return whether they do."""
        self._check_alive()
        timeout_ns = timeout.nanoseconds if timeout.nanoseconds >= 0 else INFINITE_NS
        return self._writer.wait_for_acks(timeout_ns)

    def sources(self) -> list[Source]:
        """Return what to wait for."""
        reference = self._events.reference
        return [] if reference is None else [Source(reference, self._events.execute)]

    def gids(self) -> tuple[list[bytes], list[bytes]]:
        """Return the readers and writers that the graph is told of."""
        return [], [self._writer.gid]

    def close(self) -> None:
        """Let go of what DDS holds."""
        self._closed = True
        self._writer.close()


class Subscription(NodePart):
    """Takes messages."""

    def __init__(
        self,
        node: Any,
        msg_type: Any,
        topic: str,
        callback: Callable[..., Any],
        qos_profile: QoSProfile,
        callbacks: Any,
        callback_group: CallbackGroup | None,
        raw: bool,
    ) -> None:
        super().__init__(node, callback_group)
        self.msg_type = msg_type
        self.topic, self.topic_name = topic, node.names.resolve(topic)
        self.qos_profile = qos_profile
        self.raw = raw
        self.callback = callback
        self._wants_info = callable_with(callback, 1, 2) == 2
        self._reader = node.context.participant.reader(
            _dds_name(self.topic_name, qos_profile), msg_type.__msgtype__, to_dds(qos_profile)
        )
        self._events = Events(self._reader, callbacks, node.logger, self.topic_name)

    def execute(self) -> bool:
        """Give the next message to the callback; return whether there was one."""
        taken = self._reader.take(self._read)
        if taken is None or self._closed:
            return False
        if taken.value is None:
            self._node.logger.error(
                f'{self.topic_name}: {_UNREADABLE} {self.msg_type.__msgtype__}'
            )
        elif self._wants_info:
            self.callback(
                taken.value,
                {
                    'source_timestamp': taken.source_timestamp_ns,
                    'received_timestamp': time.time_ns(),
                    'publication_sequence_number': None,
                    'reception_sequence_number': None,
                },
            )
        else:
            self.callback(taken.value)
        return True

    def _read(self, data: memoryview) -> Any:
        return bytes(data) if self.raw else decode_or_none(data, self.msg_type)

    def get_publisher_count(self) -> int:
        """Return how many publishers it takes from."""
        return 0 if self._closed else len(self._reader.matched)

    def sources(self) -> list[Source]:
        """Return what to wait for."""
        found = [Source(self._reader.condition, self.execute)]
        reference = self._events.reference
        if reference is not None:
            found.append(Source(reference, self._events.execute))
        return found

    def gids(self) -> tuple[list[bytes], list[bytes]]:
        """Return the readers and writers that the graph is told of."""
        return [self._reader.gid], []

    def close(self) -> None:
        """Let go of what DDS holds."""
        self._closed = True
        self._reader.close()


def _dds_name(topic: str, qos: QoSProfile) -> str:
    return topic if qos.avoid_ros_namespace_conventions else f'rt{topic}'


class _Correlated(NodePart):
    """A service or a client: two endpoints, and a header in front of what they carry."""

    def __init__(
        self,
        node: Any,
        srv_type: Any,
        srv_name: str,
        qos_profile: QoSProfile,
        callback_group: CallbackGroup | None,
        is_service: bool,
    ) -> None:
        super().__init__(node, callback_group)
        self.srv_type, self.srv_name = srv_type, srv_name
        self.service_name = name = node.names.resolve(srv_name, is_service=True)
        self.qos_profile = qos_profile
        participant, qos = node.context.participant, to_dds(qos_profile)
        role = f'{"serviceid" if is_service else "clientid"}={participant.service_id()};'
        request = f'rq{name}Request', srv_type.Request.__msgtype__, qos, role, True
        reply = f'rr{name}Reply', srv_type.Response.__msgtype__, qos, role, True
        self._writer = participant.writer(*(reply if is_service else request))
        self._reader = participant.reader(*(request if is_service else reply))

    def execute(self) -> bool:
        """Take what came; return whether there was anything."""
        raise NotImplementedError

    def sources(self) -> list[Source]:
        """Return what to wait for."""
        return [Source(self._reader.condition, self.execute)]

    def gids(self) -> tuple[list[bytes], list[bytes]]:
        """Return the readers and writers that the graph is told of."""
        return [self._reader.gid], [self._writer.gid]

    def close(self) -> None:
        """Let go of what DDS holds."""
        self._closed = True
        self._reader.close()
        self._writer.close()

    def _take(self, kind: Any) -> Any:
        """Take the next message, with the client and number in front of it."""

        def read(data: memoryview) -> tuple[int, int, Any]:
            if len(data) < _CDR_HEADER + SERVICE_HEADER:
                return 0, 0, None
            client_id, number = struct.unpack_from('<Qq' if data[1] else '>Qq', data, _CDR_HEADER)
            return client_id, number, decode_or_none(data, kind, SERVICE_HEADER)

        taken = self._reader.take(read)
        if taken is not None and taken.value[2] is None:
            self._node.logger.error(f'{self.service_name}: {_UNREADABLE} {kind.__msgtype__}')
        return None if self._closed else taken

    def _send(self, message: Any, client_id: int, number: int) -> None:
        data = encode(message, SERVICE_HEADER)
        struct.pack_into('<Qq', data, _CDR_HEADER, client_id, number)
        self._writer.write(data)


class RequestId(NamedTuple):
    """Whom a reply is for."""

    client_id: int
    sequence_number: int
    writer: int


class Service(_Correlated):
    """Answers requests."""

    def __init__(
        self,
        node: Any,
        srv_type: Any,
        srv_name: str,
        callback: Callable[[Any, Any], Any],
        qos_profile: QoSProfile,
        callback_group: CallbackGroup | None,
    ) -> None:
        callable_with(callback, 2)
        super().__init__(node, srv_type, srv_name, qos_profile, callback_group, True)
        self.callback = callback

    def execute(self) -> bool:
        """Answer the next request; return whether there was one."""
        taken = self._take(self.srv_type.Request)
        if taken is None:
            return False
        client_id, number, request = taken.value
        if request is not None:
            response = self.callback(request, self.srv_type.Response())
            self.send_response(response, RequestId(client_id, number, taken.publication_handle))
        return True

    def send_response(self, response: Any, header: RequestId) -> None:
        """Send an answer to whoever asked."""
        if not isinstance(response, self.srv_type.Response):
            raise TypeError(
                f'{self.srv_name}: expected {self.srv_type.Response}, not {response!r}'
            )
        if self._client_is_there(header.writer):
            self._send(response, header.client_id, header.sequence_number)

    def _client_is_there(self, writer: int) -> bool:
        """Wait for the client's reader: a reply that is written before would get lost."""
        end_s = time.monotonic() + _CLIENT_READER_S
        while True:
            user_data = self._reader.user_data_of(writer)
            if user_data is None:
                return False
            client = user_value(user_data, 'clientid')
            if not client or any(
                user_value(self._writer.user_data_of(reader) or '', 'clientid') == client
                for reader in self._writer.matched
            ):
                return True
            if time.monotonic() > end_s:
                self._node.logger.warning(
                    f'{self.srv_name}: no answer is sent, since the client cannot be reached yet'
                )
                return False
            time.sleep(_POLL_S)


class Client(_Correlated):
    """Sends requests; any thread may."""

    _numbers = itertools.count(1)

    def __init__(
        self,
        node: Any,
        srv_type: Any,
        srv_name: str,
        qos_profile: QoSProfile,
        callback_group: CallbackGroup | None,
    ) -> None:
        super().__init__(node, srv_type, srv_name, qos_profile, callback_group, False)
        self._id = self._writer.handle
        self._pending: dict[int, Future] = {}
        self._lock = threading.Lock()

    def call_async(self, request: Any) -> Future:
        """Send a request, and return its answer to come."""
        self._check_alive()
        if not isinstance(request, self.srv_type.Request):
            raise TypeError(f'{self.srv_name}: expected {self.srv_type.Request}, not {request!r}')
        number, future = next(self._numbers), Future()
        future.add_done_callback(self.remove_pending_request)
        with self._lock:
            self._pending[number] = future
        try:
            self._send(request, self._id, number)
        except BaseException:
            self.remove_pending_request(future)
            raise
        return future

    def call(self, request: Any, timeout_sec: float | None = None) -> Any:
        """Send a request while another thread spins; return the answer, None after the timeout."""
        answered = threading.Event()
        future = self.call_async(request)
        future.add_done_callback(lambda _: answered.set())
        if not answered.wait(timeout_sec):
            self.remove_pending_request(future)
        return future.result()

    def remove_pending_request(self, future: Future) -> None:
        """Wait no longer for an answer."""
        with self._lock:
            for number, known in self._pending.items():
                if known is future:
                    del self._pending[number]
                    break

    def execute(self) -> bool:
        """Take the next answer; return whether there was one."""
        taken = self._take(self.srv_type.Response)
        if taken is None:
            return False
        client_id, number, response = taken.value
        if client_id == self._id and response is not None:  # every client gets every answer
            with self._lock:
                future = self._pending.get(number)
            if future is not None:
                future.set_result(response)
        return True

    def service_is_ready(self) -> bool:
        """Tell whether a server is there, with both its endpoints."""
        self._check_alive()
        readers = {
            user_value(self._writer.user_data_of(reader) or '', 'serviceid')
            for reader in self._writer.matched
        }
        writers = {
            user_value(self._reader.user_data_of(writer) or '', 'serviceid')
            for writer in self._reader.matched
        }
        return bool(readers & writers)

    def wait_for_service(self, timeout_sec: float | None = None) -> bool:
        """Wait for a server; return whether one is there in time."""
        end_s = None if timeout_sec is None else time.monotonic() + timeout_sec
        while self._node.context.ok():
            if self.service_is_ready():
                return True
            if end_s is not None and time.monotonic() >= end_s:
                return False
            time.sleep(_POLL_S)
        return False


class Timer(NodePart):
    """Calls something again and again."""

    def __init__(
        self,
        node: Any,
        callback: Callable[[], Any] | None,
        period_ns: int,
        clock: Clock,
        callback_group: CallbackGroup | None,
        autostart: bool = True,
    ) -> None:
        super().__init__(node, callback_group)
        if period_ns < 0:
            raise ValueError('timer period must not be negative')
        self.callback, self.clock = callback, clock
        self.timer_period_ns = period_ns
        self._canceled = not autostart
        self._last_ns = clock.now_ns()
        self._next_ns = self._last_ns + period_ns
        clock.timers.add(self)

    def is_ready(self) -> bool:
        """Tell whether it is to be called."""
        return not self._canceled and self.clock.now_ns() >= self._next_ns

    def is_canceled(self) -> bool:
        """Tell whether it was stopped."""
        return self._canceled

    def cancel(self) -> None:
        """Stop it, until it is reset."""
        self._canceled = True

    def reset(self) -> None:
        """Begin a new period now."""
        self._last_ns = self.clock.now_ns()
        self._next_ns = self._last_ns + self.timer_period_ns
        self._canceled = False
        self._node.wake()

    def time_until_next_call(self) -> int | None:
        """Return when it is to be called, in ns of its clock; None if never."""
        return None if self._canceled else self._next_ns - self.clock.now_ns()

    def wait_ns(self) -> int | None:
        """Return how long to wait at most, None where simulated time decides."""
        if self._canceled:
            return None
        left_ns = self._next_ns - self.clock.now_ns()
        return None if left_ns > 0 and self.clock.is_simulated else max(0, left_ns)

    def execute(self) -> bool:
        """Call back if it is time; return whether it was."""
        now_ns = self.clock.now_ns()
        if self._canceled or self._closed or now_ns < self._next_ns:
            return False
        self._last_ns = now_ns
        self._next_ns += self.timer_period_ns
        if self._next_ns <= now_ns:  # periods were missed: they are left out
            behind_ns, period_ns = now_ns - self._next_ns, self.timer_period_ns
            self._next_ns = (
                self._next_ns + (1 + behind_ns // period_ns) * period_ns if period_ns else now_ns
            )
        if self.callback is not None:
            self.callback()
        return True

    def on_jump(self, jump: TimeJump, before_ns: int) -> None:
        """Follow a jump of the clock."""
        now_ns = self.clock.now_ns()
        if jump.clock_change != ClockChange.ROS_TIME_NO_CHANGE:
            if now_ns and before_ns:  # what was left of the period is left still
                self._next_ns += now_ns - before_ns
                self._last_ns = self._next_ns - self.timer_period_ns
        elif now_ns < self._last_ns:
            self._last_ns, self._next_ns = now_ns, now_ns + self.timer_period_ns
        if not self._canceled and self._next_ns <= now_ns:
            self._node.wake()

    def close(self) -> None:
        """Let go of the clock."""
        self._closed = True
        self.clock.timers.discard(self)
