# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""History of a run: what happened, and the whole state at any moment."""
