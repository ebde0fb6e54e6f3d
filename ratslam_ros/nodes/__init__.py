# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The nodes: convert, call core, publish. They open no recording."""
