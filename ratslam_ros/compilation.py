# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Announcement that the inner loops are being compiled, if Numba's cache does not hold them."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from typing import Any

from ratslam_ros.console import ticking

ANNOUNCED_AFTER_S = 1.0
"""Time spent on compiling before it is announced."""


@dataclass
class Taken:
    """Time spent on compiling, in s."""

    seconds: float = 0.0


@contextmanager
def compilation_time(
    on_start: Callable[[str], None] = lambda cache: None,
) -> Iterator[Taken]:
    """Measure the time spent on compiling within this context, loading from the cache excluded.

    Numba's own event is exact and free at a warm start; searching the cache for index files would
    cost time at every start and miss outdated ones.

    Args:
        on_start: called before each compilation with the folder of the cache, '' if there is none.
    """
    from numba.core import event

    taken = Taken()

    class Listener(event.Listener):  # type: ignore[misc]
        depth = 0  # Compiling a function compiles those that it calls.
        start_s = 0.0

        def on_start(self, event: Any) -> None:
            self.depth += 1
            if self.depth == 1:
                self.start_s = time.monotonic()
                on_start(event.data['dispatcher'].stats.cache_path or '')

        def on_end(self, event: Any) -> None:
            self.depth -= 1
            if self.depth == 0:
                taken.seconds += time.monotonic() - self.start_s

    with event.install_listener('numba:compile', Listener()):
        yield taken


@contextmanager
def announced_compilation(
    say: Callable[[str], None], after_s: float = ANNOUNCED_AFTER_S
) -> Iterator[None]:
    """Report, by ``say``, that functions are compiled within this context, and how long it took.

    Nothing is reported if all functions are loaded from the cache, or if the context ends within
    ``after_s`` of the first compilation, as for one outdated function.
    """
    announced = threading.Event()
    timer: threading.Timer | None = None
    shown = ExitStack()

    def announce(cache: str) -> None:
        announced.set()
        later = f'; later starts load them from the cache, such as {cache}' if cache else ''
        say(f'compiling the inner loops, about half a minute{later}')
        shown.enter_context(ticking('compiling:'))

    def start(cache: str) -> None:
        nonlocal timer
        if timer is None:
            timer = threading.Timer(min(after_s, threading.TIMEOUT_MAX), announce, [cache])
            timer.daemon = True
            timer.start()

    with shown, compilation_time(start) as taken:
        try:
            yield
        finally:
            if timer is not None:
                timer.cancel()
                timer.join()
    if announced.is_set():
        say(f'compiled the inner loops in {taken.seconds:.0f} s')
