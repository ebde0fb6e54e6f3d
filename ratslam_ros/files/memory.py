# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Memory files: the learned state of a node, written and read completely or not at all.

A file is a NumPy archive (npz) of all arrays and of ``content``, a JSON text with the other
values, in which the names of the arrays take their places.
"""

from __future__ import annotations

import json
import math
import os
import zipfile
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ratslam_ros.core.common.state import State
from ratslam_ros.errors import UnusableInput
from ratslam_ros.files.state_check import check_state

FORMAT = 1
CONTENT, ARRAY = 'content', 'array'

MAX_BYTES = 2**31
"""Largest accepted size of all arrays. A million templates of 600 bytes need a third of it."""

MAX_ARRAYS = 2**16
"""Largest accepted number of arrays. A map has some per part, and one per scan."""


def save(path: Path, part: str, state: State) -> None:
    """Write the state of a part; an earlier file stays until the new one is complete.

    Args:
        path: the file; its folder is created.
        part: name of the part, checked by `load`.
        state: nested dictionaries and lists of values and arrays.

    Raises:
        UnusableInput: the file cannot be written.
    """
    arrays: dict[str, NDArray[Any]] = {}
    # States have infinite values, such as a distance that was never driven.
    content = json.dumps(
        {'format': FORMAT, 'part': part, 'state': _without_arrays(state, arrays)}
    )
    entries: dict[str, Any] = {CONTENT: np.array(content), **arrays}
    fresh = path.with_name(f'.{path.name}.{os.getpid()}')
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        with fresh.open('wb') as file:
            np.savez_compressed(file, **entries)
            file.flush()
            os.fsync(file.fileno())  # Otherwise a power cut could leave an empty file.
        fresh.replace(path)
    except OSError as error:
        fresh.unlink(missing_ok=True)
        raise UnusableInput(
            f'{path} cannot be written ({error.strerror}); set memory_folder to another folder'
        ) from None


def load(path: Path, part: str) -> State:
    """Read the state of a part.

    Args:
        path: the file.
        part: expected name of the part.

    Raises:
        UnusableInput: the file is missing, damaged, or of another part or format, or a number in
            it is out of range.
    """
    try:
        with zipfile.ZipFile(path) as archive:
            entries = _Entries(archive)
            content = json.loads(str(entries.array(CONTENT)))
            if content['format'] != FORMAT or content['part'] != part:
                raise UnusableInput(
                    f'{path} is of {content["part"]} in format {content["format"]}; expected '
                    f'{part} in format {FORMAT}'
                )
            state = _with_arrays(content['state'], entries)
    except FileNotFoundError:
        raise UnusableInput(
            f'{path} does not exist; call save first, or set memory_folder'
        ) from None
    except UnusableInput:
        raise
    except Exception as error:  # Arbitrary bytes raise many types in zip, zlib and NumPy.
        raise UnusableInput(f'{path} is damaged or not a memory file ({error})') from None
    if not isinstance(state, dict):
        raise UnusableInput(f'{path} is damaged or not a memory file (its state is no object)')
    check_state(part, state)
    return state


def _without_arrays(value: Any, arrays: dict[str, NDArray[Any]]) -> Any:
    """Return a value with each array replaced by its name; add the arrays to ``arrays``."""
    if isinstance(value, np.ndarray):
        name = f'{ARRAY}_{len(arrays)}'
        arrays[name] = value
        return {ARRAY: name}
    if isinstance(value, dict):
        return {key: _without_arrays(item, arrays) for key, item in value.items()}
    if isinstance(value, (list, tuple)):
        return [_without_arrays(item, arrays) for item in value]
    return value


class _Entries:
    """The arrays of a memory file; their sizes are checked before memory is allocated for them."""

    def __init__(self, archive: zipfile.ZipFile) -> None:
        self._archive = archive
        self._left = {info.filename: info for info in archive.infolist()}
        size = sum(info.file_size for info in self._left.values())
        if size > MAX_BYTES or len(self._left) > MAX_ARRAYS:
            raise ValueError(
                f'{len(self._left)} arrays of {size} bytes; expected at most {MAX_ARRAYS} and '
                f'{MAX_BYTES}'
            )

    def array(self, name: str) -> NDArray[Any]:
        """Return an array, once: a small file must not stand for many copies of a large array."""
        info = self._left.pop(f'{name}.npy')
        with self._archive.open(info) as file:
            version = np.lib.format.read_magic(file)
            if version == (1, 0):
                shape, is_fortran, kind = np.lib.format.read_array_header_1_0(file)
            else:
                shape, is_fortran, kind = np.lib.format.read_array_header_2_0(file)
            # Neither objects, which would be pickles, nor records, nor views of them.
            if kind.kind not in 'biufU' or kind.shape or not all(n >= 0 for n in shape):
                raise ValueError(f'{name} is of {kind}; expected numbers')
            data = file.read()
        if len(data) != math.prod(shape) * kind.itemsize:
            raise ValueError(f'{name} has {len(data)} bytes; expected {shape} of {kind}')
        values: NDArray[Any] = np.frombuffer(bytearray(data), kind)
        return values.reshape(shape, order='F' if is_fortran else 'C')


def _with_arrays(value: Any, entries: _Entries) -> Any:
    if isinstance(value, dict):
        if value.keys() == {ARRAY}:
            return entries.array(value[ARRAY])
        return {key: _with_arrays(item, entries) for key, item in value.items()}
    if isinstance(value, list):
        return [_with_arrays(item, entries) for item in value]
    return value
