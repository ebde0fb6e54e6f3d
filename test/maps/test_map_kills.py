# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Processes that write one map, and are killed at named points and at random times."""

from __future__ import annotations

import os
import random
import tempfile
import time
from pathlib import Path

from map_states import growing_state, opened, python, same

from ratslam_ros.maps import Cut, read_map

WRITER = """
import sys
from map_states import growing_state, opened
from ratslam_ros.maps import Cut
path, part, first, last = sys.argv[1], sys.argv[2], int(sys.argv[3]), int(sys.argv[4])
from pathlib import Path
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

KILLS = """
import os, signal, sqlite3, sys
from pathlib import Path
from map_states import META, growing_state, same
from ratslam_ros.maps import Cut, file_writer, read_map, saving, schema
from ratslam_ros.maps.file_writer import FileWriter

folder, stride, offset = Path(sys.argv[1]), int(sys.argv[2]), int(sys.argv[3])
steps, kill_at, log = 0, 0, []

def point(name):
    global steps
    steps += 1
    log.append(name)
    if steps == kill_at:
        os.kill(os.getpid(), signal.SIGKILL)

class Killing(sqlite3.Connection):
    def execute(self, text, *values):
        point(f'before {text[:30]}')
        result = super().execute(text, *values)
        if text == 'COMMIT':
            point('after COMMIT')
        return result
    def executemany(self, text, rows):
        point(f'before {text[:30]}')
        result = super().executemany(text, rows)
        point(f'after {text[:30]}')
        return result
    def close(self):
        point('before close')
        super().close()
        point('after close')

connect = sqlite3.connect
sqlite3.connect = lambda *values, **options: connect(*values, **options, factory=Killing)
for owner, name in ((os, 'link'), (os, 'replace'), (os, 'fsync'), (Path, 'unlink')):
    def wrapped(*values, function=getattr(owner, name), name=name, **options):
        point(f'before {name}')
        result = function(*values, **options)
        point(f'after {name}')
        return result
    setattr(owner, name, wrapped)

def work(path):
    for session in range(2):
        writer = FileWriter(path, ('local_view',), META)
        done(path, 3 * session if session else -1)
        for number in range(3 * session + 1, 3 * session + 4):
            writer.write(Cut(number, number), {'local_view': growing_state(number)})
            done(path, number)
        writer.close(complete=True)
    saving.save_map(path, {'local_view': growing_state(9)}, META, Cut(9, 9))
    done(path, 9)

def done(path, number):
    # A file of another folder tells the parent what this process has acknowledged.
    (folder / 'acknowledged').write_text(str(number))

def state_of(path):
    if not path.exists():
        return -2
    states = read_map(path).states
    if not states:
        return -1
    number = states['local_view']['core']['n']
    assert same(states['local_view'], growing_state(number)), number
    return number

schema._expected(schema.MAP.schema)  # computed once
steps = 0
log.clear()
work(folder / 'whole.map')
total, names = steps, log
order = [-2, -1, 1, 2, 3, 4, 5, 6, 9]
for kill_at in range(1 + offset, total + 1, stride):
    path = folder / f'{kill_at}.map'
    (folder / 'acknowledged').write_text('-2')
    steps = 0
    child = os.fork()
    if not child:
        try:
            work(path)
        finally:
            os._exit(1)
    _, status = os.waitpid(child, 0)
    assert os.WTERMSIG(status) == signal.SIGKILL, (kill_at, status)
    at, kill_at = kill_at, 0
    acknowledged = int((folder / 'acknowledged').read_text())
    found = state_of(path)
    following = order[min(order.index(acknowledged) + 1, len(order) - 1)]
    assert found in (acknowledged, following), (at, names[at - 1], acknowledged, found)
    writer = FileWriter(path, ('local_view',), META)
    restored = writer.restored
    number = -1 if restored is None else restored.states['local_view']['core']['n']
    assert number == max(found, -1), (at, number, found)
    writer.write(Cut(20, 20), {'local_view': growing_state(20)})
    writer.close(complete=True)
    assert state_of(path) == 20
    assert sorted(folder.glob(f'{at}.map*')) == [path], sorted(folder.glob(f'{at}.map*'))
    path.unlink()
print('points', total)
"""


STRIDE = int(os.environ.get('RATSLAM_KILL_STRIDE', '7'))
"""Every how many points a process is killed; 1 takes a minute."""


def test_kill_at_points_of_the_writer_loses_nothing_acknowledged() -> None:
    """Points: before and after every statement, change of names, sync and end of a connection."""
    memory = '/dev/shm' if Path('/dev/shm').is_dir() else None
    with tempfile.TemporaryDirectory(dir=memory) as folder:
        process = python(KILLS, folder, STRIDE, 3 % STRIDE)
        output, _ = process.communicate()
    assert process.returncode == 0
    assert int(output.split()[-1]) > 150


def test_kills_at_random_times_lose_nothing_acknowledged(tmp_path: Path) -> None:
    path = tmp_path / 'a.map'
    generator = random.Random(1)
    acknowledged = 0
    for _ in range(4):
        process = python(WRITER, path, 'local_view', 1, 10_000)
        assert process.stdout is not None
        assert int(process.stdout.readline().split()[1]) >= acknowledged
        for _ in range(generator.randrange(1, 12)):
            acknowledged = int(process.stdout.readline().split()[1])
        time.sleep(generator.random() * 0.02)
        process.kill()
        rest = process.stdout.read().split()
        process.wait()
        acknowledged = int(rest[-1]) if rest and rest[-1].isdigit() else acknowledged
        saved = read_map(path)
        assert saved.cut is not None
        assert saved.cut.number >= acknowledged
        assert same(saved.states['local_view'], growing_state(saved.cut.number))


def test_four_processes_write_one_map_and_one_is_killed(tmp_path: Path) -> None:
    path = tmp_path / 'a.map'
    parts = 'local_view', 'pose_cells', 'experience_map', 'visual_odometry'
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
