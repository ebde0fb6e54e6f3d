# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The scene in the browser: map, robot and pose cells, drawn by viser."""

from ratslam_ros.viewer.scene.colouring import COLOURINGS
from ratslam_ros.viewer.scene.picking import Pick
from ratslam_ros.viewer.scene.run_scene import RunScene

__all__ = ['COLOURINGS', 'Pick', 'RunScene']
