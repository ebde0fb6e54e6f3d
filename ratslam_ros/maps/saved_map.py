# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""A map as it was saved: the states of its parts, and what is known of its origin."""

from __future__ import annotations

import hashlib
import json
from dataclasses import asdict, dataclass
from decimal import Decimal
from pathlib import Path
from typing import Any, Self

import msgspec

from ratslam_ros.core.common.state import State
from ratslam_ros.maps.chunks import DamagedData

NS_PER_S = 1_000_000_000

MAX_META = 2**20
"""Longest accepted description of a session; a configuration has 20,000 characters."""

CHECKSUM = 'checksum'
"""Key of the checksum in a description."""


@dataclass(frozen=True, slots=True)
class Cut:
    """A moment in stamps up to which a part has processed its messages.

    Attributes:
        number: the same for all parts; it increases within a session.
        stamp_ns: the stamp.
    """

    number: int
    stamp_ns: int


@dataclass(frozen=True, slots=True)
class MapMeta:
    """What is known of a session besides its states; '' or 0 if it is unknown.

    Attributes:
        title: name of the map, such as that of the recording.
        ratslam_version: version of this package.
        configuration: all parameters, as YAML.
        recording: path of the recording; '' for a live session.
        recording_bytes: its size.
        first_ns: its first stamp.
    """

    title: str = ''
    ratslam_version: str = ''
    configuration: str = ''
    recording: str = ''
    recording_bytes: int = 0
    first_ns: int = 0

    def to_json(self) -> str:
        """Return all fields as JSON."""
        values = asdict(self)
        return json.dumps({**values, CHECKSUM: _checksum(values)})

    @classmethod
    def from_json(cls, text: Any) -> Self:
        """Return what ``to_json`` has written; unknown fields are ignored.

        Raises:
            DamagedData: it is damaged.
        """
        try:
            if len(text) > MAX_META:
                raise ValueError(f'{len(text)} characters, expected at most {MAX_META}')
            values: Any = json.loads(text)
            checksum = values.pop(CHECKSUM, None)  # Files of version 0.1 have none.
            if checksum is not None and checksum != _checksum(values):
                raise ValueError('its checksum does not match')
            return msgspec.convert(values, cls)
        except (ValueError, TypeError, AttributeError, RecursionError) as error:
            raise DamagedData(f'the description of a session is damaged ({error})') from None


def _checksum(values: dict[str, Any]) -> str:
    text = json.dumps(values, sort_keys=True)
    return hashlib.blake2b(text.encode(), digest_size=16).hexdigest()


@dataclass(frozen=True, slots=True)
class SessionRow:
    """A session of a map.

    Attributes:
        number: of the session, from 1.
        meta: what is known of it.
        lost: stamps from which and to which the session before it is missing, None if nothing is.
        ended: whether all parts have been closed.
    """

    number: int
    meta: MapMeta
    lost: tuple[int, int] | None
    ended: bool


@dataclass(frozen=True)
class SavedMap:
    """The newest state of a map at which all parts belong together.

    Attributes:
        path: the file or folder.
        meta: what is known of its last session.
        cut: where the states end, None if nothing has been saved.
        states: by part.
        sessions: oldest first.
        notes: what a user should know, such as what is missing; one line each.
        digests: hashes of the states by part.
    """

    path: Path
    meta: MapMeta
    cut: Cut | None
    states: dict[str, State]
    sessions: list[SessionRow]
    notes: list[str]
    digests: dict[str, bytes]

    @property
    def digest(self) -> str:
        """Canonical digest: maps with the same states have the same, whoever wrote them."""
        hasher = hashlib.blake2b(digest_size=16)
        for part in sorted(self.digests):
            hasher.update(f'{part}\n'.encode() + self.digests[part])
        return hasher.hexdigest()


def loss_note(lost: tuple[int, int], cut: Cut | None) -> str:
    """Return in one line what of a session is missing."""
    begin_ns, end_ns = lost
    span = f'{(end_ns - begin_ns) / NS_PER_S:.2f} s are missing, up to stamp {seconds(end_ns)} s'
    if cut is None:
        return f'nothing of the map was saved before it was interrupted: {span}'
    return (
        f'the last session was interrupted: the map is of stamp {seconds(cut.stamp_ns)} s; {span}'
    )


def interruption_note(cut: Cut | None) -> str:
    """Return in one line what a new session misses if only the source of the last one knows it."""
    if cut is None:
        return 'nothing of the map was saved before it was interrupted: all until then may be lost'
    after = seconds(cut.stamp_ns)
    return f'the last session was interrupted: what came after {after} s may be lost'


def seconds(stamp_ns: int) -> str:
    """Return a stamp in seconds with all digits."""
    return f'{Decimal(stamp_ns).scaleb(-9).normalize():f}'
