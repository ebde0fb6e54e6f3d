# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""States, stores and processes for the tests of maps."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
from states import differences

from ratslam_ros.core.common.state import State
from ratslam_ros.maps import Cut, MapMeta, MapStore

ROOT = Path(__file__).resolve().parents[2]
META = MapMeta('test', configuration='a: 1\n', recording='/data/drive', recording_bytes=12)
LONG_S = 60.0
"""Limit on waiting for what takes milliseconds on an idle machine."""


def growing_state(number: int) -> State:
    """Return a state of which each next one differs in a few chunks."""
    poses = np.random.default_rng(7).random((2000 + 50 * number, 3))
    poses[: number % 5] += number
    ends = np.arange(300 * number, dtype=np.int32).reshape(-1, 2) % 2000
    return {
        'core': {'poses': poses, 'ends': ends, 'n': number},
        'names': [f'link {n}' for n in range(40 + number)],
        'threshold': float('inf'),
    }


def same(left: Any, right: Any) -> bool:
    """Return whether two states are equal, types and all bits included."""
    return not any(differences(left, right))


def opened(path: Path, *parts: str, reports: list[str] | None = None) -> MapStore:
    """Open a map to write parts."""
    return MapStore(path, parts, META, print if reports is None else reports.append)


def write(store: MapStore, number: int, state: State | None = None) -> None:
    """Write a cut of all parts of a store, and wait until it is durable."""
    state = growing_state(number) if state is None else state
    store.cut(Cut(number, number * 10), dict.fromkeys(store.file.parts, state))
    assert store.flush(LONG_S)


def kill(*stores: MapStore) -> None:
    """End stores as if their processes had been killed, except that SQLite ends their logs."""
    for store in stores:
        assert store.flush(LONG_S)
        store.file.release()


def python(code: str, *arguments: Any, **options: Any) -> subprocess.Popen[str]:
    """Start a process that runs code with the helpers of the tests."""
    here = Path(__file__).parent
    folders = [str(ROOT), str(here), str(here.parent), os.environ.get('PYTHONPATH', '')]
    return subprocess.Popen(
        [sys.executable, '-c', code, *map(str, arguments)], text=True, stdout=subprocess.PIPE,
        env={**os.environ, 'PYTHONPATH': os.pathsep.join(folders)}, **options,
    )
