# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Reading of camera images without holding up the loop."""

from __future__ import annotations

import threading
from collections.abc import Callable
from functools import partial

from ratslam_ros.viewer.panels.desk import Post
from ratslam_ros.viewer.run_source import RunSource

Show = Callable[[bytes | None], None]


class ImageLoader:
    """Reads images of a run in a thread; a recording may take 20 ms for each, or more.

    If requests come faster than images can be read, only the newest one is answered.
    """

    def __init__(self, post: Post) -> None:
        self._post = post
        self._wanted: tuple[RunSource, int, Show] | None = None
        self._changed = threading.Condition()
        self._thread: threading.Thread | None = None

    def request(self, source: RunSource, stamp_ns: int, show: Show) -> None:
        """Have the loop show the image of a stamp as soon as it has been read."""
        with self._changed:
            self._wanted = source, stamp_ns, show
            self._changed.notify()
        if self._thread is None:
            self._thread = threading.Thread(target=self._run, name='images', daemon=True)
            self._thread.start()

    def _run(self) -> None:
        while True:
            with self._changed:
                self._changed.wait_for(lambda: self._wanted is not None)
                assert self._wanted is not None
                source, stamp_ns, show = self._wanted
                self._wanted = None
            try:
                jpeg = source.image_at(stamp_ns)
            except Exception:  # the run shows its small image instead
                jpeg = None
            self._post(partial(show, jpeg))
