# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Announcement that the inner loops are being compiled, if Numba's cache does not hold them."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any


@contextmanager
def announced_compilation(say: Callable[[str], None]) -> Iterator[None]:
    """Report, by ``say``, that functions are compiled within this context, and how long it took.

    Nothing is reported if all functions are loaded from the cache. Numba's own event is exact and
    free at a warm start; searching the cache for index files would cost time at every start and
    miss outdated ones.
    """
    from numba.core import event

    class Listener(event.Listener):  # type: ignore[misc]
        start_s: float | None = None

        def on_start(self, event: Any) -> None:
            if self.start_s is not None:
                return
            self.start_s = time.monotonic()
            cache = event.data['dispatcher'].stats.cache_path
            later = f'; later starts load them from the cache, such as {cache}' if cache else ''
            say(f'compiling the inner loops, up to half a minute{later}')

        def on_end(self, event: Any) -> None:
            """Do nothing: further functions may follow."""

    listener = Listener()
    with event.install_listener('numba:compile', listener):
        yield
    if listener.start_s is not None:
        say(f'compiled the inner loops in {time.monotonic() - listener.start_s:.0f} s')
