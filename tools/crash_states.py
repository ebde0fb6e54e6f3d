#!/usr/bin/env python3
# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Check that a map survives every crash and every failure of the disk.

A recording file system below SQLite (apsw) notes every write, sync, truncation and change of names
while maps are created, written, merged by two writers, closed and replaced. From these records,
the tool reconstructs the files that a power failure could leave: unsynced writes are dropped,
reordered, and torn at 512 bytes, and names appear or not. Every reconstructed map has to open, as
the state before or after the operation that was interrupted. Then the n-th write, sync, open,
deletion and so on fails, for n = 1, 2, ... until the operations succeed.

    tools/crash_states.py --states 0 --failures 0     all of a small map (0: no limit)
    tools/crash_states.py --large 1000                and 1,000 random states of a large map
"""

from __future__ import annotations

import argparse
import random
import shutil
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from contextlib import suppress
from dataclasses import dataclass, field
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))
sys.path.insert(0, str(Path(__file__).resolve().parent))

from recording_disk import CODES, Database, Disk, crash_states, recording

from ratslam_ros.errors import UnusableInput
from ratslam_ros.maps import Cut, MapMeta, read_map, saving, schema
from ratslam_ros.maps.file_writer import FileWriter
from ratslam_ros.maps.reader import saved_map

MISSING = 'no file'


# What is done to a map


@dataclass
class Progress:
    """States of a map after each step, with the number of operations until then."""

    path: Path
    disk: Disk
    results: list[tuple[int, str]] = field(default_factory=list)

    def done(self) -> None:
        """Note that a step has succeeded: its result is durable."""
        if self.path.exists():
            # A connection to a map without a log would create one.
            has_log = schema.beside(self.path, schema.WAL).exists()
            options = 'mode=ro' if has_log else 'mode=ro&immutable=1'
            database: Any = Database(self.path, options, vfs='unix')
            digest = saved_map(database, self.path).digest
            database.close()
        else:
            digest = MISSING
        self.results.append((len(self.disk.operations), digest))

    def allowed(self, at: int) -> set[str]:
        """Return the states that a crash after a number of operations may leave."""
        before = [digest for count, digest in self.results if count <= at]
        after = [digest for count, digest in self.results if count > at]
        return {*(before[-1:] or [MISSING]), *after[:1]}


Step = Callable[[], None]


class Work:
    """Steps of two writers of one map, each of which may be repeated after a failure."""

    def __init__(self, path: Path, rows: int, cuts: int, seed: int, disk: Disk) -> None:
        self.path, self._disk = path, disk
        self._writers: dict[str, FileWriter] = {}
        self._generator = np.random.default_rng(seed)
        self._rows, self._cuts = rows, cuts
        self._state = self._new_state()

    def steps(self) -> Iterator[Step]:
        """Yield all steps, each to be called until it succeeds."""
        meta = MapMeta('crash', configuration='a: 1\n')
        first, second = 'local_view', 'pose_cells'
        number = 0
        for session in range(2):
            yield lambda: self._open(first, meta)
            yield lambda: self._open(second, meta)
            for _ in range(self._cuts):
                number += 1
                cut, state = Cut(number, number * 10), self._changed()
                yield lambda cut=cut, state=state: self._write(first, cut, state)
                yield lambda cut=cut, state=state: self._write(second, cut, {'n': cut.number})
            yield lambda: self._close(second)
            if session == 0:
                yield lambda: self._close(first)
        yield lambda: self._kill(first)
        yield lambda: saving.save_map(self.path, {first: self._state}, meta, Cut(1, 10))

    def end(self) -> None:
        """Release what is open."""
        for writer in self._writers.values():
            writer.release()

    def _open(self, part: str, meta: MapMeta) -> None:
        self._writers[part] = FileWriter(self.path, (part,), meta)

    def _write(self, part: str, cut: Cut, state: dict[str, Any]) -> None:
        self._writers[part].write(cut, {part: state})

    def _close(self, part: str) -> None:
        self._writers.pop(part).close(complete=True)

    def _kill(self, part: str) -> None:
        """End a writer as if it were killed: the log stays."""
        log = schema.beside(self.path, schema.WAL)
        content = log.read_bytes() if log.exists() else b''
        if part in self._writers:
            self._writers.pop(part).release()
            log.write_bytes(content)
            self._disk.note('put', log.name, content)

    def _new_state(self) -> dict[str, Any]:
        ends = self._generator.integers(0, 100, (self._rows, 2))
        return {'ends': ends, 'poses': self._generator.random((self._rows, 3)), 'name': 'a'}

    def _changed(self) -> dict[str, Any]:
        """Return a state with some changed and some more rows."""
        state = self._state
        poses = np.vstack([state['poses'], self._generator.random((self._rows // 8 + 1, 3))])
        poses[self._generator.integers(0, len(poses), 3)] += 1
        self._state = {**state, 'poses': poses, 'name': state['name'] + 'b'}
        return self._state


def check_crashes(
    rows: int, cuts: int, limit: int, seed: int, scratch: Path
) -> tuple[int, int, list[str]]:
    """Return the numbers of operations and of checked states, and what is wrong with states."""
    folder = scratch / 'written'
    folder.mkdir()
    disk = Disk(folder)
    progress = Progress(folder / 'crash.map', disk)
    work = Work(progress.path, rows, cuts, seed, disk)
    with recording(disk):
        progress.done()
        for step in work.steps():
            step()
            progress.done()
        work.end()
    problems, count = [], 0
    left = scratch / 'left'
    for at, variant, files in crash_states(disk.operations, random.Random(seed), limit):
        count += 1
        shutil.rmtree(left, ignore_errors=True)
        left.mkdir()
        for name, content in files.items():
            (left / name).write_bytes(content)
        found = _found(left / 'crash.map')
        if found in progress.allowed(at) and count % 7 == 0:
            found = _continued(left / 'crash.map', found)
        if found not in progress.allowed(at):
            operation = disk.operations[at - 1][:3] if at else 'nothing'
            problems.append(f'crash after operation {at} {operation}, {variant}: {found}')
    return len(disk.operations), count, problems


def check_failures(
    failure: str, fails_for: int, limit: int, seed: int, scratch: Path
) -> tuple[int, list[str]]:
    """Let one call after the other fail; return their number, and what is wrong afterwards."""
    problems: list[str] = []
    total = _fail_at(0, 1, failure, scratch, problems)
    numbers = list(range(1, total + 1))
    if limit and limit < total:
        numbers = sorted(random.Random(seed).sample(numbers, limit))
    for number in numbers:
        _fail_at(number, fails_for, failure, scratch, problems)
    return len(numbers), problems


def _fail_at(number: int, fails_for: int, failure: str, scratch: Path, problems: list[str]) -> int:
    """Do all steps while a call fails; return the number of calls."""
    folder, copy = scratch / 'failing', scratch / 'copy'
    shutil.rmtree(folder, ignore_errors=True)
    folder.mkdir()
    disk = Disk(folder, fails_at=number, fails_for=fails_for, failure=failure)
    path = folder / 'crash.map'
    work = Work(path, 40, 2, 1, disk)
    with recording(disk):
        before = MISSING
        for n, step in enumerate(work.steps()):
            states = set()
            for _ in range(fails_for + 2):
                try:
                    step()
                except UnusableInput:
                    states.add(_found_copy(path, copy))
                    continue
                break
            else:
                problems.append(f'{failure} at call {number}: step {n} never succeeds')
                break
            after = _found_copy(path, copy)
            if not states <= {before, after}:
                problems.append(f'{failure} at call {number}, step {n}: {states}')
            before = after
        with suppress(Exception):
            work.end()
        if before != _reference(scratch):
            problems.append(f'{failure} at call {number}: the map ends as {before}')
    return disk.calls


@cache
def _reference(scratch: Path) -> str:
    """Return the state after all steps of ``_fail_at`` without a failure."""
    folder = scratch / 'reference'
    folder.mkdir()
    work = Work(folder / 'crash.map', 40, 2, 1, Disk(folder))
    for step in work.steps():
        step()
    work.end()
    return _found(folder / 'crash.map')


def _found_copy(path: Path, copy: Path) -> str:
    """Return the state of a map from a copy, as after a crash."""
    shutil.rmtree(copy, ignore_errors=True)
    copy.mkdir()
    for suffix in ('', schema.WAL):
        with suppress(FileNotFoundError):
            shutil.copyfile(schema.beside(path, suffix), copy / (path.name + suffix))
    return _found(copy / path.name)


def _found(path: Path) -> str:
    """Return the state of a map, or why it does not open."""
    if not path.exists():
        return MISSING
    try:
        return read_map(path).digest
    except UnusableInput as error:
        return str(error)


def _continued(path: Path, before: str) -> str:
    """Return the state if a map can be continued, else what is wrong."""
    try:
        writer = FileWriter(path, ('local_view', 'pose_cells'), MapMeta())
        restored = writer.restored
        found = MISSING if before == MISSING else before
        if before != MISSING and restored is not None and restored.digest != before:
            found = f'restored {restored.digest}'
        state = {'local_view': {'a': np.arange(2000)}, 'pose_cells': {'a': 1}}
        writer.write(Cut(1000, 10_000), state)
        writer.close(complete=True)
        again = read_map(path)
        if again.states['pose_cells'] != {'a': 1} or list(path.parent.glob('*-wal')):
            return 'it cannot be continued'
        return found
    except UnusableInput as error:
        return str(error)


def main() -> int:
    """Run the checks; return the exit code."""
    parser = argparse.ArgumentParser(description=__doc__.split('\n\n')[0])
    parser.add_argument('--states', type=int, default=0, help='states of a small map; 0: all')
    parser.add_argument('--failures', type=int, default=0, help='failing calls; 0: all')
    parser.add_argument('--large', type=int, default=0, help='random states of a large map')
    parser.add_argument('--seed', type=int, default=1)
    arguments = parser.parse_args()
    if Path('/dev/shm').is_dir():
        tempfile.tempdir = '/dev/shm'
    problems: list[str] = []

    def run(title: str, check: Callable[[Path], tuple[Any, ...]]) -> None:
        start = time.monotonic()
        with tempfile.TemporaryDirectory() as scratch:
            *counts, found = check(Path(scratch))
        problems.extend(found)
        seconds = time.monotonic() - start
        print(f'{title}: {counts}, {len(found)} wrong, {seconds:.0f} s', flush=True)

    seed = arguments.seed
    run('small map: operations, states',
        lambda scratch: check_crashes(40, 3, arguments.states, seed, scratch))
    if arguments.large:
        run('large map: operations, states',
            lambda scratch: check_crashes(20_000, 4, arguments.large, seed, scratch))
    for failure in CODES:
        for fails_for in (1, 4):
            run(f'{failure}, {fails_for} calls in a row: failing calls',
                lambda scratch, failure=failure, fails_for=fails_for: check_failures(
                    failure, fails_for, arguments.failures, seed, scratch))
    for problem in problems[:20]:
        print(problem)
    return 1 if problems else 0


if __name__ == '__main__':
    sys.exit(main())
