# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Simulator of a wheeled robot with a camera and a laser on a floor plan, with ground truth."""
