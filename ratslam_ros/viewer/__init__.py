# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Live view in a browser: a recording, a robot or a finished run."""
