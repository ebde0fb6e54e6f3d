# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Map files: everything learned, saved while mapping, safe against crashes; docs/maps.md."""

from ratslam_ros.maps.reader import read_map
from ratslam_ros.maps.saved_map import Cut, MapMeta, SavedMap
from ratslam_ros.maps.saving import live_meta, save_map
from ratslam_ros.maps.store import MapStore

__all__ = [
    'Cut', 'MapMeta', 'MapStore', 'SavedMap', 'live_meta', 'read_map', 'save_map',
]
