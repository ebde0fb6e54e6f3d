# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Memory files: the learned state of a node, written and read completely or not at all.

A file is a NumPy archive (npz) of all arrays and of ``content``, a JSON text with the other
values, in which the names of the arrays take their places.
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
        UnusableInput: the file is missing, damaged, or of another part or format.
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
    except Exception as error:  # Arbitrary bytes raise many types in zip, zlib and NumPy.
        raise UnusableInput(f'{path} is damaged or not a memory file ({error})') from None
    assert isinstance(state, dict)
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


def _with_arrays(value: Any, archive: Any) -> Any:
    if isinstance(value, dict):
        if value.keys() == {ARRAY}:
            return archive[value[ARRAY]]
        return {key: _with_arrays(item, archive) for key, item in value.items()}
    if isinstance(value, list):
        return [_with_arrays(item, archive) for item in value]
    return value
