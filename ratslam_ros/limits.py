# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Limits of inputs that may come from others, and bounded reading of files.

Every limit is far above what a robot needs, and low enough that the input of one call can exhaust
neither the memory nor the patience of the user. docs/security.md lists them all.
"""

from __future__ import annotations

import os
import sqlite3
from pathlib import Path
from typing import Any

from ratslam_ros.errors import UnusableInput

MAX_PIXELS = 2**26
"""Largest accepted image: 8192 x 8192. Panoramas of 11K are smaller; 192 MiB in colour."""

MAX_MESSAGE_BYTES = 4 * MAX_PIXELS + 2**20
"""Largest accepted message of a recording: the largest image with four bytes per pixel."""

MAX_CHUNK_BYTES = 2**30
"""Largest accepted chunk of a recording. Recorders start a new one after 1 to 4 MiB, and exceed
that by one message at most."""

MAX_CONFIG_BYTES = 2**20
"""Largest accepted configuration. One with all parameters and comments has 50 kB."""

MAX_YAML_DEPTH = 32
"""Largest accepted depth of nested YAML. Parameter files and metadata have at most 8 levels."""

MAX_LINE_CHARACTERS = 10_000
"""Largest accepted length of a line of a table or trajectory. Usual ones have 200."""

MAX_COORDINATE_M = 1e9
"""Largest accepted coordinate. Coordinates of the Earth are below 1e7 m."""

IMAGES_RATE_HZ = 10.0
"""Assumed rate of images without times; here, because the command line imports little else."""


def limit_images() -> None:
    """Have OpenCV refuse images by the size in their header, before it allocates memory.

    OpenCV reads this setting once, when it is imported, so that this has to happen before. A value
    set by the user has priority.
    """
    os.environ.setdefault('OPENCV_IO_MAX_IMAGE_PIXELS', str(MAX_PIXELS))


def read_limited(path: Path, most: int, what: str) -> bytes:
    """Return the content of a file.

    Args:
        path: the file.
        most: largest accepted size in bytes.
        what: the expected content, for the error message.

    Raises:
        OSError: the file cannot be read.
        UnusableInput: the file is larger.
    """
    with path.open('rb') as file:
        data = file.read(most + 1)
    if len(data) > most:
        raise UnusableInput(
            f'{path} has more than {most} bytes; expected {what}, which is smaller'
        )
    return data


def load_yaml(text: str, loader: Any = None) -> Any:
    """Return the content of a YAML text without aliases, tags of Python, or deep nesting.

    A few lines with aliases can stand for billions of values. ROS 2 does not accept aliases in
    parameter files either. libyaml's constructor recurses in C, so the depth is checked first.

    Args:
        text: the text.
        loader: subclass of ``yaml.SafeLoader``; None for the default one.

    Raises:
        yaml.YAMLError: the text is not YAML.
        ValueError: it has an alias, is nested too deeply, or has a scalar that is out of range.
    """
    import yaml

    fast: Any = getattr(yaml, 'CSafeLoader', yaml.SafeLoader)
    depth = 0
    events: Any = yaml.parse(text, fast)
    for event in events:
        line = event.start_mark.line + 1
        if isinstance(event, yaml.AliasEvent):
            raise ValueError(
                f'line {line} has the alias *{event.anchor}; expected the '
                'value itself, because aliases are not accepted'
            )
        depth += isinstance(event, yaml.CollectionStartEvent)
        depth -= isinstance(event, yaml.CollectionEndEvent)
        if depth > MAX_YAML_DEPTH:
            raise ValueError(
                f'line {line} is nested {depth} levels deep; expected at '
                f'most {MAX_YAML_DEPTH}'
            )
    return yaml.load(text, loader or fast)


def guard_database(database: sqlite3.Connection, longest: int) -> None:
    """Restrict a database that was made by others, before its first query.

    Functions in its schema are not called, no other database can be attached, damaged pages are
    noticed, and no value or row may be longer than a limit. Extensions are never loaded.

    Args:
        database: the connection.
        longest: largest accepted value or row, in bytes.
    """
    database.text_factory = lambda text: text.decode(errors='replace')
    database.setlimit(sqlite3.SQLITE_LIMIT_LENGTH, longest)
    database.setlimit(sqlite3.SQLITE_LIMIT_ATTACHED, 0)
    for setting in ('trusted_schema = OFF', 'cell_size_check = ON', 'mmap_size = 0'):
        database.execute(f'PRAGMA {setting}')


def schema_of(database: sqlite3.Connection) -> list[tuple[str, str, str, str | None]]:
    """Return type, name, table and SQL of everything in a database, by name.

    Raises:
        sqlite3.Error: the database is damaged.
    """
    try:
        return database.execute(
            'SELECT type, name, tbl_name, sql FROM sqlite_schema ORDER BY name'
        ).fetchall()
    except MemoryError:  # Damaged pages claim rows of any length.
        raise sqlite3.DatabaseError('its schema is damaged') from None


def check_tables(database: sqlite3.Connection, path: Path, tables: tuple[str, ...]) -> None:
    """Check that a database has tables that only store values.

    Views, triggers, virtual tables and generated columns run the SQL of whoever made the file,
    which may take for ever.

    Args:
        database: the connection.
        path: its file, for the error message.
        tables: names of the tables that will be read.

    Raises:
        sqlite3.Error: the database is damaged.
        UnusableInput: a table is missing, or is none that only stores values.
    """
    found = {name: sql for kind, name, _, sql in schema_of(database) if kind == 'table'}
    missing = [name for name in tables if name not in found]
    if missing:
        raise UnusableInput(
            f'{path} is a database without the table {missing[0]}; expected '
            f'{", ".join(tables)}: give a file that ratslam_ros or the recorder wrote'
        )
    for name in tables:
        is_virtual = str(found[name]).lstrip().upper().startswith('CREATE VIRTUAL')
        columns = list(database.execute(f'PRAGMA table_xinfo("{name}")'))
        if is_virtual or any(hidden for *_, hidden in columns):
            raise UnusableInput(
                f'{path}: the table {name} computes its values; expected one that stores them: '
                'the file was not written by ratslam_ros or a recorder'
            )


def is_below(path: str, folder: str) -> bool:
    """Return whether a path that was received is a folder, or a file in it, or below it.

    Symbolic links are followed first, so that none leads out of the folder.
    """
    root = Path(folder).expanduser().resolve()
    return path.isprintable() and Path(path).expanduser().resolve().is_relative_to(root)
