# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Comparison of configurations by the maps that they build: ``ratslam tune`` and ``study``."""
