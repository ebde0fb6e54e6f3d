# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""A live run whose log is kept is repeated by a replay of the log: same map, byte for byte."""

from __future__ import annotations

import json
import subprocess
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
import yaml
from helpers import Recorded, circles, write_bag
from test_live_nodes import SMALL, Live, ratslam

from ratslam_ros.cli import main
from ratslam_ros.maps import read_map
from ratslam_ros.maps.kept_log import kept_runs


def late_circles() -> Iterator[Recorded]:
    """Yield a drive on which some images, and ten odometry messages, come 0.6 s late."""
    for n, (log_ns, *rest) in enumerate(circles(6, 30)):
        is_late = n % 20 == 11 or (n % 2 == 0 and 200 <= n < 220)
        yield (log_ns + 600_000_000 if is_late else log_ns, *rest)


@pytest.fixture(scope='module')
def bag(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp('recording') / 'late'
    return write_bag(folder, sorted(late_circles(), key=lambda one: one[0]))


def set_parameter(live: Live, node: str, name: str, value: float) -> None:
    request = f'{{parameters: [{{name: {name}, value: {{type: 3, double_value: {value}}}}}]}}'
    answer = live.run(
        'call', f'{node}/set_parameters', 'rcl_interfaces/srv/SetParameters', request
    )
    assert 'successful: true' in answer


def disturb(live: Live) -> None:
    """Save, change a parameter, pause, load a map and reset, while a drive plays."""
    live.run('echo', 'ratslam/cut', '--once', '--field', 'data', '--timeout', '20')
    live.run('call', 'pose_cells/save', 'std_srvs/srv/Trigger')
    set_parameter(live, 'pose_cells', 'vt_active_decay', 2.5)
    live.run('call', 'local_view/pause', 'std_srvs/srv/SetBool', '{data: true}')
    live.run('call', 'local_view/pause', 'std_srvs/srv/SetBool', '{data: false}')
    live.run('call', 'pose_cells/load', 'std_srvs/srv/Trigger')
    live.run('call', 'pose_cells/reset', 'std_srvs/srv/Trigger')
    live.run('call', 'experience_map/mapping', 'std_srvs/srv/SetBool', '{data: false}')
    live.run('call', 'experience_map/mapping', 'std_srvs/srv/SetBool', '{data: true}')


def check_poses(published: Path, replayed: Path) -> None:
    """Compare the poses that a subscriber has received with those of the replay."""
    lines = [line.split() for line in replayed.read_text().splitlines()]
    expected = {line[0]: line[1:3] for line in lines}
    received = [one for one in yaml.safe_load_all(published.read_text()) if one]
    assert len(received) > 0.9 * len(expected) > 90
    for one in received:
        stamp, place = one['header']['stamp'], one['pose']['position']
        at = f'{stamp["sec"]}.{stamp["nanosec"]:09d}'
        assert expected[at] == [f'{place["x"]:.9f}', f'{place["y"]:.9f}']


def test_replay_of_the_log_repeats_the_run_exactly(
    bag: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """That of nodes which are killed: test_map_restart.py."""
    path = tmp_path / 'office.map'
    settings: dict[str, Any] = {
        **SMALL, 'inputs.max_lateness_s': 0.3, 'memory.map': str(path), 'memory.keep_log': True,
        'memory.memory_folder': str(tmp_path / 'saved'),
    }
    out, poses, late = tmp_path / 'out', tmp_path / 'poses', 0
    with Live(tmp_path / 'live', settings) as live:
        for run in range(2):  # the second one continues the map
            live.start('single_process')
            with poses.open('wb') as file:
                live.processes['echo'] = subprocess.Popen(
                    ratslam('echo', 'experience_map/pose'), env=live.environment, stdout=file
                )
            live.begin('play', 'play', str(bag), '--quiet', '--rate', '4' if run else '1')
            if not run:
                disturb(live)
            assert live.processes.pop('play').wait(120.0) == 0, live.logs()
            assert live.stop('single_process') == {'single_process': 0}, live.logs()
            live.stop('echo')
            assert main(['replay', str(path), '--log', '--out', str(out), '--overwrite']) == 0
            assert 'reproduced, byte for byte' in capsys.readouterr().out
            assert read_map(out / 'replayed.map').digest == read_map(path).digest
            summary = json.loads((out / 'summary.json').read_text())
            late += summary['late']
            assert summary['templates'] > 10 or run  # then all are known
            check_poses(poses, out / 'trajectory_live.tum')
    assert late > 0
    assert main(['map', 'export', str(path), '--format', 'json']) == 0
    assert capsys.readouterr().out == (out / 'map.json').read_text()
    first, second = kept_runs(path)
    assert second.beginning.cut_ns is not None
    found = first.described()
    assert found['has_ended'] and found['inputs'] > 300 and found['bytes'] > 40_000
    # The state that was loaded.
    assert [one.name for one in first.folder.iterdir() if '-' in one.name]
    assert main(['map', 'drop-log', str(path)]) == 0
    assert 'of kept logs removed' in capsys.readouterr().out
    assert main(['replay', str(path), '--log', '--out', str(out)]) == 2
    assert 'has no log' in capsys.readouterr().err
