# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Services and clients."""

from __future__ import annotations

import itertools
import struct
import threading
import time
from collections.abc import Callable
from typing import Any

from rclpy_standin.dds import SERVICE_HEADER_BYTES, user_value
from rclpy_standin.node_parts import NodePart, Waitable, check_arguments
from rclpy_standin.qos import QoSProfile, to_dds
from rclpy_standin.task import Future
from rclpy_standin.types import decode_or_none, encode

_CLIENT_DISCOVERY_TIMEOUT_S = 0.1
"""Time a reply waits for discovery of the client's reader, in seconds; then it is dropped."""
_POLL_INTERVAL_S = 0.01
_CDR_HEADER_BYTES = 4


class _ServiceEndpoints(NodePart):
    """Base of services and clients: a reader and a writer of samples with a service header.

    The header correlates replies with requests: client ID and sequence number, 8 bytes each.
    """

    def __init__(
        self,
        node: Any,
        srv_type: Any,
        srv_name: str,
        qos_profile: QoSProfile,
        is_service: bool,
    ) -> None:
        super().__init__(node)
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
        """Take the next sample; return whether there was one."""
        raise NotImplementedError

    def waitables(self) -> list[Waitable]:
        """Return the entities to wait for."""
        return [Waitable(self._reader.condition, self.execute)]

    def gids(self) -> tuple[list[bytes], list[bytes]]:
        """Return the GIDs of the readers and of the writers to announce in the graph."""
        return [self._reader.gid], [self._writer.gid]

    def close(self) -> None:
        """Delete the DDS entities."""
        self._closed = True
        self._reader.close()
        self._writer.close()

    def _take(self, kind: Any) -> Any:
        """Take the next sample: client ID, sequence number and message (None if it is invalid)."""

        def read(data: memoryview) -> tuple[int, int, Any]:
            if len(data) < _CDR_HEADER_BYTES + SERVICE_HEADER_BYTES:
                return 0, 0, None
            layout = '<Qq' if data[1] else '>Qq'
            client_id, number = struct.unpack_from(layout, data, _CDR_HEADER_BYTES)
            return client_id, number, decode_or_none(data, kind, SERVICE_HEADER_BYTES)

        taken = self._reader.take(read)
        if taken is not None and taken.value[2] is None:
            self._count_invalid(self.service_name, kind)
        return None if self._closed else taken

    def _send(self, message: Any, client_id: int, number: int) -> None:
        data = encode(message, SERVICE_HEADER_BYTES)
        struct.pack_into('<Qq', data, _CDR_HEADER_BYTES, client_id, number)
        self._writer.write(data)


class Service(_ServiceEndpoints):
    """A service server."""

    def __init__(
        self,
        node: Any,
        srv_type: Any,
        srv_name: str,
        callback: Callable[[Any, Any], Any],
        qos_profile: QoSProfile,
    ) -> None:
        check_arguments(callback, 2)
        super().__init__(node, srv_type, srv_name, qos_profile, True)
        self.callback = callback

    def execute(self) -> bool:
        """Reply to the next request; return whether there was one."""
        taken = self._take(self.srv_type.Request)
        if taken is None:
            return False
        client_id, number, request = taken.value
        if request is not None:
            response = self.callback(request, self.srv_type.Response())
            if not isinstance(response, self.srv_type.Response):
                raise TypeError(
                    f'{self.srv_name}: expected {self.srv_type.Response}, not {response!r}'
                )
            if self._client_is_reachable(taken.publication_handle):
                self._send(response, client_id, number)
        return True

    def _client_is_reachable(self, writer: int) -> bool:
        """Wait for discovery of the client's reader: earlier replies would be lost."""
        end_s = time.monotonic() + _CLIENT_DISCOVERY_TIMEOUT_S
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
                    f'{self.srv_name}: dropped a response: its client was not discovered in time'
                )
                return False
            time.sleep(_POLL_INTERVAL_S)


class Client(_ServiceEndpoints):
    """A service client; thread-safe."""

    _numbers = itertools.count(1)

    def __init__(
        self,
        node: Any,
        srv_type: Any,
        srv_name: str,
        qos_profile: QoSProfile,
    ) -> None:
        super().__init__(node, srv_type, srv_name, qos_profile, False)
        self._id = self._writer.handle
        self._pending: dict[int, Future] = {}
        self._lock = threading.Lock()

    def call_async(self, request: Any) -> Future:
        """Send a request, and return the future of its response."""
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

    def remove_pending_request(self, future: Future) -> None:
        """Stop waiting for a response."""
        with self._lock:
            for number, pending in self._pending.items():
                if pending is future:
                    del self._pending[number]
                    break

    def execute(self) -> bool:
        """Take the next response; return whether there was one."""
        taken = self._take(self.srv_type.Response)
        if taken is None:
            return False
        client_id, number, response = taken.value
        # Every client receives the responses to all clients.
        if client_id == self._id and response is not None:
            with self._lock:
                future = self._pending.get(number)
            if future is not None:
                future.set_result(response)
        return True

    def service_is_ready(self) -> bool:
        """Return whether a server is discovered, with both of its endpoints."""
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
        """Wait for a server; return False after the timeout or at shutdown."""
        end_s = None if timeout_sec is None else time.monotonic() + timeout_sec
        while self._node.context.ok():
            if self.service_is_ready():
                return True
            if end_s is not None and time.monotonic() >= end_s:
                return False
            time.sleep(_POLL_INTERVAL_S)
        return False
