# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Reader of weights: what it reads, and what it refuses to run."""

from __future__ import annotations

import io
import pickle
import sys

import numpy as np
import pytest

from ratslam_ros.descriptors.tensors import MAGIC, read_tensors

TENSOR = (
    b'ctorch._utils\n_rebuild_tensor_v2\n('
    b'(U\x07storagectorch\nFloatStorage\nU\x01kU\x03cpuK\x07NtQ'  # storage k of 7 values
    b'K\x01K\x02K\x03\x86K\x01K\x02\x86\x89'  # offset 1, shape (2, 3), strides (1, 2)
    b'ccollections\nOrderedDict\n)RtR'
)


def file_with(tensor: bytes, begin: bytes = pickle.dumps(MAGIC)) -> io.BytesIO:
    """Write a file with the tensor `w`, of which the storage has the values 0 to 6."""
    tensors = b'}U\x01w' + tensor + b's.'
    storage = (7).to_bytes(8, 'little') + np.arange(7, dtype='<f4').tobytes()
    pickles = begin + pickle.dumps(1001) + pickle.dumps({}) + tensors + pickle.dumps(['k'])
    return io.BytesIO(pickles + storage)


def test_tensor_has_its_offset_and_strides() -> None:
    ((name, tensor),) = read_tensors(file_with(TENSOR)).items()
    assert name == 'w'
    assert tensor.dtype == np.float32
    assert tensor.tolist() == [[1, 3, 5], [2, 4, 6]]


@pytest.mark.parametrize('attack', [
    b'cthis\ns\n',  # importing the module would print a poem
    b'(ithis\ns\n',
    b'cbuiltins\neval\n(U\x0b__import__("this")tR',
    b'ctorch._utils\n_rebuild_parameter\n',
])
def test_pickle_that_names_code_is_refused(attack: bytes) -> None:
    for file in (file_with(attack), file_with(TENSOR, attack + b'.')):
        with pytest.raises(pickle.UnpicklingError, match=r'names .*; expected only collections'):
            read_tensors(file)
    assert 'this' not in sys.modules


def test_tensor_beyond_its_storage_is_refused() -> None:
    with pytest.raises((TypeError, ValueError)):
        read_tensors(file_with(TENSOR.replace(b'K\x03\x86K\x01', b'K\x04\x86K\x01', 1)))


def test_other_file_is_refused() -> None:
    with pytest.raises(pickle.UnpicklingError, match='begins with 1; expected'):
        read_tensors(file_with(TENSOR, pickle.dumps(1)))
