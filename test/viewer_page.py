# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The panels on a server without a browser, and a user who works with them."""

from __future__ import annotations

import queue
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

import viser
from viewer_doubles import FakeControls, FakeRun, FakeScene

from ratslam_ros.viewer.panels import Desk, Panels
from ratslam_ros.viewer.playback import Playback

ALL_ACTIONS = (
    'go_to', 'go_to_place', 'name_place', 'cancel_goals', 'explore', 'pause_nodes', 'mapping',
    'relocate', 'save', 'load', 'reset', 'set_parameter',
)


class AtOnce:
    """Reads images without a thread."""

    def request(self, run: FakeRun, stamp_ns: int, show: Callable[[bytes | None], None]) -> None:
        show(run.image_at(stamp_ns))


class Page:
    """Panels on a server without a browser, and a user who works with them."""

    def __init__(
        self, server: viser.ViserServer, run: FakeRun, controls: Any = None, **scene: Any
    ) -> None:
        self.run, self.controls = run, controls or FakeControls()
        self.scene = FakeScene()
        self.posted: queue.Queue[Callable[[], None]] = queue.Queue()
        self.playback = Playback(run)
        desk = Desk(server, self.playback, self.scene, self.controls, self.posted.put)
        self.panels = Panels(desk)
        self.panels.camera.loader = AtOnce()  # type: ignore[assignment]
        self.update()

    def update(self, elapsed_s: float = 0.0) -> None:
        """Do what the loop of the app does."""
        while not self.posted.empty():
            self.posted.get()()
        self.panels.update(self.playback.tick(elapsed_s))

    def give(self, handle: Any, value: Any = None) -> None:
        """Set an input, or press a button, as a browser does."""
        if value is not None:
            handle._impl.value = value
        for callback in handle._impl.update_cb:
            callback(viser.GuiEvent(client=None, client_id=1, target=handle))
        self.update()

    def trigger(self, label: str) -> None:
        """Trigger a command, as its key does."""
        (command,) = [c for c in self.panels.commands if c.label == label]
        for callback in command._impl.trigger_cb:
            callback(None)  # type: ignore[arg-type]
        self.update()

    def answer(self) -> None:
        """Wait for the answers to all requests."""
        while any(request.answer is None for request in self.panels.desk.requests):
            self.posted.get(timeout=10.0)()
        self.update()

    def settle(self) -> None:
        """Draw until the parts that are drawn less often have been drawn."""
        for _ in range(10):
            self.update()

    def at(self, number: int) -> None:
        """Show a step of the run."""
        self.playback.seek(self.run.stamps[number])
        self.update()


@contextmanager
def open_page(*values: Any, **more: Any) -> Iterator[Page]:
    """Yield a page on a server of its own."""
    server = viser.ViserServer('127.0.0.1', 0, verbose=False)
    try:
        yield Page(server, *values, **more)
    finally:
        server.stop()
