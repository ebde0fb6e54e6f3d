# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Check of saved states: whoever made a file must not choose where memory is read or written.

The inner loops are compiled without bounds checks. Every number in a state by which they find
something must therefore be within range before the state is restored. Types and further values are
checked by ``restore`` itself, which raises if they are missing.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ratslam_ros.core.common.saved import check
from ratslam_ros.core.common.state import State
from ratslam_ros.errors import UnusableInput
from ratslam_ros.limits import MAX_COORDINATE_M
from ratslam_ros.pipeline.live_stages import LivePoseCells

Size = int | str
"""A number, or the name of one: the first array that has it defines it, others must agree."""

MAX_ID = 2**31 - 1
MAX_COUNT = 2**53
MAX_STAMP_NS = 2**63 - 1
MAX_CELLS = 100_000
MAX_POINTS = 100_000
"""Largest number of points of a scan."""


@dataclass(frozen=True, slots=True)
class Rule:
    """What the numbers at a path must be.

    Attributes:
        path: keys, separated by slashes; nothing is checked if there is nothing.
        shape: sizes; '' for any.
        low: smallest value.
        high: largest value; a name for less than the number of that name.
    """

    path: str
    shape: tuple[Size, ...]
    low: float = -MAX_COORDINATE_M
    high: float | str = MAX_COORDINATE_M


RULES: dict[str, tuple[Rule, ...]] = {
    'local_view': (
        Rule('core/templates', ('', '', ''), 0, 255),
        Rule('core/low_texture', (), 0, MAX_COUNT),
    ),
    'experience_map': (
        Rule('core/poses', ('experiences', 3)),
        Rule('core/labels', ('experiences', 4), -1, MAX_ID),
        Rule('core/ends', ('links', 2), 0, 'experiences'),
        Rule('core/shapes', ('links', 3)),
        Rule('core/durations_s', ('links',), 0),
        Rule('core/counts', ('links',), 0, MAX_COUNT),
        Rule('core/behaviours', ('links',), 0, MAX_ID),
        Rule('core/failures', ('links', 2), 0, MAX_COUNT),
        Rule('core/unlearned', ('', 2), 0, 'experiences'),
        Rule('core/made_m', ('experiences',)),
        Rule('core/current', (), -1, 'experiences'),
        Rule('core/offset', (3,)),
        Rule('core/duration_s', (), 0),
        Rule('core/way_m', (), 0),
        Rule('core/odometer_m', (), 0),
        Rule('correction', (2,)),
        Rule('dead_reckoning', (3,)),
        Rule('scans/ids', ('scans',), 0, 'experiences'),
        Rule('scans/sizes', ('scans',), 0, MAX_POINTS),
        Rule('scans/present/track_ns', ('track',), 0, MAX_STAMP_NS),
        Rule('scans/present/track', ('track', 3)),
        Rule('scans/present/odometry', (3,)),
        Rule('core/present/scan_checked_m', ()),
        Rule('core/present/scan_confirmed_m', ()),
        Rule('relocator/present/created', ('created',), 0, 'experiences'),
        Rule('relocator/present/created_at_m', ('created',), 0),
        Rule('relocator/present/counts', (5,), 0, MAX_COUNT),
        Rule('relocator/present/relocated_to', (), -1, 'experiences'),
        Rule('relocator/landmarks/owners', ('landmarks',), 0, 'experiences'),
        Rule('relocator/landmarks/shapes', ('landmarks', 4)),
        Rule('relocator/landmarks/visits', ('landmarks',), 0, MAX_COUNT),
    ),
}


_MISSING = object()


def check_state(part: str, state: State) -> None:
    """Check the state of a part before it is restored.

    Raises:
        UnusableInput: a number is out of range, or an array has another shape than expected.
    """
    sizes: dict[str, int] = {}
    for rule in RULES.get(part, ()):
        value = _at(state, rule.path)
        if value is _MISSING:
            continue
        numbers = _numbers(part, rule.path, value)
        _check_shape(part, rule, numbers, sizes)
        high = rule.high if isinstance(rule.high, (int, float)) else sizes.get(rule.high, 0) - 1
        if numbers.size and not (rule.low <= numbers.min() and numbers.max() <= high):  # or NaN
            raise UnusableInput(
                f'{part}: {rule.path} is {numbers.min()} to {numbers.max()}; expected '
                f'{rule.low:g} to {high:g}: the map is damaged or was changed; use a backup'
            )
    if part == 'pose_cells':
        check(LivePoseCells, state, part, {})


def _at(state: State, path: str) -> Any:
    value: Any = state
    for key in path.split('/'):
        if not isinstance(value, dict) or key not in value:
            return _MISSING
        value = value[key]
    return value


def _numbers(part: str, path: str, value: Any) -> NDArray[Any]:
    try:
        numbers = np.asarray(value)
    except ValueError:
        numbers = np.asarray('')
    if numbers.size == 0 and numbers.ndim == 1:  # an empty list of rows
        return np.empty(0)
    if numbers.dtype.kind not in 'biuf':
        raise UnusableInput(
            f'{part}: {path} does not consist of numbers: the map is damaged or was changed; use '
            'a backup'
        )
    return numbers


def _check_shape(part: str, rule: Rule, numbers: NDArray[Any], sizes: dict[str, int]) -> None:
    is_empty = numbers.shape == (0,)  # of a list, whose rows have no length then
    found = (0, *[size if isinstance(size, int) else 0 for size in rule.shape[1:]])
    shape = found if is_empty and len(rule.shape) > 1 else numbers.shape
    expected = tuple(
        size if isinstance(size, int) else sizes.get(size, shape[n] if n < len(shape) else -1)
        for n, size in enumerate(rule.shape)
    )
    if shape != expected:
        raise UnusableInput(
            f'{part}: {rule.path} has the shape {shape}; expected {expected}: the map is damaged '
            'or was changed; use a backup'
        )
    sizes.update(
        (name, size) for name, size in zip(rule.shape, shape, strict=True)
        if isinstance(name, str) and name
    )  # fmt: skip
