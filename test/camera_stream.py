# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""A network camera: a server of motion JPEG."""

from __future__ import annotations

import itertools
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer

import cv2
from helpers import picture

PERIOD_S = 0.02
PLACES = 12


@contextmanager
def camera_stream(images: int | None = 30) -> Iterator[str]:
    """Serve images of places on a circle; return the URL.

    Args:
        images: number of images of each connection, None for no end.
    """
    ended = threading.Event()
    jpegs = [cv2.imencode('.jpg', picture(n, 48, 64))[1].tobytes() for n in range(PLACES)]

    class Handler(BaseHTTPRequestHandler):
        def do_GET(self) -> None:
            self.send_response(200)
            self.send_header('Content-Type', 'multipart/x-mixed-replace; boundary=frame')
            self.end_headers()
            try:
                for jpeg in itertools.islice(itertools.cycle(jpegs), images):
                    self.wfile.write(
                        b'--frame\r\nContent-Type: image/jpeg\r\n'
                        b'Content-Length: %d\r\n\r\n%b\r\n' % (len(jpeg), jpeg)
                    )
                    if ended.wait(PERIOD_S):
                        return
            except OSError:  # the reader has closed the connection
                return

        def log_message(self, *_: object) -> None:
            pass

    server = ThreadingHTTPServer(('127.0.0.1', 0), Handler)
    server.daemon_threads = True
    thread = threading.Thread(target=server.serve_forever, args=(0.02,))
    thread.start()
    try:
        yield f'http://127.0.0.1:{server.server_port}/stream.mjpg'
    finally:
        ended.set()
        server.shutdown()
        thread.join()
        server.server_close()
