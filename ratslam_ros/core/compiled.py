# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""How the inner loops are compiled: strict arithmetic, one thread, cached on disk."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, TypeVar

import numba

_Function = TypeVar('_Function', bound=Callable[..., Any])

compiled_functions: list[Any] = []
"""Every function that ``compiled`` made, so that a caller can tell whether any will compile."""


def compiled(signature: str, **options: Any) -> Callable[[_Function], _Function]:
    """Compile a function on its first call, for one signature, and cache the machine code.

    No fastmath and no parallel loops: the same input must give the same bits at every run.
    Compilation waits for the first call, so that whoever calls can announce it (``warm_up``).
    """

    def wrap(function: _Function) -> _Function:
        dispatcher: Any = numba.njit(cache=True, fastmath=False, **options)(function)
        dispatcher.ratslam_signature = signature
        compiled_functions.append(dispatcher)
        return dispatcher  # type: ignore[no-any-return]

    return wrap
