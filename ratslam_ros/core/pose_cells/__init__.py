# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Odometry and template ids to map actions: the continuous attractor network."""
