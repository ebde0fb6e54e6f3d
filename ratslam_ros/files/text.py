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

    A symbolic link stays, and the file that it names is replaced.

    Raises:
        UnusableInput: it cannot be written.
    """
    check_output(path)
    data = content.encode('utf-8') if isinstance(content, str) else content
    file = Path(os.path.realpath(path))  # Path.resolve raises RuntimeError for links in a loop
    fresh = file.with_name(f'.{file.name}.{os.getpid()}')
    try:
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


def check_output(path: Path, *read: Path) -> None:
    """Check that a path can be that of a file to be written, also before anything is computed.

    Raises:
        UnusableInput: its folder does not exist, it is a folder, a device or a pipe, which would
            block, or it is one of the files that are read.
    """
    problem = ''
    if not os.path.isdir(path.absolute().parent):
        problem = f'the folder {path.parent} does not exist'
    elif os.path.exists(path) and not os.path.isfile(path):
        problem = 'it is a folder' if path.is_dir() else 'it is a device or a pipe'
    for other in read:
        with suppress(OSError):  # one of them does not exist
            if path.samefile(other):
                problem = 'it is read, and would be replaced'
    if problem:
        raise UnusableInput(f'{path} cannot be written: {problem}; choose another file')
