# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Nodes in separate processes, started as a user does: they build the map of a replay."""

from __future__ import annotations

import json
import os
import runpy
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import redirect_stderr, redirect_stdout
from io import StringIO
from pathlib import Path
from typing import Any, Self

import cv2
import pytest
from contract import UNAVAILABLE
from helpers import (
    SMALL_IMAGES,
    START_NS,
    camera_info_message,
    circles,
    extended,
    live_environment,
    picture,
    real_recording,
    set_options,
    write_bag,
)
from processes import ROOT, wait_for

from ratslam_ros.cli import main
from ratslam_ros.files.config import load_config, to_yaml
from ratslam_ros.maps import read_map
from ratslam_ros.offline.map_upkeep import map_info
from ratslam_ros.pipeline.choice import NAMES
from ratslam_ros.ros.single_process import _decided_odometry

if UNAVAILABLE:
    pytest.skip(UNAVAILABLE, allow_module_level=True)

PATIENT = {'inputs.max_lateness_s': 120.0}
"""A process of a loaded machine may stand still for seconds, and playback at ten times real time
makes that ten times as many seconds of stamps."""
SMALL = {**SMALL_IMAGES, **PATIENT}
READY_S = 60.0


def ratslam(*arguments: str) -> list[str]:
    return [sys.executable, '-m', 'ratslam_ros', *arguments]


class Live:
    """Nodes, each in its own process, and commands of a user."""

    def __init__(self, folder: Path, settings: dict[str, Any] | None) -> None:
        """Without settings, the nodes get no configuration."""
        self.folder = folder
        folder.mkdir(exist_ok=True)
        self.environment = {**os.environ, **live_environment(1)}
        self.parameters: list[str] = []
        if settings is not None:
            path = folder / 'parameters.yaml'
            path.write_text(to_yaml(extended().with_values(settings)))
            self.parameters = ['--params-file', str(path)]
        self.processes: dict[str, subprocess.Popen[bytes]] = {}
        self.arguments: dict[str, list[str]] = {}
        """Further arguments of nodes, by their names."""
        self._patch = pytest.MonkeyPatch()

    def __enter__(self) -> Self:
        """Move this process to the domain of the nodes."""
        for name, value in live_environment(1).items():
            self._patch.setenv(name, value)
        return self

    def __exit__(self, *_: object) -> None:
        self._patch.undo()
        for process in self.processes.values():
            process.kill()
            process.wait()

    def start(self, *nodes: str, arguments: tuple[str, ...] = ()) -> None:
        for node in nodes:
            own = self.arguments.get(node, [])
            self.begin(node, 'run', node, *arguments, *own, '--ros-args', *self.parameters)
        self.wait_ready(*nodes)

    def begin(self, name: str, *words: str) -> None:
        """Start a command whose output is in a log; do not wait for it."""
        with self.log(name).open('wb') as log:
            self.processes[name] = subprocess.Popen(
                ratslam(*words), env=self.environment, cwd=self.folder, stdout=log,
                stderr=subprocess.STDOUT,
            )

    def wait_ready(self, *nodes: str) -> None:
        end_s = time.monotonic() + READY_S
        for node in nodes:
            while 'ready' not in self.log(node).read_text():
                assert self.processes[node].poll() is None, self.log(node).read_text()
                assert time.monotonic() < end_s, self.log(node).read_text()
                time.sleep(0.05)

    def log(self, node: str) -> Path:
        return self.folder / f'{node}.log'

    def stop(self, *nodes: str, number: signal.Signals = signal.SIGINT) -> dict[str, int]:
        """Interrupt the given nodes, by default all; return their exit codes."""
        names = nodes or tuple(self.processes)
        for name in names:
            self.processes[name].send_signal(number)
        return {name: self.processes.pop(name).wait(20.0) for name in names}

    def run(self, *words: str) -> str:
        """Run one command in this process until it ends; return its output."""
        out, err = StringIO(), StringIO()
        before = signal.getsignal(signal.SIGTERM)
        try:
            with redirect_stdout(out), redirect_stderr(err):
                code = main(words)
        finally:
            signal.signal(signal.SIGTERM, before)
        assert code == 0, f'{words}: {out.getvalue()}{err.getvalue()}'
        return out.getvalue()

    def play(self, recording: Path, *words: str) -> None:
        self.run('play', str(recording), '--quiet', *words)

    def map(self) -> str:
        """Return the last published map."""
        words = 'echo', 'experience_map/map', '--once', '--field', 'data', '--timeout', '20'
        return self.run(*words).rstrip('\n')

    def settled_map(self, expected: str) -> str:
        """Wait for the expected map; return the last one received."""
        end_s = time.monotonic() + READY_S
        while (found := self.map()) != expected and time.monotonic() < end_s:
            time.sleep(0.1)
        return found

    def logs(self) -> str:
        return '\n'.join(path.read_text() for path in sorted(self.folder.glob('*.log')))


def offline(recording: Path, folder: Path, settings: dict[str, Any], *arguments: str) -> str:
    """Return map.json of a replay."""
    words = ['replay', str(recording), '--out', str(folder), '--quiet', '--config', 'extended']
    words += [*set_options(settings), *arguments]
    assert main(words) == 0
    return (folder / 'map.json').read_text()


@pytest.fixture(scope='module')
def bag(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_bag(tmp_path_factory.mktemp('recording') / 'circles', list(circles(4, 30)))


@pytest.fixture(scope='module')
def expected(bag: Path, tmp_path_factory: pytest.TempPathFactory) -> str:
    return offline(bag, tmp_path_factory.mktemp('offline'), SMALL)


THREE = ('local_view', 'pose_cells', 'experience_map')


@pytest.fixture
def live(tmp_path: Path) -> Iterator[Live]:
    with Live(tmp_path / 'live', SMALL) as nodes:
        yield nodes


INVALID_INPUT_SOURCE = """
import math, random, sys, time
from ratslam_ros.live import ros
ros.require()
from nav_msgs.msg import Odometry
from sensor_msgs.msg import Image
from std_msgs.msg import String
from geometry_msgs.msg import PoseStamped
from ratslam_ros.ros.convert import header_of
from ratslam_ros.ros.qos import PLAYED

rng = random.Random(1)
first = int(sys.argv[1])
with ros.node('invalid_input', ()) as node:
    odometry = node.create_publisher(Odometry, 'odom', PLAYED)
    image = node.create_publisher(Image, 'image', PLAYED)
    texts = [node.create_publisher(String, name, PLAYED)
             for name in ('local_view/template', 'pose_cells/action')]
    goal = node.create_publisher(PoseStamped, 'goal_pose', PLAYED)
    stamps = [0, 1, first - 10**12, first + 10**13, first - 1, -5 * 10**9]
    bad = [
        lambda: odometry.publish(broken()),
        lambda: image.publish(Image(header=header_of(first - 7, 'x'), width=2**31, height=2**31)),
        lambda: image.publish(Image(header=header_of(rng.choice(stamps), 'x'), encoding='what')),
        lambda: image.publish(Image(header=header_of(rng.choice(stamps), 'x'), width=64,
                              height=64, step=64, encoding='mono8', data=bytes(64 * 64))),
        lambda: rng.choice(texts).publish(String(data=rng.choice(
            ['', 'null', '[' * 9999, '{"schema_version": 1}', '\\x00', '{"stamp": 5}']))),
        lambda: goal.publish(PoseStamped(header=header_of(0, 'mars'))),
    ]

    def broken():
        if rng.random() < 0.5:
            message = Odometry(header=header_of(rng.choice(stamps), 'odom'))
            message.twist.twist.linear.x = 50.0
        else:
            message = Odometry(header=header_of(first, 'odom'))
            message.twist.twist.linear.x = rng.choice([math.nan, math.inf, -math.inf, 1e300])
        return message

    print('ready', flush=True)
    while True:
        rng.choice(bad)()
        time.sleep(0.01)
"""


def test_live_nodes_build_replay_map_whatever_else_arrives(
    live: Live, bag: Path, expected: str, monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    """Twice, with invalid input on every topic at last; then with new pose cells."""
    live.start(*THREE)
    live.play(bag, '--rate', '10')
    assert live.settled_map(expected) == expected, live.logs()
    monkeypatch.setattr(sys, 'argv', ['goal_client.py', '0.0', '0.5'])
    runpy.run_path(str(ROOT / 'examples/goal_client.py'), run_name='__main__')
    route = [line.split() for line in capsys.readouterr().out.splitlines()]
    assert len(route) > 2 and all(len(pose) == 2 for pose in route)

    live.play(bag, '--rate', '10', '--duration', '3')
    wait_for(lambda: live.logs().count('starting with an empty memory') == 3)
    with live.log('invalid_input').open('wb') as log:
        live.processes['invalid_input'] = subprocess.Popen(
            [sys.executable, '-c', INVALID_INPUT_SOURCE, str(START_NS)], env=live.environment,
            stdout=log, stderr=subprocess.STDOUT,
        )
    wait_for(lambda: live.log('invalid_input').read_text() == 'ready\n')
    live.play(bag, '--rate', '3', '--start', '3')
    assert live.log('invalid_input').read_text() == 'ready\n'
    live.stop('invalid_input', number=signal.SIGKILL)
    assert live.settled_map(expected) == expected, live.logs()
    refused = [line for line in live.logs().splitlines() if 'refused' in line]
    assert 3 <= len(refused) < 60  # Logged at a bounded rate.

    live.stop('pose_cells', number=signal.SIGKILL)
    live.start('pose_cells')
    after = write_bag(live.folder / 'after', list(circles(5, 30))[2 * 4 * 30:])
    live.play(after, '--rate', '10')
    count = len(json.loads(expected)['experiences'])
    wait_for(lambda: len(json.loads(live.map())['experiences']) > count)
    assert 'has started with an empty memory' in live.log('experience_map').read_text()
    assert 'started late' in live.log('pose_cells').read_text()
    assert live.stop() == dict.fromkeys(THREE, 0), live.logs()
    assert 'Traceback' not in live.logs()


def test_invalid_parameter_ends_node_with_one_line(live: Live, refusal) -> None:
    assert 'pc_dim_th' in refusal('run', 'pose_cells', '--ros-args', '-p', 'pc_dim_th:=-3')


def test_launch_with_automatic_odometry_gives_replay_map(
    live: Live, bag: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """The player has publishers before it waits for the nodes; the decision is in the map file.

    Nodes and replay take the field of view from the recorded camera_info.
    """
    info = START_NS, '/camera/camera_info', 'camera_info', camera_info_message(START_NS, 16.0)
    calibrated = write_bag(tmp_path / 'calibrated', [info, *circles(4, 30)])
    expected = offline(calibrated, tmp_path / 'visual', SMALL, '--visual-odometry')
    assert expected != offline(bag, tmp_path / 'other', SMALL, '--visual-odometry')
    path = tmp_path / 'a.map'
    settings = *set_options(SMALL), '--map', str(path)
    live.begin('launch', 'launch', '--odometry', 'auto', '--config', 'extended', *settings)
    live.play(calibrated, '--visual-odometry', '--rate', '0', '--lockstep', '--wait', '60')
    assert live.settled_map(expected) == expected, live.logs()
    assert 'odometry: camera, as /odom has' in live.log('launch').read_text()
    assert live.stop() == {'launch': 0}
    assert map_info(path)['decided_odometry'] == 'camera'
    assert _decided_odometry(['--ros-args', '-p', f'map:={path}']) == 'camera'
    assert 'odometry: camera, as decided before' in capsys.readouterr().err


SLOW_START_SOURCE = """
import sys
from ratslam_ros.starting import announced

with announced('single_process'):
    print('announced', flush=True)
    sys.stdin.readline()
from ratslam_ros.live.run import run
sys.exit(run('single_process', sys.argv[1:]))
"""


def test_slow_unconfigured_nodes_map_images_with_stamps_from_zero(tmp_path: Path) -> None:
    """Playing waits for the nodes, which run with a stage of the user."""
    own = '--stage', f'{ROOT}/test/own_counters.py:Brightness'
    folder, files = tmp_path / 'images', (tmp_path / 'replayed.map', tmp_path / 'live.map')
    folder.mkdir()
    for n in range(60):
        cv2.imwrite(str(folder / f'{n:03d}.png'), picture(n % 20, 24, 32))
    words = 'replay', str(folder), '--no-inspect', '--out', str(tmp_path / 'out'), '--quiet'
    assert main([*words, '--map', str(files[0]), *own]) == 0
    expected = (tmp_path / 'out' / 'map.json').read_text()
    assert json.loads(expected)['experiences']
    with Live(tmp_path / 'live', None) as live:
        arguments = '--stages', ','.join(NAMES), *own, '--ros-args', '-p', f'map:={files[1]}'
        with live.log('node').open('wb') as log:
            node = live.processes['node'] = subprocess.Popen(
                [sys.executable, '-c', SLOW_START_SOURCE, *arguments], env=live.environment,
                stdin=subprocess.PIPE, stdout=log, stderr=subprocess.STDOUT,
            )
        wait_for(lambda: 'announced' in live.log('node').read_text())
        live.begin('play', 'play', str(folder), '--rate', '0', '--lockstep', '--wait', '1')
        wait_for(lambda: 'waiting for single_process to start' in live.log('play').read_text())
        assert node.stdin is not None
        node.stdin.close()  # the start goes on
        assert live.processes.pop('play').wait(READY_S) == 0, live.logs()
        assert live.settled_map(expected) == expected, live.logs()
        assert live.stop() == {'node': 0}
    theirs, mine = (read_map(file).states['brightness']['state']['counts'] for file in files)
    assert len(mine)
    assert mine.tolist() == theirs.tolist()
    assert main(['map', 'check', str(files[1]), *own]) == 0


def test_real_recording_at_tenfold_speed_gives_replay_map(tmp_path: Path) -> None:
    recording = real_recording('rc_car_loops')
    settings = {**load_config('rc_car')[0].flat(), **PATIENT}
    part = ('--duration', '20')
    expected = offline(recording, tmp_path / 'offline', settings, *part)
    with Live(tmp_path / 'live', settings) as live:
        live.start('single_process')
        live.play(recording, '--rate', '10', *part)
        assert live.settled_map(expected) == expected, live.logs()
        assert set(live.stop().values()) == {0}
