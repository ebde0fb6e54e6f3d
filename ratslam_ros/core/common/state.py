# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Serialisable states, as returned by ``state()`` and accepted by ``restore()``."""

from __future__ import annotations

from typing import Any

State = dict[str, Any]
"""Nested dictionaries and lists of numbers, strings and NumPy arrays."""

STAGE = 'stage'
"""Item of a part that was saved by a stage of the user: the name of its class. What the stage has
returned is the item `state` then."""
