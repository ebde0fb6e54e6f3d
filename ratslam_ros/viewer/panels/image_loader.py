# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Reading of camera images without holding up the loop."""

from __future__ import annotations

import threading
from collections.abc import Callable
from functools import partial
from queue import SimpleQueue

from ratslam_ros.viewer.panels.desk import Post
from ratslam_ros.viewer.run_source import RunSource

Show = Callable[[bytes | None], None]


class ImageLoader:
    """Reads images of a run in a thread; a recording may take 20 ms for each, or more.

    If requests come faster than images can be read, only the newest one is answered.
    """

    def __init__(self, post: Post) -> None:
        self._post = post
        self._requests: SimpleQueue[tuple[RunSource, int, Show]] = SimpleQueue()
        threading.Thread(target=self._run, name='images', daemon=True).start()

    def request(self, source: RunSource, stamp_ns: int, show: Show) -> None:
        """Have the loop show the image of a stamp as soon as it has been read."""
        self._requests.put((source, stamp_ns, show))

    def _run(self) -> None:
        while True:
            source, stamp_ns, show = self._requests.get()
            if not self._requests.empty():
                continue
            try:
                jpeg = source.image_at(stamp_ns)
            except Exception:  # the run shows its small image instead
                jpeg = None
            self._post(partial(show, jpeg))
