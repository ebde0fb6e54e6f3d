# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Replay a recording in a format of your own, here a NumPy archive of stamps, images and twists.

usage: python examples/custom_recording.py FILE.npz RESULTS
"""

import sys
from collections.abc import Iterator
from pathlib import Path

import numpy as np

import ratslam_ros as rs


class NumpyRecording(rs.Recording):
    """Grey images, (n, H, W) uint8, and the speed in m/s and turn rate in rad/s at each."""

    kind = 'NumPy archive'

    def __init__(self, path: Path) -> None:
        super().__init__(path)
        self._data = np.load(path)
        self.topics = rs.Topic('images', 'image files', None), rs.Topic('twists', 'table', None)
        self.start_ns, self.end_ns = self._data['stamps_ns'][[0, -1]].tolist()

    def read_events(self, selection: rs.Selection, start_ns: int, stop_ns: int) -> Iterator:
        """Yield an odometry and an image event for each stamp in the span."""
        no_rotation = rs.Orientation(0.0, 0.0, 0.0, 1.0)
        arrays = (self._data[name] for name in ('stamps_ns', 'images', 'twists'))
        for stamp, pixels, (v_mps, w_radps) in zip(*arrays, strict=True):
            if start_ns <= (ns := int(stamp)) < stop_ns:
                yield rs.OdometryEvent(ns, ns, v_mps, w_radps, 0.0, 0.0, no_rotation)
                yield rs.ImageEvent(ns, ns, rs.Frame(pixels, 'mono8'))


print(rs.map_recording(NumpyRecording(Path(sys.argv[1])), sys.argv[2]))
