# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Type of a serialisable state, as returned by ``state()`` and accepted by ``restore()``."""

from __future__ import annotations

from typing import Any

State = dict[str, Any]
"""Nested dictionaries and lists of numbers, strings and NumPy arrays."""
