# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Running nodes of one version and an observer of their topics, for same_results.py."""

from __future__ import annotations

import json
import os
import queue
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import IO, Any, Self

OBSERVER = Path(__file__).with_name('topic_observer.py')
READY_TIMEOUT_S = 120.0
ANSWER_TIMEOUT_S = 60.0
STOP_TIMEOUT_S = 40.0
POLL_S = 0.05
FIRST_DOMAIN, DOMAIN_COUNT = 1, 100

_domains = iter(range(10**9))


class LiveError(Exception):
    """Nodes or the observer did not start, answer or end."""


def new_domain() -> int:
    """Return a domain that other sessions of this process and, mostly, of others do not use."""
    return FIRST_DOMAIN + (7 * os.getpid() + next(_domains)) % DOMAIN_COUNT


class LiveSession:
    """Processes of one version in a ROS domain of their own; all are ended at exit."""

    def __init__(self, entry: str, environment: Mapping[str, str], folder: Path) -> None:
        self._entry = entry
        self._environment = {
            **environment, 'ROS_DOMAIN_ID': str(new_domain()),
            'ROS_AUTOMATIC_DISCOVERY_RANGE': 'LOCALHOST',
        }
        self._folder = folder
        self._processes: dict[str, subprocess.Popen[str]] = {}
        self._observer: Observer | None = None

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        if self._observer is not None:
            self._observer.kill()
        for process in self._processes.values():
            process.terminate()  # `launch` then ends its nodes
            try:
                process.wait(STOP_TIMEOUT_S)
            except subprocess.TimeoutExpired:
                process.kill()
                process.wait()

    def start(self, name: str, *arguments: str | Path, ready: int = 1) -> None:
        """Start a command and wait until a number of its nodes have logged that they are ready."""
        log = self._folder / f'{name}.log'
        with log.open('w') as file:
            process = self._processes[name] = subprocess.Popen(
                self._command(arguments), env=self._environment, cwd=self._folder, stdout=file,
                stderr=subprocess.STDOUT, stdin=subprocess.DEVNULL, text=True,
            )
        end_s = time.monotonic() + READY_TIMEOUT_S
        while log.read_text().count('ready') < ready:
            if process.poll() is not None or time.monotonic() > end_s:
                raise LiveError(f'{name} is not ready: {log.read_text()[-2000:]}')
            time.sleep(POLL_S)

    def stop(self, name: str) -> int:
        """Interrupt a command; return its exit code."""
        process = self._processes.pop(name)
        process.send_signal(signal.SIGINT)
        try:
            return process.wait(STOP_TIMEOUT_S)
        except subprocess.TimeoutExpired:
            process.kill()
            raise LiveError(f'{name} did not end within {STOP_TIMEOUT_S:.0f} s') from None

    def ratslam(self, *arguments: str | Path) -> str:
        """Run a command beside the nodes that must succeed; return what it prints."""
        done = subprocess.run(
            self._command(arguments), env=self._environment, cwd=self._folder,
            capture_output=True, text=True, timeout=READY_TIMEOUT_S, check=False,
            stdin=subprocess.DEVNULL,
        )
        if done.returncode:
            words = ' '.join(map(str, arguments))
            raise LiveError(f'ratslam {words}: exit code {done.returncode}\n{done.stderr[-2000:]}')
        return done.stdout

    def call(self, service: str, kind: str, request: str = '') -> str:
        """Call a service; return its answer as YAML."""
        return self.ratslam('call', service, kind, request, '--timeout', '30')

    def play(self, recording: Path, *arguments: str) -> None:
        """Play a recording as fast as the nodes can follow."""
        self.ratslam('play', recording, '--lockstep', '--rate', '0', '--quiet', *arguments)

    def observe(self, *arguments: str) -> Observer:
        """Start an observer of the nodes."""
        self._observer = Observer(self._environment, self._folder, arguments)
        return self._observer

    def _command(self, arguments: Sequence[str | Path]) -> list[str]:
        return [sys.executable, '-c', self._entry, *map(str, arguments)]


class Observer:
    """The process that records topics; see topic_observer.py."""

    def __init__(
        self, environment: Mapping[str, str], folder: Path, arguments: Sequence[str]
    ) -> None:
        self._output = folder / 'observed.jsonl'
        self._output.unlink(missing_ok=True)
        self._errors = folder / 'observer.log'
        with self._errors.open('w') as errors:
            self._process = subprocess.Popen(
                [sys.executable, str(OBSERVER), str(self._output), *arguments],
                env=dict(environment), stdin=subprocess.PIPE, stdout=subprocess.PIPE,
                stderr=errors, text=True,
            )
        self._lines: queue.Queue[str] = queue.Queue()
        threading.Thread(target=self._forward, args=(self._process.stdout,), daemon=True).start()
        self._answer()

    def publish(self, topic: str, text: str) -> None:
        """Publish a text on a topic."""
        self._ask({'do': 'publish', 'topic': topic, 'data': text})

    def endpoints(self) -> list[str]:
        """Return a line for each publisher and subscriber."""
        found = self._ask({'do': 'endpoints'})
        assert isinstance(found, list)
        return found

    def received(self) -> dict[str, list[str]]:
        """Return the messages received until now, by topic."""
        found: dict[str, list[str]] = {}
        text = self._output.read_text(encoding='utf-8') if self._output.exists() else ''
        for line in text.split('\n')[:-1]:
            message = json.loads(line)
            found.setdefault(message['topic'], []).append(message['data'])
        return found

    def last(self, topic: str) -> str:
        """Return the last message of a topic, '' if there is none."""
        return self.received().get(topic, [''])[-1]

    def end(self) -> dict[str, list[str]]:
        """End the observer; return all that it received, by topic."""
        self._ask({'do': 'end'})
        self._process.wait(STOP_TIMEOUT_S)
        return self.received()

    def kill(self) -> None:
        """End the process at once if it is still running."""
        if self._process.poll() is None:
            self._process.kill()
        self._process.wait()

    def _ask(self, command: dict[str, str]) -> Any:
        assert self._process.stdin is not None
        self._process.stdin.write(json.dumps(command) + '\n')
        self._process.stdin.flush()
        return self._answer()

    def _answer(self) -> Any:
        try:
            line = self._lines.get(timeout=ANSWER_TIMEOUT_S)
        except queue.Empty:
            line = ''
        if not line:
            raise LiveError(f'the observer gave no answer: {self._errors.read_text()[-2000:]}')
        return json.loads(line)

    def _forward(self, stream: IO[str]) -> None:
        for line in stream:
            self._lines.put(line)
        self._lines.put('')
