# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Serialisable states, as returned by ``state()`` and accepted by ``restore()``."""

from __future__ import annotations

from collections.abc import Collection
from typing import Any

State = dict[str, Any]
"""Nested dictionaries and lists of numbers, strings and NumPy arrays."""

STAGE = 'stage'
"""Item of a part that was saved by a stage of the user: the name of its class. What the stage has
returned is the item `state` then."""

OF_SESSION = {
    'action_ns', 'answers', 'behaviour', 'behaviours', 'dead_reckoning', 'has_matched', 'has_seen',
    'inputs', 'joining', 'last_ns', 'memory_ns', 'motion', 'numbering', 'order', 'reached',
    'relocations', 'rhythm', 'sequence', 'settings',
}  # fmt: skip
"""Items of the state of a part that describe the messages and commands of one session."""


def unused(saved: State, used: Collection[str]) -> State:
    """Return the items of a part that a program keeps although it does not use them.

    Args:
        saved: the state of a part, saved by another program.
        used: keys that the program saves itself.
    """
    return {
        key: value for key, value in saved.items() if key not in used and key not in OF_SESSION
    }
