# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""How the inner loops are compiled: strict arithmetic, one thread, cached on disk."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, TypeVar

import numba

_Function = TypeVar('_Function', bound=Callable[..., Any])


def compiled(function: _Function) -> _Function:
    """Compile a function when it is first called, and cache the machine code.

    No fastmath and no parallel loops: the same input must give the same bits at every run.
    """
    dispatcher: _Function = numba.njit(cache=True, fastmath=False)(function)
    return dispatcher
