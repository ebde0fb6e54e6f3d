# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""What all panels share: the page, the run, its controls, and the loop that draws."""

from __future__ import annotations

import threading
from collections import deque
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from ratslam_ros.viewer.playback import Playback
from ratslam_ros.viewer.run_source import Answer, Controls

if TYPE_CHECKING:
    import viser

    from ratslam_ros.viewer.scene import RunScene

Post = Callable[[Callable[[], None]], None]
"""Has a function called by the loop, from any thread."""

NOTIFIED_S = 8.0
"""Time for which an answer or error stays on the page, long enough to be read."""

KEPT_REQUESTS = 8
"""Number of requests that the log shows."""


@dataclass
class Request:
    """A request to the controls; the answer is None until it comes."""

    text: str
    answer: Answer | None = None


class Desk:
    """What all panels share.

    Callbacks of viser come from its threads. They only post what is to be done, so that all
    state belongs to the loop. Requests to the controls may take long and run in a thread each.
    """

    def __init__(
        self, server: viser.ViserServer, playback: Playback, scene: RunScene, controls: Controls,
        post: Post,
    ) -> None:
        self.server, self.gui = server, server.gui
        self.playback, self.scene, self.controls, self.post = playback, scene, controls, post
        self.requests: deque[Request] = deque(maxlen=KEPT_REQUESTS)
        """The last requests to the controls, newest first."""
        self.updates = 0
        """Number of updates; panels that need not follow every one count them."""

    def on_change(self, handle: Any, act: Callable[[Any], None]) -> None:
        """Have the loop act on every new value that a user gives to an input."""

        def changed(event: Any) -> None:
            if event.client_id is None:  # assigned by this program, which needs no answer
                return
            value = event.target.value
            self.post(lambda: act(value))

        handle.on_update(changed)

    def on_click(self, button: Any, act: Callable[[], None]) -> None:
        """Have the loop act on every click of a button."""
        button.on_click(lambda _event: self.post(act))

    def on_press(self, group: Any, acts: Mapping[str, Callable[[], None]]) -> None:
        """Have the loop act on every button of a group that is pressed."""
        group.on_click(lambda event: self.post(acts[event.target.value]))

    def ask(
        self, request: str, call: Callable[[], Answer],
        then: Callable[[Answer], None] | None = None,
    ) -> None:
        """Send a request in a thread of its own; its answer is logged by the loop.

        Args:
            request: what is requested, for the log.
            call: sends the request and waits for its answer.
            then: called by the loop with the answer.
        """
        entry = Request(request)
        self.requests.appendleft(entry)

        def wait() -> None:
            try:
                answer = call()
            except Exception as error:
                answer = Answer(False, f'{type(error).__name__}: {error}')
            self.post(lambda: answered(answer))

        def answered(answer: Answer) -> None:
            entry.answer = answer
            self._report(request, answer)
            if then is not None:
                then(answer)

        threading.Thread(target=wait, name=f'request: {request}', daemon=True).start()

    def refuse(self, request: str, reason: str) -> None:
        """Log a request that cannot be sent."""
        answer = Answer(False, reason)
        self.requests.appendleft(Request(request, answer))
        self._report(request, answer)

    def _report(self, request: str, answer: Answer) -> None:
        outcome = 'Done' if answer.success else 'Refused'
        self.notify(f'{outcome}: {request}', answer.message, not answer.success)

    def notify(self, title: str, text: str, is_error: bool) -> None:
        """Show a text on every connected page, whatever panel is open; from any thread."""
        for client in self.server.get_clients().values():
            client.add_notification(
                title, text, color='red' if is_error else 'green', auto_close_seconds=NOTIFIED_S
            )


def assign(handle: Any, value: Any) -> None:
    """Set the value of an input if it differs."""
    put(handle, 'value', value)


def put(handle: Any, name: str, value: Any) -> None:
    """Set a property if it differs; viser would compare it too, after 25 us of casts."""
    if getattr(handle, name) != value:
        setattr(handle, name, value)


def offer(choice: Any, options: Sequence[str]) -> None:
    """Set the options of a dropdown or a group of buttons; viser sends every assignment."""
    if choice.options != tuple(options):
        choice.options = tuple(options)
