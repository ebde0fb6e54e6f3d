# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""A stage of your own in the place of local_view: python examples/custom_stage.py RECORDING MAP.

The same by commands, offline and as a node, for a class in any file:
ratslam replay RECORDING --stage examples/custom_stage.py:HashView --map MAP
ratslam launch --stage examples/custom_stage.py:HashView --map MAP
"""

import sys
from pathlib import Path

import cv2
import numpy as np

import ratslam_ros as rs
from ratslam_ros.pipeline.commands import Reset, SetMapping

UNKNOWN = rs.ViewMatch(-1, False, -1.0, 0.0)


class HashView:
    """Stores a 64-bit difference hash of each template; up to 6 bits of a match may differ."""

    NAME, WRITES = 'local_view', ('template',)

    def __init__(self, config: rs.Config) -> None:
        self._hashes, self._mapping = np.empty((0, 64), bool), True

    def readers(self) -> dict:
        """Return a method for each stream that the stage reads."""
        return {'command': self._obey, 'image': self._match}

    def _obey(self, stamp_ns: int, command) -> None:
        if isinstance(command, Reset):
            self._hashes = self._hashes[:0]
        elif isinstance(command, SetMapping):
            self._mapping = command.mapping

    def _match(self, stamp_ns: int, image) -> list[rs.Output]:
        if image is None:  # it could not be decoded
            return [rs.Output('template', stamp_ns, UNKNOWN)]
        small = cv2.resize(image.pixels, (9, 8), interpolation=cv2.INTER_AREA)
        bits = (small[:, 1:] > small[:, :-1]).ravel()
        errors = [int(error) for error in (self._hashes != bits).sum(axis=1)]
        if min(errors, default=64) <= 6:
            match = rs.ViewMatch(errors.index(min(errors)), False, min(errors) / 64.0, 0.0)
        elif not self._mapping:
            match = UNKNOWN
        else:
            self._hashes = np.vstack([self._hashes, bits])
            match = rs.ViewMatch(len(errors), True, 1.0, 0.0)
        return [rs.Output('template', stamp_ns, match)]

    def state(self) -> dict:
        """Return everything that influences later results."""
        return {'hashes': self._hashes}

    def restore(self, state: dict) -> None:
        """Restore what state returned."""
        self._hashes = state['hashes'].astype(bool)


if __name__ == '__main__':
    config, saved = rs.Config(), sys.argv[2]
    slam = rs.RatSLAM(config, stages=[HashView])
    if Path(saved).exists():
        slam = rs.load_map(saved, stages=[HashView])
        slam.begin_session()
    with rs.open_recording(sys.argv[1]) as recording:
        for recorded in rs.recorded_inputs(recording, slam):
            slam.feed(*recorded)
    slam.finish()
    rs.save_map(slam, saved, config)
    print(f'{len(slam.experience_map)} experiences, {slam.experience_map.link_count} links')
