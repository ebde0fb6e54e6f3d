# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Detection of file formats, and temporary copies of files that cannot be read in place."""

import shutil
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path
from tempfile import TemporaryDirectory

import zstandard

from ratslam_ros.errors import UnusableInput
from ratslam_ros.recordings.mcap_file import MCAP_MAGIC
from ratslam_ros.recordings.rosbag1 import ROSBAG1_MAGIC
from ratslam_ros.recordings.salvage import ZSTD_MAGIC
from ratslam_ros.recordings.sqlite_file import SQLITE_MAGIC

_SMALL_BYTES = 2**30
_MAX_RATIO = 1000
"""Files may unpack to 1 GiB, or to 1000 times their size; recordings of images without any texture
reach 300. A file that fills the disk would harm other programs."""


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
