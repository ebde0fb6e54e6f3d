# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Merging: one map of the maps of several sessions or robots that share places."""
