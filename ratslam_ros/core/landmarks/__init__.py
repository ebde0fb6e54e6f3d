# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Landmarks: stochastic mapping, relocalisation by joint compatibility, and a fading memory."""
