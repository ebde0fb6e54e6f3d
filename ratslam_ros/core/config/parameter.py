# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""What a section of parameters is: named values with unit, range, default and effect."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import Field, dataclass, field, fields
from typing import Any, cast

from ratslam_ros.errors import UnusableParameter

Value = bool | int | float | str


@dataclass(frozen=True)
class ParameterInfo:
    """What is known of one parameter beside its name and default."""

    unit: str
    low: float
    high: float
    effect: str
    raise_if: str
    lower_if: str
    choices: tuple[str, ...] = ()


def parameter(
    default: Any,
    unit: str,
    low: float,
    high: float,
    effect: str,
    raise_if: str = '',
    lower_if: str = '',
    choices: tuple[str, ...] = (),
) -> Any:
    """Declare one parameter of a section."""
    info = ParameterInfo(unit, low, high, effect, raise_if, lower_if, choices)
    return field(default=default, metadata={'info': info})


@dataclass(frozen=True)
class Section:
    """A frozen group of parameters; constructing one checks every value's type and range."""

    def __post_init__(self) -> None:
        for name, info, default in self.parameters():
            object.__setattr__(self, name, _checked(name, getattr(self, name), default, info))

    @classmethod
    def parameters(cls) -> Iterator[tuple[str, ParameterInfo, Value]]:
        """Yield name, info and default of each parameter, in declared order."""
        for item in fields(cls):
            yield item.name, item.metadata['info'], _default(item)


def _default(item: Field[Any]) -> Value:
    return cast(Value, item.default)


def _checked(name: str, value: Any, default: Value, info: ParameterInfo) -> Value:
    """Return the value in the default's type, or say what is wrong with it."""
    if isinstance(default, bool):
        if isinstance(value, (bool, int)) and value in (0, 1):
            return bool(value)
        raise UnusableParameter(f'{name} is {value!r}; expected true or false')
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
    if not info.low <= value <= info.high:
        raise UnusableParameter(
            f'{name} is {value!r}; expected {info.low:g} to {info.high:g} {info.unit}'
        )
    return type(default)(value)


def _is_name(value: str, info: ParameterInfo) -> bool:
    return not info.choices and bool(value) and not any(c.isspace() for c in value)
