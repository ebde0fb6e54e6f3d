# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Descriptions of the JSON payloads on pages of the documentation, from the declarations.

A page has two marks for a topic, between which are an example, and tables of the keys with their
types, ranges, units and meanings.
"""

from __future__ import annotations

import ast
import math
import re
from collections.abc import Iterator
from importlib import import_module
from inspect import getsource
from itertools import pairwise
from pkgutil import iter_modules
from typing import Any

from msgspec import inspect

from ratslam_ros import messages
from ratslam_ros.messages.json_schema import Payload, Stamp, bare, decode, encode_json

for _module in iter_modules(messages.__path__):
    import_module(f'{messages.__name__}.{_module.name}')
PAYLOADS = {kind.TOPIC: kind for kind in Payload.__subclasses__() if kind.TOPIC}
"""Declared payloads by their topics."""

BEGIN, END = '<!-- Payload of {}, by `make docs`; do not edit. -->\n', '<!-- End. -->\n'
_DESCRIPTION = re.compile(BEGIN.format(r'(\S+)') + f'.*?{END}', re.DOTALL)

UNITS = {
    'per_m_rad': 'rad/m', '_rad': 'rad', '_mrad': 'mrad', '_m': 'm', '_mm': 'mm', '_s': 's',
    '_ms': 'ms', '_ns': 'ns',
}
"""Units of numbers, by the ends of their names."""


def with_payloads(page: str) -> str:
    """Return a page with the present descriptions in the places of its last ones."""
    return _DESCRIPTION.sub(lambda found: description(PAYLOADS[found[1]]), page)


def description(kind: type[Payload]) -> str:
    """Return the example and the tables of a payload, with the marks around them."""
    declared = bare(inspect.type_info(kind))
    text = encode_json(_example(declared))
    decode(kind, text)
    parts = [BEGIN.format(kind.TOPIC), f'```json\n{text}\n```\n\n', _table(declared)]
    inner: dict[type, tuple[inspect.StructType, list[str]]] = {}
    for field in declared.fields:
        for struct in _structs(field.type):
            if issubclass(kind, struct.cls):
                continue  # it has the same keys
            inner.setdefault(struct.cls, (struct, []))[1].append(f'`{field.encode_name}`')
    for struct, names in inner.values():
        parts.append(f'\n{" and ".join(names)}:\n\n{_table(struct)}')
    return ''.join([*parts, END])


def _structs(kind: inspect.Type) -> Iterator[inspect.StructType]:
    """Yield the objects within a type that have a table of their own."""
    match bare(kind):
        case inspect.StructType(cls=cls) as struct:
            if cls is not Stamp:
                yield struct
        case inspect.ListType(item_type=item):
            yield from _structs(item)
        case inspect.UnionType(types=kinds):
            for one in kinds:
                yield from _structs(one)


def _meanings(kind: type) -> dict[str, str]:
    """Return the docstrings of the keys of a payload, as parts of sentences."""
    found: dict[str, str] = {}
    for base in kind.__mro__:
        if not base.__module__.startswith(messages.__name__):
            continue
        for line, text in pairwise(ast.parse(getsource(base)).body[0].body):
            match line, text:
                case ast.AnnAssign(target=ast.Name(id=name)), ast.Expr(ast.Constant(str(meaning))):
                    meaning = ' '.join(meaning.removesuffix('.').split())
                    found.setdefault(name, meaning[0].lower() + meaning[1:])
    return found


def _table(struct: inspect.StructType) -> str:
    rows: list[list[str]] = []
    meanings = _meanings(struct.cls)
    for field in struct.fields:
        value = '' if field.required else 'optional '
        value += _value(field.encode_name, field.type)
        name, meaning = f'`{field.encode_name}`', meanings.get(field.name, '')
        if not meaning and rows and rows[-1][1] == value:
            rows[-1][0] += f', {name}'
        else:
            rows.append([name, value, meaning])
    lines = ['key | value | meaning', '--- | --- | ---', *map(' | '.join, rows)]
    return ''.join(f'| {line} |\n' for line in lines)


def _examples(kind: inspect.Type) -> Any:
    return (getattr(kind, 'extra_json_schema', None) or {}).get('examples')


def _value(name: str, kind: inspect.Type) -> str:
    """Return type, range and unit of a key."""
    match bare(kind):
        case inspect.StructType(cls=cls):
            return 'stamp' if cls is Stamp else 'object'
        case inspect.ListType(item_type=item) | inspect.VarTupleType(item_type=item):
            return f'list of: {_value(name, item)}'
        case inspect.TupleType(item_types=items):
            different = dict.fromkeys(_value(name, item) for item in items)
            return f'list of {len(items)}: {"; ".join(different)}'
        case inspect.DictType(value_type=value):
            return f'object of: {_value(name, value)}'
        case inspect.UnionType(types=kinds):
            return ' or '.join(_value(name, one) for one in kinds)
        case inspect.LiteralType(values=values):
            return ', '.join(f'`{value}`' for value in values)
        case inspect.StrType(max_length=length):
            return 'text' if length is None else f'text, at most {length} characters'
        case inspect.IntType() | inspect.FloatType() as number:
            return _number(name, number)
    names: dict[Any, str] = {
        inspect.BoolType: 'true or false', inspect.NoneType: 'null', inspect.AnyType: 'any value',
        inspect.BytesType: 'text in Base64',
    }
    return names[type(bare(kind))]


def _number(name: str, kind: inspect.IntType | inspect.FloatType) -> str:
    low, high = kind.ge, kind.le
    if kind.lt is not None:
        high = kind.lt - 1
    text = 'integer' if isinstance(kind, inspect.IntType) else 'number'
    unit = next((f' {unit}' for end, unit in UNITS.items() if name.endswith(end)), '')
    if low is None:
        return text + (unit and f' in{unit}')
    between = f'at least {_shown(low)}' if high is None else f'{_shown(low)} to {_shown(high)}'
    return f'{text}, {between}{unit}'


def _shown(limit: float) -> str:
    sign, size = '-' * (limit < 0), abs(limit)
    symbols = {math.pi: 'π', math.tau: '2π', 2**31 - 1: '2^31 - 1', 2**63 - 1: '2^63 - 1'}
    if size >= 1e6 and size == 10 ** round(math.log10(size)):
        return f'{sign}10^{round(math.log10(size))}'
    return sign + symbols.get(size, f'{size:g}')


def _example(kind: inspect.Type) -> Any:
    """Return the annotated example of a type, or a value that it has."""
    found = _examples(kind)
    if found and found[0] is not ...:
        return found[0]
    match bare(kind):
        case inspect.StructType(fields=fields, tag=tag, tag_field=tag_field):
            values = {
                field.encode_name: _example(field.type) for field in fields
                if field.required or _examples(field.type)
            }
            return values if tag_field is None else {tag_field: tag, **values}
        case inspect.ListType(item_type=item) | inspect.VarTupleType(item_type=item):
            return [_example(item)]
        case inspect.TupleType(item_types=items):
            return [_example(item) for item in items]
        case inspect.UnionType(types=kinds):
            return _example(kinds[0])
        case inspect.LiteralType(values=values):
            return values[0]
    simple: dict[Any, Any] = {
        inspect.BoolType: False, inspect.IntType: 1, inspect.FloatType: 0.5, inspect.StrType: '',
        inspect.DictType: {},
    }
    return simple[type(bare(kind))]
