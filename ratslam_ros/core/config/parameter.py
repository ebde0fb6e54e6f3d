# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Declaration and validation of parameter sections."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, field, fields
from typing import Any, Literal, cast

from ratslam_ros.errors import UnusableParameter

Value = bool | int | float | str
"""Type of a parameter value."""

AUTOMATIC = -1
"""Value of a number that is estimated from the inputs instead of being set."""

WHOLE = -1
"""Value of an upper image bound that stands for the edge of the image."""

CROP_MAX = 'px; -1: to the edge of the image'
"""Unit text of upper image bounds."""

NO_FILE = ''
"""Default of parameters that are paths of files, which may contain spaces."""

Change = Literal['no', 'at once', 'at next message']
"""When a value that is set while a node runs takes effect. Values that influence the map do so at
the stamp of the next message that the node processes, so that the map depends on stamps only."""

MAX_PATH_LENGTH = 4096
"""Longest path that Linux accepts, in characters."""


@dataclass(frozen=True)
class ParameterInfo:
    """Metadata of one parameter, apart from its name and default."""

    effect: str
    """Help text: what the parameter does."""
    unit: str = ''
    """Unit of the value, and the meaning of special values; empty if there is none."""
    low: float = 0.0
    """Smallest valid number; not used for strings and switches."""
    high: float = 0.0
    """Largest valid number; not used for strings and switches."""
    raise_if: str = ''
    """Condition under which to raise the value or turn a switch on; for strings, full advice."""
    lower_if: str = ''
    """Condition under which to lower the value or turn a switch off; for strings, full advice."""
    choices: tuple[str, ...] = ()
    """Valid strings; if empty, any string without whitespace is valid, or any path."""
    automatic: bool = False
    """Whether ``AUTOMATIC`` is valid as well."""
    runtime: Change = 'no'
    """Whether the value can be set while a node runs, and when it takes effect."""

    @property
    def lowest(self) -> float:
        """Smallest valid number, ``AUTOMATIC`` included."""
        return AUTOMATIC if self.automatic else self.low

    @property
    def range_text(self) -> str:
        """The valid numbers, for messages and documentation."""
        text = f'{self.low:g} to {self.high:g}'
        return f'{text}, or {AUTOMATIC} (automatic)' if self.automatic else text


def parameter(default: Any, effect: str, **info: Any) -> Any:
    """Declare one parameter as a dataclass field of a section.

    Args:
        default: the default value; its type is the type of the parameter.
        effect, info: see ``ParameterInfo``.
    """
    return field(default=default, metadata={'info': ParameterInfo(effect, **info)})


@dataclass(frozen=True)
class Section:
    """A frozen group of parameters, validated on construction.

    Raises:
        UnusableParameter: a value has the wrong type or is out of range.
    """

    def __post_init__(self) -> None:
        for name, info, default in self.parameters():
            object.__setattr__(self, name, _checked(name, getattr(self, name), default, info))

    @classmethod
    def parameters(cls) -> Iterator[tuple[str, ParameterInfo, Value]]:
        """Yield name, metadata and default of each parameter, in declared order."""
        for item in fields(cls):
            yield item.name, item.metadata['info'], cast(Value, item.default)

    def check_change(self, new: Section) -> None:
        """Check that a part that was created with these values can continue with others.

        Args:
            new: the other values, of the same class.

        Raises:
            UnusableParameter: a value differs that is used when the part is created, or a value
                would become automatic, although nothing has been measured for it.
        """
        for name, info, _ in self.parameters():
            before, now = getattr(self, name), getattr(new, name)
            if before == now:
                continue
            if info.runtime == 'no':
                raise UnusableParameter(
                    f'{name} is {before!r} and cannot change while the map is built; restart with '
                    f'{now!r}'
                )
            if info.automatic and now == AUTOMATIC:
                raise UnusableParameter(
                    f'{name} is {AUTOMATIC} (automatic); expected {info.low:g} to {info.high:g}, '
                    'because it was not automatic at the start: restart to have it estimated'
                )


def _checked(name: str, value: Any, default: Value, info: ParameterInfo) -> Value:
    """Return the value converted to the type of the default, or raise UnusableParameter."""
    if isinstance(default, bool):
        if isinstance(value, (bool, int)) and value in (0, 1):
            return bool(value)
        raise UnusableParameter(f'{name} is {value!r}; expected true or false')
    if default == NO_FILE:
        if isinstance(value, str) and value.isprintable() and len(value) <= MAX_PATH_LENGTH:
            return value
        raise UnusableParameter(
            f'{name} is {str(value)[:80]!r}; expected the path of a file, of up to '
            f'{MAX_PATH_LENGTH} printable characters'
        )
    if isinstance(default, str):
        if isinstance(value, str) and (value in info.choices or _is_name(value, info)):
            return value
        if not info.choices:
            raise UnusableParameter(f'{name} is {value!r}; expected a name without spaces')
        raise UnusableParameter(f'{name} is {value!r}; expected one of {", ".join(info.choices)}')
    if isinstance(value, bool) or not isinstance(value, (int, float)):
        raise UnusableParameter(f'{name} is {value!r}; expected a number in {info.unit}')
    if isinstance(default, int) and value != int(value if math.isfinite(value) else 0):
        raise UnusableParameter(f'{name} is {value!r}; expected a whole number')
    if not info.low <= value <= info.high and not (info.automatic and value == AUTOMATIC):
        raise UnusableParameter(f'{name} is {value!r}; expected {info.range_text} {info.unit}')
    return type(default)(value)


def _is_name(value: str, info: ParameterInfo) -> bool:
    return not info.choices and bool(value) and not any(c.isspace() for c in value)
