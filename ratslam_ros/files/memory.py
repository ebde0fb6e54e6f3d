# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""What a node has learned, in a file: written whole or not at all, and read whole or not at all.

A file is a NumPy archive (npz): the arrays, and ``content``, JSON with the rest and with the
arrays' names where they belong.
"""

from __future__ import annotations

import json
import os
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ratslam_ros.core.common.state import State
from ratslam_ros.errors import UnusableInput

FORMAT = 1
CONTENT, ARRAY = 'content', 'array'


def save(path: Path, part: str, state: State) -> None:
    """Write a part's state; an earlier file stays until the new one is complete.

    Raises:
        UnusableInput: the file cannot be written.
    """
    arrays: dict[str, NDArray[Any]] = {}
    content = json.dumps(
        {'format': FORMAT, 'part': part, 'state': _without_arrays(state, arrays)},
        allow_nan=False,
    )
    entries: dict[str, Any] = {CONTENT: np.array(content), **arrays}
    fresh = path.with_name(f'.{path.name}.{os.getpid()}')
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        with fresh.open('wb') as file:
            np.savez_compressed(file, **entries)
            file.flush()
            os.fsync(file.fileno())  # else a power cut could leave an empty file of that name
        fresh.replace(path)
    except OSError as error:
        fresh.unlink(missing_ok=True)
        raise UnusableInput(
            f'{path} cannot be written ({error.strerror}); set memory_folder to another folder'
        ) from None


def load(path: Path, part: str) -> State:
    """Read a part's state.

    Raises:
        UnusableInput: there is no such file, or it is damaged or of something else.
    """
    try:
        with np.load(path, allow_pickle=False) as archive:
            content = json.loads(str(archive[CONTENT]))
            if content['format'] != FORMAT or content['part'] != part:
                raise UnusableInput(
                    f'{path} is of {content["part"]} in format {content["format"]}; expected '
                    f'{part} in format {FORMAT}'
                )
            state = _with_arrays(content['state'], archive)
    except FileNotFoundError:
        raise UnusableInput(
            f'{path} does not exist; call save first, or set memory_folder'
        ) from None
    except UnusableInput:
        raise
    except Exception as error:  # zip, zlib and NumPy meet arbitrary bytes
        raise UnusableInput(f'{path} is damaged or no such file ({error})') from None
    assert isinstance(state, dict)
    return state


def _without_arrays(value: Any, arrays: dict[str, NDArray[Any]]) -> Any:
    """Return a value with each array replaced by its name, and note the arrays."""
    if isinstance(value, np.ndarray):
        name = f'{ARRAY}_{len(arrays)}'
        arrays[name] = value
        return {ARRAY: name}
    if isinstance(value, dict):
        return {key: _without_arrays(item, arrays) for key, item in value.items()}
    if isinstance(value, (list, tuple)):
        return [_without_arrays(item, arrays) for item in value]
    return value


def _with_arrays(value: Any, archive: Any) -> Any:
    if isinstance(value, dict):
        if value.keys() == {ARRAY}:
            return archive[value[ARRAY]]
        return {key: _with_arrays(item, archive) for key, item in value.items()}
    if isinstance(value, list):
        return [_with_arrays(item, archive) for item in value]
    return value
