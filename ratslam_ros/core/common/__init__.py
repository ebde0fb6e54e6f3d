# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Types and helpers that the other core packages share: poses, odometry, scans, stamp order."""
