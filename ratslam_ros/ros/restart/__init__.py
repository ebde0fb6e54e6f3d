# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Saving and restarting of nodes that run in processes of their own."""
