# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Check of saved states: whoever made a file must not choose where memory is read or written.

The inner loops are compiled without bounds checks. Every number in a state by which they find
something must therefore be within range before the state is restored. Types and further values are
checked by ``restore`` itself, which raises if they are missing.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ratslam_ros.core.common.state import State
from ratslam_ros.errors import UnusableInput
from ratslam_ros.limits import MAX_COORDINATE_M

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
    'pose_cells': (
        Rule('core/dims', (3,), 1, MAX_CELLS),
        Rule('core/links/templates', ('linked',), 0, MAX_ID),
        Rule('core/links/counts', ('linked',), 0, MAX_COUNT),
        Rule('core/links/cells', ('weights',), 0, 'all cells'),
        Rule('core/links/weights', ('weights',), 0),
        Rule('core/memories', ('', ''), -MAX_ID, MAX_ID),
        Rule('core/experiences', ('experiences', 4), -1, MAX_ID),
        Rule('core/superseded', ('',), 0, 'experiences'),
        Rule('core/unrolled/peak', (3,)),
        Rule('core/unrolled/here', ('',)),
        Rule('core/unrolled/memories', ('', 2)),
        Rule('core/unrolled/experiences', ('experiences', 2)),
        Rule('core/transitions', ('', 2), -1, 'experiences'),
        Rule('core/visits/counts', ('experiences',), 0, MAX_COUNT),
        Rule('core/visits/last', ('experiences',), 0, MAX_COUNT),
        Rule('core/gaps/ends', ('gaps', 2), 0, 'experiences'),
        Rule('core/gaps/ways_m', ('gaps',)),
        Rule('core/created', ('experiences',), 0, MAX_COUNT),
        Rule('core/current', (), -1, 'experiences'),
        Rule('core/since_current', ('',)),
        Rule('core/visits/now', (), 0, MAX_COUNT),
        Rule('core/messages', (), 0, MAX_COUNT),
        Rule('core/last_template', (), -1, MAX_ID),
        Rule('core/agreement/slot', (), -1, MAX_ID),
        Rule('core/agreement/slot_began', ()),
        Rule('core/agreement/travelled', ()),
        Rule('core/present/odometry', (3,)),
        Rule('core/present/at_views', ('', 3)),
        Rule('motion/correction', (2,)),
        Rule('sequence', (), 0, MAX_COUNT),
        Rule('goal_memory/dims', (2,), 1, MAX_CELLS),
        Rule('goal_memory/cells', ('cells',), 0, 'all cells'),
        Rule('goal_memory/ends', ('steps', 2), 0, 'cells'),
        Rule('goal_memory/mu_s', ('steps',), 0),
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
        if rule.path.endswith('dims'):
            sizes['all cells'] = math.prod(numbers.tolist())
        high = rule.high if isinstance(rule.high, (int, float)) else sizes.get(rule.high, 0) - 1
        if numbers.size and not (rule.low <= numbers.min() and numbers.max() <= high):  # or NaN
            raise UnusableInput(
                f'{part}: {rule.path} is {numbers.min()} to {numbers.max()}; expected '
                f'{rule.low:g} to {high:g}: the map is damaged or was changed; use a backup'
            )
    if part == 'pose_cells':
        _check_packets(_at(state, 'core/packets'), _at(state, 'core/dims'))


def _check_packets(packets: Any, dims: Any) -> None:
    """Check that the boxes of activity lie on the torus, and are of the size of their cells."""
    if packets is _MISSING or dims is _MISSING:
        return
    size = np.asarray(dims)[::-1]
    for packet in packets if isinstance(packets, list) else [packets]:
        try:
            cells, box, frame = (np.asarray(packet[key]) for key in ('cells', 'box', 'frame'))
            is_good = (
                box.dtype.kind == 'i' and box.shape == (6,) and cells.ndim == 3
                and box[3:].tolist() == list(cells.shape) and bool((box[3:] <= size).all())
                # A merged packet may begin before the edge of the torus: the kernels wrap it.
                and bool((np.abs(box[:3]) <= MAX_CELLS).all())
                and frame.shape == (3,) and bool((np.abs(frame) <= 0.5).all())
                and bool(np.isfinite(cells).all()) and bool((cells >= 0.0).all())
            )  # fmt: skip
        except (KeyError, TypeError, ValueError, IndexError):
            is_good = False
        if not is_good:
            raise UnusableInput(
                'pose_cells: core/packets do not lie on the pose cells: the map is damaged or was '
                'changed; use a backup'
            )


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
