# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Comparison of states, and their way through JSON and arrays, for the tests of saved maps."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from ratslam_ros.core.common.state import State
from ratslam_ros.maps import MapMeta, read_map, save_map


def filed(states: Mapping[str, State], folder: Path) -> dict[str, State]:
    """Return states of stages or their cores after they were written to a file and read again."""
    parts = {part: state if 'core' in state else {'core': state} for part, state in states.items()}
    save_map(folder / 'states.map', parts, MapMeta())
    read = read_map(folder / 'states.map').states
    return {part: read[part] if 'core' in states[part] else read[part]['core'] for part in states}


def differences(a: Any, b: Any, path: str = '') -> Iterator[str]:
    """Yield the paths at which two states differ; tuples and lists are alike."""
    if isinstance(a, np.ndarray) or isinstance(b, np.ndarray):
        same = (
            isinstance(a, np.ndarray) and isinstance(b, np.ndarray) and a.shape == b.shape
            and a.dtype == b.dtype and a.tobytes() == b.tobytes()
        )
        if not same:
            yield path
    elif isinstance(a, dict) and isinstance(b, dict):
        for key in sorted(a.keys() | b.keys()):
            if key in a and key in b:
                yield from differences(a[key], b[key], f'{path}/{key}')
            else:
                yield f'{path}/{key} in one of them only'
    elif isinstance(a, (list, tuple)) and isinstance(b, (list, tuple)):
        if len(a) != len(b):
            yield f'{path} has {len(a)} and {len(b)} items'
        for number, (one, other) in enumerate(zip(a, b, strict=False)):
            yield from differences(one, other, f'{path}/{number}')
    elif repr(a) != repr(b):
        yield f'{path}: {a!r} and {b!r}'
