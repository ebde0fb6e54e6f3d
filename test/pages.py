# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Pages of the viewer in headless Chromium, commands that serve them, and a relay between both."""

from __future__ import annotations

import io
import os
import re
import select
import signal
import socket
import subprocess
import sys
import threading
import time
from collections import deque
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray
from PIL import Image

ROOT = Path(__file__).parents[1]
TIMEOUT_S = 60.0
"""Generous, because rendering by software on a loaded machine is slow."""

POLL_S = 0.05
SIZE = (1280, 720)

T = TypeVar('T')

COUNTING = """
window.received = {};
const Native = window.Worker;
window.Worker = class extends Native {
  constructor(...all) {
    super(...all);
    this.addEventListener('message', (event) => {
      for (const message of (event.data && event.data.messages) || [])
        window.received[message.type] = (window.received[message.type] || 0) + 1;
    });
  }
};
"""
"""Counts the messages that the page receives; viser's WebSocket is in a worker."""


def wait_for(condition: Callable[[], T], what: str = '', timeout_s: float = TIMEOUT_S) -> T:
    """Return the first true value of a condition; fail if there is none in time."""
    end_s = time.monotonic() + timeout_s
    while not (found := condition()):
        assert time.monotonic() < end_s, f'not within {timeout_s:g} s: {what or condition}'
        time.sleep(POLL_S)
    return found


class Page:
    """A tab of the browser."""

    def __init__(self, driver: Any) -> None:
        self.driver = driver
        driver.switch_to.new_window('tab')
        self._handle = driver.current_window_handle
        driver.execute_cdp_cmd('Emulation.setDeviceMetricsOverride', {
            'width': SIZE[0], 'height': SIZE[1], 'deviceScaleFactor': 1, 'mobile': False,
        })
        driver.execute_cdp_cmd('Page.addScriptToEvaluateOnNewDocument', {'source': COUNTING})

    def __enter__(self) -> Page:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def close(self) -> None:
        self._front()
        self.driver.close()
        self.driver.switch_to.window(self.driver.window_handles[0])

    def open(self, url: str) -> Page:
        """Open an address, and wait until the panels are there."""
        self._front()
        self.driver.get(url)
        self.wait_for_text('Playback')
        return self

    def reload(self) -> None:
        self._front()
        self.driver.refresh()
        self.wait_for_text('Playback')

    def run(self, script: str, *values: object) -> Any:
        """Run JavaScript; return its result."""
        self._front()
        return self.driver.execute_script(script, *values)

    @property
    def text(self) -> str:
        """All visible text."""
        return str(self.run('return document.body.innerText'))

    def wait_for_text(self, pattern: str) -> re.Match[str]:
        """Wait until the visible text matches a regular expression."""
        try:
            return wait_for(
                lambda: re.search(pattern, self.text), f'{pattern!r} on the page'
            )  # type: ignore[return-value]
        except AssertionError as error:
            raise AssertionError(f'{error}; its text is:\n{self.text}') from None

    @property
    def received(self) -> dict[str, int]:
        """Number of received messages since the page was loaded, by type."""
        return dict(self.run('return window.received'))

    @property
    def received_count(self) -> int:
        """Number of received messages since the page was loaded."""
        return sum(self.received.values())

    def click(self, label: str) -> None:
        """Click the button or tab with a label."""
        wait_for(
            lambda: self.run(
                'const found = [...document.querySelectorAll('
                "'button, [role=tab], label.mantine-SegmentedControl-label')]"
                '.find(e => e.innerText.trim() === arguments[0] && !e.disabled);'
                'if (found) found.click(); return Boolean(found);', label,
            ),
            f'button {label!r}',
        )

    def open_tab(self, label: str) -> None:
        """Click a tab with the mouse, to which the tabs listen."""
        script = (
            "const found = [...document.querySelectorAll('[role=tab]')]"
            '.find(e => e.innerText.trim() === arguments[0]);'
            'if (!found) return null; const box = found.getBoundingClientRect();'
            'return [box.x + box.width / 2, box.y + box.height / 2];'
        )
        self.click_at(*wait_for(lambda: self.run(script, label), f'tab {label!r}'))

    def click_at(self, x: float, y: float) -> None:
        """Click a pixel of the page."""
        for kind in ('mouseMoved', 'mousePressed', 'mouseReleased'):
            self._front()
            self.driver.execute_cdp_cmd('Input.dispatchMouseEvent', {
                'type': kind, 'x': x, 'y': y, 'button': 'left', 'clickCount': 1,
            })

    def images(self) -> list[str]:
        """Return the pixels of all pictures of the panels, from top to bottom, as data URLs."""
        return list(self.run(
            'return [...document.images].filter(image => image.naturalWidth).map(image => {'
            "const canvas = document.createElement('canvas');"
            'canvas.width = image.naturalWidth; canvas.height = image.naturalHeight;'
            "canvas.getContext('2d').drawImage(image, 0, 0); return canvas.toDataURL(); });"
        ))

    def close_notices(self) -> None:
        """Close notifications, such as that of the slow rendering, which cover the map."""
        self.run(
            "document.querySelectorAll('.mantine-Notification-closeButton')"
            '.forEach(b => b.click())'
        )

    def picture(self) -> NDArray[np.uint8]:
        """Return the (height, width, 3) pixels of the page."""
        self._front()
        image = Image.open(io.BytesIO(self.driver.get_screenshot_as_png()))
        return np.asarray(image.convert('RGB'))

    def scene(self) -> NDArray[np.uint8]:
        """Return the pixels of the map between the panels."""
        left, right = self.scene_span
        return self.picture()[:, left:right]

    @property
    def scene_span(self) -> tuple[int, int]:
        """Columns of the page between which only the map is seen."""
        return 300, SIZE[0] - 360

    def wait_for_picture(
        self, condition: Callable[[NDArray[np.uint8]], Any], what: str
    ) -> NDArray[np.uint8]:
        """Wait until the pixels of the map fulfil a condition; return them."""
        last: list[NDArray[np.uint8]] = []

        def holds() -> bool:
            last[:] = [self.scene()]
            return bool(condition(last[0]))

        wait_for(holds, what)
        return last[0]

    def _front(self) -> None:
        self.driver.switch_to.window(self._handle)


def count_pixels(picture: NDArray[np.uint8], colour: Sequence[int], tolerance: int = 40) -> int:
    """Return the number of pixels whose channels all are near a colour."""
    distance = np.abs(picture.astype(int) - np.asarray(colour)).max(axis=2)
    return int((distance <= tolerance).sum())


class View:
    """A ratslam command that serves a page."""

    def __init__(self, words: Sequence[str], folder: Path, **variables: str) -> None:
        path = os.pathsep.join([str(ROOT), *filter(None, [os.environ.get('PYTHONPATH')])])
        # A variable of the desktop would open a browser.
        kept = {k: v for k, v in os.environ.items() if k not in ('DISPLAY', 'WAYLAND_DISPLAY')}
        self.process = subprocess.Popen(
            [sys.executable, '-m', 'ratslam_ros', *words], cwd=folder, text=True,
            env={**kept, 'PYTHONPATH': path, **variables}, stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE, stderr=subprocess.PIPE,
        )
        self.output: deque[str] = deque()
        self.errors: deque[str] = deque()
        self._readers = [
            threading.Thread(target=lines.extend, args=(stream,), daemon=True)
            for lines, stream in (
                (self.output, self.process.stdout), (self.errors, self.process.stderr)
            )
        ]
        for reader in self._readers:
            reader.start()

    @property
    def url(self) -> str:
        """Address of the page, once it is printed."""
        def found() -> str:
            line = next((line for line in self.output if 'http://' in line), '')
            assert line or self.process.poll() is None, ''.join(self.errors)
            return line

        match = re.search(r'http://\S+', wait_for(found, 'address'))
        assert match is not None
        return match[0]

    def interrupt(self) -> float:
        """Press Ctrl-C; return the time in s until the command has ended."""
        begun_s = time.monotonic()
        self.process.send_signal(signal.SIGINT)
        self.process.wait(TIMEOUT_S)
        return time.monotonic() - begun_s

    def wait(self) -> int:
        """Wait until the command ends; return its exit code."""
        code = self.process.wait(TIMEOUT_S)
        for reader in self._readers:
            reader.join(TIMEOUT_S)
        return code

    def close(self) -> None:
        if self.process.poll() is None:
            self.process.send_signal(signal.SIGINT)  # so that its children end
            try:
                self.process.wait(10.0)
            except subprocess.TimeoutExpired:
                self.process.kill()
        self.wait()


class Relay:
    """A connection to a server that can be stalled, as by a bad network."""

    def __init__(self, port: int) -> None:
        self._target = port
        self._flows = threading.Event()
        self._flows.set()
        self._closed = False
        self._listener = socket.create_server(('127.0.0.1', 0))
        self.port: int = self._listener.getsockname()[1]
        threading.Thread(target=self._accept, daemon=True).start()

    def stall(self) -> None:
        """Pass nothing on, and keep the connections open."""
        self._flows.clear()

    def resume(self) -> None:
        self._flows.set()

    def close(self) -> None:
        self._closed = True
        self._flows.set()
        self._listener.close()

    def _accept(self) -> None:
        while True:
            try:
                near, _ = self._listener.accept()
                far = socket.create_connection(('127.0.0.1', self._target))
            except OSError:
                return
            threading.Thread(target=self._pass, args=(near, far), daemon=True).start()

    def _pass(self, near: socket.socket, far: socket.socket) -> None:
        with near, far:
            while not self._closed:
                for source in select.select([near, far], [], [], 1.0)[0]:
                    self._flows.wait()
                    try:
                        data = source.recv(2**16)
                        if not data:
                            return
                        (far if source is near else near).sendall(data)
                    except OSError:
                        return
