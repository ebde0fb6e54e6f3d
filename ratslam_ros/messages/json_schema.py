# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Encoding and strict decoding of all JSON payloads, as their classes declare them.

Stamps are integers ``sec`` and ``nanosec``. Numbers are written with the digits of Python's repr
and are never NaN, and keys have the order of the declaration, so that equal content gives equal
bytes. Classes have a constructor ``of``, and properties with the types of core.

``make docs`` writes the tables in docs/topics.md: the range of a key is in its annotation, and its
meaning in the docstring below. A key without a docstring shares that of the key before. Examples
have all required keys, and of the others those with ``examples``, where ``...`` stands for an
example that is made of those of the parts.
"""

from __future__ import annotations

import json
import math
import re
import reprlib
from collections.abc import Sequence
from contextlib import suppress
from functools import cache
from typing import Annotated, Any, ClassVar, TypeVar

import msgspec
import numpy as np
from msgspec import UNSET, Meta, Struct, inspect

from ratslam_ros.errors import UnusableInput

SCHEMA_VERSION = 1
NS_PER_S = 1_000_000_000
MAX_ID = 2**31 - 1
"""Largest accepted id of a template or experience."""

MAX_PAYLOAD_CHARACTERS = 2**20
"""Largest accepted payload. Those of one step, and lists of goals, are below 100 kB."""

Id = Annotated[int, Meta(ge=0, le=MAX_ID)]
OptionalId = Annotated[int, Meta(ge=-1, le=MAX_ID)]
"""An id, or -1 for none."""
Count = Annotated[int, Meta(ge=0, le=2**63 - 1)]
"""A number of a message, or a stamp in ns."""
Angle = Annotated[float, Meta(ge=-math.pi, le=math.pi)]
Text = Annotated[str, Meta(max_length=1000)]
"""A text such as the reason why a goal was not reached."""

_ENCODER = json.JSONEncoder(allow_nan=False, check_circular=False, separators=(',', ':'))
_ROWS = msgspec.json.Encoder(enc_hook=np.generic.item)
_PATH = re.compile(r'\.(\w+)|\[(\d+)\]')
_REPR = reprlib.Repr()
_REPR.maxstring = _REPR.maxother = 90
_REPR.maxlevel = 3


class MalformedMessage(UnusableInput):
    """A payload that does not match its schema; no part of it is used."""


class Stamp(Struct, frozen=True):
    """A stamp in a payload."""

    sec: Annotated[int, Meta(ge=0, lt=2**31, examples=[1_700_000_012])]
    nanosec: Annotated[int, Meta(ge=0, lt=NS_PER_S, examples=[500_000_000])]

    @classmethod
    def of(cls, stamp_ns: int) -> Stamp:
        """Return a stamp in ns for a payload."""
        return cls(*divmod(stamp_ns, NS_PER_S))

    @property
    def ns(self) -> int:
        """Stamp in ns."""
        return self.sec * NS_PER_S + self.nanosec


class Payload(Struct, frozen=True, tag_field='schema_version', tag=SCHEMA_VERSION):
    """Base class of all payloads, which begin with ``schema_version``.

    Attributes:
        TOPIC: name of the topic, for error messages.
        MAX_CHARACTERS: largest accepted length of a payload.
        IS_TYPED: whether people type such payloads, which may leave out ``schema_version``.
    """

    TOPIC: ClassVar[str] = ''
    MAX_CHARACTERS: ClassVar[int] = MAX_PAYLOAD_CHARACTERS
    IS_TYPED: ClassVar[bool] = False


class _NoVersion(Struct, frozen=True, tag_field='schema_version', tag=-1):
    """Never sent. msgspec requires a tag only where it must choose between two classes."""


P = TypeVar('P', bound=Payload)


def encode_json(value: Any) -> str:
    """Return a value as compact JSON; raises ValueError if a number is not finite."""
    return _ENCODER.encode(value)


def encode(payload: Payload) -> str:
    """Return a payload as JSON, without the fields that are UNSET.

    Raises:
        ValueError: a number is not finite.
    """
    return encode_json(msgspec.to_builtins(payload, enc_hook=np.generic.item))


def encode_rows(rows: Sequence[Struct]) -> bytes:
    """Return the items of a JSON list in UTF-8, eight times faster than by ``encode``.

    msgspec formats exponents and letters beyond ASCII differently than ``encode``: 1e-7 instead of
    1e-07. The values are the same.

    Raises:
        ValueError: a number is not finite.
    """
    text = _ROWS.encode(rows)[1:-1]
    if b'null' in text:  # as msgspec writes NaN
        encode_json(msgspec.to_builtins(rows, enc_hook=np.generic.item))
    return text


def only_if(condition: bool, value: Any) -> Any:
    """Return a value, or UNSET, which is not written: receivers use the default of the field."""
    return value if condition else UNSET


def finite(value: float) -> float | None:
    """Return a number, or None if it is infinite, which JSON cannot express."""
    return value if math.isfinite(value) else None


def decode(kind: type[P], payload: str) -> P:
    """Return the content of a payload; integers are accepted for floats, and unknown keys ignored.

    Raises:
        MalformedMessage: the payload is too long or not a JSON object, has another schema version,
            or a field is missing, of the wrong type, out of its range or not printable.
    """
    if len(payload) > kind.MAX_CHARACTERS:
        raise MalformedMessage(
            f'{kind.TOPIC}: {len(payload)} characters; expected at most {kind.MAX_CHARACTERS}'
        )
    try:
        decoded = _decoder(kind).decode(payload)
    except msgspec.ValidationError as error:
        raise MalformedMessage(_explained(kind, payload, str(error))) from None
    except (ValueError, RecursionError) as error:
        raise MalformedMessage(
            f'{kind.TOPIC}: {shown(payload)} is not JSON ({error}); expected an object'
        ) from None
    if not isinstance(decoded, kind):
        raise MalformedMessage(f'{kind.TOPIC}: schema_version is -1; expected {SCHEMA_VERSION}')
    if not payload.isascii() or '\\' in payload or '\x7f' in payload:
        _check_printable(kind.TOPIC, '', decoded)
    return decoded


@cache
def _decoder(kind: type[P]) -> msgspec.json.Decoder[P | _NoVersion]:
    return msgspec.json.Decoder(kind if kind.IS_TYPED else kind | _NoVersion)


def shown(value: Any) -> str:
    """Return a value for an error message: at most some 100 characters of its repr."""
    return _REPR.repr(value)[:100]


def bare(kind: inspect.Type) -> Any:
    """Return a declared type without its annotation."""
    return kind.type if isinstance(kind, inspect.Metadata) else kind


def _explained(kind: type[Payload], payload: str, problem: str) -> str:
    """Return an error of msgspec in one line, with the value that was found."""
    problem, _, path = problem.partition(' - at `$')
    found: Any = payload
    with suppress(ValueError, RecursionError, LookupError, TypeError):
        found = json.loads(payload)
        for key, index in _PATH.findall(path):
            found = found[key or int(index)]
    where = path.strip('.`')
    if where == 'schema_version':
        problem = f'expected {SCHEMA_VERSION}: sender and receiver are of different versions'
    elif problem.startswith('Invalid enum value'):
        declared = {one.encode_name: one.type for one in bare(inspect.type_info(kind)).fields}
        problem = f'expected {", ".join(bare(declared[where]).values)}'
    elif 'unknown field' in problem and not where:
        problem = f'{problem[:100]}; expected {", ".join(kind.__struct_encode_fields__)}'
    problem = problem.replace('Object missing required field', 'expected the key')
    problem = problem.encode('unicode_escape').decode()[:300]
    return (
        f'{kind.TOPIC}: {where and f"{where} is "}{shown(found)}; '
        f'{problem[0].lower()}{problem[1:]}'
    )


def _check_printable(topic: str, key: str, value: Any) -> None:
    """Raise MalformedMessage if a text within a value contains control characters.

    Texts appear in logs, where control characters could forge lines, and in messages of ROS, which
    cannot hold half a surrogate pair.
    """
    inner: list[tuple[str, Any]] = []
    if isinstance(value, str):
        if not value.isprintable():
            raise MalformedMessage(
                f'{topic}: {key} is {shown(value)}; expected printable characters'
            )
    elif isinstance(value, Struct):
        inner = [(name, getattr(value, name)) for name in value.__struct_fields__]
    elif isinstance(value, dict):
        inner = [(key, text) for text in (*value, *value.values())]
    elif isinstance(value, list | tuple) and value and not isinstance(value[0], int | float):
        inner = [(key, one) for one in value]
    for name, one in inner:
        _check_printable(topic, name, one)
