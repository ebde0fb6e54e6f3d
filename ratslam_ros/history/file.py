# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Layout of a history file, and what is known of the run that it describes."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from ratslam_ros.limits import IMAGES_RATE_HZ
from ratslam_ros.maps.saved_map import MapMeta
from ratslam_ros.maps.schema import Layout, beside

HISTORY_NAME = 'history.sqlite'
"""Name of the history in a results folder; it ends with ``PART`` while it grows."""

PART = '.part'

HISTORY = Layout(
    'history', 0x52534C48, 4, advice='replay the recording again', synchronous='OFF', schema="""
CREATE TABLE meta (key TEXT PRIMARY KEY, value TEXT NOT NULL) WITHOUT ROWID;
CREATE TABLE segments (
    first_record INTEGER PRIMARY KEY, begin_ns INTEGER NOT NULL, end_ns INTEGER NOT NULL,
    data BLOB NOT NULL
);
CREATE TABLE checkpoints (
    record_count INTEGER PRIMARY KEY, stamp_ns INTEGER NOT NULL, data BLOB NOT NULL
);
CREATE TABLE visits (
    experience INTEGER NOT NULL, number INTEGER NOT NULL, stamp_ns INTEGER NOT NULL,
    record BLOB NOT NULL, PRIMARY KEY (experience, number)
) WITHOUT ROWID;
""")
"""Its application id is the text `RSLH`."""


@dataclass(frozen=True, slots=True)
class HistoryMeta(MapMeta):
    """What is known of a run besides its records; '' if it is unknown.

    Attributes:
        image_topic: topic of the images of the recording.
        images_rate_hz: rate of images without times, as for ``open_recording``.
    """

    image_topic: str = ''
    images_rate_hz: float = IMAGES_RATE_HZ


def part_path(path: Path) -> Path:
    """Return the name that a history has while it grows."""
    return beside(path, PART)
