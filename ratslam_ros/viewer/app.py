# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""A page in the browser: a loop draws the state of a run at the cursor while it is connected."""

from __future__ import annotations

import queue
import threading
import time
from collections.abc import Callable

from ratslam_ros.console import print_notice
from ratslam_ros.viewer.panels import Desk, Panels
from ratslam_ros.viewer.playback import Playback
from ratslam_ros.viewer.run_source import Controls, RunSource
from ratslam_ros.viewer.scene import RunScene
from ratslam_ros.viewer.server import ViewServer

PERIOD_S = 0.1
"""Period of drawing: 10 Hz, the rate of the images of most recordings."""

MAX_POSTED = 1000
"""Longest queue of posted functions; more are dropped, so that a blocked loop uses no memory."""

REPEAT_S = 10.0
"""Time after which an error that occurs again is reported again."""

TIDY_S = 60.0
"""Period at which viser's messages about removed objects are deleted.

Viser keeps them until another browser connects, so they would add up over hours.
"""


class Page:
    """A page that shows a run and lets the user control it, until it is closed.

    Only the thread of the loop touches the state. Callbacks of the page come from threads of
    viser: they ``post`` a function, which the loop calls.
    """

    def __init__(self, server: ViewServer, source: RunSource, controls: Controls) -> None:
        """Add the scene and the panels, and begin to draw.

        Args:
            server: a server with an empty page.
            source: the run to show first.
            controls: what the user can request of the run.
        """
        self.server = server
        self.playback = Playback(source)
        self.scene = RunScene(server.viser)
        self.desk = Desk(server.viser, self.playback, self.scene, controls, self.post)
        self.panels = Panels(self.desk)
        self._posted: queue.Queue[Callable[[], None]] = queue.Queue(MAX_POSTED)
        self._reported: dict[str, float] = {}
        self.error: BaseException | None = None
        """The exception that ended the loop, if any."""
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._run, name='view', daemon=True)
        self._thread.start()

    def close(self, within_s: float | None = None) -> None:
        """End the loop and the server; with a limit, the server does not wait for the loop."""
        self._stop.set()
        if within_s is None:
            self._thread.join()
        self.server.stop()
        self._thread.join(within_s)

    def post(self, function: Callable[[], None]) -> None:
        """Have a function called by the loop; may be called from any thread."""
        try:
            self._posted.put_nowait(function)
        except queue.Full:
            self._report('request', RuntimeError('too many requests; one was dropped'))

    def show(self, source: RunSource) -> None:
        """Show another run; may be called from any thread."""
        self.post(lambda: self.playback.use(source))

    def notify(self, title: str, text: str) -> None:
        """Show an error on every connected page; may be called from any thread."""
        self.desk.notify(title, text, is_error=True)

    def _run(self) -> None:
        try:
            self._loop()
        except BaseException as error:
            self.error = error

    def _loop(self) -> None:
        """Draw at 10 Hz until the page is closed.

        An error in a panel or callback is shown and logged in one line; the loop goes on.
        """
        drawn_s, tidied_s = time.monotonic(), 0.0
        while not self._stop.is_set():
            begun_s = time.monotonic()
            # Functions that are posted meanwhile wait for the next period: the page stays alive.
            for _ in range(self._posted.qsize()):
                self._attempt('request', self._posted.get_nowait())
            if self.server.client_count:
                self._attempt('drawing', lambda: self._draw(begun_s - drawn_s))  # noqa: B023
            drawn_s = begun_s
            if begun_s - tidied_s >= TIDY_S:
                tidied_s = begun_s
                self.server.viser._run_garbage_collector()
            self._stop.wait(max(0.0, begun_s + PERIOD_S - time.monotonic()))

    def _draw(self, elapsed_s: float) -> None:
        state = self.playback.tick(elapsed_s)
        with self.server.viser.atomic():  # Pages show all of an update or nothing of it.
            self.scene.update(state)
            self.panels.update(state)

    def _attempt(self, what: str, function: Callable[[], None]) -> None:
        try:
            function()
        except Exception as error:
            self._report(what, error)

    def _report(self, what: str, error: Exception) -> None:
        text = f'{what}: {type(error).__name__}: {" ".join(str(error).split())}'
        now_s = time.monotonic()
        if now_s - self._reported.get(text, -REPEAT_S) < REPEAT_S:
            return
        if len(self._reported) >= MAX_POSTED:
            self._reported.clear()
        self._reported[text] = now_s
        print_notice(f'ratslam view: {text}')
        self.notify('Error', text)
