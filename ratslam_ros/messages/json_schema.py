# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Encoding and strict decoding that all JSON payloads share.

Stamps are integers ``sec`` and ``nanosec``. Numbers are written like Python's repr and are never
NaN, and keys have a fixed order, so that equal content gives equal bytes.
"""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from typing import Any

from ratslam_ros.errors import UnusableInput

SCHEMA_VERSION = 1
NS_PER_S = 1_000_000_000
MAX_ID = 2**31 - 1
"""Largest accepted id of a template or experience."""


class MalformedMessage(UnusableInput):
    """A payload that does not match its schema; no part of it is used."""


def encode_json(value: Any) -> str:
    """Return a value as compact JSON; raises ValueError if a number is not finite."""
    return json.dumps(value, allow_nan=False, separators=(',', ':'))


def decode_fields(payload: str, name: str, types: Mapping[str, type]) -> dict[str, Any]:
    """Return the fields of a payload after checking its version and the types of its fields.

    Args:
        payload: JSON text.
        name: name of the topic, for error messages.
        types: expected type by key; further keys are ignored.

    Raises:
        MalformedMessage: the payload is not a JSON object, has another schema version, or a field
            is missing, of the wrong type or not finite.
    """
    try:
        fields = json.loads(payload)
    except (ValueError, RecursionError) as error:
        raise MalformedMessage(f'{name}: not JSON ({error}); expected an object') from None
    if not isinstance(fields, dict):
        raise MalformedMessage(f'{name}: {type(fields).__name__}; expected an object')
    version = fields.get('schema_version')
    if type(version) is not int or version != SCHEMA_VERSION:
        raise MalformedMessage(
            f'{name}: schema_version is {version!r}; expected '
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
            raise MalformedMessage(f'{name}: {key} is {value!r}; expected {expected.__name__}')
        if isinstance(value, float) and not math.isfinite(value):
            raise MalformedMessage(f'{name}: {key} is {value!r}; expected a finite number')


def check_range(name: str, key: str, value: float, low: float, high: float) -> None:
    """Raise MalformedMessage if a value is not within [low, high]."""
    if not low <= value <= high:
        raise MalformedMessage(f'{name}: {key} is {value}; expected {low:.4g} to {high:.4g}')


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
            f'stamp is {dict(stamp)!r}; expected integers, sec below 2^31 and nanosec below 10^9'
        )
    return sec * NS_PER_S + nanosec
