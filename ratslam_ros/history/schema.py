# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Schema of the history file, an SQLite database; the module `writer` uses it."""

FILE_NAME = 'history.sqlite'

APPLICATION_ID = 0x52534C48
"""``RSLH``: marks SQLite files that are histories of this package."""

SCHEMA_VERSION = 1

SCHEMA = """
CREATE TABLE meta (key TEXT PRIMARY KEY, value TEXT NOT NULL) WITHOUT ROWID;
CREATE TABLE segments (
  id INTEGER PRIMARY KEY, first_ns INTEGER NOT NULL, last_ns INTEGER NOT NULL,
  count INTEGER NOT NULL, raw_bytes INTEGER NOT NULL, data BLOB NOT NULL);
CREATE INDEX segment_stamps ON segments (first_ns);
CREATE TABLE checkpoints (
  segment INTEGER PRIMARY KEY, raw_bytes INTEGER NOT NULL, data BLOB NOT NULL);
CREATE TABLE views (
  id INTEGER PRIMARY KEY, stamp_ns INTEGER NOT NULL, segment INTEGER NOT NULL,
  experience INTEGER NOT NULL, kind INTEGER NOT NULL);
CREATE INDEX view_stamps ON views (stamp_ns);
CREATE INDEX view_visits ON views (experience, id) WHERE kind != 0;
CREATE INDEX view_closures ON views (id) WHERE kind >= 2;
"""

NO_VISIT, VISIT, CLOSURE, REJECTION = range(4)
"""Kinds of views: no new visit, an experience becomes current, a loop closes, or would have."""
