# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Definitions of message and service types, from the type store of rosbags."""

from __future__ import annotations

import keyword
from functools import cache
from typing import Any, NamedTuple

from rosbags.interfaces import Nodetype
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from rclpy_standin.service_texts import SERVICES

ARRAY_CODES = {
    'int8': 'b', 'uint8': 'B', 'char': 'B', 'int16': 'h', 'uint16': 'H', 'int32': 'i',
    'uint32': 'I', 'int64': 'q', 'uint64': 'Q', 'float32': 'f', 'float64': 'd',
}
"""Type codes of array.array."""
_IDL_NAMES = {'float32': 'float', 'float64': 'double', 'byte': 'octet', 'bool': 'boolean',
              'char': 'uint8'}
NO_FIELDS = 'structure_needs_at_least_one_member'
"""Name of the field that empty messages have in their IDL."""


class Field(NamedTuple):
    """One field of a message."""

    name: str
    """Name of the Python attribute."""
    base: str
    """Primitive type, or full name of a message type."""
    is_message: bool
    size: int | None
    """None for a single value; else length of an array, or bound of a sequence (0: unbounded)."""
    is_fixed: bool
    """Whether the field is an array of fixed length."""
    bound: int
    """Maximum length of a string; 0 for no limit."""

    @property
    def is_numbers(self) -> bool:
        """Whether the field is a list of numbers, which rclpy stores in contiguous memory."""
        return self.size is not None and self.base in ARRAY_CODES

    @property
    def is_converted(self) -> bool:
        """Whether the codec of rosbags needs another Python type than the message holds."""
        return (
            self.is_numbers
            or self.base == 'byte'
            or (self.base == 'bool' and self.size is not None)
        )

    @property
    def idl(self) -> str:
        """IDL name of the type, as in ``get_fields_and_field_types``."""
        name = self.base.replace('/msg/', '/') if self.is_message else self.base
        name = _IDL_NAMES.get(name, name) + (f'<{self.bound}>' if self.bound else '')
        if self.size is None:
            return name
        if self.is_fixed:
            return f'{name}[{self.size}]'
        return f'sequence<{name}, {self.size}>' if self.size else f'sequence<{name}>'


@cache
def _store() -> Any:
    """Return the type store with all messages and the supported services."""
    store = get_typestore(Stores.ROS2_JAZZY)
    for name, texts in SERVICES.items():
        for text, part in zip(texts, ('Request', 'Response'), strict=True):
            parsed = get_types_from_msg(text, f'{name.replace("/srv/", "/msg/")}_{part}')
            [(constants, fields)] = parsed.values()
            fields = fields or [(NO_FIELDS, (Nodetype.BASE, ('uint8', 0)))]
            store.fielddefs[f'{name}_{part}'] = (constants, fields)
    return store


def definition(name: str) -> Any:
    """Return the constants and fields of a message type, in the format of rosbags.

    Raises:
        KeyError: the type is unknown.
    """
    return _store().fielddefs[name]


def packages() -> set[str]:
    """Return the names of all packages with known messages or services."""
    return {name.partition('/')[0] for name in _store().fielddefs} | {
        name.partition('/')[0] for name in SERVICES
    }


def names_in(package: str, kind: str) -> list[str]:
    """Return the sorted names of the types in a package; ``kind`` is msg or srv."""
    known = SERVICES if kind == 'srv' else _store().fielddefs
    return sorted(n.rpartition('/')[2] for n in known if n.startswith(f'{package}/{kind}/'))


def fields_of(name: str) -> tuple[Field, ...]:
    """Return the fields of a message type given by its full name; () for an empty message."""
    return tuple(
        field_from_definition(*entry)
        for entry in _store().fielddefs[name][1]
        if entry[0] != NO_FIELDS
    )


def type_hash(name: str) -> str:
    """Return the RIHS01 hash of a message type, by which ROS compares type definitions."""
    return str(_store().hash_rihs01(name))


def field_from_definition(name: str, desc: Any) -> Field:
    """Return a field given by its name and its type in the format of rosbags."""
    size, is_fixed = None, False
    if desc[0] in (Nodetype.ARRAY, Nodetype.SEQUENCE):
        size, is_fixed = desc[1][1], desc[0] == Nodetype.ARRAY
        desc = desc[1][0]
    name = f'{name}_' if keyword.iskeyword(name) else name
    if desc[0] == Nodetype.NAME:
        return Field(name, desc[1], True, size, is_fixed, 0)
    return Field(name, desc[1][0], False, size, is_fixed, desc[1][1])
