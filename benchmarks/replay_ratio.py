# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Processor time of a replay, relative to that of an earlier commit.

    python benchmarks/replay_ratio.py COMMIT [--data FOLDER | --recording PATH] [--preset rc_car]
                                      [--pairs 3] [--no-history]

COMMIT is written to a temporary folder. The working tree and COMMIT then replay the recording in
turn, as commands of their own: a pair is one replay of each, and every other pair begins with
COMMIT. A ratio is the processor time of the working tree divided by that of COMMIT, of all threads
of the process, with its start and its garbage collection. Both compile into caches of their own
first, which is not counted. `start` is a replay of the first second; its median is subtracted for
the ratio `without start`, which is less exact.

Pairs are measured without history, then with one unless --no-history is given. A COMMIT that can
write none is compared without one both times.
"""

from __future__ import annotations

import argparse
import os
import statistics
import subprocess
import sys
import tempfile
from dataclasses import dataclass
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
sys.path[:0] = [str(ROOT / 'tools')]

from same_results import PACKAGE, Version, extract_commit  # noqa: E402 - beside ROOT

START = '--duration', '1'
"""Options of a replay whose processor time is that of a start."""


@dataclass(frozen=True)
class Replays:
    """Replays of one recording with one version of the program."""

    version: Version
    recording: Path
    preset: str
    has_history: bool

    @classmethod
    def of(cls, name: str, tree: Path, folder: Path, recording: Path, preset: str) -> Replays:
        """Return the replays of the program in a folder, compiled."""
        work = folder / name
        work.mkdir()
        version = Version(name, tree, work, work, recording.parent, work / 'compiled')
        version.check_import()
        help_text = subprocess.run(
            [sys.executable, '-m', PACKAGE, 'replay', '--help'], env=version.environment(),
            cwd=work, capture_output=True, text=True, check=True,
        ).stdout
        found = cls(version, recording, preset, '--no-history' in help_text)
        for with_history in (False, True):
            found.processor_s(with_history)
        return found

    def processor_s(self, with_history: bool, *options: str) -> float:
        """Replay in a process of its own; return its processor time in s."""
        words = ['replay', str(self.recording), '--config', self.preset, '--quiet', *options]
        if self.has_history and not with_history:
            words.append('--no-history')
        with (
            tempfile.TemporaryDirectory(dir=self.version.outputs) as folder,
            tempfile.TemporaryFile() as log,
        ):
            words += ['--out', f'{folder}/results']
            process = subprocess.Popen(
                [sys.executable, '-m', PACKAGE, *words], env=self.version.environment(),
                cwd=folder, stdin=subprocess.DEVNULL, stdout=log, stderr=log,
            )
            _, status, used = os.wait4(process.pid, 0)
            process.returncode = os.waitstatus_to_exitcode(status)
            if process.returncode:
                log.seek(0)
                text = log.read().decode(errors='replace')
                sys.exit(f'{self.version.name}: ratslam {" ".join(words)}: {text[-2000:]}')
        return used.ru_utime + used.ru_stime


def measure(now: Replays, before: Replays, with_history: bool, pairs: int) -> None:
    """Print the ratio of each pair, their median and range."""
    starts_s = [
        statistics.median(one.processor_s(with_history, *START) for _ in range(3))
        for one in (now, before)
    ]
    ratios, replay_ratios = [], []
    for number in range(pairs):
        order = (now, before) if number % 2 == 0 else (before, now)
        times_s = {one: one.processor_s(with_history) for one in order}
        ratios.append(times_s[now] / times_s[before])
        own_s = [times_s[now] - starts_s[0], times_s[before] - starts_s[1]]
        replay_ratios.append(own_s[0] / own_s[1])
        print(
            f'  pair {number + 1}: {times_s[now]:.2f} s / {times_s[before]:.2f} s = '
            f'{ratios[-1]:.3f}, without start {replay_ratios[-1]:.3f}', flush=True,
        )
    print(f'  start: {starts_s[0]:.2f} s / {starts_s[1]:.2f} s')
    for name, found in (('ratio', ratios), ('without start', replay_ratios)):
        print(
            f'  {name}: median {statistics.median(found):.3f}, '
            f'{min(found):.3f} to {max(found):.3f}', flush=True,
        )


def main() -> None:
    """Measure, and print the ratios."""
    parser = argparse.ArgumentParser(
        description='Measure the processor time of a replay, relative to an earlier commit.'
    )
    parser.add_argument('commit')
    parser.add_argument('--data', type=Path, default=ROOT.parent / 'shared' / 'data')
    parser.add_argument('--recording', type=Path, help='default: rc_car_loops in --data')
    parser.add_argument('--preset', default='rc_car')
    parser.add_argument('--pairs', type=int, default=3)
    parser.add_argument('--no-history', action='store_true')
    options = parser.parse_args()
    recording = (options.recording or options.data / 'rc_car_loops').resolve()
    if not recording.exists():
        sys.exit(f'{recording} does not exist; name the folder of the recordings with --data')
    with tempfile.TemporaryDirectory() as temporary:
        folder = Path(temporary)
        extract_commit(options.commit, ROOT, folder / 'tree')
        now, before = (
            Replays.of(name, tree, folder, recording, options.preset)
            for name, tree in (('now', ROOT), ('before', folder / 'tree'))
        )
        print(f'{recording.name}, {options.preset}: working tree / {options.commit}')
        for with_history in (False,) if options.no_history else (False, True):
            print('with history' if with_history else 'without history')
            if with_history and not before.has_history:
                print(f'  {options.commit} writes none')
            measure(now, before, with_history, options.pairs)


if __name__ == '__main__':
    main()
