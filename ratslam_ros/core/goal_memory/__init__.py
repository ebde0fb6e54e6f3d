# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Goal navigation on the pose cells, without an experience map."""
