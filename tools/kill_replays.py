# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Kill replays that keep their map in a file, start them again, and compare the final maps.

usage: python tools/kill_replays.py RECORDING [--kills 200] [--seed 1] [--config FILE|PRESET]
           [--duration S] [--period S]

Half of the kills (SIGKILL) come at random times, half at named points of the program: before and
after the statements of the writer, when the file is created, and when it is closed. A replay is
killed several times before it may end. Then its map.json and the digest of all states must equal
those of a replay that was never disturbed. What is acknowledged as saved is written to a pipe, so
that the surviving process can check that no restart falls behind it.
"""

from __future__ import annotations

import argparse
import multiprocessing
import os
import random
import shutil
import signal
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass, field
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any

from ratslam_ros.core.config import Config
from ratslam_ros.core.warm_up import warm_up
from ratslam_ros.files.config import load_config
from ratslam_ros.maps import file_writer, locks, read_map, schema, store
from ratslam_ros.offline import replay_map
from ratslam_ros.offline.replay import ReplayOptions, replay
from ratslam_ros.recordings import open_recording

STATEMENTS = {
    'a session begins': 'INSERT INTO sessions',
    'a transaction begins': 'BEGIN IMMEDIATE',
    'a chunk is written': 'INSERT INTO chunks',
    'a cut is written': 'INSERT INTO cuts',
    'an old cut is removed': 'DELETE FROM cuts',
    'an old chunk is removed': 'DELETE FROM chunks',
    'a transaction ends': 'COMMIT',
    'the session ends': 'UPDATE members',
}
"""Points before the execution of a statement: name, and how the statement begins."""

CALLS: dict[str, tuple[Any, str, bool]] = {
    'the new file gets its name': (os, 'link', False),
    'the new file has its name': (schema, 'sync_folder', False),
    'a cut is handed over': (store.MapStore, 'cut', False),
    'a cut is durable': (file_writer.FileWriter, 'write', True),
    'the lock is removed': (locks.MapLock, 'remove', False),
    'all is closed': (file_writer.FileWriter, 'close', True),
}
"""Points at a call: name, where the function is, its name, and whether it is after the call."""

POINTS = (*STATEMENTS, *CALLS)
CREATION = 'the new file gets its name', 'the new file has its name'
ONCE = (*CREATION, 'a session begins', 'the session ends', 'the lock is removed', 'all is closed')
"""Points that a replay passes only once; those of the creation only if there is no file."""

RANDOM = 'random time'


@dataclass(frozen=True)
class Job:
    """A replay: recording, configuration, length in s, and its time between two cuts."""

    recording: Path
    config: Config
    duration_s: float | None
    period_s: float
    landmarks: bool = False


@dataclass
class Tally:
    """Result of all kills."""

    kills: Counter[str] = field(default_factory=Counter)
    missed: Counter[str] = field(default_factory=Counter)
    """Replays that ended before the point at which they would have been killed."""
    maps: int = 0
    identical: int = 0
    behind: int = 0
    """Restarts from an older state than the newest acknowledged one."""
    failures: list[str] = field(default_factory=list)

    def table(self) -> str:
        """Return the result as a table."""
        lines = [f'{"killed when":30} kills  survived']
        for name in (RANDOM, *POINTS):
            lines.append(f'{name:30} {self.kills[name]:5}  {self.missed[name]:8}')
        lines += [
            f'{"all":30} {self.kills.total():5}  {self.missed.total():8}',
            f'maps: {self.maps}, of them identical to the undisturbed one: {self.identical}',
            f'restarts behind an acknowledged state: {self.behind}',
            *self.failures,
        ]
        return '\n'.join(lines)


def run(job: Job, folder: Path, pipe: Connection, point: str, count: int) -> None:
    """Replay in a child process, which is killed at a point when it is passed for the n-th time.

    Args:
        job: the replay.
        folder: for the map and the results.
        pipe: receives the number of messages of the restored state and of each acknowledged one.
        point: one of ``POINTS``, '' for none.
        count: n.
    """
    os.setsid()
    replay_map.CUT_PERIOD_S = job.period_s
    left = [count]

    def passed() -> None:
        left[0] -= 1
        if left[0] == 0:
            os.kill(os.getpid(), signal.SIGKILL)

    if point in STATEMENTS:
        _watch_statements(STATEMENTS[point], passed)
    elif point:
        _watch_calls(*CALLS[point], passed)
    write = file_writer.FileWriter.write

    def acknowledged(writer: Any, cut: Any, states: Any) -> None:
        write(writer, cut, states)
        progress = states['inputs'][replay_map.PROGRESS]
        pipe.send(('saved', sum(progress['counts'].values())))

    file_writer.FileWriter.write = acknowledged  # type: ignore[method-assign]
    map_file = replay_map.ReplayMap(folder / 'a.map', False, lambda line: None, _report)
    options = ReplayOptions(
        0.0, job.duration_s, None, progress=False, landmarks=job.landmarks, map_file=map_file
    )
    begin = map_file.open

    def opened(*args: Any) -> None:
        begin(*args)
        pipe.send(('restored', sum(map_file._counts.values())))

    map_file.open = opened  # type: ignore[method-assign]
    with open_recording(job.recording) as recording:
        selection = recording.select(
            scans=job.config.experience_map.exp_align_scans or job.landmarks
        )
        replay(recording, selection, job.config, folder / 'results', options)


def _report(line: str) -> None:
    print(line, file=sys.stderr, flush=True)


def _watch_statements(begin: str, passed: Callable[[], None]) -> None:
    connect = schema.connect

    def traced(*args: Any) -> Any:
        database = connect(*args)
        database.set_trace_callback(lambda sql: passed() if sql.startswith(begin) else None)
        return database

    file_writer.connect = schema.connect = traced  # type: ignore[assignment]


def _watch_calls(owner: Any, name: str, after: bool, passed: Callable[[], None]) -> None:
    function = getattr(owner, name)

    def watched(*args: Any, **kwargs: Any) -> Any:
        if not after:
            passed()
        result = function(*args, **kwargs)
        if after:
            passed()
        return result

    setattr(owner, name, watched)
    if owner is schema:
        setattr(file_writer, name, watched)


def attempt(
    job: Job, folder: Path, point: str = '', count: int = 1, after_s: float | None = None
) -> tuple[int, int | None, int]:
    """Replay once, perhaps killed; return exit code, messages restored, and messages saved.

    The number of restored messages is None if the process was killed before it had restored them.
    """
    context = multiprocessing.get_context('fork')  # The inner loops are compiled already.
    receiver, sender = context.Pipe(duplex=False)
    process = context.Process(target=run, args=(job, folder, sender, point, count))
    process.start()
    sender.close()
    restored: int | None = None
    saved = 0
    end_s = None if after_s is None else time.monotonic() + after_s
    while True:
        left_s = None if end_s is None else max(end_s - time.monotonic(), 0.0)
        if not receiver.poll(left_s):
            end_s = None
            process.kill()
            continue
        try:
            kind, number = receiver.recv()
        except EOFError:
            break
        restored, saved = (number, saved) if kind == 'restored' else (restored, number)
    process.join()
    assert process.exitcode is not None
    return process.exitcode, restored, saved


def result_of(folder: Path) -> tuple[bytes, str]:
    """Return the map and the digest of all states of a finished replay."""
    return (folder / 'results' / 'map.json').read_bytes(), read_map(folder / 'a.map').digest


def kill_replays(
    job: Job, kills: int, seed: int, folder: Path, log: Callable[[str], None] = lambda line: None,
    per_map: int = 4,
) -> Tally:
    """Kill replays until the given number of kills is reached, and compare all final maps.

    Args:
        job: the replay.
        kills: number of kills, half of them at random times.
        seed: of the random times and points.
        folder: for temporary files.
        log: receives the progress.
        per_map: number of kills of one replay before it may end.

    Raises:
        RuntimeError: the undisturbed replay fails.
    """
    begin_s = time.monotonic()
    if attempt(job, folder / 'undisturbed')[0] != 0:
        raise RuntimeError('the undisturbed replay fails')
    length_s = time.monotonic() - begin_s
    expected = result_of(folder / 'undisturbed')
    rng, tally = random.Random(seed), Tally()
    while tally.kills.total() < kills:
        place = folder / f'map_{tally.maps}'
        known = 0
        for _ in range(per_map):
            if tally.missed.total() > 10 * kills:
                raise RuntimeError('most replays end before they are killed; use a longer one')
            by_time = rng.random() < 0.5
            exists = (place / 'a.map').exists()
            point = '' if by_time else rng.choice(
                [name for name in POINTS if not (exists and name in CREATION)]
            )
            after_s = rng.uniform(0.0, length_s) if by_time else None
            count = 1 if point in ONCE else rng.choice((1, 2, 5))
            code, restored, saved = attempt(job, place, point, count, after_s)
            name = RANDOM if by_time else point
            if code == -signal.SIGKILL:
                tally.kills[name] += 1
            elif code == 0:
                tally.missed[name] += 1
            else:
                tally.failures.append(f'exit code {code} after a kill ({name})')
            tally.behind += restored is not None and restored < known
            known = max(known, restored or 0, saved)
            if tally.kills.total() >= kills:
                break
        code, restored, _ = attempt(job, place)
        tally.behind += restored is None or restored < known
        tally.maps += 1
        if code == 0 and result_of(place) == expected:
            tally.identical += 1
        else:
            tally.failures.append(f'map {tally.maps} of seed {seed} differs (exit code {code})')
        shutil.rmtree(place)
        log(f'{tally.kills.total()} kills, {tally.maps} maps, {tally.identical} identical')
    return tally


def main() -> int:
    """Run the experiment and print a table; return 1 if a map differs."""
    parser = argparse.ArgumentParser(description=__doc__.split('\n', 1)[0])
    parser.add_argument('recording', type=Path)
    parser.add_argument('--kills', type=int, default=200)
    parser.add_argument('--seed', type=int, default=1)
    parser.add_argument('--config', metavar='FILE|PRESET', help='default: the defaults')
    parser.add_argument('--duration', type=float, help='seconds of the recording to replay')
    parser.add_argument('--period', type=float, default=0.1, help='time between two cuts, in s')
    parser.add_argument('--landmarks', action='store_true', help='map landmarks, too')
    options = parser.parse_args()
    warm_up()
    job = Job(
        options.recording, load_config(options.config)[0], options.duration, options.period,
        options.landmarks,
    )
    with tempfile.TemporaryDirectory(prefix='kills-') as folder:
        tally = kill_replays(
            job, options.kills, options.seed, Path(folder),
            lambda line: print(line, file=sys.stderr, flush=True),
        )
    print(tally.table())
    return 0 if tally.identical == tally.maps and not tally.behind else 1


if __name__ == '__main__':
    sys.exit(main())
