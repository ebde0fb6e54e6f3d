# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Encoding and strict decoding that all JSON payloads share.

Stamps are integers ``sec`` and ``nanosec``. Numbers are written like Python's repr and are never
NaN, and keys have a fixed order, so that equal content gives equal bytes.
"""

from __future__ import annotations

import json
import math
import reprlib
from collections.abc import Mapping
from typing import Any

from ratslam_ros.errors import UnusableInput

SCHEMA_VERSION = 1
NS_PER_S = 1_000_000_000
MAX_ID = 2**31 - 1
"""Largest accepted id of a template or experience."""

MAX_PAYLOAD_CHARACTERS = 2**20
"""Largest accepted payload. Those of one step, and lists of goals, are below 100 kB."""

MAX_TEXT_CHARACTERS = 1000
"""Largest accepted text, such as the reason why a goal was not reached."""

_REPR = reprlib.Repr()
_REPR.maxstring = _REPR.maxother = 90
_REPR.maxlevel = 3


class MalformedMessage(UnusableInput):
    """A payload that does not match its schema; no part of it is used."""


def encode_json(value: Any) -> str:
    """Return a value as compact JSON; raises ValueError if a number is not finite."""
    return json.dumps(value, allow_nan=False, separators=(',', ':'))


def shown(value: Any) -> str:
    """Return a value for an error message: at most some 100 characters of its repr."""
    return _REPR.repr(value)[:100]


def decode_fields(
    payload: str, name: str, types: Mapping[str, type], most: int = MAX_PAYLOAD_CHARACTERS
) -> dict[str, Any]:
    """Return the fields of a payload after checking its version and the types of its fields.

    Args:
        payload: JSON text.
        name: name of the topic, for error messages.
        types: expected type by key; further keys are ignored.
        most: largest accepted length of the payload.

    Raises:
        MalformedMessage: the payload is too long or not a JSON object, has another schema version,
            or a field is missing, of the wrong type, too long or not finite.
    """
    if len(payload) > most:
        raise MalformedMessage(f'{name}: {len(payload)} characters; expected at most {most}')
    try:
        fields = json.loads(payload)
    except (ValueError, RecursionError) as error:
        raise MalformedMessage(f'{name}: not JSON ({error}); expected an object') from None
    if not isinstance(fields, dict):
        raise MalformedMessage(f'{name}: {type(fields).__name__}; expected an object')
    version = fields.get('schema_version')
    if type(version) is not int or version != SCHEMA_VERSION:
        raise MalformedMessage(
            f'{name}: schema_version is {shown(version)}; expected '
            f'{SCHEMA_VERSION}: sender and receiver are of different versions'
        )
    check_types(fields, name, types)
    return fields


def check_types(fields: dict[str, Any], name: str, types: Mapping[str, type]) -> None:
    """Check that fields have the expected types, converting integers to expected floats in place.

    Raises:
        MalformedMessage: a field is missing, of the wrong type or not finite.
    """
    for key, expected in types.items():
        value = fields.get(key)
        if expected is float and type(value) is int and abs(value) < 2**53:
            value = fields[key] = float(value)
        if not isinstance(value, expected) or (expected is int and isinstance(value, bool)):
            raise MalformedMessage(
                f'{name}: {key} is {shown(value)}; expected {expected.__name__}'
            )
        if isinstance(value, str):
            check_text(name, key, value, MAX_TEXT_CHARACTERS)
        if isinstance(value, float) and not math.isfinite(value):
            raise MalformedMessage(f'{name}: {key} is {value!r}; expected a finite number')


def check_text(name: str, key: str, text: str, most: int) -> None:
    """Raise MalformedMessage if a text is too long, or contains control characters.

    Texts appear in logs, where control characters could forge lines, and in messages of ROS, which
    cannot hold half a surrogate pair.
    """
    if len(text) > most or not text.isprintable():
        raise MalformedMessage(
            f'{name}: {key} is {shown(text)}; expected at most {most} printable characters'
        )


def check_range(name: str, key: str, value: float, low: float, high: float) -> None:
    """Raise MalformedMessage if a value is not within [low, high]."""
    if not low <= value <= high:
        raise MalformedMessage(
            f'{name}: {key} is {shown(value)}; expected {low:.4g} to {high:.4g}'
        )


def encode_stamp(stamp_ns: int) -> dict[str, int]:
    """Split a stamp in ns into ``sec`` and ``nanosec``."""
    return {'sec': stamp_ns // NS_PER_S, 'nanosec': stamp_ns % NS_PER_S}


def decode_stamp(stamp: Mapping[str, Any]) -> int:
    """Return a stamp in ns; raises MalformedMessage if a part is no valid non-negative integer."""
    sec, nanosec = stamp.get('sec'), stamp.get('nanosec')
    if (
        type(sec) is not int
        or type(nanosec) is not int
        or not 0 <= sec < 2**31
        or not 0 <= nanosec < NS_PER_S
    ):
        raise MalformedMessage(
            f'stamp is {shown(dict(stamp))}; expected integers, sec below 2^31 and nanosec below '
            '10^9'
        )
    return sec * NS_PER_S + nanosec
