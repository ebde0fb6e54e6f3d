# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Numba settings for the inner loops: strict arithmetic, one thread, cached on disk."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, TypeVar

import numba

_Function = TypeVar('_Function', bound=Callable[..., Any])


def compiled(function: _Function) -> _Function:
    """Compile a function with numba on its first call, and cache the machine code on disk.

    Fastmath and parallel loops are off, so that the same input gives bit-identical results in
    every run.
    """
    dispatcher: _Function = numba.njit(cache=True, fastmath=False)(function)
    return dispatcher


def compiled_without_gil(function: _Function) -> _Function:
    """Compile a function as ``compiled`` does; it releases the interpreter lock while it runs.

    For the work on single images, which a replay does in a second thread. Short functions must not
    release the lock: taking it again may take longer than the function.
    """
    dispatcher: _Function = numba.njit(cache=True, fastmath=False, nogil=True)(function)
    return dispatcher
