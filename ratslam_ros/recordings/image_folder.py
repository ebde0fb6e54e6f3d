# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""A folder of images as a recording, with or without a table of stamps and velocities.

The table is a CSV file with a header. Its columns, in any order:

- ``image``: file name relative to the table; empty in a row that has only odometry;
- ``stamp_s`` (decimal seconds) or ``stamp_ns`` (integer nanoseconds);
- ``linear_x_mps`` and ``angular_z_radps``: odometry, optional; empty in rows without.

Without a table the images are read in natural order (2 before 10) at a constant rate.
"""

import csv
import math
import re
from collections.abc import Iterator
from dataclasses import dataclass
from decimal import Decimal, InvalidOperation
from pathlib import Path

from ratslam_ros.errors import UnusableInput
from ratslam_ros.images import EncodedImage
from ratslam_ros.recordings.events import Event, ImageEvent, OdometryEvent, Orientation
from ratslam_ros.recordings.recording import Recording
from ratslam_ros.recordings.topics import IMAGE_FILES, TABLE, Selection, Topic

IMAGE_SUFFIXES = frozenset(
    {
        '.jpg',
        '.jpeg',
        '.png',
        '.bmp',
        '.pgm',
        '.ppm',
        '.pnm',
        '.tif',
        '.tiff',
        '.webp',
        '.jp2',
    }
)
IMAGES_TOPIC, ODOMETRY_TOPIC = 'images', 'odometry'


@dataclass(frozen=True, slots=True)
class _Row:
    """A row of the table: an image, velocities (m/s, rad/s) or both."""

    stamp_ns: int
    image: Path | None
    motion: tuple[float, float] | None


def natural_key(name: str) -> list[tuple[bool, int, str]]:
    """Return a sort key that compares numbers by value: image2 before image10."""
    return [
        (piece.isdecimal(), int(piece) if piece.isdecimal() else 0, piece)
        for piece in re.split(r'(\d+)', name)
    ]


def image_files(folder: Path) -> list[Path]:
    """Return the image files of a folder in natural order."""
    return sorted(
        (
            path
            for path in folder.iterdir()
            if path.suffix.lower() in IMAGE_SUFFIXES and not path.name.startswith('.')
        ),
        key=lambda path: natural_key(path.name),
    )


def find_table(folder: Path) -> Path | None:
    """Return the table of a folder, None without one; raises UnusableInput if there are two."""
    found = []
    for path in sorted(folder.glob('*.csv')):
        columns = _columns(path)
        if 'image' in columns and columns & {'stamp_s', 'stamp_ns'}:
            found.append(path)
    if len(found) > 1:
        raise UnusableInput(
            f'{folder} holds {len(found)} tables of images: expected one; give one of '
            + ', '.join(map(str, found))
        )
    return found[0] if found else None


class ImageFolder(Recording):
    """The images of a folder, or those that a table lists, as a recording."""

    kind = 'image folder'

    def __init__(self, path: Path, rate_hz: float) -> None:
        """Read the table, or list the images.

        Args:
            path: a folder of images, or a table.
            rate_hz: assumed rate of images without a table.

        Raises:
            UnusableInput: the table, the rate or the folder cannot be used.
        """
        super().__init__(path)
        folder = path if path.is_dir() else path.parent
        table = find_table(path) if path.is_dir() else path
        if table is not None:
            self._rows = _read_table(table)
        elif math.isfinite(rate_hz) and rate_hz > 0.0:
            self._rows = [
                _Row(round(index * 1e9 / rate_hz), image, None)
                for index, image in enumerate(image_files(folder))
            ]
            self._warnings.add(
                f'{folder} holds {len(self._rows)} images and no table of times: an image rate '
                f'of {rate_hz:g} Hz is assumed'
            )
        else:
            raise UnusableInput(f'the rate of the images is {rate_hz:g} Hz: expected more than 0')
        images = sum(row.image is not None for row in self._rows)
        motions = sum(row.motion is not None for row in self._rows)
        if not images:
            raise UnusableInput(f'{path} lists no images: expected at least one')
        self.topics = (Topic(IMAGES_TOPIC, IMAGE_FILES, images),) + (
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
                linear, angular = row.motion
                middle = heading + angular * seconds / 2.0
                x += linear * seconds * math.cos(middle)
                y += linear * seconds * math.sin(middle)
                heading = math.remainder(heading + angular * seconds, math.tau)
            if not start_ns <= row.stamp_ns < stop_ns:
                continue
            if row.motion is not None and selection.odom_topic:
                orientation = Orientation.of_heading(heading)
                yield OdometryEvent(row.stamp_ns, row.stamp_ns, *row.motion, x, y, orientation)
            if row.image is not None and selection.image_topic:
                yield ImageEvent(row.stamp_ns, row.stamp_ns, self._load(row.image))

    def _load(self, path: Path) -> EncodedImage:
        try:
            data = path.read_bytes()
        except OSError as error:
            self._warnings.add(f'{path} cannot be read: {error.strerror}')
            data = b''
        return EncodedImage(data, path.suffix.lstrip('.').lower())


def _columns(path: Path) -> set[str]:
    try:
        with path.open(newline='', encoding='utf-8-sig', errors='replace') as file:
            return {name.strip() for name in next(csv.reader(file), [])}
    except (OSError, csv.Error):
        return set()


def _read_table(path: Path) -> list[_Row]:
    columns = _columns(path)
    if 'image' not in columns or not columns & {'stamp_s', 'stamp_ns'}:
        raise UnusableInput(
            f'{path} has the columns {", ".join(sorted(columns)) or "none"}: expected image, '
            'stamp_s or stamp_ns, and for odometry linear_x_mps and angular_z_radps'
        )
    rows: list[_Row] = []
    with path.open(newline='', encoding='utf-8-sig', errors='replace') as file:
        reader = csv.DictReader(file, skipinitialspace=True)
        reader.fieldnames = [name.strip() for name in reader.fieldnames or ()]
        try:
            for fields in reader:
                rows.append(_row(path.parent, fields))
        except (ValueError, ArithmeticError, csv.Error) as error:
            raise UnusableInput(
                f'{path}, line {reader.line_num}, cannot be used: {error}'
            ) from None
    if not rows:
        raise UnusableInput(f'{path} has no rows: expected one per image')
    return sorted(rows, key=lambda row: row.stamp_ns)


def _row(folder: Path, fields: dict[str, str]) -> _Row:
    values = {
        name: (value or '').strip()
        for name, value in fields.items()
        if isinstance(name, str) and not isinstance(value, list)
    }
    image = folder / values['image'] if values['image'] else None
    if image is not None and not image.is_file():
        raise ValueError(f'the image {image} does not exist')
    linear, angular = values.get('linear_x_mps', ''), values.get('angular_z_radps', '')
    motion = (float(linear), float(angular)) if linear and angular else None
    if motion and not all(map(math.isfinite, motion)):
        raise ValueError(f'expected finite velocities, not {linear} and {angular}')
    return _Row(_stamp_ns(values), image, motion)


def _stamp_ns(values: dict[str, str]) -> int:
    """Return the stamp of a row; decimal arithmetic keeps it exact to the nanosecond."""
    if values.get('stamp_ns'):
        return int(values['stamp_ns'])
    text = values.get('stamp_s', '')
    try:
        return int((Decimal(text) * 1_000_000_000).to_integral_value())
    except (InvalidOperation, OverflowError):
        raise ValueError(f'expected a stamp in seconds, not {text!r}') from None
