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

import hmac
import http
import http.client
import ipaddress
import secrets
import socket
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import replace
from typing import Any
from unittest.mock import patch
from urllib.parse import urlsplit

from ratslam_ros.errors import UnusableInput

DEFAULT_HOST, DEFAULT_PORT = '127.0.0.1', 8080

LOOPBACK = frozenset({'127.0.0.1', 'localhost', '::1'})
"""Names of this machine for a browser on it."""

MAX_MESSAGE_BYTES = 16 * 2**20
"""Largest message from a browser: a screenshot of 4K as PNG. Events are below 1 kB."""

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
        _check_address(host, port)
        self.host = host
        self._token = secrets.token_urlsafe(24)
        with _guarded(self._refusal, self._without_token):
            self.viser = viser.ViserServer(host, port, label='RatSLAM', verbose=False)
        self.port = int(self.viser.get_port())
        if port not in (0, self.port):  # taken between the check and the start; viser went on
            self.stop()
            raise _in_use(host, port)
        self._forbid_sharing()
        self.set_theme(dark=False)
        if self._answers_strangers():
            self.stop()
            raise UnusableInput(
                f'the access check has no effect with viser {viser.__version__}; install '
                "the version that this package asks for: pip install 'ratslam_ros[view]'"
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
        """Number of connected browsers."""
        return len(self.viser.get_clients())

    def set_theme(self, dark: bool) -> None:
        """Set the theme of the page, always without viser's button that opens a public tunnel."""
        self.viser.gui.configure_theme(
            dark_mode=dark, show_logo=False, show_share_button=False, control_layout='fixed',
            control_width='large', brand_color=(0, 114, 178),
        )  # fmt: skip

    def stop(self) -> None:
        """End all connections and free the port."""
        with _quiet():
            self.viser.stop()

    # Who may connect

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
        if name in LOOPBACK or name == self.host:
            return True
        if not self.is_public:
            return False
        with suppress(ValueError):  # an address, unlike a name, is not resolved by any DNS
            ipaddress.ip_address(name)
            return True
        return name in (socket.gethostname(), socket.getfqdn())

    def _without_token(self, path: str) -> str:
        return path.replace(f'/{self._token}', '', 1) or '/'

    def _forbid_sharing(self) -> None:
        """Refuse requests for a public tunnel, which a client could send without the button."""
        from viser import _messages

        connection = self.viser._websock_server
        connection.unregister_handler(_messages.ShareUrlRequest)
        connection.unregister_handler(_messages.ShareUrlDisconnect)

    def _answers_strangers(self) -> bool:
        """Return whether a page or a WebSocket is served without the token."""
        host = '127.0.0.1' if self.host in ('', '0.0.0.0') else self.host
        for headers in ({}, {
            'Upgrade': 'websocket', 'Connection': 'Upgrade', 'Sec-WebSocket-Version': '13',
            'Sec-WebSocket-Key': 'AAAAAAAAAAAAAAAAAAAAAA==', 'Origin': f'http://{host}',
        }):  # fmt: skip
            connection = http.client.HTTPConnection(host, self.port, timeout=5.0)
            try:
                connection.request('GET', '/', headers=headers)
                if connection.getresponse().status != http.HTTPStatus.FORBIDDEN:
                    return True
            finally:
                connection.close()
        return False


@contextmanager
def _guarded(
    refusal: Callable[[str, str, str | None, bool], str], path_of: Callable[[str], str]
) -> Iterator[None]:
    """Have servers that are started in this context check who connects.

    Viser has no setting for this. It passes its own handler of requests, which serves the page, to
    `websockets`; here, that handler is preceded by the check.
    """
    from websockets.asyncio import server

    serve = server.serve

    def serve_guarded(handler: Any, *address: Any, process_request: Any, **options: Any) -> Any:
        def process(connection: Any, request: Any) -> Any:
            def header(name: str) -> str | None:
                values = request.headers.get_all(name)
                return values[0] if len(values) == 1 else None  # twice is as bad as never

            is_socket = bool(request.headers.get_all('Upgrade'))
            reason = refusal(
                request.path, header('Host') or '', header('Origin'), is_socket
            )
            if reason:
                return connection.respond(http.HTTPStatus.FORBIDDEN, f'ratslam: {reason}\n')
            response = process_request(
                connection, replace(request, path=path_of(request.path))
            )
            if response is not None:
                for name, value in HEADERS.items():
                    response.headers[name] = value
            return response

        options['max_size'] = MAX_MESSAGE_BYTES
        return serve(handler, *address, process_request=process, **options)

    with patch.object(server, 'serve', serve_guarded), _quiet():
        yield


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
            f"the viewer needs viser ({error}): pip install 'ratslam_ros[view]'"
        ) from error
    return viser


def _check_address(host: str, port: int) -> None:
    """Raise if a server cannot listen there; viser would try the next thousand ports."""
    try:
        family, kind, protocol, _, address = socket.getaddrinfo(
            host, port, type=socket.SOCK_STREAM, flags=socket.AI_PASSIVE
        )[0]
        with socket.socket(family, kind, protocol) as probe:
            probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
            probe.bind(address)
    except OverflowError as error:
        raise UnusableInput(f'the port is {port}; expected 0 to 65535') from error
    except OSError as error:
        import errno

        if error.errno == errno.EADDRINUSE:
            raise _in_use(host, port) from error
        raise UnusableInput(
            f'the viewer cannot listen on {host}, port {port}: {error.strerror}; choose another '
            '--host or --port'
        ) from error


def _in_use(host: str, port: int) -> UnusableInput:
    return UnusableInput(
        f'port {port} of {host} is in use, perhaps by another viewer; choose another one by '
        '--port, or 0 for any'
    )


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
