# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Result files and plots of a run, and the evaluation of trajectories."""
