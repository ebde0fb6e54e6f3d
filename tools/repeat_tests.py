# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Runs the tests that start nodes and processes again and again, and counts the runs that pass.

    python tools/repeat_tests.py --runs 20 --load 2 --results repeat.tsv
    python tools/repeat_tests.py --runs 5 --results repeat.tsv test/live/test_launch.py

It uses the rclpy that is installed, else the stand-in for it. The results have a line for each run
and can be continued: a run is added until the file has ``--runs`` of them for this code, rclpy and
these tests. The exit code is 1 if one of these runs has failed.
"""

from __future__ import annotations

import argparse
import csv
import os
import re
import signal
import subprocess
import sys
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from datetime import UTC, datetime
from importlib.util import find_spec
from pathlib import Path

ROOT = Path(__file__).parents[1]
TESTS = (
    'test/ros', 'test/live', 'test/rclpy_standin', 'test/viewer/test_view_command.py',
    'test/test_examples.py', 'test/test_starting.py',
)
"""Tests that start nodes or other processes."""

COLUMNS = (
    'date', 'code', 'rclpy', 'load', 'tests', 'passed', 'failed', 'skipped', 'seconds', 'failures',
)

LOAD_NICENESS = 5
"""Of the processes that load the machine: they take what the tests leave, and a fourth of the
rest."""


def code() -> str:
    """Return the commit, with + if files differ from it."""

    def git(*words: str) -> str:
        return subprocess.run(
            ['git', *words], cwd=ROOT, capture_output=True, text=True, check=True
        ).stdout.strip()

    return git('rev-parse', '--short', 'HEAD') + ('+' if git('status', '--porcelain') else '')


@contextmanager
def load(processes: int) -> Iterator[None]:
    """Keep a number of cores busy."""
    running = [
        subprocess.Popen([
            sys.executable, '-c', f'import os\nos.nice({LOAD_NICENESS})\nwhile True: pass'
        ])
        for _ in range(processes)
    ]
    try:
        yield
    finally:
        for process in running:
            process.kill()
            process.wait()


def one_run(tests: Sequence[str], log: Path) -> dict[str, str]:
    """Run the tests once; return the counts."""
    begun_s = time.monotonic()
    with log.open('w', encoding='utf-8') as out:
        subprocess.run(
            [sys.executable, '-m', 'pytest', '-p', 'no:cacheprovider', '-p', 'no:xdist',
             '-rfE', *tests],
            cwd=ROOT, stdout=out, stderr=subprocess.STDOUT, check=False,
            env={**os.environ, 'PYTHONUNBUFFERED': '1', 'PYTHONPATH': os.pathsep.join(
                filter(None, [str(ROOT), os.environ.get('PYTHONPATH')])
            )},
        )
    text = log.read_text(encoding='utf-8')
    summary = text.splitlines()[-1] if text else ''
    counts = {
        name: next(iter(re.findall(rf'(\d+) {name}', summary)), '0')
        for name in ('passed', 'failed', 'skipped', 'error')
    }
    failures = re.findall(r'^(?:FAILED|ERROR) (\S+)', text, re.MULTILINE)
    failed = int(counts['failed']) + int(counts['error'])
    if not int(counts['passed']):
        failed = max(failed, 1)  # it ended before the summary
    return {
        'passed': counts['passed'], 'failed': str(failed), 'skipped': counts['skipped'],
        'seconds': f'{time.monotonic() - begun_s:.0f}', 'failures': ' '.join(failures),
    }


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the tests until there are enough results."""
    parser = argparse.ArgumentParser(description=str(__doc__).split('\n')[0])
    parser.add_argument('--runs', type=int, default=20, help='number of runs in the results')
    parser.add_argument('--load', type=int, default=0, help='number of cores to keep busy')
    parser.add_argument('--results', type=Path, default=Path('repeat.tsv'), help='table of runs')
    parser.add_argument('tests', nargs='*', default=TESTS, help='files or folders')
    options = parser.parse_args(arguments)
    # A shell starts background jobs with SIGINT ignored, which the tests would inherit.
    signal.signal(signal.SIGINT, signal.default_int_handler)
    same = {
        'code': code(), 'rclpy': 'stand-in' if find_spec('rclpy') is None else 'real',
        'load': str(options.load), 'tests': ' '.join(options.tests),
    }
    rows = []
    if options.results.exists():
        with options.results.open(encoding='utf-8', newline='') as file:
            rows = list(csv.DictReader(file, delimiter='\t'))
    else:
        options.results.write_text('\t'.join(COLUMNS) + '\n', encoding='utf-8')
    mine = [row for row in rows if all(row[key] == value for key, value in same.items())]
    with load(options.load):
        while len(mine) < options.runs:
            log = options.results.with_suffix('.log')
            found = one_run(options.tests, log)
            row = {'date': datetime.now(UTC).strftime('%Y-%m-%d %H:%M'), **same, **found}
            with options.results.open('a', encoding='utf-8', newline='') as file:
                csv.DictWriter(file, COLUMNS, delimiter='\t').writerow(row)
            mine.append(row)
            if row['failed'] != '0':
                log.rename(options.results.with_suffix(f'.failed{len(rows) + len(mine)}.log'))
            shown = f'{row["passed"]} passed, {row["failed"]} failed in {row["seconds"]} s'
            print(f'run {len(mine)}: {shown} {row["failures"]}', flush=True)
    good = sum(row['failed'] == '0' for row in mine)
    print(f'{good} of {len(mine)} runs passed')
    return 0 if good == len(mine) else 1


if __name__ == '__main__':
    sys.exit(main())
