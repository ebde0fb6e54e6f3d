# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""What all panels share: the page, the run, its controls, and the loop that draws."""

from __future__ import annotations

import threading
from collections import deque
from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, Any, Protocol

from ratslam_ros.history.run_state import RunState
from ratslam_ros.viewer.playback import Playback
from ratslam_ros.viewer.run_source import Answer, Controls

if TYPE_CHECKING:
    import viser

Post = Callable[[Callable[[], None]], None]
"""Has a function called by the loop, from any thread."""

KEPT_ANSWERS = 8
"""Number of answers that the log shows."""


class Scene(Protocol):
    """The drawn map, as far as the panels use it; see ``scene.RunScene``."""

    colouring: str
    dark: bool

    @property
    def layers(self) -> Sequence[str]:
        """Names of what can be shown and hidden."""

    @property
    def detail(self) -> str:
        """How the detail is reduced; '' if it is not."""

    def show(self, layer: str, on: bool) -> None:
        """Show or hide a layer."""

    def pick(self, origin: Any, direction: Any, state: RunState) -> Any:
        """Return what a ray hits."""

    def select(self, pick: Any) -> None:
        """Mark what is selected."""

    def legend(self) -> Any:
        """Return colours and what they stand for."""


class Desk:
    """What all panels share.

    Callbacks of viser come from its threads. They only post what is to be done, so that all
    state belongs to the loop. Requests to the controls may take long and run in a thread each.
    """

    def __init__(
        self, server: viser.ViserServer, playback: Playback, scene: Scene, controls: Controls,
        post: Post,
    ) -> None:  # fmt: skip
        self.server, self.gui = server, server.gui
        self.playback, self.scene, self.controls, self.post = playback, scene, controls, post
        self.answers: deque[tuple[str, Answer | None]] = deque(maxlen=KEPT_ANSWERS)
        """Last requests, newest first; without an answer if it has not come yet."""
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

    def ask(
        self, request: str, call: Callable[[], Answer],
        then: Callable[[Answer], None] | None = None,
    ) -> None:  # fmt: skip
        """Send a request in a thread of its own; its answer is logged by the loop.

        Args:
            request: what is requested, for the log.
            call: sends the request and waits for its answer.
            then: called by the loop with the answer.
        """
        entry: list[Answer | None] = [None]
        self.answers.appendleft((request, None))

        def answered() -> None:
            answer = entry[0]
            assert answer is not None
            for place, (name, known) in enumerate(self.answers):
                if name is request and known is None:
                    self.answers[place] = (name, answer)
                    break
            else:
                self.answers.appendleft((request, answer))
            if then is not None:
                then(answer)

        def wait() -> None:
            try:
                entry[0] = call()
            except Exception as error:
                entry[0] = Answer(False, f'{type(error).__name__}: {error}')
            self.post(answered)

        threading.Thread(target=wait, name=f'request: {request}', daemon=True).start()
