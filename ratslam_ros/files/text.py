# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Files that are replaced: at once, and none that is read."""

from __future__ import annotations

import os
from contextlib import suppress
from pathlib import Path

from ratslam_ros.errors import UnusableInput


def write_durably(path: Path, content: str | bytes) -> None:
    """Replace a file; the earlier one stays until the new one is on the disk.

    Raises:
        UnusableInput: it cannot be written.
    """
    fresh = path.with_name(f'.{path.name}.{os.getpid()}')
    try:
        with fresh.open('wb') as file:
            file.write(content.encode('utf-8') if isinstance(content, str) else content)
            file.flush()
            os.fsync(file.fileno())
        fresh.replace(path)
    except OSError as error:
        fresh.unlink(missing_ok=True)
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
