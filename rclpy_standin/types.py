# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Message and service classes, generated from their definitions, and their CDR encoding.

As in rclpy, lists of numbers are converted on assignment: to numpy.ndarray if their length is
fixed, else to array.array. All other values are stored unchanged and checked when the message is
encoded. The codec of rosbags requires NumPy arrays and small integers where rclpy has array.array,
lists of bool, and bytes. It accesses such fields through properties with a prefix.
"""

from __future__ import annotations

import array
import struct
from collections.abc import Callable, Iterator
from contextlib import suppress
from functools import cache
from typing import Any, ClassVar, NoReturn

import numpy as np
from numpy.typing import NDArray
from rosbags.interfaces import Nodetype
from rosbags.serde import SerdeError
from rosbags.typesys import Stores, get_typestore

from rclpy_standin.definitions import (
    ARRAY_CODES,
    NO_FIELDS,
    Field,
    definition,
    field_from_definition,
    fields_of,
)
from rclpy_standin.service_texts import SERVICES

_INTEGERS = {
    f'{sign}int{bits}': (0, 2**bits - 1) if sign else (-(2 ** (bits - 1)), 2 ** (bits - 1) - 1)
    for sign in ('', 'u')
    for bits in (8, 16, 32, 64)
} | {'char': (0, 255)}
_DEFAULTS = {
    ('geometry_msgs/msg/Quaternion', 'w'): '1.0',
    ('sensor_msgs/msg/NavSatStatus', 'status'): '-2',
}
"""Defaults that are not zero or empty, as source code; the type store has no defaults."""
_WIRE_PREFIX = '_wire_'
"""Prefix of the properties that the codec of rosbags reads."""
_STORED_PREFIX = '_held_'
"""Prefix of the attributes that store lists of numbers."""
_HEADER_BYTES = 4
_ALIGNMENT_BYTES = 4


class Message:
    """Base of all message classes, with comparison and representation."""

    __slots__ = ()
    __msgtype__: ClassVar[str]
    FIELDS: ClassVar[tuple[Field, ...]]

    @classmethod
    def get_fields_and_field_types(cls) -> dict[str, str]:
        """Return the IDL type of each field by its name."""
        return {field.name: field.idl for field in cls.FIELDS}

    def __eq__(self, other: object) -> bool:
        if not isinstance(other, type(self)):
            return False
        for field in self.FIELDS:
            own, others = getattr(self, field.name), getattr(other, field.name)
            if not (np.array_equal(own, others) if field.is_fixed else own == others):
                return False
        return True

    __hash__ = None  # type: ignore[assignment]

    def __repr__(self) -> str:
        parts = []
        for field in self.FIELDS:
            value = getattr(self, field.name)
            shown = value.tolist() if hasattr(value, 'tolist') else value
            parts.append(f'{field.name}={shown!r}')
        return f'{type(self).__module__}.{type(self).__name__}({", ".join(parts)})'


@cache
def _codec() -> Any:
    """Return the type store for encoding and decoding, which uses the prefixed properties."""
    return get_typestore(Stores.EMPTY)


# Classes


@cache
def message_class(name: str) -> Any:
    """Return the class of a message type given by its full name.

    Raises:
        KeyError: the type is unknown.
    """
    constants, definitions = definition(name)
    fields = fields_of(name)
    package, kind, short = name.split('/')
    body: dict[str, Any] = {
        '__slots__': tuple((_STORED_PREFIX if f.is_numbers else '') + f.name for f in fields),
        '__module__': f'{package}.{kind}',
        '__doc__': f'Message class {short!r}.',
        '__msgtype__': name,
        'FIELDS': fields,
    }
    if not fields:
        body[NO_FIELDS] = 0
    for constant, base, value in constants:
        body[constant] = bytes([value & 255]) if base == 'byte' else value
    for field in fields:
        if field.is_numbers:
            body[field.name] = _numbers(field)
        if field.is_converted:
            body[_WIRE_PREFIX + field.name] = property(_to_wire(field))
    made = type(short, (Message,), body)
    scope: dict[str, Any] = {'cls': made, 'array': array.array, 'np': np, 'fail': _fail}
    for field in fields:
        if field.is_message:
            scope[f'class_{field.name}'] = message_class(field.base)
            scope[f'check_{field.name}'] = _checker(field.base)
        elif field.is_converted:
            scope[f'from_wire_{field.name}'] = _from_wire(field)
    exec('\n'.join(_code(name, fields)), scope)
    made.__init__ = scope['__init__']  # type: ignore[misc]
    _checkers[name] = scope['check']
    codec = _codec()
    codec.fielddefs[name] = ([], [_wire_definition(*entry) for entry in definitions])
    codec.types[name] = scope['from_wire']
    return made


_checkers: dict[str, Callable[[Any], None]] = {}


def _checker(name: str) -> Callable[[Any], None]:
    message_class(name)
    return _checkers[name]


@cache
def service_class(name: str) -> Any:
    """Return the class of a service type given by its full name.

    Raises:
        KeyError: the type is unknown.
    """
    if name not in SERVICES:
        raise KeyError(name)
    package, _, short = name.split('/')
    body = {
        '__module__': f'{package}.srv',
        '__doc__': f'Service class {short!r}.',
        '__srvtype__': name,
        'Request': message_class(f'{name}_Request'),
        'Response': message_class(f'{name}_Response'),
    }
    return type(short, (), body)


def _code(name: str, fields: tuple[Field, ...]) -> Iterator[str]:
    """Yield the source of ``__init__``, ``from_wire`` and ``check``.

    They run for every message, so that their loops over the fields are unrolled.
    """
    names = [field.name for field in fields]
    yield f'def __init__(self{", *, " if names else ""}{", ".join(f"{n}=None" for n in names)}):'
    yield '    pass'
    for field in fields:
        default = _DEFAULTS.get((name, field.name)) or _default(field)
        yield f'    if {field.name} is None:'
        yield f'        self.{_STORED_PREFIX if field.is_numbers else ""}{field.name} = {default}'
        yield '    else:'
        yield f'        self.{field.name} = {field.name}'
    yield f'def from_wire({", ".join(names) or "_"}):'
    yield '    self = cls.__new__(cls)'
    for field in fields:
        value = f'from_wire_{field.name}({field.name})' if field.is_converted else field.name
        yield f'    self.{_STORED_PREFIX if field.is_numbers else ""}{field.name} = {value}'
    yield '    return self'
    yield 'def check(self):'
    yield '    pass'
    for field in fields:
        yield f'    value = self.{field.name}'
        if field.size:
            invalid = '!=' if field.is_fixed else '>'
            yield f'    if len(value) {invalid} {field.size}: fail(self, {field.name!r}, value)'
        if field.size is None:
            yield from _check_one(field, 'value', '    ')
        elif not field.is_numbers:
            yield f'    if isinstance(value, (str, bytes)): fail(self, {field.name!r}, value)'
            yield '    for item in value:'
            yield from _check_one(field, 'item', '        ')


def _default(field: Field) -> str:
    if field.is_numbers:
        if field.is_fixed:
            return f'np.zeros({field.size}, np.{_dtype(field)})'
        return f'array({ARRAY_CODES[field.base]!r})'
    one = f'class_{field.name}()' if field.is_message else {
        'string': "''", 'bool': 'False', 'byte': "b'\\0'", 'float32': '0.0', 'float64': '0.0',
    }.get(field.base, '0')
    if field.size is None:
        return one
    return f'[{one} for _ in range({field.size})]' if field.is_fixed else '[]'


def _check_one(field: Field, value: str, indent: str) -> Iterator[str]:
    if field.is_message:
        valid = f'type({value}) is class_{field.name}'
    elif field.base in _INTEGERS:
        low, high = _INTEGERS[field.base]
        valid = f'isinstance({value}, (int, np.integer)) and {low} <= {value} <= {high}'
    elif field.base == 'byte':
        valid = f'isinstance({value}, bytes) and len({value}) == 1'
    else:
        # rclpy encodes numbers that are no floats as garbage; an error is easier to find.
        kind = {'string': 'str', 'bool': 'bool'}.get(field.base, 'float')
        valid = f'isinstance({value}, {kind})'
        if field.bound:
            valid += f' and len({value}) <= {field.bound}'
    yield f'{indent}if not ({valid}): fail(self, {field.name!r}, {value})'
    if field.is_message:
        yield f'{indent}check_{field.name}({value})'


def _fail(message: Message, name: str, value: object) -> NoReturn:
    expected = message.get_fields_and_field_types()[name]
    shown = repr(value)
    shown = shown if len(shown) < 60 else f'{shown[:57]}...'
    raise TypeError(
        f'{message.__msgtype__}.{name}: expected {expected}, not {type(value).__name__} {shown}'
    )


# Conversion between the fields of messages and the values of rosbags' codec


def _wire_definition(name: str, desc: Any) -> tuple[str, Any]:
    field = field_from_definition(name, desc)
    if name == NO_FIELDS or not field.is_converted:
        return name, desc
    base: Any = (Nodetype.BASE, ('uint8' if field.base in ('byte', 'char') else field.base, 0))
    return _WIRE_PREFIX + field.name, base if field.size is None else (desc[0], (base, field.size))


def _dtype(field: Field) -> str:
    return {'byte': 'uint8', 'char': 'uint8'}.get(field.base, field.base)


def _to_wire(field: Field) -> Callable[[Any], Any]:
    name = field.name
    if field.size is None:
        return lambda message: getattr(message, name)[0]
    if field.base == 'bool':
        return lambda message: np.array(getattr(message, name), bool)
    if field.base == 'byte':
        return lambda message: np.array(list(b''.join(getattr(message, name))), np.uint8)
    held = _STORED_PREFIX + name
    return lambda message: np.asarray(getattr(message, held))


def _numbers(field: Field) -> property:
    """Return the property for a list of numbers, which converts on assignment."""
    name, held, code = field.name, _STORED_PREFIX + field.name, ARRAY_CODES[field.base]
    dtype = np.dtype(_dtype(field))

    def get(message: Message) -> Any:
        return getattr(message, held)

    def assign(message: Message, value: Any) -> None:
        setattr(message, held, (fixed if field.is_fixed else sequence)(message, value))

    def fixed(message: Message, value: Any) -> NDArray[Any]:
        with suppress(TypeError, ValueError, OverflowError):
            made = np.array(value, dtype)
            if made.shape == (field.size,):
                return made
        _fail(message, name, value)

    def sequence(message: Message, value: Any) -> array.array[Any]:
        if isinstance(value, array.array) and value.typecode == code:
            return value
        if isinstance(value, np.ndarray) and value.dtype == dtype and value.ndim == 1:
            made = array.array(code)
            made.frombytes(np.ascontiguousarray(value).view(np.uint8).data)
            return made
        with suppress(TypeError, ValueError, OverflowError):
            return array.array(code, value)
        _fail(message, name, value)

    return property(get, assign)


def _from_wire(field: Field) -> Callable[[Any], Any]:
    if field.size is None:
        return lambda value: bytes((value,))
    if field.base == 'bool':
        return lambda value: value.tolist()
    if field.base == 'byte':
        return lambda value: [bytes((item,)) for item in value]
    if field.is_fixed:
        return lambda value: value.copy()
    code = ARRAY_CODES[field.base]

    def numbers(value: NDArray[Any]) -> array.array[Any]:
        made = array.array(code)
        made.frombytes(value.view(np.uint8).data)
        return made

    return numbers


# CDR


def encode(message: Message, reserved_bytes: int = 0) -> bytearray:
    """Encode a message as CDR with its 4-byte header, padded to a multiple of 4 bytes.

    Args:
        message: any message.
        reserved_bytes: space between header and body, set to 0; a multiple of 8.

    Raises:
        TypeError: the value of a field does not fit its type.
    """
    name = message.__msgtype__
    try:
        _checkers[name](message)
        codec = _codec().get_msgdef(name)
        size = codec.getsize_cdr(0, message, _codec())
        out = bytearray(
            -(-(_HEADER_BYTES + reserved_bytes + size) // _ALIGNMENT_BYTES) * _ALIGNMENT_BYTES
        )
        out[1] = 1  # little-endian
        codec.serialize_cdr_le(
            memoryview(out)[_HEADER_BYTES + reserved_bytes :], 0, message, _codec()
        )
    except (AttributeError, ValueError, SerdeError, struct.error) as error:
        raise TypeError(f'{name} cannot be serialised: {error}') from error
    return out


def decode(data: bytes | memoryview, kind: type[Message], reserved_bytes: int = 0) -> Any:
    """Decode a message from CDR.

    Args:
        data: CDR with its 4-byte header; the message does not refer to this memory.
        kind: class of the message.
        reserved_bytes: space between header and body.

    Raises:
        ValueError: the bytes do not encode such a message.
    """
    name = kind.__msgtype__
    codec = _codec().get_msgdef(name)
    view = memoryview(data)
    if len(view) < _HEADER_BYTES + reserved_bytes or view[0] != 0 or view[1] > 1:
        raise ValueError(f'{name}: unknown encoding {bytes(view[:_HEADER_BYTES]).hex()}')
    read = codec.deserialize_cdr_le if view[1] else codec.deserialize_cdr_be
    body = view[_HEADER_BYTES + reserved_bytes :]
    try:
        message, end = read(body, 0, codec.cls, _codec())
    except (SerdeError, ValueError, struct.error) as error:
        raise ValueError(f'{name} cannot be deserialised: {error}') from error
    if not 0 <= len(body) - end < _ALIGNMENT_BYTES:
        raise ValueError(
            f'{name} cannot be deserialised: it has {end} bytes, but {len(body)} were received'
        )
    return message


def decode_or_none(data: memoryview, kind: type[Message], reserved_bytes: int = 0) -> Any:
    """Decode a message from CDR; return None if the bytes are invalid. See ``decode``."""
    try:
        return decode(data, kind, reserved_bytes)
    except ValueError:
        return None
