# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Notices and progress bar of the commands, on standard error."""

from __future__ import annotations

import shutil
import sys
import threading
import time
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from typing import Any, Self

REFRESH_PERIOD_S = 0.1

TICK_PERIOD_S = 0.5

_ticking: list[threading.Event] = []
"""Ends of the contexts that show elapsed seconds, the innermost last."""

Progress = Callable[[str, float, float], None]
"""Receives a phase, and the processed and the total seconds of the recording."""


def is_terminal() -> bool:
    """Return whether standard error is a terminal."""
    return sys.stderr.isatty()


def print_status(text: str) -> None:
    """Print what is being done, if standard error is a terminal."""
    if is_terminal():
        print_notice(text)


def print_notice(text: str) -> None:
    """Print a line to standard error."""
    print(text, file=sys.stderr, flush=True)


def print_notices(texts: Iterable[str]) -> None:
    """Print lines to standard error."""
    for text in texts:
        print_notice(text)


@contextmanager
def ticking(text: str, shown: bool = True) -> Iterator[None]:
    """Show a short text and the elapsed seconds on a terminal, twice a second in this context.

    The cursor stays at the start of the line, so that the next line replaces the text. Of nested
    contexts, the innermost is shown.
    """
    ended = threading.Event()
    start_s = time.monotonic()

    def tick() -> None:
        after = ''
        while not ended.wait(TICK_PERIOD_S):
            if _ticking[-1:] == [ended]:
                line = f'{text} {time.monotonic() - start_s:.0f} s\x1b[K\r'  # clears the rest
                print(line, end='', file=sys.stderr, flush=True)
                after = '\x1b[K'
        print(after, end='', file=sys.stderr, flush=True)

    if not (shown and is_terminal()):
        yield
        return
    thread = threading.Thread(target=tick, name='ticking', daemon=True)
    _ticking.append(ended)
    thread.start()
    try:
        yield
    finally:
        _ticking.remove(ended)
        ended.set()
        thread.join()


class ProgressBar:
    """Progress bar in seconds of a recording.

    Used as a context manager. The bar appears at the first update after a delay, or at the end
    of the context, and not at all if an exception occurs before, or if standard error is not a
    terminal. A function may take the place of the bar.
    """

    def __init__(
        self,
        total_s: float,
        *,
        shown: bool | Progress = True,
        delay_s: float = 0.0,
        status: Callable[[], str] = lambda: '',
        label: str = '',
    ) -> None:
        """Show nothing before the first update.

        Args:
            total_s: duration of the part of the recording that is processed.
            shown: False for no bar even on a terminal; or what is called in place of the bar.
            delay_s: time before the bar appears, in seconds.
            status: text behind the bar, called at each refresh.
            label: text before the bar.
        """
        self._total_s = round(total_s, 1)
        self._report = shown if callable(shown) else None
        self._shown = bool(shown) and (callable(shown) or is_terminal())
        self._status, self._label = status, label
        self._done_s = 0.0
        self._start_s = time.monotonic()
        self._due_s = self._start_s + delay_s
        self._bar: Any = None

    def __enter__(self) -> Self:
        return self

    def __exit__(self, error_type: object, *_: object) -> None:
        if error_type is None and self._shown:
            self._refresh()
        if self._bar is not None:
            self._bar.close()

    def update(self, done_s: float) -> None:
        """Set the processed duration in seconds, and refresh the bar if that is due."""
        self._done_s = done_s
        now_s = time.monotonic()
        if self._shown and now_s >= self._due_s:
            self._due_s = now_s + REFRESH_PERIOD_S
            self._refresh()

    def _refresh(self) -> None:
        if self._report is not None:
            self._report(self._label.strip(), min(self._done_s, self._total_s), self._total_s)
            return
        if self._bar is None:
            from tqdm import tqdm

            columns, rows = shutil.get_terminal_size()
            self._bar = tqdm(
                total=self._total_s,
                file=sys.stderr,
                desc=self._label,
                # tqdm shows nothing on a terminal of unknown size, as many are in containers.
                ncols=columns, nrows=rows,
                bar_format='{desc}{percentage:3.0f}% |{bar}| {n:.0f}/{total:.0f} s, '
                           '{remaining} left{postfix}',
            )
            self._bar.start_t -= time.monotonic() - self._start_s  # for the remaining time
        self._bar.n = min(self._done_s, self._total_s)
        self._bar.set_postfix_str(self._status())
