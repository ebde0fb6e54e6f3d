# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Who may connect to the viewer, and what is done with what they send."""

from __future__ import annotations

import gzip
import http.client
import socket
import sys
import time
from collections.abc import Iterator
from contextlib import ExitStack, suppress
from typing import Any
from urllib.parse import urlsplit

import pytest
from viewer_doubles import FakeControls, FakeRun

from ratslam_ros.errors import UnusableInput
from ratslam_ros.viewer.app import Page
from ratslam_ros.viewer.rendering import SCRIPT, with_elements
from ratslam_ros.viewer.server import MAX_CONNECTIONS, MAX_MESSAGE_BYTES, ViewServer

FORBIDDEN, OK = 403, 200
INVALID_DATA = 1007


@pytest.fixture(scope='module')
def server(viser: Any) -> Iterator[ViewServer]:
    started = ViewServer(port=0)
    yield started
    started.stop()


def get(server: ViewServer, path: str, host: str | None = None) -> tuple[int, str]:
    """Request a page; return the status and the first characters of the answer."""
    connection = http.client.HTTPConnection('127.0.0.1', server.port, timeout=30.0)
    try:
        connection.request('GET', path, headers={} if host is None else {'Host': host})
        answer = connection.getresponse()
        return answer.status, answer.read().decode()[:500]
    finally:
        connection.close()


def connect(server: ViewServer, path: str | None = None, **options: Any) -> Any:
    """Open a WebSocket as the page does, with anything else than usual in the options."""
    import viser
    from websockets.sync.client import connect as open_socket

    options = {'origin': f'http://127.0.0.1:{server.port}', **options}
    return open_socket(
        f'ws://127.0.0.1:{server.port}{page_of(server) if path is None else path}',
        subprotocols=[f'viser-v{viser.__version__}'], compression=None, max_size=None, **options,
    )


def page_of(server: ViewServer) -> str:
    return urlsplit(server.url).path


def message(kind: str, **content: object) -> bytes:
    import msgspec

    return msgspec.msgpack.encode({'type': kind, **content})


def is_closed(connection: Any) -> bool:
    """Return whether the server closes a connection, reading all that it sends before."""
    from websockets.exceptions import ConnectionClosed

    try:
        while True:
            connection.recv(timeout=30.0)
    except ConnectionClosed:
        return True
    except TimeoutError:
        return False


@pytest.mark.parametrize('encoding', ['identity', 'gzip'])
def test_page_has_own_script_before_those_of_viser(server: ViewServer, encoding: str) -> None:
    connection = http.client.HTTPConnection('127.0.0.1', server.port, timeout=30.0)
    try:
        connection.request('GET', page_of(server), headers={'Accept-Encoding': encoding})
        answer = connection.getresponse()
        body = answer.read()
    finally:
        connection.close()
    page = (gzip.decompress(body) if encoding == 'gzip' else body).decode()
    assert answer.headers.get_all('Content-Length') == [str(len(body))]
    assert page.count(SCRIPT.read_text()) == 1
    assert page.index('antialias') < page.index('<script', page.index('</script>'))


def test_page_that_is_not_visers_is_not_adapted() -> None:
    with pytest.raises(ValueError, match='<meta charset'):
        with_elements('<html></html>', '<script></script>')


@pytest.mark.parametrize('path', ['/', '/index.html', '/wrong/', '/?token=wrong', 'cut'])
def test_page_without_token_is_refused(server: ViewServer, path: str) -> None:
    status, text = get(server, page_of(server)[:-2] if path == 'cut' else path)
    assert status == FORBIDDEN
    assert 'the address is incomplete' in text


@pytest.mark.parametrize('host', ['evil.example', 'evil.example:80', '127.0.0.1.evil.example', ''])
def test_page_for_unknown_name_is_refused(server: ViewServer, host: str) -> None:
    status, text = get(server, page_of(server), host)
    assert status == FORBIDDEN
    assert 'name' in text


@pytest.mark.parametrize('host', ['localhost', '127.0.0.1', '[::1]', 'LOCALHOST:9999'])
def test_page_for_loopback_name_is_served(server: ViewServer, host: str) -> None:
    assert get(server, page_of(server), host)[0] == OK


def test_tokens_differ_between_servers(server: ViewServer) -> None:
    other = ViewServer(port=0)
    try:
        assert page_of(other) != page_of(server)
        assert get(other, page_of(server))[0] == FORBIDDEN
    finally:
        other.stop()


@pytest.mark.parametrize(
    'changed',
    [
        {'path': '/'},
        {'origin': 'http://evil.example'},
        {'origin': 'http://127.0.0.1:1'},
        {'origin': 'https://127.0.0.1'},
        {'origin': 'null'},
        {'origin': None},
        {'additional_headers': {'Origin': 'http://evil.example'}},
    ],
    ids=str,
)
def test_socket_of_strangers_is_refused(server: ViewServer, changed: dict[str, Any]) -> None:
    from websockets.exceptions import InvalidStatus

    with pytest.raises(InvalidStatus) as caught, connect(server, **changed):
        pass
    assert caught.value.response.status_code == FORBIDDEN


def test_share_request_opens_no_tunnel(server: ViewServer) -> None:
    with connect(server) as connection:
        connection.send(message('ShareUrlRequest'))
        connection.send(b'\xc1')  # never valid; the server closes after what came before
        assert is_closed(connection)
    assert server.viser._share_tunnel is None
    with pytest.raises(UnusableInput, match='no public tunnel'):
        server.viser.request_share_url()


def test_uploads_are_not_kept(server: ViewServer) -> None:
    with connect(server) as connection:
        connection.send(message(
            'FileTransferStartUpload', source_component_uuid='a', transfer_uuid='b', filename='c',
            mime_type='d', part_count=9, size_bytes=9,
        ))
        connection.send(b'\xc1')
        assert is_closed(connection)
    assert not server.viser.gui._current_file_upload_states


@pytest.mark.parametrize('data', [b'\xc1', b'', 'text', message('Unknown') + b'\xc1'])
def test_malformed_message_ends_only_its_connection(
    server: ViewServer, data: bytes | str, capfd: pytest.CaptureFixture[str]
) -> None:
    from websockets.exceptions import ConnectionClosed

    with connect(server) as other:
        with connect(server) as connection:
            connection.send(data)
            with suppress(ConnectionClosed):  # The first one may have ended it already.
                connection.send(b'\xc1')
            assert is_closed(connection)
        assert isinstance(other.recv(timeout=30.0), bytes)
    assert capfd.readouterr().err == ''


def test_huge_message_ends_its_connection(server: ViewServer) -> None:
    from websockets.exceptions import ConnectionClosed

    with connect(server) as connection:
        try:
            connection.send(bytes(MAX_MESSAGE_BYTES + 1))
        except ConnectionClosed:
            return
        assert is_closed(connection)


def test_public_server_serves_addresses_but_no_foreign_names(viser: Any) -> None:
    server = ViewServer('0.0.0.0', 0)
    try:
        assert server.is_public
        assert get(server, page_of(server), '192.0.2.7:80')[0] == OK
        assert get(server, page_of(server), socket.gethostname())[0] == OK
        assert get(server, page_of(server), 'evil.example')[0] == FORBIDDEN
        assert get(server, '/')[0] == FORBIDDEN
    finally:
        server.stop()


def test_port_in_use_is_an_error(server: ViewServer) -> None:
    with pytest.raises(UnusableInput, match=f'port {server.port} .*--port'):
        ViewServer(port=server.port)


@pytest.mark.parametrize(('host', 'port'), [('127.0.0.1', 70000), ('no.such.name.invalid', 0)])
def test_unusable_address_is_an_error(viser: Any, host: str, port: int) -> None:
    with pytest.raises(UnusableInput, match='port'):
        ViewServer(host, port)


def test_missing_extra_is_an_error(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, 'viser', None)
    with pytest.raises(UnusableInput, match=r"pip install '.\[view\]'"):
        ViewServer(port=0)


def test_server_without_access_check_does_not_start(
    viser: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(ViewServer, '_refusal', lambda *_: '')
    with pytest.raises(UnusableInput, match='the access check has no effect'):
        ViewServer(port=0)


def test_stop_ends_silent_connections(viser: Any) -> None:
    server = ViewServer(port=0)
    page = connect(server)
    idle = socket.create_connection(('127.0.0.1', server.port))  # as browsers open in advance
    begun_s = time.monotonic()
    server.stop()
    assert time.monotonic() - begun_s < 10.0  # 2 s on a machine without load
    assert idle.recv(1) == b''
    assert is_closed(page)
    idle.close()


def test_connections_beyond_limit_close_the_oldest(server: ViewServer) -> None:
    with ExitStack() as stack:
        opened = [
            stack.enter_context(socket.create_connection(('127.0.0.1', server.port), timeout=30.0))
            for _ in range(MAX_CONNECTIONS + 5)
        ]
        assert all(one.recv(1) == b'' for one in opened[:5])
        opened[-1].sendall(b'GET / HTTP/1.1\r\n\r\n')
        assert opened[-1].recv(100).startswith(b'HTTP/1.1 403')


def test_connection_without_complete_request_is_closed(
    viser: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr('ratslam_ros.viewer.server.REQUEST_S', 0.1)
    one = ViewServer(port=0)
    try:
        with socket.create_connection(('127.0.0.1', one.port), timeout=30.0) as silent:
            silent.sendall(b'GET / HTTP/1.1\r\n')
            assert silent.recv(1) == b''
    finally:
        one.stop()


def test_open_page_is_kept_when_others_connect(server: ViewServer) -> None:
    with ExitStack() as stack:
        page = stack.enter_context(connect(server))
        for _ in range(MAX_CONNECTIONS):
            stack.enter_context(socket.create_connection(('127.0.0.1', server.port)))
        assert get(server, page_of(server))[0] == OK
        page.send(b'\xc1')
        assert is_closed(page)
        assert page.close_code == INVALID_DATA  # by the message, and not aborted before


def test_flood_of_messages_waits(viser: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    from ratslam_ros.viewer import server as module

    monkeypatch.setattr(module, 'MAX_RATE_HZ', 100.0)
    monkeypatch.setattr(module, 'BURST', 10)
    one = ViewServer(port=0)
    try:
        with connect(one) as connection:
            begin_s = time.monotonic()
            for _ in range(110):
                connection.send(message('Unknown'))
            connection.send(b'\xc1')  # invalid, which closes the connection when it is its turn
            assert is_closed(connection)
            assert time.monotonic() - begin_s > 0.9  # 100 messages at 100 Hz
    finally:
        one.stop()


def test_server_of_a_closed_page_ends_after_its_last_drawing(
    monkeypatch: pytest.MonkeyPatch
) -> None:
    """Otherwise a drawing would fail, and be reported."""
    done: list[str] = []

    def draw(page: Page) -> None:
        page._stop.wait()
        time.sleep(0.1)
        done.append('drawn')

    monkeypatch.setattr(Page, '_loop', draw)
    server = ViewServer(port=0)
    stop = server.stop
    monkeypatch.setattr(server, 'stop', lambda: (done.append('stopped'), stop()))
    Page(server, FakeRun(), FakeControls()).close()
    assert done == ['drawn', 'stopped']
