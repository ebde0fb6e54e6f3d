# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Simulate all nodes with a map file under faults that are drawn from seeds.

    python tools/simulate_faults.py [--seeds 10000] [--first 0] [--results FILE] [--minutes 60]
                                    [--jobs 2]
    python tools/simulate_faults.py --seed 17 [--trace]

Each seed is a run of 20 s of robot time in one process, with virtual time and a bus in memory:
messages are delayed and lost, queues are short, nodes are killed and restarted, the disk is full.
At the end, the map must equal that of a replay, or the nodes must have reported losses; the file
must open and contain states that the nodes had. The exit code is 0 if that holds for all seeds.

With --results, the outcome of each seed is appended to a file, and seeds in it are not repeated:
an interrupted command continues if it is given again. --seed runs one of them again, and --trace
prints its events.
"""

from __future__ import annotations

import argparse
import itertools
import multiprocessing
import os
import sys
import time
from collections import Counter
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
sys.path[:0] = [str(ROOT), str(ROOT / 'test'), str(ROOT / 'test' / 'simulation')]

MINUTE_S = 60.0
REPAIRABLE = ' (repairable)'
"""Mark of outcomes of plans in which the source can send everything again."""

SEEDS_PER_PROCESS = 500
"""Seeds after which a process is replaced. Nodes that a seed has killed never close their files
and free their memory: about four files for each seed."""



def main() -> int:
    """Simulate seeds, and print a table; return the exit code."""
    parser = argparse.ArgumentParser(description='Simulate all nodes under faults.')
    parser.add_argument('--seeds', type=int, default=10_000, help='number of seeds')
    parser.add_argument('--first', type=int, default=0, help='first seed')
    parser.add_argument('--results', type=Path, help='file of outcomes, to continue from')
    parser.add_argument('--minutes', type=float, default=float('inf'), help='stop after this time')
    parser.add_argument('--seed', type=int, help='run this seed only')
    parser.add_argument('--trace', action='store_true', help='print the events of the seed')
    parser.add_argument(
        '--jobs', type=int, default=os.cpu_count() or 1, help='number of processes'
    )
    options = parser.parse_args()

    if options.jobs < 1:
        parser.error(f'--jobs {options.jobs}: expected at least 1')
    prepare()  # compiles once, before the processes begin
    if options.seed is not None:
        from virtual_robot import simulate
        from virtual_world import Plan

        outcome = simulate(options.seed, trace=options.trace)
        for line in outcome.trace:
            print(line)
        print(Plan.drawn(options.seed))
        print('\n'.join([f'trace {outcome.trace_hash:08x}', outcome.kind, *outcome.problems]))
        return 1 if outcome.problems else 0

    done = earlier(options.results)
    end_s = time.monotonic() + options.minutes * MINUTE_S
    seeds = (
        seed for seed in range(options.first, options.first + options.seeds) if seed not in done
    )
    while (some := list(itertools.islice(seeds, options.jobs * SEEDS_PER_PROCESS))):
        if not simulated(some, done, options.results, options.jobs, end_s):
            break
    print(table(done))
    return 1 if any(kind.startswith('FAILED') for _, kind in done.values()) else 0


def prepare() -> None:
    """Install the stand-in for rclpy, and load all compiled functions."""
    from rclpy_standin import install

    if not install():
        sys.exit('rclpy of ROS is sourced; the simulation needs the stand-in for it')
    from ratslam_ros.core.warm_up import warm_up

    warm_up()
    warm_up('landmark_map', 'goal_follower')


def outcome_of(seed: int) -> tuple[int, str, str]:
    """Simulate a seed; return its number of kills, the class of its outcome, and problems."""
    from virtual_robot import simulate

    outcome = simulate(seed)
    kind = f'{outcome.kind}{REPAIRABLE if outcome.is_repairable else ""}'
    return outcome.kills, kind, '; '.join(outcome.problems)


def simulated(
    seeds: list[int], done: dict[int, tuple[int, str]], results: Path | None, jobs: int,
    end_s: float,
) -> bool:
    """Simulate seeds in new processes, and add their outcomes; return False if time is over.

    Args:
        seeds: the seeds.
        done: outcomes by seed; extended.
        results: file that the outcomes are appended to, if any.
        jobs: number of processes.
        end_s: time, of the monotonic clock, after which no seed begins.
    """
    spawn = multiprocessing.get_context('spawn')
    with ProcessPoolExecutor(jobs, spawn, initializer=prepare) as pool:
        for seed, (kills, kind, problems) in zip(seeds, pool.map(outcome_of, seeds), strict=True):
            done[seed] = kills, kind
            if results is not None:
                with results.open('a') as file:
                    file.write(f'{seed}\t{kills}\t{kind}\n')
            if problems:
                print(f'seed {seed}: {problems}', flush=True)
            if time.monotonic() >= end_s:
                pool.shutdown(cancel_futures=True)
                return False
    return True


def earlier(path: Path | None) -> dict[int, tuple[int, str]]:
    """Return number of kills and class of outcome of the seeds in a file of results."""
    if path is None or not path.exists():
        return {}
    rows = [line.split('\t') for line in path.read_text().splitlines()]
    return {int(row[0]): (int(row[1]), row[2]) for row in rows if len(row) == 3}


def table(done: dict[int, tuple[int, str]]) -> str:
    """Return the numbers of outcomes, and of the losses that were reported."""
    kinds = [kind.removesuffix(REPAIRABLE) for _, kind in done.values()]
    repairable = [kind for _, kind in done.values() if kind.endswith(REPAIRABLE)]
    differing = [kind.partition(': ')[2].split(', ') for kind in kinds if ': ' in kind]
    losses = Counter(loss for found in differing for loss in found)
    rows = [
        ('seeds', len(done)), ('kills', sum(kills for kills, _ in done.values())),
        ('maps identical to the replay', kinds.count('identical')),
        ('maps that differ, with reported losses', len(differing)),
        *((f'  of them with: {loss}', count) for loss, count in losses.most_common()),
        ('failures', kinds.count('FAILED')),
        ('seeds whose source can send all again', len(repairable)),
        ('  of them identical', repairable.count(f'identical{REPAIRABLE}')),
    ]
    return '\n'.join(f'{name:<44} {value:>6}' for name, value in rows)


if __name__ == '__main__':
    try:
        sys.exit(main())
    except KeyboardInterrupt:
        sys.exit(130)
