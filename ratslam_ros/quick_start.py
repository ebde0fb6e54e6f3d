# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Shorter start of nodes, most of which is spent in imports, above all that of Numba."""

from __future__ import annotations

import gc
import sys
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from types import ModuleType

_BLAS = 'scipy.linalg.cython_blas'


@contextmanager
def quick_start() -> Iterator[None]:
    """Start and run a node in this context, with garbage collection off until ``settle``.

    A start creates almost no garbage, but searching for it takes a sixth of the time.
    """
    gc.disable()
    try:
        yield
    finally:
        gc.enable()


def settle() -> None:
    """Switch garbage collection on again, and exempt the objects created by the start."""
    if not gc.isenabled():
        gc.freeze()
        gc.enable()


def import_numba() -> None:
    """Import the part of Numba that loading a compiled function needs, without SciPy.

    Numba imports SciPy's BLAS there, which is slow, only to check whether it exists. No function
    of this package uses it; functions that do import it when they are compiled.
    """
    if _BLAS in sys.modules:
        return
    sys.modules[_BLAS] = ModuleType(_BLAS)
    try:
        with suppress(ImportError):  # another layout of Numba: the start is slower then
            import numba.np.arraymath  # noqa: F401
    finally:
        del sys.modules[_BLAS]
