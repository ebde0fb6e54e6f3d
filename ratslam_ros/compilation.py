# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Announcement that the inner loops are being compiled, if Numba's cache does not hold them."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

ANNOUNCED_AFTER_S = 1.0
"""Time spent on compiling before it is announced."""


@contextmanager
def announced_compilation(
    say: Callable[[str], None], after_s: float = ANNOUNCED_AFTER_S
) -> Iterator[None]:
    """Report, by ``say``, that functions are compiled within this context, and how long it took.

    Nothing is reported if all functions are loaded from the cache, or if compiling took less than
    ``after_s``, as for one outdated function. Numba's own event is exact and free at a warm start;
    searching the cache for index files would cost time at every start and miss outdated ones.
    """
    from numba.core import event

    class Listener(event.Listener):  # type: ignore[misc]
        depth = 0  # Compiling a function compiles those that it calls.
        start_s = took_s = 0.0
        announced = False

        def on_start(self, event: Any) -> None:
            self.depth += 1
            if self.depth > 1:
                return
            self.start_s = time.monotonic()
            if self.announced or self.took_s < after_s:
                return
            self.announced = True
            cache = event.data['dispatcher'].stats.cache_path
            later = f'; later starts load them from the cache, such as {cache}' if cache else ''
            say(f'compiling the inner loops, about half a minute{later}')

        def on_end(self, event: Any) -> None:
            self.depth -= 1
            if self.depth == 0:
                self.took_s += time.monotonic() - self.start_s

    listener = Listener()
    with event.install_listener('numba:compile', listener):
        yield
    if listener.announced:
        say(f'compiled the inner loops in {listener.took_s:.0f} s')
