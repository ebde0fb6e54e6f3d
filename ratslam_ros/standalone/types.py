# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Message and service classes, made from the definitions that rosbags has, and their CDR.

As in rclpy, lists of numbers become array.array (numpy.ndarray where their length is fixed) when
they are set, and all else is kept as it is: only when a message is sent, it is checked. rosbags'
codec wants NumPy arrays and small integers where rclpy has array.array, lists of bool and bytes;
it sees such fields through properties of another name.
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

from ratslam_ros.standalone.definitions import (
    ARRAY_CODES,
    NO_FIELDS,
    Field,
    definition,
    field_from_definition,
    fields_of,
)
from ratslam_ros.standalone.service_texts import SERVICES

_INTEGERS = {
    f'{sign}int{bits}': (0, 2**bits - 1) if sign else (-(2 ** (bits - 1)), 2 ** (bits - 1) - 1)
    for sign in ('', 'u')
    for bits in (8, 16, 32, 64)
} | {'char': (0, 255)}
_DEFAULTS = {
    ('geometry_msgs/msg/Quaternion', 'w'): '1.0',
    ('sensor_msgs/msg/NavSatStatus', 'status'): '-2',
}
"""All that is not zero or empty; the type store does not know defaults."""
_WIRE = '_wire_'
_HELD = '_held_'
_HEADER = 4
_PADDED = 4


class Message:
    """Base of all message classes: keyword construction, attributes, comparison."""

    __slots__ = ()
    __msgtype__: ClassVar[str]
    FIELDS: ClassVar[tuple[Field, ...]]

    @classmethod
    def get_fields_and_field_types(cls) -> dict[str, str]:
        """Return the IDL type of each field, by its name."""
        return {field.name: field.idl for field in cls.FIELDS}

    def __eq__(self, other: object) -> bool:
        if not isinstance(other, type(self)):
            return False
        for field in self.FIELDS:
            mine, theirs = getattr(self, field.name), getattr(other, field.name)
            if not (np.array_equal(mine, theirs) if field.is_fixed else mine == theirs):
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
    """Return the store that encodes and decodes: fields under the names of the properties."""
    return get_typestore(Stores.EMPTY)


# The classes


@cache
def message_class(name: str) -> Any:
    """Return the class of a message type given by its full name.

    Raises:
        KeyError: there is no such type.
    """
    constants, definitions = definition(name)
    fields = fields_of(name)
    package, kind, short = name.split('/')
    body: dict[str, Any] = {
        '__slots__': tuple((_HELD if f.is_numbers else '') + f.name for f in fields),
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
            body[_WIRE + field.name] = property(_to_wire(field))
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
        KeyError: there is no such type.
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
    """Yield the source of what is called for every message, with no loop over its fields."""
    names = [field.name for field in fields]
    yield f'def __init__(self{", *, " if names else ""}{", ".join(f"{n}=None" for n in names)}):'
    yield '    pass'
    for field in fields:
        default = _DEFAULTS.get((name, field.name)) or _default(field)
        yield f'    if {field.name} is None:'
        yield f'        self.{_HELD if field.is_numbers else ""}{field.name} = {default}'
        yield '    else:'
        yield f'        self.{field.name} = {field.name}'
    yield f'def from_wire({", ".join(names) or "_"}):'
    yield '    self = cls.__new__(cls)'
    for field in fields:
        value = f'from_wire_{field.name}({field.name})' if field.is_converted else field.name
        yield f'    self.{_HELD if field.is_numbers else ""}{field.name} = {value}'
    yield '    return self'
    yield 'def check(self):'
    yield '    pass'
    for field in fields:
        yield f'    value = self.{field.name}'
        if field.size:
            wrong = '!=' if field.is_fixed else '>'
            yield f'    if len(value) {wrong} {field.size}: fail(self, {field.name!r}, value)'
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
    }.get(field.base, '0')  # fmt: skip
    if field.size is None:
        return one
    return f'[{one} for _ in range({field.size})]' if field.is_fixed else '[]'


def _check_one(field: Field, value: str, indent: str) -> Iterator[str]:
    if field.is_message:
        right = f'type({value}) is class_{field.name}'
    elif field.base in _INTEGERS:
        low, high = _INTEGERS[field.base]
        right = f'isinstance({value}, (int, np.integer)) and {low} <= {value} <= {high}'
    elif field.base == 'byte':
        right = f'isinstance({value}, bytes) and len({value}) == 1'
    else:
        # Numbers that are no float are garbage on the wire of rclpy: found here, not there.
        kind = {'string': 'str', 'bool': 'bool'}.get(field.base, 'float')
        right = f'isinstance({value}, {kind})'
        if field.bound:
            right += f' and len({value}) <= {field.bound}'
    yield f'{indent}if not ({right}): fail(self, {field.name!r}, {value})'
    if field.is_message:
        yield f'{indent}check_{field.name}({value})'


def _fail(message: Message, name: str, value: object) -> NoReturn:
    expected = message.get_fields_and_field_types()[name]
    shown = repr(value)
    shown = shown if len(shown) < 60 else f'{shown[:57]}...'
    raise TypeError(
        f'{message.__msgtype__}.{name}: expected {expected}, not {type(value).__name__} {shown}'
    )


# Between what a message holds and what rosbags' codec takes and gives


def _wire_definition(name: str, desc: Any) -> tuple[str, Any]:
    field = field_from_definition(name, desc)
    if name == NO_FIELDS or not field.is_converted:
        return name, desc
    base: Any = (Nodetype.BASE, ('uint8' if field.base in ('byte', 'char') else field.base, 0))
    return _WIRE + field.name, base if field.size is None else (desc[0], (base, field.size))


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
    held = _HELD + name
    return lambda message: np.asarray(getattr(message, held))


def _numbers(field: Field) -> property:
    """Return the property of a list of numbers."""
    name, held, code = field.name, _HELD + field.name, ARRAY_CODES[field.base]
    dtype = np.dtype(_dtype(field))

    def give(message: Message) -> Any:
        return getattr(message, held)

    def take(message: Message, value: Any) -> None:
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

    return property(give, take)


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


def encode(message: Message, room: int = 0) -> bytearray:
    """Return a message as CDR, with its four bytes of header, padded to a multiple of 4.

    Args:
        message: any message.
        room: bytes to leave free between header and body; a multiple of 8.

    Raises:
        TypeError: a field holds what does not fit its type.
    """
    name = message.__msgtype__
    try:
        _checkers[name](message)
        codec = _codec().get_msgdef(name)
        size = codec.getsize_cdr(0, message, _codec())
        out = bytearray(-(-(_HEADER + room + size) // _PADDED) * _PADDED)
        out[1] = 1  # little-endian
        codec.serialize_cdr_le(memoryview(out)[_HEADER + room :], 0, message, _codec())
    except (AttributeError, ValueError, SerdeError, struct.error) as error:
        raise TypeError(f'{name} cannot be serialised: {error}') from error
    return out


def decode(data: bytes | memoryview, kind: type[Message], room: int = 0) -> Any:
    """Return the message that CDR holds; see ``encode``.

    Nothing of the message refers to the bytes.

    Raises:
        ValueError: the bytes are no such message.
    """
    name = kind.__msgtype__
    codec = _codec().get_msgdef(name)
    view = memoryview(data)
    if len(view) < _HEADER + room or view[0] != 0 or view[1] > 1:
        raise ValueError(f'{name}: unknown encoding {bytes(view[:_HEADER]).hex()}')
    read = codec.deserialize_cdr_le if view[1] else codec.deserialize_cdr_be
    body = view[_HEADER + room :]
    try:
        message, end = read(body, 0, codec.cls, _codec())
    except (SerdeError, ValueError, struct.error) as error:
        raise ValueError(f'{name} cannot be deserialised: {error}') from error
    if not 0 <= len(body) - end < _PADDED:
        raise ValueError(f'{name} cannot be deserialised: {end} bytes of {len(body)} are used')
    return message


def decode_or_none(data: memoryview, kind: type[Message], room: int = 0) -> Any:
    """Return the message that CDR holds, None where it is no such message; see ``decode``."""
    try:
        return decode(data, kind, room)
    except ValueError:
        return None
