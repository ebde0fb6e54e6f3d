# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Services and clients."""

from __future__ import annotations

import itertools
import struct
import threading
import time
from collections.abc import Callable
from typing import Any, NamedTuple

from ratslam_ros.standalone.dds import SERVICE_HEADER, user_value
from ratslam_ros.standalone.node_parts import (
    UNREADABLE,
    CallbackGroup,
    NodePart,
    Source,
    callable_with,
)
from ratslam_ros.standalone.qos import QoSProfile, to_dds
from ratslam_ros.standalone.task import Future
from ratslam_ros.standalone.types import decode_or_none, encode

_CLIENT_READER_S = 0.1
"""How long a reply waits until its receiver is known; after that nobody would get it."""
_POLL_S = 0.01
_CDR_HEADER = 4


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
            self._node.logger.error(f'{self.service_name}: {UNREADABLE} {kind.__msgtype__}')
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
