# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Conversion between messages and plain values, as in rosidl_runtime_py."""

from __future__ import annotations

import array
from collections.abc import Callable, Mapping
from functools import partial
from typing import Any

import numpy as np

from rclpy_standin.definitions import Field
from rclpy_standin.types import Message, message_class

_TIME = 'builtin_interfaces/msg/Time'
_HEADER = 'std_msgs/msg/Header'


def message_to_yaml(msg: Message, *, truncate_length: int | None = None) -> str:
    """Convert a message to YAML.

    Args:
        msg: any message.
        truncate_length: number of items or characters after which lists and strings are cut.
    """
    import sys

    import yaml

    return str(
        yaml.safe_dump(
            _plain_fields(msg, truncate_length),
            allow_unicode=True,
            width=sys.maxsize,
            default_flow_style=False,
            sort_keys=False,
        )
    )


def set_message_fields(
    msg: Message,
    values: Mapping[str, Any],
    expand_header_auto: bool = False,
    expand_time_now: bool = False,
) -> list[Callable[[Any], None]]:
    """Set fields of a message from plain values.

    Args:
        msg: message to modify.
        values: values by field name.
        expand_header_auto: accept 'auto' for a header, whose stamp is set later.
        expand_time_now: accept 'now' for a time, which is set later.

    Returns:
        Functions that set the stamps given as 'auto' or 'now'.

    Raises:
        AttributeError: the message has no such field.
        TypeError, ValueError: a value does not fit its field.
    """
    if not isinstance(values, Mapping):
        raise TypeError(
            f"Value '{values}' is expected to be a dictionary but is a {type(values).__name__}"
        )
    stamps: list[Callable[[Any], None]] = []
    fields = {field.name: field for field in msg.FIELDS}
    for name, value in values.items():
        if name not in fields:
            raise AttributeError(f"'{type(msg).__name__}' object has no attribute '{name}'")
        field = fields[name]
        if field.is_message and field.size is None and value in ('auto', 'now'):
            made = message_class(field.base)()
            if value == 'auto' and expand_header_auto and field.base == _HEADER:
                stamps.append(partial(setattr, made, 'stamp'))
            elif value == 'now' and expand_time_now and field.base == _TIME:
                stamps.append(partial(setattr, msg, name))
            else:
                raise TypeError(f'{name}: {value!r} is not a value for {field.idl}')
        else:
            made = _value(
                getattr(msg, name), field, value, stamps, expand_header_auto, expand_time_now
            )
        setattr(msg, name, made)
    return stamps


def _value(
    present: Any, field: Field, value: Any, stamps: list[Callable[[Any], None]],
    header: bool, now: bool,
) -> Any:
    if field.is_message and field.size is None:
        if type(value) is type(present):
            return value
        stamps += set_message_fields(present, value or {}, header, now)
        return present
    if field.size is None:
        return _scalar(field, value)
    if isinstance(value, str | bytes | Mapping) or not hasattr(value, '__iter__'):
        raise ValueError(f'{field.name}: expected a list, not {value!r}')
    if field.is_message:
        made = []
        for item in value:
            if not isinstance(item, Message):
                part = message_class(field.base)()
                stamps += set_message_fields(part, item, header, now)
                item = part
            made.append(item)
        return made
    items = [_scalar(field, item) for item in value]
    if isinstance(present, np.ndarray):
        if len(items) != len(present):
            raise ValueError(f'{field.name}: expected {len(present)} values, not {len(items)}')
        return np.array(items, present.dtype)
    return array.array(present.typecode, items) if isinstance(present, array.array) else items


def _scalar(field: Field, value: Any) -> Any:
    kind: Any
    if field.base == 'byte':
        return value if isinstance(value, bytes) else bytes([int(value)])
    if field.base in ('string', 'bool'):
        kind = str if field.base == 'string' else bool
        # YAML reads an unquoted 12 as a number, which is accepted for strings but not for bools.
        if kind is bool and not isinstance(value, bool):
            raise TypeError(f'{field.name}: expected a boolean, not {value!r}')
        return kind(value)
    kind = float if field.base.startswith('float') else int
    if kind is int and isinstance(value, float) and not value.is_integer():
        raise ValueError(f'{field.name}: expected an integer, not {value!r}')
    return kind(value)


def _plain_fields(msg: Message, max_length: int | None) -> dict[str, Any]:
    """Return plain values by field name."""
    return {
        field.name: _plain(getattr(msg, field.name), field, max_length) for field in msg.FIELDS
    }


def _plain(value: Any, field: Field, max_length: int | None) -> Any:
    if field.size is not None:
        items = value.tolist() if hasattr(value, 'tolist') else list(value)
        cut = max_length is not None and len(items) > max_length
        one = field._replace(size=None)
        made = [_plain(item, one, max_length) for item in items[:max_length]]
        return [*made, '...'] if cut else made
    if field.is_message:
        return _plain_fields(value, max_length)
    if isinstance(value, bytes):
        return value[0] if len(value) == 1 else list(value)
    if isinstance(value, str) and max_length is not None and len(value) > max_length:
        return f'{value[:max_length]}...'
    return value
