# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Start-up time of the nodes, from the start of the process to the log line `ready`.

    python benchmarks/node_start.py [--repeats 5] [--node local_view]

Each start is a separate process, ended by SIGINT before the next one. A first start of each node
is not counted, because it fills Numba's cache and that of Python's bytecode, which all later ones
load. PYTHONDONTWRITEBYTECODE is ignored, with which every start would compile all modules. The
nodes use whichever runtime ``import rclpy`` finds: rclpy in a shell with ROS 2, its stand-in
otherwise.
"""

from __future__ import annotations

import argparse
import signal
import statistics
import subprocess
import sys
import time
from importlib.util import find_spec

from processes import environment, use_own_domain

NODES = ('visual_odometry', 'local_view', 'pose_cells', 'experience_map', 'single_process')
END_S = 20.0
"""Time within which an interrupted node must exit, in s."""


def ready_s(node: str, repeats: int) -> list[float]:
    """Return the start-up times in s, without the first start, which fills the cache.

    Raises:
        RuntimeError: the node exited before it was ready, or with a code other than 0.
    """
    return [_start_s(node) for _ in range(repeats + 1)][1:]


def _start_s(node: str) -> float:
    use_own_domain()
    variables = environment()
    variables.pop('PYTHONDONTWRITEBYTECODE', None)
    start_s = time.monotonic()
    with subprocess.Popen(
        [sys.executable, '-m', 'ratslam_ros', 'run', node], env=variables, text=True,
        stdout=subprocess.PIPE, stderr=subprocess.STDOUT,
    ) as process:
        assert process.stdout is not None
        output = ''
        for line in process.stdout:
            output += line
            if line.rstrip().endswith(' ready'):
                break
        took_s = time.monotonic() - start_s
        process.send_signal(signal.SIGINT)
        try:
            output += process.communicate(timeout=END_S)[0]
        except subprocess.TimeoutExpired:
            process.kill()
            raise
    if process.returncode != 0:
        raise RuntimeError(f'{node} exited with code {process.returncode}: {output}')
    return took_s


def main() -> int:
    parser = argparse.ArgumentParser(description='Start-up time of the nodes.')
    parser.add_argument('--repeats', type=int, default=5, help='counted starts (default: 5)')
    parser.add_argument('--node', choices=NODES, help='measure only this node')
    options = parser.parse_args()
    print(f'runtime: {"stand-in" if find_spec("rclpy") is None else "rclpy"}\n')
    print('| node | median s | best s | worst s |', '| --- | --- | --- | --- |', sep='\n')
    for node in [options.node] if options.node else NODES:
        times_s = ready_s(node, options.repeats)
        print(f'| {node} | {statistics.median(times_s):.2f} | {min(times_s):.2f} | '
              f'{max(times_s):.2f} |', flush=True)
    return 0


if __name__ == '__main__':
    sys.exit(main())
