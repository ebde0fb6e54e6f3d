# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""``ratslam launch``: command lines of the nodes, and how they end."""

import argparse
import os
import re
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest
import yaml
from processes import wait_for

from ratslam_ros import supervision
from ratslam_ros.cli.main import parser
from ratslam_ros.core.config import Config
from ratslam_ros.errors import UnusableParameter
from ratslam_ros.live import launch as module
from ratslam_ros.live.launch import (
    launch,
    nodes,
    remappings,
    ros_arguments,
    used_scans,
    with_map,
)
from ratslam_ros.pipeline.choice import AUTO, CAMERA, DEFAULT, NAMES, TOPIC
from ratslam_ros.supervision import supervise

ROOT = Path(__file__).parents[2]
FILE = Path('/somewhere/parameters.yaml')
STOPS = 'signal.signal(signal.SIGINT, lambda *_: sys.exit(0))'
IGNORES = 'signal.signal(signal.SIGINT, signal.SIG_IGN)'


def python(code: str) -> list[str]:
    return [sys.executable, '-c', code]


def test_stages_share_a_process_unless_they_are_split() -> None:
    assert nodes(DEFAULT, CAMERA, False) == {'single_process': ['--stages', ','.join(NAMES)]}
    assert list(nodes(DEFAULT, CAMERA, False, viewer=True)) == ['single_process', 'viewer']
    assert nodes(DEFAULT, TOPIC, split=True) == {
        'local_view': ['--followed'],
        'pose_cells': ['--follows', 'local_view', '--followed'],
        'experience_map': ['--follows', 'pose_cells'],
    }
    assert nodes(DEFAULT, CAMERA, split=True)['single_process'] == [
        '--stages', 'visual_odometry,local_view', '--followed'
    ]


def test_first_process_of_a_split_receives_the_scans() -> None:
    values = {'experience_map.exp_align_scans': True, 'experience_map.scan_topics': 'scan,rear'}
    scans = used_scans(Config().with_values(values))
    started = nodes(DEFAULT, TOPIC, split=True, scans=scans)
    assert started['local_view'] == ['--followed', 'scan,rear']
    assert started['experience_map'] == ['--follows', 'pose_cells']
    assert used_scans(Config()) == ''


def test_process_of_local_view_decides_about_odometry() -> None:
    decides = 'single_process', ['--stages', DEFAULT, '--odometry', AUTO]
    assert nodes(DEFAULT, AUTO, split=False) == dict([decides])
    assert nodes(DEFAULT, AUTO, split=True) == {
        'single_process': ['--stages', 'local_view', '--odometry', AUTO, '--followed'],
        'pose_cells': ['--follows', 'local_view', '--followed'],
        'experience_map': ['--follows', 'pose_cells'],
    }
    with pytest.raises(UnusableParameter, match='before local_view; found the stages pose_cells:'):
        nodes('pose_cells', AUTO, split=False)


@pytest.mark.parametrize(('stages', 'expected'), [
    ('experience_map,pose_cells', {'single_process': ['--stages', 'pose_cells,experience_map']}),
    ('local_view,experience_map', {'local_view': [], 'experience_map': []}),
    ('pose_cells', {'single_process': ['--stages', 'pose_cells']}),
])
def test_stages_beside_foreign_ones_are_started(
    stages: str, expected: dict[str, list[str]]
) -> None:
    assert nodes(stages, TOPIC, split=False) == expected


def test_own_stages_run_in_the_process_of_all_mapping_nodes() -> None:
    words = ['--stages', DEFAULT, '--stage', 'a.py:A', '--stage', 'b:B']
    assert nodes(DEFAULT, TOPIC, False, viewer=True, own_stages=['a.py:A', 'b:B']) == {
        'single_process': words, 'viewer': []
    }
    with pytest.raises(UnusableParameter, match='processes for local_view, pose_cells, exp'):
        nodes(DEFAULT, TOPIC, split=True, own_stages=['a.py:A'])


def test_split_pose_cells_without_our_map_wait_for_no_answers() -> None:
    started = nodes('local_view,pose_cells', TOPIC, split=True)
    assert started == {'local_view': ['--followed'], 'pose_cells': ['--follows', 'local_view']}
    started = nodes('pose_cells', TOPIC, split=True)
    assert started == {'single_process': ['--stages', 'pose_cells']}


def test_only_one_node_may_drive() -> None:
    assert list(nodes(DEFAULT, TOPIC, False, nav2=True)) == ['single_process', 'route_to_nav2']
    assert list(nodes(DEFAULT, TOPIC, False, route_server=True)) == [
        'single_process', 'route_server_graph'
    ]
    with pytest.raises(UnusableParameter, match='both would drive'):
        nodes(DEFAULT, TOPIC, False, goal_follower=True, nav2=True)


def given(*arguments: str) -> argparse.Namespace:
    return parser().parse_args(['launch', *arguments])


def test_all_options_are_passed_to_nodes() -> None:
    options = given(
        '--use-sim-time', '--namespace', 'robot', '--image-topic', '/cam/image_raw',
        '--odom-topic', '/wheels', '--log-level', 'debug',
    )
    assert ros_arguments(options, FILE) == [
        '--params-file', str(FILE), '-p', 'use_sim_time:=true', '-r', '__ns:=/robot',
        '-r', 'image:=/cam/image_raw', '-r', 'image/compressed:=/cam/image_raw/compressed',
        '-r', 'camera_info:=/cam/camera_info', '-r', 'odom:=/wheels', '--log-level', 'debug',
    ]


@pytest.mark.parametrize('given', ['/cam/image', '/cam/image/compressed'])
def test_raw_or_compressed_camera_topic_is_accepted(given: str) -> None:
    assert remappings(given, '') == [
        ('image', '/cam/image'), ('image/compressed', '/cam/image/compressed'),
        ('camera_info', '/cam/camera_info'),
    ]


def test_nodes_share_one_parameter_file(monkeypatch: pytest.MonkeyPatch) -> None:
    seen: dict[str, list[str]] = {}

    def inspect(
        commands: dict[str, list[str]], optional: object, respawn: bool, are_nodes: bool
    ) -> int:
        assert are_nodes and not respawn
        seen.update(commands)
        values = yaml.safe_load(Path(commands['pose_cells'][-1]).read_text('utf-8'))
        assert values['/**/pose_cells']['ros__parameters']['pc_dim_x'] == 31
        return 0

    monkeypatch.setattr(module, 'supervise', inspect)
    config = Config().with_values({'pose_cells.pc_dim_x': 31})
    assert launch(config, given('--stages', ','.join(NAMES), '--split')) == 0
    assert list(seen) == ['single_process', 'pose_cells', 'experience_map']
    command = seen['pose_cells']
    assert command[:7] == [
        sys.executable, '-m', 'ratslam_ros', 'run', 'pose_cells', '--follows', 'local_view'
    ]
    assert not Path(command[-1]).exists()  # It is removed at the end.


@pytest.mark.parametrize(('odometry', 'stages'), [
    ('topic', DEFAULT), ('camera', ','.join(NAMES)),
])
def test_odometry_from_camera_adds_a_stage(
    odometry: str, stages: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(module, 'supervise', lambda commands, **_: commands['single_process'][6])
    assert launch(Config(), given('--odometry', odometry)) == stages


def child(ready: Path, answer: str) -> list[str]:
    """Return a command that writes its process id when it can be interrupted."""
    report = f'open({str(ready)!r}, "w").write(str(os.getpid()))'
    return python(f'import os, signal, sys, time\n{answer}\n{report}\ntime.sleep(60)')


@contextmanager
def interrupts(*ready: Path, times: int = 1) -> Iterator[None]:
    """Send this process SIGINT when all children are ready."""

    def send() -> None:
        wait_for(lambda: all(path.exists() for path in ready))
        for _ in range(times):
            os.kill(os.getpid(), signal.SIGINT)
            time.sleep(0.2)

    thread = threading.Thread(target=send)
    thread.start()
    yield
    thread.join()


def test_interrupt_stops_all_without_failure(tmp_path: Path, capfd) -> None:
    a, b = tmp_path / 'a', tmp_path / 'b'
    with interrupts(a, b):
        assert supervise({'a': child(a, STOPS), 'b': child(b, STOPS)}) == 0
    assert capfd.readouterr() == ('', '')


def test_interrupt_during_start_up_is_no_failure(tmp_path: Path) -> None:
    a = tmp_path / 'a'
    with interrupts(a):
        assert supervise({'a': child(a, 'signal.signal(signal.SIGINT, signal.SIG_DFL)')}) == 0


def test_second_interrupt_kills(tmp_path: Path, capfd) -> None:
    a, b = tmp_path / 'a', tmp_path / 'b'
    with interrupts(a, b, times=2):
        assert supervise({'a': child(a, STOPS), 'b': child(b, IGNORES)}) == 1
    assert re.search('killing (a, )?b', capfd.readouterr().err)  # a may be slow to end


def test_process_that_does_not_end_is_killed(
    tmp_path: Path, capfd, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(supervision, 'SHUTDOWN_TIMEOUT_S', 0.3)
    a = tmp_path / 'a'
    with interrupts(a):
        assert supervise({'a': child(a, IGNORES)}) == 1
    assert 'killing a' in capfd.readouterr().err


def test_process_that_ends_is_named_and_stops_others(tmp_path: Path, capfd) -> None:
    a = child(tmp_path / 'a', STOPS)
    assert supervise({'a': a, 'b': python('raise SystemExit(3)')}) == 1
    assert 'b ended with code 3; stopping a' in capfd.readouterr().err


def failing(times: int, failure: str, ready: Path, reports: Path) -> list[str]:
    """Return a command that fails this many times, and reports why it is started again."""
    return python(
        'import os, signal, sys, time\n'
        f'with open({str(reports)!r}, "a") as file: '
        'print(os.getenv("RATSLAM_RESTARTS"), file=file)\n'
        f'if len(open({str(reports)!r}).readlines()) <= {times}: {failure}\n'
        f'{STOPS}\nopen({str(ready)!r}, "w").close()\ntime.sleep(60)'
    )


def test_killed_process_is_started_again_with_a_map(tmp_path: Path, capfd) -> None:
    a = tmp_path / 'a'
    command = failing(2, 'os.kill(os.getpid(), signal.SIGKILL)', a, tmp_path / 'reports')
    with interrupts(a):
        assert supervise({'a': command}, respawn=True) == 0
    assert capfd.readouterr().err.count('a was ended by SIGKILL; starting it again') == 2


def test_process_that_keeps_failing_is_restarted_with_growing_pauses(
    tmp_path: Path, capfd, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(supervision, 'PAUSE_S', 0.001)
    a, reports = tmp_path / 'a', tmp_path / 'reports'
    with interrupts(a):
        assert supervise({'a': failing(7, 'sys.exit(3)', a, reports)}, respawn=True) == 0
    printed = capfd.readouterr().err
    pauses = re.findall(r'a ended with code 3; starting it again(?: in (.+) s)?', printed)
    assert pauses == ['', '0.001', '0.003', '0.007', '0.015', '0.031', '0.063']
    *_, last = reports.read_text().splitlines()
    assert last == 'restart 7 at short intervals, after 0.063 s: a ended with code 3'


def test_process_that_ends_at_any_moment_is_started_again(monkeypatch: pytest.MonkeyPatch) -> None:
    """It fails between two looks at it."""
    class Ending:
        returncode: int | None = None

        def __init__(self, looks: int, code: int) -> None:
            self._looks, self._code = looks, code

        def poll(self) -> int | None:
            self._looks -= 1
            self.returncode = None if self._looks >= 0 else self._code
            return self.returncode

        def wait(self) -> int:
            return self._code

    processes = iter([Ending(1, 3), Ending(0, 0)])
    starts: list[object] = []
    monkeypatch.setattr(
        supervision.subprocess, 'Popen', lambda *_, **__: starts.append(0) or next(processes)
    )
    supervise({'a': []}, respawn=True)
    assert len(starts) == 2


def test_unusable_map_ends_the_nodes_at_once(capfd) -> None:
    assert supervise({'a': python('raise SystemExit(2)')}, respawn=True) == 1
    assert 'starting it again' not in capfd.readouterr().err


def test_map_option_sets_the_map_of_all_nodes() -> None:
    memory = with_map(Config(), '~/office map.ratslam', localize=True).memory
    assert memory.map == str(Path.home() / 'office map.ratslam')
    assert memory.localize is True
    with pytest.raises(UnusableParameter, match='needs the map'):
        with_map(Config(), '', localize=True)


def test_log_is_kept_only_beside_a_map_that_is_written() -> None:
    assert with_map(Config(), 'a.map', localize=False, keep_log=True).memory.keep_log
    with pytest.raises(UnusableParameter, match='give its file'):
        with_map(Config(), '', localize=False, keep_log=True)
    with pytest.raises(UnusableParameter, match='leave one out'):
        with_map(Config(), 'a.map', localize=True, keep_log=True)


def test_optional_command_may_end(tmp_path: Path) -> None:
    """The viewer without its package: the nodes go on until they are stopped."""
    a, b = tmp_path / 'a', tmp_path / 'b'
    viewer = python(f'open({str(b)!r}, "w").close(); raise SystemExit(2)')
    with interrupts(a, b):
        assert supervise({'a': child(a, STOPS), 'viewer': viewer}, {'viewer'}) == 0


def test_single_process_that_ends_is_reported(capfd) -> None:
    assert supervise({'a': python('pass')}) == 1
    assert capfd.readouterr().err == 'ratslam launch: a ended with code 0\n'


def test_missing_command_leaves_no_process_running(tmp_path: Path) -> None:
    before = signal.getsignal(signal.SIGINT)
    with pytest.raises(FileNotFoundError):
        supervise({'a': child(tmp_path / 'a', STOPS), 'b': ['/no/such/command']})
    assert signal.getsignal(signal.SIGINT) is before


@pytest.mark.skipif(sys.platform != 'linux', reason='only Linux signals children')
def test_children_end_if_parent_is_killed(tmp_path: Path) -> None:
    pid = tmp_path / 'pid'
    code = (
        'from ratslam_ros.supervision import supervise\n'
        f'supervise({{"a": {child(pid, "signal.SIGTERM")!r}}})\n'
    )
    parent = subprocess.Popen(python(code), cwd=ROOT, env={**os.environ, 'PYTHONPATH': str(ROOT)})
    try:
        wait_for(lambda: pid.exists() and pid.read_text())
    finally:
        parent.kill()
        parent.wait()
    wait_for(lambda: not alive(int(pid.read_text())))


def alive(pid: int) -> bool:
    try:
        return Path(f'/proc/{pid}/stat').read_text().split(')')[-1].split()[0] != 'Z'
    except OSError:
        return False
