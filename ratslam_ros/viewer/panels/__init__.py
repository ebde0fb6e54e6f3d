# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Panels of the viewer: text, pictures and controls beside the map."""

from ratslam_ros.viewer.panels.desk import Desk
from ratslam_ros.viewer.panels.panels import Panels

__all__ = ['Desk', 'Panels']
