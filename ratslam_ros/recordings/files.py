# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Detection of file formats, and temporary copies of files that cannot be read in place."""

import shutil
import tempfile
from pathlib import Path

import zstandard

from ratslam_ros.errors import UnusableInput
from ratslam_ros.recordings.mcap_file import MCAP_MAGIC
from ratslam_ros.recordings.rosbag1 import ROSBAG1_MAGIC
from ratslam_ros.recordings.sqlite_file import SQLITE_MAGIC

_SMALL_BYTES = 2**30
_MAX_RATIO = 1000
"""Files may unpack to 1 GiB, or to 1000 times their size; recordings of images without any texture
reach 300. A file that fills the disk would harm other programs."""

ZSTD_MAGIC = b'\x28\xb5\x2f\xfd'


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
        'mcap': MCAP_MAGIC,
        'sqlite3': SQLITE_MAGIC,
        'ros1': ROSBAG1_MAGIC,
        'zstd': ZSTD_MAGIC,
    }
    return next((kind for kind, magic in magics.items() if head.startswith(magic)), None)


class Workspace:
    """A temporary folder, created on first use, that leaves the recording's folder unchanged.

    If it is not closed, Python removes it at the end of the program.
    """

    def __init__(self) -> None:
        self._folder: tempfile.TemporaryDirectory[str] | None = None
        self._used = 0

    def decompressed(self, path: Path) -> tuple[Path, bool]:
        """Decompress a zstd file; return the new file and whether the data were complete."""
        target, whole = self._new(path.name.removesuffix('.zstd')), True
        try:
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
        except OSError as error:
            raise _no_room(path, target, error) from None
        return target, whole

    def copied(self, path: Path, companions: list[Path]) -> Path:
        """Copy a file together with its companion files, and return the copy."""
        target = self._new(path.name)
        try:
            for file in (path, *companions):
                shutil.copyfile(file, target.parent / file.name)
        except OSError as error:
            raise _no_room(path, target, error) from None
        return target

    def close(self) -> None:
        """Remove the folder and all files in it."""
        if self._folder is not None:
            self._folder.cleanup()
            self._folder = None

    def _new(self, name: str) -> Path:
        if self._folder is None:
            self._folder = tempfile.TemporaryDirectory(prefix='ratslam-')
        self._used += 1
        folder = Path(self._folder.name) / str(self._used)
        folder.mkdir()
        return folder / name


def _no_room(path: Path, target: Path, error: OSError) -> UnusableInput:
    return UnusableInput(
        f'{path} cannot be unpacked to {target.parent} ({error.strerror}): expected enough '
        'free space there; free some, or set TMPDIR to a folder on a larger disk'
    )
