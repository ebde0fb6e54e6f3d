# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""A simulated office, robot and camera: recordings with a known truth, from a seed."""
