# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""State: what a part has learned, as plain values that a file can hold."""

from __future__ import annotations

from typing import Any

State = dict[str, Any]
"""Numbers, texts, lists and dictionaries of them, and NumPy arrays."""
