# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Times of the commands that a new user runs first, and how long each of them prints nothing.

    python benchmarks/first_hour.py [--only NAME ...] [--environment .venv] [--recording PATH]

The commands run in a fresh clone of the last commit, in a temporary folder, each on a pseudo
terminal like that of a user. A silence is an interval without output: *first output* is the one at
the start, *longest silence* the longest one afterwards, also before the end of the command.
Targets: 0.3 s and 2 s.

``make demo`` installs what is needed, which depends on the network. ``--environment`` uses the
packages of a virtual environment instead, without changing it. Functions are compiled in either
case. ``play`` and ``launch`` run together, in two terminals; ``launch`` is measured until it is
ready, because it is to be silent afterwards.
"""

from __future__ import annotations

import argparse
import contextlib
import os
import pty
import re
import select
import signal
import struct
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from fcntl import ioctl
from pathlib import Path
from termios import TIOCSWINSZ

ROOT = Path(__file__).resolve().parents[1]
# A replay, which is last, replaces the results of the demo.
ROWS = ('demo-first', 'demo-warm', 'demo', 'help', 'live', 'replay')
RECORDING = 'results/latest/recording'
READY = 'ready'
END_S = 30.0
"""Time within which interrupted nodes must exit, in s."""

TERMINAL_SIZE = struct.pack('HHHH', 40, 100, 0, 0)


@dataclass
class Watched:
    """Output of one command over time.

    took_s: duration. first_s: time until the first output. silence_s: longest interval without
    output afterwards. before: the last line before it.
    """

    took_s: float = 0.0
    first_s: float = 0.0
    silence_s: float = 0.0
    before: str = ''
    output: str = ''


class Terminal:
    """A command that runs on a pseudo terminal of its own."""

    def __init__(self, words: Sequence[str], folder: Path, environment: dict[str, str]) -> None:
        """Start the command in a folder."""
        self._master, slave = pty.openpty()
        ioctl(slave, TIOCSWINSZ, TERMINAL_SIZE)
        self._words = words
        self._start_s = time.monotonic()
        self.process = subprocess.Popen(
            words, cwd=folder, env=environment, stdin=slave, stdout=slave, stderr=slave,
            start_new_session=True,
        )
        os.close(slave)

    def watch(self, until: str | None = None) -> Watched:
        """Read until the command has printed a text, or until it has ended.

        Raises:
            RuntimeError: the command failed, or ended without the text.
        """
        seen = Watched()
        last_s = self._start_s
        for text in self._texts():
            now_s = time.monotonic()
            if not seen.output:
                seen.first_s = now_s - self._start_s
            elif now_s - last_s > seen.silence_s:
                seen.silence_s, seen.before = now_s - last_s, _last_line(seen.output)
            last_s = now_s
            seen.output += text
            if until is not None and re.search(rf'\b{until}\b', seen.output):
                break
        else:
            if self.process.wait() != 0 or until is not None:
                raise RuntimeError(f'{" ".join(self._words)} failed: {seen.output[-2000:]}')
        seen.took_s = time.monotonic() - self._start_s
        return seen

    def interrupt(self) -> None:
        """Press Ctrl-C, and wait for the end of the command."""
        os.killpg(self.process.pid, signal.SIGINT)
        deadline_s = time.monotonic() + END_S
        while self.process.poll() is None and time.monotonic() < deadline_s:
            self._read(0.1)
        if self.process.poll() is None:
            os.killpg(self.process.pid, signal.SIGKILL)
            self.process.wait()

    def _texts(self) -> Iterator[str]:
        """Yield the output, and an empty text at the end of the command."""
        while (data := self._read(None)) is not None:
            yield data
        yield ''

    def _read(self, timeout_s: float | None) -> str | None:
        """Return what was printed, '' after the timeout, None after the end of the command."""
        if not select.select([self._master], [], [], timeout_s)[0]:
            return ''
        try:
            return os.read(self._master, 65536).decode('utf-8', 'replace') or None
        except OSError:  # no process has the terminal open any more
            return None


def _last_line(output: str) -> str:
    lines = [line.strip() for line in re.split(r'[\r\n]', re.sub(r'\x1b\[[0-9;?]*\w', '', output))]
    return next((line for line in reversed(lines) if line), '')


def cloned(folder: Path, virtual_environment: Path | None) -> tuple[Path, dict[str, str]]:
    """Clone this repository, and return the clone and the environment variables of its commands.

    Args:
        folder: an empty folder.
        virtual_environment: links to its files take the place of the installation; None for none.
    """
    clone = folder / 'ratslam_ros'
    subprocess.run(['git', 'clone', '--quiet', str(ROOT), str(clone)], check=True)
    variables = {
        **os.environ, 'TERM': 'xterm', 'ROS_DOMAIN_ID': '102',
        'ROS_AUTOMATIC_DISCOVERY_RANGE': 'LOCALHOST',
    }
    for name in ('PYTHONDONTWRITEBYTECODE', 'PYTHONUNBUFFERED', 'PYTHONPATH', 'NUMBA_CACHE_DIR'):
        variables.pop(name, None)
    if virtual_environment is not None:
        (clone / '.venv').mkdir()
        for path in virtual_environment.resolve().iterdir():
            if not path.name.startswith('.'):
                (clone / '.venv' / path.name).symlink_to(path)
        (clone / '.venv/.installed').touch()
        variables['PYTHONPATH'] = str(clone)
    return clone, variables


def measured(
    name: str, clone: Path, variables: dict[str, str], recording: str
) -> Iterator[tuple[str, Watched]]:
    """Run the commands of a row; yield each as a user types it, and its output over time."""

    def started(*words: str) -> Terminal:
        program = str(clone / '.venv/bin' / words[0]) if words[0] == 'ratslam' else words[0]
        return Terminal([program, *words[1:]], clone, variables)

    if name in ('demo-first', 'demo-warm'):
        yield f'`make demo`, {name.removeprefix("demo-")}', started('make', 'demo').watch()
    elif name == 'demo':
        yield '`ratslam demo`', started('ratslam', 'demo').watch()
    elif name == 'help':
        yield '`ratslam --help`', started('ratslam', '--help').watch()
    elif name == 'replay':
        yield '`ratslam replay RECORDING`', started('ratslam', 'replay', recording).watch()
    else:
        nodes = started('ratslam', 'launch')
        try:
            player = started('ratslam', 'play', recording, '--rate', '2', '--duration', '60')
            with ThreadPoolExecutor(1) as pool:
                played = pool.submit(player.watch)
                yield '`ratslam launch`, until it is ready', nodes.watch(READY)
                yield '`ratslam play RECORDING --rate 2 --duration 60`', played.result()
        finally:
            nodes.interrupt()


def main() -> int:
    parser = argparse.ArgumentParser(description='The first commands of a new user.')
    parser.add_argument('--only', nargs='+', choices=ROWS, default=ROWS, help='rows to measure')
    parser.add_argument('--environment', type=Path, metavar='FOLDER',
                        help='a virtual environment with all packages, against an installation')
    parser.add_argument('--recording', type=Path, metavar='PATH',
                        help='for replay and live (default: that of the demo, which then runs)')
    options = parser.parse_args()
    names = [name for name in ROWS if name in options.only]
    recording = RECORDING if options.recording is None else str(options.recording.resolve())
    needs_demo = options.recording is None and {'replay', 'live'} & {*names}
    with tempfile.TemporaryDirectory() as folder:
        clone, variables = cloned(Path(folder), options.environment)
        print('| command | time | first output | longest silence | after the line |')
        print('| --- | --- | --- | --- | --- |', flush=True)
        if 'demo-first' not in names and ({'demo-warm', 'demo'} & {*names} or needs_demo):
            list(measured('demo-first', clone, variables, recording))
        elif options.environment is None and 'demo-first' not in names:
            Terminal(['make', '.venv/.installed'], clone, variables).watch()
        for name in names:
            with contextlib.closing(measured(name, clone, variables, recording)) as rows:
                for command, seen in rows:
                    print(f'| {command} | {seen.took_s:.1f} s | {seen.first_s:.2f} s | '
                          f'{seen.silence_s:.1f} s | {seen.before[:60]} |', flush=True)
    return 0


if __name__ == '__main__':
    sys.exit(main())
