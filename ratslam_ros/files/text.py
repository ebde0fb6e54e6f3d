# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Files that are replaced: at once, and neither one that is read nor a device."""

from __future__ import annotations

import os
from contextlib import suppress
from pathlib import Path

from ratslam_ros.errors import UnusableInput


def write_durably(path: Path, content: str | bytes) -> None:
    """Replace a file; the earlier one stays until the new one is on the disk.

    A symbolic link stays, and the file that it names is replaced. A device or a pipe, such as
    /dev/stdout, is written to.

    Raises:
        UnusableInput: it cannot be written.
    """
    data = content.encode('utf-8') if isinstance(content, str) else content
    file = Path(os.path.realpath(path))  # Path.resolve raises RuntimeError for links in a loop
    fresh = file.with_name(f'.{file.name}.{os.getpid()}')
    try:
        if path.exists() and not path.is_file():
            path.write_bytes(data)
            return
        with fresh.open('wb') as opened:
            opened.write(data)
            opened.flush()
            os.fsync(opened.fileno())
        fresh.replace(file)
    except OSError as error:
        with suppress(OSError):  # such as a file where the path has a folder
            fresh.unlink()
        raise UnusableInput(
            f'{path} cannot be written ({error.strerror}); choose another file'
        ) from None


def check_not_read(path: Path, *read: Path) -> None:
    """Check that a file to be written is none of those that are read.

    Raises:
        UnusableInput: it is one of them.
    """
    for other in read:
        with suppress(OSError):  # one of them does not exist
            if path.samefile(other):
                raise UnusableInput(f'{path} is read, and would be replaced; choose another file')
