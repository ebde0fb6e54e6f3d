# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""A map passes from a replay to launched nodes and back; all pairs: test_map_passing.py."""

from __future__ import annotations

import signal
from collections.abc import Callable
from itertools import islice
from pathlib import Path

from helpers import circles, write_bag
from processes import Commands

from ratslam_ros.maps import read_map

Here = Callable[..., tuple[int, str, str]]
SETTINGS = (
    '--config', 'default', '--set', 'local_view.template_x_size=16',
    '--set', 'local_view.template_y_size=8', '--set', 'local_view.vt_shift_match=2',
    '--set', 'pose_cells.pc_cell_x_size=0.5',
)


def test_replayed_map_is_continued_by_launch_and_replayed_again(
    commands: Commands, here: Here, tmp_path: Path
) -> None:
    path = tmp_path / 'a.map'
    bag = str(write_bag(tmp_path / 'bag', islice(circles(), 100)))  # 5 s
    out = str(tmp_path / 'out')
    replay = 'replay', bag, *SETTINGS, '--map', str(path), '--no-history', '--out', out
    assert here(*replay)[0] == 0
    for options in (('--split',), ('--localize',)):
        nodes = commands.start('launch', *SETTINGS, '--map', str(path), *options)
        played = commands.run('play', bag, '--lockstep', '--rate', '0', '--quiet')
        nodes.send_signal(signal.SIGINT)
        out, err = nodes.communicate(timeout=30.0)
        assert (played[0], nodes.returncode) == (0, 0), (*played, out, err)
        assert 'going on without' not in played[2]
        saved = read_map(path)
        assert (len(saved.sessions), saved.notes) == (2, [])
    assert here(*replay)[0] == 0
    assert here('map', 'check', str(path))[0] == 0
