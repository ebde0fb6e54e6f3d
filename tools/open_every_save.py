#!/usr/bin/env python3
# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Save the map of a replay after every message, and open each of these maps.

    tools/open_every_save.py RECORDING...                 whole recordings: a minute or more each
    tools/open_every_save.py --duration 10 RECORDING
"""

from __future__ import annotations

import argparse
import sys
import tempfile
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from state_digest import digest_of

from ratslam_ros.core.config import Config
from ratslam_ros.errors import RatslamError
from ratslam_ros.files.config import load_config
from ratslam_ros.maps.system import load_map
from ratslam_ros.offline.replay import ReplayOptions, replay
from ratslam_ros.offline.replay_map import FLUSH_S, ReplayMap
from ratslam_ros.recordings import Event, open_recording


class OpenedMap(ReplayMap):
    """A map that is saved after every message, and opened at once."""

    opened = 0

    def after(self, event: Event, last_view_ns: int) -> None:
        """Count a processed event, save the state, and compare the opened map with it."""
        super().after(event, last_view_ns)
        self.save_before_end()
        assert self._store is not None and self._store.flush(FLUSH_S)
        assert self._slam is not None
        opened = load_map(self.path, self._slam.config).state()
        for part, state in self._slam.state().items():
            assert digest_of(opened[part]) == digest_of(state), part
        self.opened += 1


def open_every_save(path: Path, config: Config, duration_s: float | None) -> int:
    """Return the number of maps that were saved and opened.

    Raises:
        RatslamError, AssertionError: a map cannot be opened, or its state is not the saved one.
    """
    with tempfile.TemporaryDirectory() as folder, open_recording(path) as recording:
        saved = OpenedMap(Path(folder) / 'a.map', False, print, print)
        options = ReplayOptions(duration_s=duration_s, progress=False, map_file=saved)
        replay(recording, recording.select(), config, Path(folder) / 'results', options)
    return saved.opened


def main() -> int:
    """Check all given recordings; return 1 if a map cannot be opened."""
    parser = argparse.ArgumentParser(description=(__doc__ or '').partition('\n')[0])
    parser.add_argument('recordings', nargs='+', type=Path, metavar='RECORDING')
    parser.add_argument('--duration', type=float, help='seconds of each recording')
    options = parser.parse_args()
    failed = 0
    for path in options.recordings:
        try:
            count = open_every_save(path, load_config('auto')[0], options.duration)
            print(f'{path}: {count} maps were saved and opened', flush=True)
        except (RatslamError, AssertionError) as error:
            failed = 1
            print(f'{path}: {error}', flush=True)
    return failed


if __name__ == '__main__':
    sys.exit(main())
