# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Layout of a history file, and what is known of the run that it describes."""

from __future__ import annotations

import json
from dataclasses import asdict, dataclass
from pathlib import Path

import msgspec

from ratslam_ros.errors import UnusableInput

HISTORY_NAME = 'history.sqlite'
"""Name of the history in a results folder; it ends with ``PART`` while it grows."""

PART = '.part'
LOCK = '.lock'
"""Suffix of the file beside a growing history that its writer has locked."""

APPLICATION_ID = 0x52534C48  # 'RSLH'
SCHEMA_VERSION = 2

SCHEMA = """
CREATE TABLE meta (key TEXT PRIMARY KEY, value TEXT NOT NULL) WITHOUT ROWID;
CREATE TABLE segments (
    first_record INTEGER PRIMARY KEY, records INTEGER NOT NULL,
    begin_ns INTEGER NOT NULL, end_ns INTEGER NOT NULL,
    first_view INTEGER NOT NULL, views INTEGER NOT NULL,
    data BLOB NOT NULL
);
CREATE INDEX segment_begin ON segments (begin_ns);
CREATE INDEX segment_view ON segments (first_view) WHERE views > 0;
CREATE TABLE checkpoints (
    record_count INTEGER PRIMARY KEY, stamp_ns INTEGER NOT NULL, data BLOB NOT NULL
);
CREATE INDEX checkpoint_stamp ON checkpoints (stamp_ns);
CREATE TABLE visits (
    experience INTEGER NOT NULL, view INTEGER NOT NULL, stamp_ns INTEGER NOT NULL,
    record BLOB NOT NULL, PRIMARY KEY (experience, view)
) WITHOUT ROWID;
CREATE TABLE closures (
    view INTEGER PRIMARY KEY, stamp_ns INTEGER NOT NULL, record BLOB NOT NULL
);
"""

TABLES = 'meta', 'segments', 'checkpoints', 'visits', 'closures'


@dataclass(frozen=True, slots=True)
class HistoryMeta:
    """What is known of a run besides its records; '' if it is unknown.

    Attributes:
        title: name of the run, such as that of the recording.
        map_frame: frame of the poses.
        configuration: all parameters, as YAML.
        recording: path of the recording.
        recording_kind: its format.
        image_topic: topic of its images.
        images_rate_hz: rate of images without times, as for ``open_recording``.
        ratslam_version: version of this package.
    """

    title: str
    map_frame: str = 'map'
    configuration: str = ''
    recording: str = ''
    recording_kind: str = ''
    image_topic: str = ''
    images_rate_hz: float = 10.0
    ratslam_version: str = ''

    def to_json(self) -> str:
        """Return all fields as JSON."""
        return json.dumps(asdict(self))

    @classmethod
    def from_json(cls, text: str, path: Path) -> HistoryMeta:
        """Return what ``to_json`` has written; raises UnusableInput."""
        try:
            return msgspec.json.decode(text, type=cls)
        except msgspec.DecodeError:
            raise UnusableInput(
                f'{path}: the description of the run is damaged; replay the recording again'
            ) from None


def part_path(path: Path) -> Path:
    """Return the name that a history has while it grows."""
    return path.with_name(path.name + PART)


def lock_path(path: Path) -> Path:
    """Return the file that the writer of a history has locked; ``path``: its final name."""
    return path.with_name(path.name + LOCK)
