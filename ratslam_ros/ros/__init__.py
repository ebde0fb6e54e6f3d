# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The ROS nodes: they convert messages, call core and publish. They open no recordings."""
