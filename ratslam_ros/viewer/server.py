# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The viewer's server: viser behind a check of who may connect.

Viser answers everyone who reaches its port, and any web page that the user visits could open a
WebSocket to 127.0.0.1 and drive the robot. Therefore the address of the page contains a random
token: without it there is no page and no WebSocket. A WebSocket must also come from that page
(Origin), and every request must name this server (Host), so that a name which somebody's DNS
resolves to 127.0.0.1 is of no use.
"""

from __future__ import annotations

import asyncio
import errno
import hmac
import http
import http.client
import ipaddress
import logging
import secrets
import socket
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import replace
from typing import Any
from unittest.mock import patch
from urllib.parse import urlsplit

from ratslam_ros.errors import UnusableInput
from ratslam_ros.viewer.rendering import adapted

DEFAULT_HOST, DEFAULT_PORT = '127.0.0.1', 8080

MAX_PORT = 65535

BACKLOG = 100
"""Number of connections that wait to be accepted, as asyncio has it."""

LOOPBACK = frozenset({'127.0.0.1', 'localhost', '::1'})
"""Names of this machine for a browser on it."""

MAX_MESSAGE_BYTES = 16 * 2**20
"""Largest message from a browser: a screenshot of 4K as PNG. Events are below 1 kB."""

MAX_CONNECTIONS = 64
"""Largest number of open connections. A page has one, and a browser opens some in advance. Beyond
it, the oldest connection without a request that has the token is closed."""

REQUEST_S = 10.0
"""Time for a request and its response, after which a connection is closed: that of websockets."""

MAX_RATE_HZ, BURST = 1000.0, 1000
"""Largest mean rate of messages of one connection, and number that may come at once. A dragged
slider or camera sends 60 a second; more wait in the connection, which slows their sender down."""

REFUSED_MESSAGES = frozenset({
    'FileTransferStartUpload',  # No panel takes files, and viser would keep them in memory.
    'FileTransferPart',
    'ShareUrlRequest',  # A public tunnel, which a client could request without the button.
    'ShareUrlDisconnect',
})
"""Messages of viser's client that are dropped."""

HEADERS = {
    'Cache-Control': 'no-store',
    'Content-Security-Policy': "frame-ancestors 'none'",  # no other page may embed this one
    'Referrer-Policy': 'no-referrer',  # the address is a secret
    'X-Content-Type-Options': 'nosniff',
}


class ViewServer:
    """A viser server that only the holder of its address can use."""

    def __init__(self, host: str = DEFAULT_HOST, port: int = DEFAULT_PORT) -> None:
        """Start to serve an empty page.

        Args:
            host: address to listen on. Others than the loopback can be reached by the network.
            port: port to listen on; 0 for any free one.

        Raises:
            UnusableInput: viser is not installed, or the address cannot be used.
        """
        viser = _viser()
        listener = _listen(host, port)
        self.host = host
        self._token = secrets.token_urlsafe(24)
        self._connections = _Connections()
        with self._guarded(listener):
            self.viser = viser.ViserServer(host, port, label='RatSLAM', verbose=False)
        self.port = int(self.viser.get_port())
        self.viser.request_share_url = _no_tunnel
        if self._answers_strangers():
            self.stop()
            raise UnusableInput(
                f'the access check has no effect with viser {viser.__version__}; install '
                "the version that this package asks for: pip install '.[view]'"
            )

    @property
    def url(self) -> str:
        """Address of the page, with the token."""
        name = self.host
        if self.is_public:
            name = _own_name() if name in ('', '0.0.0.0', '::') else name
        if ':' in name:
            name = f'[{name}]'
        return f'http://{name}:{self.port}/{self._token}/'

    @property
    def is_public(self) -> bool:
        """Whether other machines can reach the server."""
        return self.host not in LOOPBACK

    @property
    def client_count(self) -> int:
        """Number of connected browsers, also of those that have not drawn anything yet."""
        return len(self.viser._websock_server._live_connections)

    def stop(self) -> None:
        """End all connections and free the port, within 2 s even if a browser is stalled."""
        with _quiet():
            with suppress(RuntimeError):  # the loop has ended
                self.viser._event_loop.call_soon_threadsafe(self._connections.abort)
            self.viser.stop()

    # Who may connect

    @contextmanager
    def _guarded(self, listener: socket.socket) -> Iterator[None]:
        """Have servers that are started in this context check who connects.

        Viser has no setting for this. It passes its own handler of requests, which serves the
        page, to `websockets`; here, that handler is preceded by the check.
        """
        from websockets.asyncio import server

        serve = server.serve

        def serve_guarded(handler: Any, *_: Any, process_request: Any, **options: Any) -> Any:
            def process(connection: Any, request: Any) -> Any:
                def header(name: str) -> str | None:
                    values = request.headers.get_all(name)
                    return values[0] if len(values) == 1 else None  # twice is as bad as never

                is_socket = bool(request.headers.get_all('Upgrade'))
                reason = self._refusal(
                    request.path, header('Host') or '', header('Origin'), is_socket
                )
                if reason:
                    return connection.respond(http.HTTPStatus.FORBIDDEN, f'ratslam: {reason}\n')
                self._connections.admit(connection.transport)
                path = request.path.replace(f'/{self._token}', '', 1) or '/'
                response = process_request(connection, replace(request, path=path))
                if response is not None:
                    if response.headers.get('Content-Type', '').startswith('text/html'):
                        encoding = response.headers.get('Content-Encoding', '')
                        response.body = adapted(response.body, encoding)
                        del response.headers['Content-Length']
                        response.headers['Content-Length'] = str(len(response.body))
                    for name, value in HEADERS.items():
                        response.headers[name] = value
                return response

            silent = logging.getLogger(f'{__name__}.connections')
            silent.disabled = True  # failures of connections are not for the terminal
            options |= {
                'max_size': MAX_MESSAGE_BYTES, 'logger': silent,
                'open_timeout': REQUEST_S,
                'create_connection': _connection_class(self._connections),
            }
            return serve(handler, sock=listener, process_request=process, **options)

        with patch.object(server, 'serve', serve_guarded), _quiet():
            yield

    def _refusal(self, path: str, host: str, origin: str | None, is_socket: bool) -> str:
        """Return why a request is refused, '' if it is not.

        Args:
            path: path of the request.
            host: the header Host.
            origin: the header Origin, None if it is missing.
            is_socket: whether a WebSocket is to be opened.
        """
        if not self._is_own_name(_name_of(host)):
            return 'this name of the server is unknown: use the address that was printed'
        token = path.partition('?')[0].strip('/').partition('/')[0]
        if not hmac.compare_digest(token.encode(), self._token.encode()):
            return 'the address is incomplete: use the one that was printed, with its token'
        if is_socket and origin != f'http://{host}':
            return 'another page may not connect to this server'
        return ''

    def _is_own_name(self, name: str) -> bool:
        if name in LOOPBACK or name == self.host.lower():
            return True
        if not self.is_public:
            return False
        with suppress(ValueError):  # an address, unlike a name, is not resolved by any DNS
            ipaddress.ip_address(name)
            return True
        return name in (socket.gethostname(), socket.getfqdn())

    def _answers_strangers(self) -> bool:
        """Return whether a page or a WebSocket is served without the token."""
        host = '127.0.0.1' if self.host in ('', '0.0.0.0') else self.host
        for headers in ({}, {
            'Upgrade': 'websocket', 'Connection': 'Upgrade', 'Sec-WebSocket-Version': '13',
            'Sec-WebSocket-Key': 'AAAAAAAAAAAAAAAAAAAAAA==', 'Origin': f'http://{host}',
        }):
            connection = http.client.HTTPConnection(host, self.port, timeout=5.0)
            try:
                connection.request('GET', '/', headers=headers)
                if connection.getresponse().status != http.HTTPStatus.FORBIDDEN:
                    return True
            finally:
                connection.close()
        return False


class _Connections:
    """All open connections, those on which a browser has not sent a request yet included.

    Browsers open connections in advance, and the server would wait for their requests when it
    stops. Used by the thread of the server.
    """

    def __init__(self) -> None:
        self._open: dict[Any, bool] = {}
        """Connections, oldest first, and whether each has sent a request with the token."""
        self._aborted = False

    def add(self, transport: Any) -> None:
        """Add an open connection; close the oldest one without the token if there are too many."""
        self._open[transport] = False
        if self._aborted:
            transport.abort()
        elif len(self._open) > MAX_CONNECTIONS:
            oldest = next(one for one, is_admitted in self._open.items() if not is_admitted)
            self.remove(oldest)
            oldest.abort()

    def admit(self, transport: Any) -> None:
        """Keep a connection that has sent a request with the token."""
        if transport in self._open:
            self._open[transport] = True

    def remove(self, transport: Any) -> None:
        """Remove a closed connection."""
        self._open.pop(transport, None)

    def abort(self) -> None:
        """End all connections at once, and every later one."""
        self._aborted = True
        for transport in tuple(self._open):
            transport.abort()


def _connection_class(connections: _Connections) -> Any:
    """Return a class of connections that drop messages which viser must not receive."""
    import msgspec
    from viser._messages import Message
    from websockets.asyncio.server import ServerConnection
    from websockets.frames import CloseCode

    class Head(msgspec.Struct):
        type: str

    head = msgspec.msgpack.Decoder(Head)
    permitted = {kind.__name__ for kind in Message.get_subclasses()} - REFUSED_MESSAGES

    class Connection(ServerConnection):
        def connection_made(self, transport: Any) -> None:
            super().connection_made(transport)
            self._free_s = 0.0
            connections.add(transport)

        def connection_lost(self, exc: Exception | None) -> None:
            connections.remove(self.transport)
            super().connection_lost(exc)

        async def recv(self, decode: bool | None = None) -> Any:
            while True:
                data = await super().recv(decode)
                now_s = asyncio.get_running_loop().time()
                self._free_s = max(self._free_s, now_s - BURST / MAX_RATE_HZ) + 1.0 / MAX_RATE_HZ
                if self._free_s > now_s:
                    await asyncio.sleep(self._free_s - now_s)
                try:
                    if isinstance(data, bytes) and head.decode(data).type in permitted:
                        return data
                except msgspec.MsgspecError:
                    await self.close(CloseCode.INVALID_DATA)

    return Connection


def _no_tunnel(verbose: bool = True) -> None:
    raise UnusableInput('the viewer opens no public tunnel; use --host, or a tunnel by ssh')


@contextmanager
def _quiet() -> Iterator[None]:
    """Suppress what viser prints: addresses without the token, and its end."""
    import rich

    with patch.object(rich, 'print'):
        yield


def _viser() -> Any:
    try:
        import viser
    except ImportError as error:
        raise UnusableInput(
            f"the viewer needs viser ({error}): pip install '.[view]'"
        ) from error
    return viser


def _listen(host: str, port: int) -> socket.socket:
    """Return a socket that listens there.

    Viser would try the next thousand ports if this one is in use, and wait for ever if none of
    them can be opened.

    Raises:
        UnusableInput: the address cannot be used.
    """
    if not 0 <= port <= MAX_PORT:
        raise UnusableInput(f'the port is {port}; expected 0 to {MAX_PORT}')
    try:
        family, _, _, _, address = socket.getaddrinfo(
            host, port, type=socket.SOCK_STREAM, flags=socket.AI_PASSIVE
        )[0]
        return socket.create_server(
            address, family=family, backlog=BACKLOG, dualstack_ipv6=family == socket.AF_INET6
        )
    except (OSError, UnicodeError) as error:
        if isinstance(error, OSError) and error.errno == errno.EADDRINUSE:
            raise UnusableInput(
                f'port {port} of {host} is in use, perhaps by another viewer; choose another one '
                'by --port, or 0 for any'
            ) from error
        raise UnusableInput(
            f'the viewer cannot listen on {host}, port {port}: '
            f'{getattr(error, "strerror", None) or error}; choose another --host or --port'
        ) from error


def _name_of(host: str) -> str:
    """Return the name in a Host header, without the port."""
    with suppress(ValueError):
        return urlsplit(f'//{host}').hostname or ''
    return ''


def _own_name() -> str:
    """Return an address of this machine by which others can reach it."""
    with suppress(OSError), socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        probe.connect(('192.0.2.1', 9))  # sends nothing: finds the interface of the default route
        return str(probe.getsockname()[0])
    return socket.gethostname()
