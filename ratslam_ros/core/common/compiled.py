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
