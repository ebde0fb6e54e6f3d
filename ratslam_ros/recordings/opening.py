# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Detection of the recording format of a path."""

import math
import re
from collections import Counter
from pathlib import Path

from ratslam_ros.errors import UnusableInput
from ratslam_ros.limits import IMAGES_RATE_HZ
from ratslam_ros.recordings.image_folder import (
    IMAGE_SUFFIXES,
    ImageFolder,
    find_table,
    image_files,
)
from ratslam_ros.recordings.recording import Recording
from ratslam_ros.recordings.rosbag2 import (
    METADATA,
    bag_files,
    first_bytes,
    open_bag,
    storage_kind,
)
from ratslam_ros.recordings.video import VIDEO_SUFFIXES, Video

EXPECTED = 'a rosbag2 folder, a .mcap, .db3 or ROS 1 .bag file, a video or a folder of images'


def open_recording(path: str | Path, *, images_rate_hz: float = IMAGES_RATE_HZ) -> Recording:
    """Open a recording of any supported format.

    Args:
        path: a file or folder.
        images_rate_hz: rate of images that have no table of times, and of a video that does not
            state its frame rate.

    Raises:
        UnusableInput: the path holds no usable recording, or the rate is none. The message is one
            line.
    """
    path = Path(path)
    if not 0.0 < images_rate_hz < math.inf:
        raise UnusableInput(
            f'the rate of the images is {images_rate_hz:g} Hz: expected more than 0'
        )
    try:
        if path.is_dir():
            return _open_folder(path, images_rate_hz)
        if path.is_file():
            return _open_file(path, images_rate_hz)
    except (OSError, ValueError) as error:
        reason = error.strerror if isinstance(error, OSError) and error.strerror else error
        raise UnusableInput(
            f'{path} cannot be read ({reason}): expected {EXPECTED}; check its name and '
            'permissions'
        ) from None
    problem = 'is neither a file nor a folder' if path.exists() else 'does not exist'
    raise UnusableInput(f'{path} {problem}: expected {EXPECTED}; check the path')


def _open_folder(path: Path, rate_hz: float) -> Recording:
    if (path / METADATA).is_file() or bag_files(path):
        return open_bag(path)
    if find_table(path):
        return ImageFolder(path, rate_hz)
    if images := image_files(path):
        _check_images(path, images)
        return ImageFolder(path, rate_hz)
    entries = sorted(entry for entry in path.iterdir() if not entry.name.startswith('.'))
    if not entries:
        raise UnusableInput(f'{path} is an empty folder: expected {EXPECTED}; check the path')
    inside = [
        entry for entry in entries
        if entry.suffix.lower() in VIDEO_SUFFIXES or (entry.is_dir() and (
            (entry / METADATA).is_file() or bag_files(entry) or image_files(entry)
        ))
    ]
    advice = (
        'give one of ' + ', '.join(map(str, inside[:5]))
        if inside
        else f'it holds {", ".join(entry.name for entry in entries[:5])}'
    )
    tables = [entry.name for entry in entries if entry.suffix.lower() == '.csv']
    if inside and tables:
        advice += f', or the table {tables[0]}, to see which columns it lacks'
    raise UnusableInput(f'{path} is a folder without a recording: expected {EXPECTED}; {advice}')


def _check_images(path: Path, images: list[Path]) -> None:
    """Refuse images that lie in a folder by chance, such as those of a home folder.

    Raises:
        UnusableInput: their names differ in more than their numbers, and most of the folder is
            something else.
    """
    patterns = Counter(re.sub(r'\d+', '#', image.name) for image in images)
    alike = patterns.most_common(1)[0][1]
    count = sum(1 for entry in path.iterdir() if not entry.name.startswith('.'))
    if 2 * alike <= len(images) and 2 * len(images) < count:
        raise UnusableInput(
            f'{path} holds {len(images)} images with unrelated names, such as {images[0].name} '
            f'and {images[-1].name}, among {count} files and folders: expected the images of one '
            'camera, whose names differ in their numbers; give the folder of a recording, or '
            'list its images in a table (docs/recordings.md)'
        )


def _open_file(path: Path, rate_hz: float) -> Recording:
    head = first_bytes(path)
    suffix = path.suffix.lower()
    if storage_kind(head) is not None or path.name.endswith(('.mcap', '.db3', '.bag', '.zstd')):
        return open_bag(path)
    if path.name == METADATA:
        return open_bag(path.parent)
    if suffix in VIDEO_SUFFIXES:
        return Video(path, rate_hz)
    if suffix == '.csv':
        return ImageFolder(path, rate_hz)
    if suffix in IMAGE_SUFFIXES:
        raise UnusableInput(
            f'{path} is a single image: expected {EXPECTED}; give its folder {path.parent}'
        )
    raise UnusableInput(
        f'{path} begins with {head!r}, which is no known recording format: expected {EXPECTED}'
    )
