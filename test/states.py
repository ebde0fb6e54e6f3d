# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Comparison of states, and their way through JSON and arrays, for the tests of saved maps."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from ratslam_ros.core.common.state import State
from ratslam_ros.files.memory import load, save
from ratslam_ros.pipeline.items import Step
from ratslam_ros.pipeline.ratslam import RatSLAM

Event = Callable[[RatSLAM], list[Step]]


def filed(states: Mapping[str, State], folder: Path) -> dict[str, State]:
    """Return states as they are after they were written to files and read again."""
    found = {}
    for part, state in states.items():
        save(folder / part, part, state)
        found[part] = load(folder / part, part)
    return found


def differences(a: Any, b: Any, path: str = '') -> Iterator[str]:
    """Yield the paths at which two states differ; tuples and lists are alike."""
    if isinstance(a, np.ndarray) or isinstance(b, np.ndarray):
        same = (
            isinstance(a, np.ndarray) and isinstance(b, np.ndarray) and a.shape == b.shape
            and a.dtype == b.dtype and a.tobytes() == b.tobytes()
        )  # fmt: skip
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


def continues_exactly(
    new: Callable[[], RatSLAM], events: Sequence[Event], cuts: Sequence[int], folder: Path
) -> list[str]:
    """Return how runs that were saved and restored differ from one that was not.

    Args:
        new: creates an empty system.
        events: what is fed to it.
        cuts: numbers of the events before which the run is saved.
        folder: for the files.

    Returns:
        Differences of the steps, the final state, or the state after it was restored; no lines if
        there are none.
    """
    slam, saved = new(), {}
    steps: list[list[Step]] = []
    for number, event in enumerate(events):
        if number in cuts:
            saved[number] = slam.state()
        steps.append(event(slam))
    steps.append(slam.finish())
    final = slam.state()
    found: list[str] = []
    for cut, states in saved.items():
        # Only now, because a state must not change while the run continues.
        read = filed(states, folder)
        slam = new()
        slam.restore(read)
        found += [f'cut {cut}, restored: {one}' for one in differences(slam.state(), read)]
        for number in range(cut, len(events)):
            got = events[number](slam)
            if repr(got) != repr(steps[number]):
                found.append(f'cut {cut}: step {number} is {got}; expected {steps[number]}')
                break
        else:
            if repr(slam.finish()) != repr(steps[-1]):
                found.append(f'cut {cut}: the last steps')
            found += [f'cut {cut}, at the end: {one}' for one in differences(slam.state(), final)]
    return found
