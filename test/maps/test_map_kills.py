# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Processes that write one map, of which one is killed. At random times: test_replay_map.py."""

from __future__ import annotations

from pathlib import Path

from map_states import growing_state, opened, python, same

from ratslam_ros.maps import Cut, read_map

WRITER = """
import sys
from pathlib import Path
from map_states import growing_state, opened
from ratslam_ros.maps import Cut
path, part, first, last = sys.argv[1], sys.argv[2], int(sys.argv[3]), int(sys.argv[4])
store = opened(Path(path), part)
restored = store.file.restored
state = None if restored is None else restored.states.get(part)
start = 0 if state is None else state['core']['n']
print('restored', start, flush=True)
for number in range(max(first, start + 1), last + 1):
    store.cut(Cut(number, number * 10), {part: growing_state(number)})
    assert store.flush(60)
    print('acknowledged', number, flush=True)
store.close()
"""


def test_processes_write_one_map_and_one_is_killed(tmp_path: Path) -> None:
    path = tmp_path / 'a.map'
    parts = 'local_view', 'pose_cells'
    # The test itself writes a part, so that all processes are in one session.
    store = opened(path, 'goal_follower')
    processes = [python(WRITER, path, part, 1, 12) for part in parts]
    killed = processes[0]
    assert killed.stdout is not None
    for _ in range(4):
        line = killed.stdout.readline()
    assert line == 'acknowledged 3\n'
    killed.kill()
    killed.communicate()
    again = python(WRITER, path, parts[0], 1, 12)
    output, _ = again.communicate()
    assert int(output.split()[1]) == 0  # the newest cut of all: this process has none
    for process in processes[1:]:
        process.communicate()
        assert process.returncode == 0
    store.cut(Cut(12, 120), {'goal_follower': growing_state(12)})
    store.close()
    saved = read_map(path)
    assert saved.cut == Cut(12, 120)
    assert sorted(saved.states) == sorted([*parts, 'goal_follower'])
    assert all(same(state, growing_state(12)) for state in saved.states.values())
    assert [file.name for file in tmp_path.iterdir()] == ['a.map']
    assert len(saved.sessions) == 1
