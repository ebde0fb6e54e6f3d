# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""How long a node takes to start: from the start of its process to its log line `ready`.

    python benchmarks/node_start.py [--repeats 5] [--node local_view]

Each start is a process of its own, ended by SIGINT before the next. One start of each node goes
before those that are counted: it fills numba's cache, which every later one loads. It runs on
whatever ``import rclpy`` gives: the real one in a shell where ROS 2 is set up, the stand-in
elsewhere.
"""

from __future__ import annotations

import argparse
import os
import signal
import statistics
import subprocess
import sys
import time
from importlib.util import find_spec
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
NODES = ('visual_odometry', 'local_view', 'pose_cells', 'experience_map', 'single_process')
END_S = 20.0
"""A node that was interrupted ends within this time."""


def ready_s(node: str, repeats: int) -> list[float]:
    """Return how long each start took, without the one that fills the cache.

    Raises:
        RuntimeError: the node ended before it was ready, or with another code than 0.
    """
    return [_start_s(node) for _ in range(repeats + 1)][1:]


def _start_s(node: str) -> float:
    environment = {
        **os.environ,
        'ROS_AUTOMATIC_DISCOVERY_RANGE': 'LOCALHOST',
        'ROS_DOMAIN_ID': '96',  # of its own: what else runs here neither hears nor slows it
        'PYTHONPATH': os.pathsep.join(filter(None, [str(ROOT), os.environ.get('PYTHONPATH')])),
    }
    start_s = time.monotonic()
    with subprocess.Popen(
        [sys.executable, '-m', 'ratslam_ros', 'run', node], env=environment, text=True,
        stdout=subprocess.PIPE, stderr=subprocess.STDOUT,
    ) as process:  # fmt: skip
        assert process.stdout is not None
        told = ''
        for line in process.stdout:
            told += line
            if line.rstrip().endswith(' ready'):
                break
        took_s = time.monotonic() - start_s
        process.send_signal(signal.SIGINT)
        try:
            told += process.communicate(timeout=END_S)[0]
        except subprocess.TimeoutExpired:
            process.kill()
            raise
    if process.returncode != 0:
        raise RuntimeError(f'{node} ended with code {process.returncode}: {told}')
    return took_s


def main() -> int:
    parser = argparse.ArgumentParser(description='From the start of a process to `ready`.')
    parser.add_argument('--repeats', type=int, default=5, help='starts counted (default: 5)')
    parser.add_argument('--node', choices=NODES, help='only this one')
    options = parser.parse_args()
    print(f'runtime: {"stand-in" if find_spec("rclpy") is None else "rclpy"}\n')
    print('| node | median s | best s | worst s |', '| --- | --- | --- | --- |', sep='\n')
    for node in [options.node] if options.node else NODES:
        times_s = ready_s(node, options.repeats)
        print(f'| {node} | {statistics.median(times_s):.2f} | {min(times_s):.2f} | '
              f'{max(times_s):.2f} |', flush=True)  # fmt: skip
    return 0


if __name__ == '__main__':
    sys.exit(main())
