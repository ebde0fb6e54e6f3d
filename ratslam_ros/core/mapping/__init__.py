# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Map actions to the experience map: pose graph, loop-closure gate, relaxation."""
