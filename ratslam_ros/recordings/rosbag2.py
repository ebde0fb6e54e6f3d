# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Opening of rosbag2 folders, folders of ROS 1 bags and single files, with their metadata.

Files that cannot be read in place are copied to a temporary folder.
"""

import shutil
from collections.abc import Iterator, Sequence
from contextlib import ExitStack, closing, contextmanager
from itertools import pairwise
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import yaml
import zstandard
from msgspec import Struct, convert
from msgspec.structs import replace

from ratslam_ros.errors import UnusableInput
from ratslam_ros.limits import load_yaml, read_limited
from ratslam_ros.recordings.bag import BagRecording
from ratslam_ros.recordings.image_folder import natural_key
from ratslam_ros.recordings.mcap_file import MCAP_MAGIC, McapFile
from ratslam_ros.recordings.rosbag1 import ROSBAG1_MAGIC, Rosbag1File
from ratslam_ros.recordings.salvage import ZSTD_MAGIC
from ratslam_ros.recordings.sqlite_file import SQLITE_MAGIC, SqliteFile
from ratslam_ros.recordings.stored_file import StoredFile
from ratslam_ros.recordings.stream import Warnings

METADATA = 'metadata.yaml'
MAX_METADATA_BYTES = 2**25  # 100,000 files or topics.
BAG_SUFFIXES = ('.mcap', '.db3', '.bag', '.mcap.zstd', '.db3.zstd')


_SMALL_BYTES = 2**30
_MAX_RATIO = 1000
"""Files may unpack to 1 GiB, or to 1000 times their size; recordings of images without any texture
reach 300. A file that fills the disk would harm other programs."""

APART_S, OVERLAP_S = 60.0, 1.0
"""Time between two files of a folder, and time that both cover, from which they are hardly parts
of one recording: a recorder begins the next file at once."""


class _TopicMetadata(Struct):
    name: str
    serialization_format: str


class _TopicCount(Struct):
    topic_metadata: _TopicMetadata
    message_count: int


class _FileCount(Struct):
    path: str
    message_count: int


class _Metadata(Struct):
    """The part of metadata.yaml that is used."""

    relative_file_paths: list[str]
    topics_with_message_count: list[_TopicCount]
    message_count: int | None
    files: list[_FileCount] | None = None

    @property
    def names(self) -> list[str]:
        """Names of the files, in order."""
        return [Path(name).name for name in self.relative_file_paths]


UNKNOWN = _Metadata([], [], None)


def bag_files(folder: Path) -> list[Path]:
    """Return the files in a folder that have the suffix of a bag, in natural order."""
    return sorted(
        (path for path in folder.iterdir() if path.name.endswith(BAG_SUFFIXES) and path.is_file()),
        key=lambda path: natural_key(path.name),
    )


def open_bag(path: Path) -> BagRecording:
    """Open a rosbag2 folder, a folder of ROS 1 bags or a single bag file."""
    warnings = Warnings()
    storages: list[StoredFile] = []
    if path.is_dir():
        metadata = _read_metadata(path, warnings)
        files = _files_to_read(path, metadata, warnings)
    else:
        metadata, files = _metadata_beside(path), [path]
    refusals = []
    file_counts = {Path(one.path).name: one.message_count for one in metadata.files or ()}
    with ExitStack() as opened:
        for file in files:
            expected = file_counts.get(file.name)
            if expected is None and len(files) == 1:
                expected = metadata.message_count
            try:
                storages.append(_open_file(file, warnings, opened, expected))
            except UnusableInput as error:
                if len(files) == 1:
                    raise
                refusals.append(str(error))  # The other files of a split recording may be intact.
        if not storages:
            raise UnusableInput(refusals[0])
        for text in refusals:
            warnings.add(text)
        if path.is_dir() and not metadata.names:
            _warn_of_several(storages, files[0], warnings)
        whole = not refusals and len(storages) == len(metadata.names)
        topics = metadata.topics_with_message_count
        recording = BagRecording(
            path, storages, warnings, opened,
            {one.topic_metadata.name: one.message_count for one in topics} if whole else None,
            {one.topic_metadata.name: one.topic_metadata.serialization_format for one in topics},
        )
        if path.is_dir():
            recording.files = [path / METADATA, *files]
        return recording


def _warn_of_several(storages: Sequence[StoredFile], first: Path, warnings: Warnings) -> None:
    """Warn if the files that lie in a folder seem to be several recordings."""
    filled = [one for one in storages if one.end_ns >= one.start_ns]
    for before, after in pairwise(sorted(filled, key=lambda one: one.start_ns)):
        apart_s = (after.start_ns - before.end_ns) * 1e-9
        topics = [{channel.topic for channel in one.channels} for one in (before, after)]
        if apart_s > APART_S:
            found = f'are {apart_s:.0f} s apart'
        elif apart_s < -OVERLAP_S and topics[0] & topics[1]:
            found = 'hold the same topics at the same time'
        else:
            continue
        warnings.add(
            f'two of the {len(storages)} files in {first.parent} {found}: they are read as one '
            f'recording; if they are several, give one, such as {first}'
        )
        return


def _open_file(
    path: Path, warnings: Warnings, opened: ExitStack, expected: int | None
) -> StoredFile:
    """Open one file, to be closed with ``opened``."""
    kind, plain = storage_kind(first_bytes(path)), path
    if kind == 'zstd':
        plain, whole = decompressed(path, opened)
        if not whole:
            warnings.add(
                f'{path.name} is truncated or damaged: only the part before that was decompressed'
            )
        if not plain.stat().st_size:
            raise UnusableInput(
                f'{path} is truncated or damaged and nothing in it can be read: expected a '
                'compressed recording; copy it again from where it was recorded'
            )
        kind = storage_kind(first_bytes(plain))
    if kind == 'sqlite3':
        leftovers = [
            leftover
            for suffix in ('-wal', '-journal')
            if (leftover := Path(f'{path}{suffix}')).is_file() and leftover.stat().st_size
        ]
        if leftovers:
            # The recorder was killed, and its last messages are only in the write-ahead log. To
            # read the log in place, SQLite would write to the recording's folder.
            plain = copied(path, leftovers, opened)
            SqliteFile.merge_log(plain)
            warnings.add(
                f'{path.name} was not closed: its write-ahead log {leftovers[0].name} '
                'is merged into a temporary copy'
            )
    formats: dict[str | None, type[StoredFile]] = {
        'sqlite3': SqliteFile, 'mcap': McapFile, 'ros1': Rosbag1File,
    }
    if kind not in formats:
        raise UnusableInput(
            f'{path} begins with {first_bytes(plain)[:13]!r}: expected an mcap, an SQLite or a '
            'ROS 1 bag file (format 2.0); copy it again from where it was recorded, or convert it'
        )
    return opened.enter_context(closing(formats[kind](plain, warnings, expected)))


def _files_to_read(folder: Path, metadata: _Metadata, warnings: Warnings) -> list[Path]:
    """Return the existing files that the metadata lists, or else all bag files of the folder."""
    listed = [folder / name for name in metadata.names]
    present = [path for path in listed if path.is_file()]
    if listed and not present:
        warnings.add(
            f'none of the files listed in {METADATA} exists: all bag files in the folder are read'
        )
    elif len(present) < len(listed):
        missing = [path.name for path in listed if path not in present]
        warnings.add(
            f'{len(missing)} of {len(listed)} files of the recording are missing: '
            f'{", ".join(missing[:5])}'
        )
    found = present or bag_files(folder)
    if not found:
        raise UnusableInput(
            f'{folder} holds a {METADATA} and no file with messages: expected '
            f'{", ".join(metadata.names[:3]) or "a .mcap or .db3 file"}; copy the whole folder'
        )
    return found


def _metadata_beside(path: Path) -> _Metadata:
    """Return the part of the folder's metadata that applies to a single file."""
    metadata = _read_metadata(path.parent, Warnings())
    if path.name not in metadata.names:
        return UNKNOWN
    return metadata if len(metadata.names) == 1 else replace(metadata, message_count=None)


def _read_metadata(folder: Path, warnings: Warnings) -> _Metadata:
    """Read metadata.yaml; return defaults if it is missing, and also warn if it is damaged."""
    path = folder / METADATA
    if not path.is_file():
        return UNKNOWN
    try:
        text = read_limited(path, MAX_METADATA_BYTES, 'the metadata of a recording')
        about: Any = load_yaml(text.decode(errors='replace'))
        return convert(about['rosbag2_bagfile_information'], _Metadata)
    except (
        OSError, UnusableInput, yaml.YAMLError, KeyError, TypeError, ValueError, AttributeError,
    ) as error:
        reason = str(error).splitlines()[0][:200] if str(error) else type(error).__name__
        warnings.add(f'{path} is damaged ({reason}): the files in the folder are read without it')
        return UNKNOWN


def first_bytes(path: Path) -> bytes:
    """Return the first 16 bytes of a file; raises UnusableInput if it is empty or unreadable."""
    try:
        with path.open('rb') as file:
            head = file.read(16)
    except OSError as error:
        raise UnusableInput(
            f'{path} cannot be opened ({error.strerror}): expected a recording; check its name '
            'and permissions'
        ) from None
    if not head:
        raise UnusableInput(
            f'{path} is an empty file (0 bytes): expected a recording; copy it again from where '
            'it was recorded'
        )
    return head


def storage_kind(head: bytes) -> str | None:
    """Return 'mcap', 'sqlite3', 'ros1' or 'zstd' by the first bytes of a file, or None."""
    magics = {
        'mcap': MCAP_MAGIC, 'sqlite3': SQLITE_MAGIC, 'ros1': ROSBAG1_MAGIC, 'zstd': ZSTD_MAGIC,
    }
    return next((kind for kind, magic in magics.items() if head.startswith(magic)), None)


def decompressed(path: Path, opened: ExitStack) -> tuple[Path, bool]:
    """Decompress a zstd file; return the new file and whether the data were complete."""
    whole = True
    with _unpacking(path, opened) as folder:
        target = folder / path.name.removesuffix('.zstd')
        with path.open('rb') as packed, target.open('wb') as plain:
            most = max(_SMALL_BYTES, _MAX_RATIO * path.stat().st_size)
            try:
                for piece in zstandard.ZstdDecompressor().read_to_iter(packed):
                    most -= len(piece)
                    if most < 0:
                        raise UnusableInput(
                            f'{path} unpacks to more than {_MAX_RATIO} times its size: '
                            'expected a recording; unpack it with "zstd -d" if it is one'
                        )
                    plain.write(piece)
            except zstandard.ZstdError:
                whole = False
            whole = whole and packed.tell() == path.stat().st_size
    return target, whole


def copied(path: Path, companions: list[Path], opened: ExitStack) -> Path:
    """Copy a file together with its companion files, and return the copy."""
    with _unpacking(path, opened) as folder:
        for file in (path, *companions):
            shutil.copyfile(file, folder / file.name)
    return folder / path.name


@contextmanager
def _unpacking(path: Path, opened: ExitStack) -> Iterator[Path]:
    """Create a temporary folder, so that the recording's folder stays as it is.

    Args:
        path: the file that is unpacked to the folder, for errors.
        opened: removes the folder when it is closed, or else Python at the end of the program.
    """
    folder = Path(opened.enter_context(TemporaryDirectory(prefix='ratslam-')))
    try:
        yield folder
    except OSError as error:
        raise UnusableInput(
            f'{path} cannot be unpacked to {folder} ({error.strerror}): expected enough '
            'free space there; free some, or set TMPDIR to a folder on a larger disk'
        ) from None
