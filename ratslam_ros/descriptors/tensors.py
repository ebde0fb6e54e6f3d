# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Reader of the weights of PyTorch models, in the format before PyTorch 1.6, without PyTorch.

Such a file consists of five pickles: a magic number, the version of the format, properties of the
machine, the tensors by name, and the keys of the storages. The storages follow in the order of the
keys, each as the number of its values (int64) and the values.
"""

from __future__ import annotations

import pickle
from collections import OrderedDict
from collections.abc import Mapping
from pickle import UnpicklingError
from typing import Any, BinaryIO

import numpy as np
from numpy.typing import NDArray

MAGIC = 0x1950A86A20F9469CFC6C
"""First object of a file in this format."""


def read_tensors(file: BinaryIO) -> dict[str, NDArray[Any]]:
    """Return the tensors of a file by name.

    Raises:
        UnpicklingError: a pickle names a function or class that tensors do not need, or
            the file does not have this format. Nothing is imported or called.
    """
    magic = _TensorUnpickler(file).load()
    if magic != MAGIC:
        raise UnpicklingError(f'the file begins with {magic!r:.40}; expected {MAGIC:#x}')
    _version, _machine, tensors, keys = (_TensorUnpickler(file).load() for _ in range(4))
    types = {key: kind for (kind, key), *_ in tensors.values()}
    storages = {}
    for key in keys:
        count = int.from_bytes(file.read(8), 'little')
        storages[key] = file.read(count * types[key].itemsize)
    return {
        name: np.ndarray(
            size, kind, storages[key], offset * kind.itemsize, [n * kind.itemsize for n in strides]
        )
        for name, ((kind, key), offset, size, strides) in tensors.items()
    }


class RestrictedUnpickler(pickle.Unpickler):
    """Unpickler that knows some names and imports nothing."""

    def __init__(self, file: BinaryIO, names: Mapping[tuple[str, str], Any]) -> None:
        """Read from a file.

        Args:
            file: file with a pickle.
            names: what a module and a name in it stand for.
        """
        super().__init__(file)
        self._names = names

    def find_class(self, module: str, name: str) -> Any:
        """Return what a name stands for.

        Raises:
            UnpicklingError: the name is not known.
        """
        if (module, name) not in self._names:
            raise UnpicklingError(
                f'a pickle names {module}.{name}; expected only '
                + ', '.join('.'.join(known) for known in self._names)
            )
        return self._names[module, name]


class _TensorUnpickler(RestrictedUnpickler):
    def __init__(self, file: BinaryIO) -> None:
        super().__init__(file, _NAMES)

    def persistent_load(self, pid: Any) -> tuple[np.dtype[Any], str]:
        """Return the type and the key of a storage."""
        _, kind, key, *_ = pid
        return kind, key


def _tensor(storage: Any, offset: int, size: Any, strides: Any, *_: Any) -> tuple[Any, ...]:
    return storage, offset, size, strides


_NAMES: dict[tuple[str, str], Any] = {
    ('collections', 'OrderedDict'): OrderedDict,
    ('torch', 'FloatStorage'): np.dtype('<f4'),
    ('torch', 'LongStorage'): np.dtype('<i8'),
    ('torch._utils', '_rebuild_tensor_v2'): _tensor,
}
