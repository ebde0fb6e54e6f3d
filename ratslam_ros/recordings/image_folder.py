# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""A folder of images as a recording, with or without a table of stamps and velocities.

The table is a CSV file with a header; ``table_columns`` finds its columns: times, images (file
names relative to the table, empty in a row that has only odometry), and optionally velocities
(empty in rows without odometry).

Without a table, the names of the images are their stamps if all are Unix times. Otherwise they are
read in natural order (2 before 10) at a constant rate.
"""

import csv
import math
import os
import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from decimal import Decimal
from itertools import repeat
from pathlib import Path

from ratslam_ros.errors import UnusableInput
from ratslam_ros.images import EncodedImage
from ratslam_ros.limits import MAX_MESSAGE_BYTES, read_limited
from ratslam_ros.recordings.events import Event, ImageEvent, OdometryEvent, Orientation
from ratslam_ros.recordings.recording import Recording
from ratslam_ros.recordings.table_columns import (
    IMAGE,
    SIDEWAYS,
    SPEED,
    TIME,
    TURN_RATE,
    Columns,
    Quantity,
)
from ratslam_ros.recordings.topics import IMAGE_FILES, TABLE, Selection, Topic

IMAGE_SUFFIXES = frozenset({
    '.jpg', '.jpeg', '.png', '.bmp', '.pgm', '.ppm', '.pnm', '.tif', '.tiff', '.webp', '.jp2',
})
UNIX_TIME = re.compile(r'(?<!\d)(\d{10}(?:\.\d+)?|\d{13}|\d{16}|\d{19})$')
"""A number at the end of a name that may be a Unix time: in s, or an integer in ms, us or ns."""

UNIX_TIMES_NS = range(10**18, 4 * 10**18)
"""Unix times from 2001 to 2096. Names that count images with ten digits are below."""

IMAGES_TOPIC, ODOMETRY_TOPIC = 'images', 'odometry'


@dataclass(frozen=True, slots=True)
class _Row:
    """A row of the table: an image, velocities or both.

    motion: speed ahead (m/s), turn rate (rad/s) and speed to the left (m/s).
    """

    stamp_ns: int
    image: Path | None
    motion: tuple[float, float, float] | None


def natural_key(name: str) -> list[tuple[bool, int, str]]:
    """Return a sort key that compares numbers by value: image2 before image10."""
    return [
        (piece.isdecimal(), int(piece) if piece.isdecimal() else 0, piece)
        for piece in re.split(r'(\d+)', name)
    ]


def image_files(folder: Path) -> list[Path]:
    """Return the image files of a folder in natural order."""
    return sorted(
        (path for path in folder.iterdir()
         if path.suffix.lower() in IMAGE_SUFFIXES and not path.name.startswith('.')),
        key=lambda path: natural_key(path.name),
    )


def _stamps_of(images: Sequence[Path]) -> list[int]:
    """Return the Unix times in ns that are the names of images; [] unless all are, and differ."""
    stamps_ns = []
    for image in images:
        found = UNIX_TIME.search(image.stem)
        if found is None:
            return []
        digits = len(found[1].partition('.')[0])
        stamps_ns.append(int(Decimal(found[1]).scaleb(19 - digits)))
    is_time = len(set(stamps_ns)) == len(images) and all(
        stamp_ns in UNIX_TIMES_NS for stamp_ns in stamps_ns
    )
    return stamps_ns if is_time else []


def find_table(folder: Path) -> Path | None:
    """Return the table of a folder, None without one.

    Raises:
        UnusableInput: there are two tables, or only one that lacks a column.
    """
    columns = _columns_in(folder)
    found = [path for path, one in columns.items() if one.is_table]
    if len(found) > 1:
        raise UnusableInput(
            f'{folder} holds {len(found)} tables of images: expected one; give one of '
            + ', '.join(map(str, found))
        )
    if not found and image_files(folder):
        for one in columns.values():
            if one.is_nearly:
                one.check()
    return found[0] if found else None


def _columns_in(folder: Path) -> dict[Path, Columns]:
    """Return the columns of each CSV file of a folder."""
    return {path: Columns(path, _header(path)) for path in sorted(folder.glob('*.csv'))}


class ImageFolder(Recording):
    """The images of a folder, or those that a table lists, as a recording."""

    kind = 'image folder'

    def __init__(self, path: Path, rate_hz: float) -> None:
        """Read the table, or list the images.

        Args:
            path: a folder of images, or a table.
            rate_hz: assumed rate of images without a table.

        Raises:
            UnusableInput: the table or the folder cannot be used.
        """
        super().__init__(path)
        folder = path if path.is_dir() else path.parent
        table = find_table(path) if path.is_dir() else path
        if table is not None:
            columns = Columns(table, _header(table))
            self.notices = (str(columns),)
            self._rows = _read_table(table, columns)
            for other, found in _columns_in(folder).items():
                if found.is_nearly and not found.is_table:
                    self.warn(f'{other} is not used: the table is {table}')
        elif stamps_ns := _stamps_of(images := image_files(folder)):
            self.notices = ('the names of the images are used as their times (Unix)',)
            self._rows = sorted(
                map(_Row, stamps_ns, images, repeat(None)), key=lambda row: row.stamp_ns
            )
        else:
            self._rows = [
                _Row(round(index * 1e9 / rate_hz), image, None)
                for index, image in enumerate(images)
            ]
            files = _columns_in(folder).items()
            listing = [one.name for one, columns in files if IMAGE in columns]
            self._warnings.add(
                f'{folder} holds {len(self._rows)} images and no table of times'
                + (f' ({", ".join(listing)} has none)' if listing else '')
                + f': an image rate of {rate_hz:g} Hz is assumed'
            )
        if path.is_dir():
            listed = {row.image for row in self._rows if row.image is not None}
            self.files = [*([] if table is None else [table]), *sorted(listed)]
        count = sum(row.image is not None for row in self._rows)
        motions = sum(row.motion is not None for row in self._rows)
        if not count:
            raise UnusableInput(f'{path} lists no images: expected at least one')
        self.topics = (Topic(IMAGES_TOPIC, IMAGE_FILES, count),) + (
            (Topic(ODOMETRY_TOPIC, TABLE, motions),) if motions else ()
        )
        self.start_ns, self.end_ns = self._rows[0].stamp_ns, self._rows[-1].stamp_ns

    def read_events(self, selection: Selection, start_ns: int, stop_ns: int) -> Iterator[Event]:
        """Yield the selected events with start_ns <= log_ns < stop_ns."""
        x = y = heading = 0.0
        before_ns = self.start_ns
        for row in self._rows:
            if row.motion is not None:
                # A row's velocity applies to the interval that ends at its stamp, as in ROS.
                seconds, before_ns = (row.stamp_ns - before_ns) / 1e9, row.stamp_ns
                linear, angular, sideways = row.motion
                middle = heading + angular * seconds / 2.0
                x += linear * seconds * math.cos(middle)
                y += linear * seconds * math.sin(middle)
                if sideways:
                    x -= sideways * seconds * math.sin(middle)
                    y += sideways * seconds * math.cos(middle)
                heading = math.remainder(heading + angular * seconds, math.tau)
            if not start_ns <= row.stamp_ns < stop_ns:
                continue
            if row.motion is not None and selection.odom_topic:
                orientation = Orientation.of_heading(heading)
                yield OdometryEvent(
                    row.stamp_ns, row.stamp_ns, linear, angular, x, y, orientation, sideways
                )
            if row.image is not None and selection.image_topic:
                yield ImageEvent(row.stamp_ns, row.stamp_ns, self._load(row.image))

    def _load(self, path: Path) -> EncodedImage:
        try:
            data = read_limited(path, MAX_MESSAGE_BYTES, 'an image')
        except (OSError, UnusableInput) as error:
            reason = getattr(error, 'strerror', error)
            self._warnings.add(f'{path} cannot be read: {reason}')
            data = b''
        return EncodedImage(data, path.suffix.lstrip('.').lower())


def _header(path: Path) -> list[str]:
    try:
        with path.open(newline='', encoding='utf-8-sig', errors='replace') as file:
            line = file.readline()
        return [name.strip() for name in next(csv.reader([line], delimiter=_delimiter(line)), [])]
    except (OSError, csv.Error):
        return []


def _delimiter(header: str) -> str:
    """Return what separates the columns: spreadsheets export commas, semicolons or tabs."""
    return max(',;\t', key=header.count)


def _read_table(path: Path, columns: Columns) -> list[_Row]:
    columns.check()
    rows: list[_Row] = []
    with path.open(newline='', encoding='utf-8-sig', errors='replace') as file:
        delimiter = _delimiter(file.readline())
        file.seek(0)
        reader = csv.DictReader(file, delimiter=delimiter, skipinitialspace=True)
        reader.fieldnames = [name.strip() for name in reader.fieldnames or ()]
        try:
            for fields in reader:
                rows.append(_row(path.parent, columns, fields))
        except (ValueError, ArithmeticError, csv.Error) as error:
            raise UnusableInput(
                f'{path}, line {reader.line_num}, cannot be used: {error}'
            ) from None
    if not rows:
        raise UnusableInput(f'{path} has no rows: expected one per image')
    return sorted(rows, key=lambda row: row.stamp_ns)


def _row(folder: Path, columns: Columns, fields: dict[str, str]) -> _Row:
    def text_of(quantity: Quantity) -> str:
        return (fields[columns[quantity].name] or '').strip() if quantity in columns else ''

    name = text_of(IMAGE)
    image = folder / name if name else None
    if image is not None and not os.path.isfile(image):  # False for names of any length
        raise ValueError(f'the image {str(image)[:200]} does not exist')
    motion = None
    if text_of(SPEED) and text_of(TURN_RATE):
        speed, turn_rate, sideways = (
            _number(text_of(quantity) or '0', quantity) * columns[quantity].factor
            if quantity in columns else 0.0 for quantity in (SPEED, TURN_RATE, SIDEWAYS)
        )
        motion = speed, turn_rate, sideways
    return _Row(_stamp_ns(text_of(TIME), columns), image, motion)


def _number(text: str, quantity: Quantity) -> float:
    try:
        number = float(text)
    except ValueError:
        number = math.nan
    if not math.isfinite(number):
        raise ValueError(
            f'expected a number with a decimal point for the {quantity.label}, or none in a row '
            f'without odometry, not {text[:40]!r}'
        )
    return number


def _stamp_ns(text: str, columns: Columns) -> int:
    """Return a stamp; decimal arithmetic keeps it exact to the nanosecond."""
    column = columns[TIME]
    try:
        number = Decimal(int(text) if column.unit == 'ns' else text)
        stamp_ns = int((number * int(column.factor)).to_integral_value())
    except (ValueError, ArithmeticError):
        raise ValueError(f'expected a time in {column.unit}, not {text[:40]!r}') from None
    if stamp_ns < 0:
        raise ValueError(
            f'expected a time of 0 or more, not {text[:40]}: add a number to all times'
        )
    if stamp_ns >= 2**63:
        raise ValueError(
            f'a time of {text[:40]} {column.unit} is out of range: rename the column '
            f'{column.name}, as in time_ns or time_ms, if it has another unit'
        )
    return stamp_ns
