# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""What makes a node start in less time: most of that goes into imports, numba's above all."""

from __future__ import annotations

import gc
import sys
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from types import ModuleType

_BLAS = 'scipy.linalg.cython_blas'


@contextmanager
def quick_start() -> Iterator[None]:
    """Start and run a node in here: until ``settle`` nobody looks for garbage.

    A start makes next to none, and looking through all that it makes takes a sixth of its time.
    """
    gc.disable()
    try:
        yield
    finally:
        gc.enable()


def settle() -> None:
    """End the haste: from now on garbage is collected, but not sought in what the start made."""
    if not gc.isenabled():
        gc.freeze()
        gc.enable()


def import_numba() -> None:
    """Import what numba needs of itself to load a compiled function, and not SciPy.

    numba imports SciPy's BLAS then, which takes long, only to see whether it could. Nothing here
    is compiled to use it; what is, elsewhere, imports it when it is compiled.
    """
    if _BLAS in sys.modules:
        return
    sys.modules[_BLAS] = ModuleType(_BLAS)
    try:
        with suppress(ImportError):  # a numba that is arranged otherwise: then it takes as long
            import numba.np.arraymath  # noqa: F401
    finally:
        del sys.modules[_BLAS]
