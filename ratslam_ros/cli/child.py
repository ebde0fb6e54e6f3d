# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""A ratslam command as a child process, whose messages are passed on."""

from __future__ import annotations

import signal
import subprocess
import sys
import threading
import time
from collections.abc import Sequence
from contextlib import suppress

from ratslam_ros.console import print_notice
from ratslam_ros.supervision import end_with_parent


class Child:
    """A running command; its standard error is printed here line by line, and kept."""

    def __init__(self, words: Sequence[str]) -> None:
        """Start ``ratslam`` with these arguments; call it from the main thread.

        The child is ended by the kernel if the thread that started it ends.
        """
        # In a session of its own, so that Ctrl-C in the terminal reaches it only through `end`.
        self._is_interrupted = False
        self._process = subprocess.Popen(
            [sys.executable, '-m', 'ratslam_ros', *words], stdin=subprocess.DEVNULL,
            stderr=subprocess.PIPE, text=True, errors='replace', start_new_session=True,
            preexec_fn=end_with_parent(),
        )
        self.lines: list[str] = []
        """What it has printed to standard error."""
        self._reader = threading.Thread(target=self._read, name='child', daemon=True)
        self._reader.start()

    @property
    def code(self) -> int | None:
        """Exit code, None while it runs."""
        code = self._process.poll()
        if code is not None:
            self._reader.join(1.0)  # its last line, which may be the reason of the end
        return code

    @property
    def reason(self) -> str:
        """Last line that it has printed, without the name of the command."""
        return self.lines[-1].removeprefix('ratslam: ') if self.lines else f'exit code {self.code}'

    def interrupt(self) -> None:
        """Send SIGINT once, upon which a replay writes its results, and print nothing more.

        An interrupt within the compilation of the loops ends in a long traceback.
        """
        if not self._is_interrupted:
            self._is_interrupted = True
            self._process.send_signal(signal.SIGINT)

    def end(self, within_s: float) -> int:
        """Wait until it ends, kill it if it does not in time, and return its exit code."""
        end_s = time.monotonic() + within_s
        with suppress(subprocess.TimeoutExpired):
            self._process.wait(max(0.0, within_s))
        self._process.kill()  # which does nothing if it has ended
        code = self._process.wait()
        self._reader.join(max(0.1, end_s - time.monotonic()))
        return code

    def _read(self) -> None:
        assert self._process.stderr is not None
        for line in self._process.stderr:
            if text := line.rstrip():
                self.lines.append(text)
                if not self._is_interrupted:
                    print_notice(text)
