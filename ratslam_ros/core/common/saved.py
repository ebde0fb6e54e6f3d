# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Parts that declare what they save: state, restoring and checks follow from the declaration.

``SAVED`` of a class has a ``Field`` for each value; ``_restored`` derives what is not saved. To
save another value, add a field at the end with ``optional=True``, as earlier maps lack it.

The inner loops are compiled without bounds checks, and anyone can have written a map file. Each
number of a state is therefore checked before it is restored.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from operator import attrgetter
from typing import Any, ClassVar

import numpy as np

from ratslam_ros.core.common.addition import Addition
from ratslam_ros.core.common.rows import Rows
from ratslam_ros.core.common.state import State
from ratslam_ros.errors import UnusableInput

Size = int | str
"""A number, or the name of one: the first field with it defines it, others must agree; '' for
any."""

MAX_NUMBER = 1e9
"""Largest accepted real number. Coordinates of the Earth are below 1e7 m."""

MAX_ID = 2**31 - 1
MAX_COUNT = 2**53
MAX_STAMP_NS = 2**63 - 1

_MISSING: Any = object()
_ADVICE = 'the map is damaged or was changed; use a backup'


@dataclass(frozen=True)
class Field:
    """One saved value of a part, or a part of it.

    Attributes:
        key: its place in the state, keys separated by slashes. '': the fields of a part stand
            among those of its owner. The group `present`, of the robot at the moment, is missing
            in merged maps.
        attribute: that of the part that contains the value, or of a part of it (`one.other`), or
            several of numbers, separated by spaces. '': ``save`` computes it from the part, or
            ``state`` of the class adds it, and ``_restored`` of the part takes it.
        dtype: of an array, as text; int, float or bool of numbers in lists or alone; str, list,
            dict or object, whose content ``fits`` checks; or a class of a part, which may be an
            addition.
        shape: sizes; () for a single number.
        low: smallest number; -inf: any number, also NaN.
        high: largest number; a name for less than the size of that name. By default, real
            numbers are limited to MAX_NUMBER, and integers to 64 bits.
        make: function of the numbers of a row, whose result is an iterable of these numbers.
        save: converts the value of the attribute to what is saved.
        load: converts what was saved.
        is_fixed: the array is never changed, and therefore not copied.
        when: whether the value is saved; None for always.
        optional: states of earlier versions may lack it; it then keeps its initial value.
        nullable: it may be None.
        of_session: describes the messages and commands of one session, not what was learned.
        fits: what is expected of the value, and whether it is so in the state of its part.
        parameters: names of those that determine the value, which must be as in the run that
            saved; '' for none.
    """

    key: str
    attribute: str
    dtype: Any = float
    shape: tuple[Size, ...] = ()
    low: float | None = None
    high: float | str | None = None
    make: Callable[..., Any] | None = None
    save: Callable[[Any], Any] | None = None
    load: Callable[[Any], Any] | None = None
    is_fixed: bool = False
    when: Callable[[Any], bool] | None = None
    optional: bool = False
    nullable: bool = False
    of_session: bool = False
    fits: tuple[str, Callable[[Any, State], bool]] | None = None
    parameters: str = ''

    @cached_property
    def is_part(self) -> bool:
        """Whether the value is a part, and not numbers or texts."""
        return isinstance(self.dtype, Addition) or (
            isinstance(self.dtype, type) and issubclass(self.dtype, Saved)
        )

    @property
    def part(self) -> type[Saved] | None:
        """The class of the part; None for a value."""
        if isinstance(self.dtype, Addition):
            added: type[Saved] = self.dtype.load()
            return added
        return self.dtype if self.is_part else None

    def save_to(self, state: State, part: Any) -> None:
        """Add the value of a part to its state."""
        value = self._value(part)
        if self.when is not None and not self.when(part):
            return
        if value is None if self.is_part else value is part and self.save is None:
            return
        if self.is_part and not self.key:
            for one in self.dtype.SAVED:
                one.save_to(state, value)
            return
        *groups, name = self.key.split('/')
        for group in groups:
            state = state.setdefault(group, {})
        state[name] = self._saved(value)

    def _value(self, part: Any) -> Any:
        if ' ' in self.attribute:
            return [getattr(part, name) for name in self.attribute.split()]
        return attrgetter(self.attribute)(part) if self.attribute else part

    def _saved(self, value: Any) -> Any:
        if self.is_part:
            return value.state()
        if self.save is not None and not (value is None and self.nullable):
            value = self.save(value)
        if value is None and self.nullable:
            return None
        if isinstance(self.dtype, str):
            value = value.values if isinstance(value, Rows) else value
            return value if self.is_fixed else np.array(value, self.dtype)
        if len(self.shape) == 2:
            return [list(row) for row in value]
        return list(value) if self.shape else value

    def restore(self, part: Any, state: State) -> None:
        """Set the value of a part, or restore a part of it, from its state."""
        value = found(state, self.key)
        may_lack = self.optional or self.when or self.key.startswith('present/')
        if value is _MISSING and not may_lack:
            raise KeyError(self.key)
        if self.parameters and value != (now := self._saved(self._value(part))):
            raise UnusableInput(
                f'the map was saved with the {self.key} {value}; expected {now}: '
                f'{self.parameters} must be as in the run that saved'
            )
        if value is _MISSING or not self.attribute or self.parameters:
            return
        if self.is_part:
            owner = self._value(part)
            if owner is not None:
                owner.restore(value)
            return
        owner = getattr(part, self.attribute, None)
        if isinstance(owner, Rows):
            owner.replace(value)
        elif isinstance(owner, deque):
            owner.clear()
            owner.extend(self._loaded(value))
        elif ' ' in self.attribute:
            for name, one in zip(self.attribute.split(), np.asarray(value).tolist(), strict=True):
                setattr(part, name, one)
        else:
            setattr(part, self.attribute, self._loaded(value))

    def _loaded(self, value: Any) -> Any:
        if value is None and self.nullable:
            return None
        if isinstance(self.dtype, str):
            value = np.array(value, self.dtype)
            if value.ndim < len(self.shape):  # an empty list
                value = value.reshape(-1, *self.shape[1:])
        if self.load is not None:
            return self.load(value)
        if self.make is not None:
            if len(self.shape) == 2:
                return [self.make(*row) for row in value]
            return self.make(*value)
        if isinstance(self.dtype, str):
            return value
        return list(value) if self.shape else self.dtype(value)

    def check(self, state: State, where: str, sizes: dict[str, int]) -> None:
        """Check the value in the state of a part, if it is there."""
        value = found(state, self.key)
        if value is _MISSING or (value is None and self.nullable):
            return
        where = f'{where}/{self.key}' if self.key else where
        if self.part is not None:
            check(self.part, value, where, sizes)
        elif self.dtype in (str, list, dict, object):
            if not isinstance(value, self.dtype):
                raise UnusableInput(
                    f'{where} is {_short(value)}; expected a {self.dtype.__name__}: {_ADVICE}'
                )
        else:
            self._check_numbers(value, where, sizes)
        if self.fits is not None and not _holds(self.fits[1], value, state):
            raise UnusableInput(f'{where} is {_short(value)}; expected {self.fits[0]}: {_ADVICE}')

    def _check_numbers(self, value: Any, where: str, sizes: dict[str, int]) -> None:
        is_real = np.dtype(self.dtype).kind == 'f'
        try:
            numbers = np.asarray(value)
        except ValueError:
            numbers = np.asarray('')
        is_empty = numbers.shape == (0,)  # of a list, whose rows have no length then
        if not is_empty and numbers.dtype.kind not in ('biuf' if is_real else 'biu'):
            raise UnusableInput(
                f'{where} is {_short(value)}; expected {"" if is_real else "whole "}numbers: '
                f'{_ADVICE}'
            )
        shape = numbers.shape
        if is_empty and len(self.shape) > 1:
            shape = (0, *[size if isinstance(size, int) else 0 for size in self.shape[1:]])
        expected = tuple(
            size if isinstance(size, int) else sizes.get(size, shape[n] if n < len(shape) else -1)
            for n, size in enumerate(self.shape)
        )
        if shape != expected:
            raise UnusableInput(f'{where} has the shape {shape}; expected {expected}: {_ADVICE}')
        sizes.update(
            (name, size) for name, size in zip(self.shape, shape, strict=True)
            if isinstance(name, str) and name
        )
        most = MAX_NUMBER if is_real else MAX_STAMP_NS
        low = -most if self.low is None else self.low
        high = most if self.high is None else self.high
        limit = sizes.get(high, 0) - 1 if isinstance(high, str) else high
        if numbers.size == 0 or low == -math.inf:
            return
        least, largest = numbers.min().item(), numbers.max().item()
        if not (low <= least and largest <= limit):  # or NaN
            raise UnusableInput(
                f'{where} is {least} to {largest}; expected {low:g} to {limit:g}: '
                f'{_ADVICE}'
            )


def count(key: str, attribute: str, **options: Any) -> Field:
    """Return the field of a count."""
    return Field(key, attribute, int, low=0, high=MAX_COUNT, **options)


def session_keys(part: Any) -> set[str]:
    """Return the keys in the state of a part that describe only one session."""
    return {field.key for field in getattr(part, 'SAVED', ()) if field.of_session}


def named_numbers(length: int) -> tuple[str, Callable[[Any, State], bool]]:
    """Return ``fits`` of rows of a text and numbers."""
    return f'rows of a text and {length} numbers', lambda rows, _: all(
        isinstance(name, str) and len(numbers) == length
        and all(abs(number) <= MAX_NUMBER for number in numbers)
        for name, *numbers in rows
    )


class Saved:
    """A part whose state follows from the declaration of its fields."""

    SAVED: ClassVar[tuple[Field, ...]] = ()

    def state(self) -> State:
        """Return all saved fields, for ``restore``; arrays are copies."""
        state: State = {}
        for field in self.SAVED:
            field.save_to(state, self)
        return state

    def restore(self, state: State) -> None:
        """Restore what ``state`` returned; the part must be new.

        Raises:
            KeyError: a field is missing.
            UnusableInput: the state does not fit the parameters.
        """
        for field in self.SAVED:
            field.restore(self, state)
        self._restored(state)

    def _restored(self, state: State) -> None:
        """Derive what is not saved itself, after the fields were set from a state."""


def check(kind: type[Saved], state: State, where: str, sizes: dict[str, int]) -> None:
    """Check the state of a part before it is restored.

    Args:
        kind: class of the part.
        state: the state.
        where: its name, for errors.
        sizes: known sizes, by name; those of the part are added.

    Raises:
        UnusableInput: a field has another type or shape than declared, or is out of range.
    """
    if not isinstance(state, dict):
        raise UnusableInput(f'{where} is {_short(state)}; expected fields: {_ADVICE}')
    for field in kind.SAVED:
        field.check(state, where, sizes)


def found(state: Any, key: str) -> Any:
    """Return the value at keys separated by slashes; _MISSING if there is none."""
    for name in key.split('/') if key else ():
        if not isinstance(state, dict) or name not in state:
            return _MISSING
        state = state[name]
    return state


def _holds(fits: Callable[[Any, State], bool], value: Any, state: State) -> bool:
    try:
        return fits(value, state)
    except (LookupError, TypeError, ValueError, AttributeError, OverflowError):
        return False


def _short(value: Any) -> str:
    return f'{type(value).__name__} {str(value)[:40]!r}'
