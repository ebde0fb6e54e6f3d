# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Commands that run without nodes: replay, demo, simulate and map."""
