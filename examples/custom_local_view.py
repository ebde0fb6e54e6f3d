# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Map a recording with a local view of your own, here one that compares difference hashes.

usage: python examples/custom_local_view.py RECORDING
"""

import sys

import cv2
import numpy as np

from ratslam_ros import Config, ImageEvent, RatSLAM, ViewMatch, open_recording


class HashView:
    """Stores a 64-bit difference hash of each template; up to 6 bits of a match may differ."""

    def __init__(self) -> None:
        self._hashes: list[np.ndarray] = []

    def match(self, image: np.ndarray) -> ViewMatch:
        """Return the template with the most similar hash, or a new one."""
        small = cv2.resize(image, (9, 8), interpolation=cv2.INTER_AREA)
        bits = (small[:, 1:] > small[:, :-1]).ravel()
        errors = [int((bits != known).sum()) for known in self._hashes]
        if errors and min(errors) <= 6:
            return ViewMatch(int(np.argmin(errors)), False, min(errors) / 64.0, 0.0)
        self._hashes.append(bits)
        return ViewMatch(len(self._hashes) - 1, True, 1.0, 0.0)


slam = RatSLAM(Config(), head='visual_odometry', local_view=HashView())
with open_recording(sys.argv[1]) as recording:
    for event in recording.events(recording.select(visual_odometry=True)):
        if isinstance(event, ImageEvent):
            slam.image(event.stamp_ns, event.grey())
slam.finish()
print(f'{len(slam.experience_map)} experiences, {slam.experience_map.link_count} links')
