# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Nodes in separate processes, started as a user does: they build the map of a replay."""

from __future__ import annotations

import json
import math
import os
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any, Self

import cv2
import pytest
from contract import UNAVAILABLE
from helpers import (
    SMALL_IMAGES,
    START_NS,
    Recorded,
    camera_info_message,
    circles,
    extended,
    image_message,
    live_environment,
    odometry_message,
    picture,
    real_recording,
    set_options,
    write_bag,
)
from processes import wait_for

from ratslam_ros.cli import main
from ratslam_ros.core.common.pose import Pose
from ratslam_ros.files.config import load_config, to_yaml
from ratslam_ros.live.launch import nodes
from ratslam_ros.maps import read_map
from ratslam_ros.offline.map_upkeep import map_info
from ratslam_ros.pipeline.choice import CAMERA, DEFAULT

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

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
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
        names = nodes or tuple(name for name in self.processes if name != 'echo')
        for name in names:
            self.processes[name].send_signal(number)
        return {name: self.processes.pop(name).wait(20.0) for name in names}

    def run(self, *arguments: str, timeout_s: float = 120.0) -> str:
        """Run one command until it ends; return its output."""
        done = subprocess.run(
            ratslam(*arguments), env=self.environment, cwd=self.folder, capture_output=True,
            text=True, timeout=timeout_s, check=False,
        )
        assert done.returncode == 0, f'{arguments}: {done.stdout}{done.stderr}'
        return done.stdout

    def map(self) -> str:
        """Return the last map received, of a subscriber that the first call starts."""
        if 'echo' not in self.processes:
            command = ratslam('echo', 'experience_map/map', '--field', 'data')
            with (self.folder / 'maps').open('wb') as out:
                self.processes['echo'] = subprocess.Popen(
                    command, env=self.environment, cwd=self.folder, stdout=out
                )
        received = wait_for(lambda: (self.folder / 'maps').read_text().rpartition('\n')[0])
        return received.rpartition('\n')[2]  # without a line that is being written

    def settled_map(self, expected: str, timeout_s: float = 60.0) -> str:
        """Wait for the expected map; return the last one received."""
        end_s = time.monotonic() + timeout_s
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


def test_live_nodes_build_replay_map_and_plan_routes(live: Live, bag: Path, expected: str) -> None:
    live.start(*THREE)
    live.run('play', str(bag), '--rate', '10', '--quiet')
    assert live.settled_map(expected) == expected, live.logs()
    answer = live.run(
        'call', 'experience_map/recall_goal', 'nav_msgs/srv/GetPlan',
        '{goal: {header: {frame_id: map}, pose: {position: {x: 0.0, y: 0.5}}}, tolerance: 1.0}',
    )
    assert answer.count('frame_id: map') > 2
    payload = json.loads(expected)
    assert json.loads(live.map())['stamp'] == payload['stamp']
    assert live.stop() == dict.fromkeys(THREE, 0), live.logs()
    assert 'Traceback' not in live.logs()


def test_own_stages_live_give_the_map_of_a_replay(bag: Path, tmp_path: Path) -> None:
    root = Path(__file__).parents[2]
    words = (
        '--stage', f'{root}/examples/custom_stage.py:HashView',
        '--stage', f'{root}/test/own_counters.py:Brightness',
    )
    files = tmp_path / 'replayed.map', tmp_path / 'live.map'
    expected = offline(bag, tmp_path / 'replayed', SMALL, '--map', str(files[0]), *words)
    with Live(tmp_path / 'live', {**SMALL, 'memory.map': str(files[1])}) as live:
        live.start('single_process', arguments=words)
        live.run('play', str(bag), '--rate', '0', '--lockstep', '--quiet')
        assert live.settled_map(expected) == expected, live.logs()
        assert live.stop() == {'single_process': 0}
    for part, item in (('local_view', 'hashes'), ('brightness', 'counts')):
        theirs, mine = (read_map(file).states[part]['state'][item] for file in files)
        assert len(mine)
        assert mine.tolist() == theirs.tolist()
    assert main(['map', 'check', str(files[1]), *words]) == 0


def test_camera_alone_gives_same_map_split_and_offline(
    live: Live, bag: Path, tmp_path: Path
) -> None:
    """Both take the field of view from the recorded camera_info."""
    info = START_NS, '/camera/camera_info', 'camera_info', camera_info_message(START_NS, 16.0)
    calibrated = write_bag(tmp_path / 'calibrated', [info, *circles(4, 30)])
    expected = offline(calibrated, tmp_path / 'visual', SMALL, '--visual-odometry')
    assert expected != offline(bag, tmp_path / 'other', SMALL, '--visual-odometry')
    live.arguments = nodes(DEFAULT, CAMERA, split=True)
    live.start(*live.arguments)
    live.run('play', str(calibrated), '--rate', '5', '--quiet', '--visual-odometry')
    assert live.settled_map(expected) == expected, live.logs()
    assert set(live.stop().values()) == {0}


def test_image_folder_with_stamps_from_zero_gives_same_map(live: Live, tmp_path: Path) -> None:
    folder = tmp_path / 'images'
    folder.mkdir()
    for n in range(60):
        cv2.imwrite(str(folder / f'{n:03d}.png'), picture(n % 20, 24, 32))
    expected = offline(folder, tmp_path / 'folder', SMALL)
    assert json.loads(expected)['experiences']
    live.start('visual_odometry', *THREE)
    live.run('play', str(folder), '--rate', '3', '--quiet')
    assert live.settled_map(expected) == expected, live.logs()


def test_playing_twice_starts_over_with_same_map(live: Live, bag: Path, expected: str) -> None:
    live.start(*THREE)
    live.run('play', str(bag), '--rate', '10', '--quiet')
    assert live.settled_map(expected) == expected, live.logs()
    live.run('play', str(bag), '--rate', '10', '--quiet')
    wait_for(lambda: live.logs().count('starting with an empty memory') == 3)
    assert live.settled_map(expected) == expected, live.logs()


def test_restarted_pose_cells_are_detected_by_the_map(
    live: Live, bag: Path, tmp_path: Path
) -> None:
    before = offline(bag, tmp_path / 'before', SMALL, '--duration', '6')
    live.start(*THREE)
    live.run('play', str(bag), '--rate', '10', '--quiet', '--duration', '6')
    assert live.settled_map(before) == before, live.logs()
    live.stop('pose_cells', number=signal.SIGKILL)
    live.run('play', str(bag), '--rate', '10', '--quiet', '--start', '6', '--duration', '3',
             '--wait', '1')
    assert live.map() == before
    live.start('pose_cells')
    live.run('play', str(bag), '--rate', '10', '--quiet', '--start', '9')
    count = len(json.loads(before)['experiences'])
    wait_for(lambda: len(json.loads(live.map())['experiences']) > count)
    assert 'empty memory' in live.log('experience_map').read_text()
    assert 'started late' in live.log('pose_cells').read_text()
    assert set(live.stop().values()) == {0}


def test_invalid_parameter_ends_node_with_one_line(live: Live) -> None:
    done = subprocess.run(
        ratslam('run', 'pose_cells', '--ros-args', '-p', 'pc_dim_th:=-3'),
        env=live.environment, capture_output=True, text=True, timeout=60, check=False,
    )
    assert done.returncode == 2
    assert 'pc_dim_th' in done.stderr
    assert 'Traceback' not in done.stderr


@pytest.mark.parametrize('is_recorded', [True, False])
def test_launch_with_automatic_odometry_gives_replay_map(
    live: Live, bag: Path, expected: str, tmp_path: Path, is_recorded: bool
) -> None:
    """The player has publishers before it waits for the nodes; the decision is in the map file."""
    without = () if is_recorded else ('--visual-odometry',)
    if not is_recorded:
        expected = offline(bag, tmp_path / 'offline', SMALL, *without)
    path = tmp_path / 'a.map'
    settings = *set_options(SMALL), '--map', str(path)
    command = 'launch', '--odometry', 'auto', '--config', 'extended', *settings
    live.begin('launch', *command)
    live.run('play', str(bag), *without, '--rate', '0', '--lockstep', '--wait', '60', '--quiet')
    assert live.settled_map(expected) == expected, live.logs()
    source = 'topic' if is_recorded else 'camera'
    assert f'odometry: {source}, as /odom has' in live.log('launch').read_text()
    assert live.stop() == {'launch': 0}
    assert map_info(path)['decided_odometry'] == source
    live.begin('launch', *command)
    live.wait_ready('launch')
    assert f'odometry: {source}, as decided before' in live.log('launch').read_text()
    assert ('[visual_odometry]' in live.log('launch').read_text()) != is_recorded
    assert live.stop() == {'launch': 0}


SLOW_START_SOURCE = """
import sys
from ratslam_ros.starting import announced

with announced('single_process'):
    print('announced', flush=True)
    sys.stdin.readline()
from ratslam_ros.live.run import run
sys.exit(run('single_process', sys.argv[1:]))
"""


def test_play_waits_for_nodes_that_are_starting(live: Live, bag: Path) -> None:
    with live.log('node').open('wb') as log:
        node = live.processes['node'] = subprocess.Popen(
            [sys.executable, '-c', SLOW_START_SOURCE, '--ros-args', *live.parameters],
            env=live.environment, stdin=subprocess.PIPE, stdout=log, stderr=subprocess.STDOUT,
        )
    wait_for(lambda: 'announced' in live.log('node').read_text())
    with live.log('play').open('wb') as log:
        play = live.processes['play'] = subprocess.Popen(
            ratslam('play', str(bag), '--rate', '0', '--duration', '0.5', '--wait', '1'),
            env=live.environment, stdout=log, stderr=subprocess.STDOUT,
        )
    wait_for(lambda: 'waiting for single_process to start' in live.log('play').read_text())
    assert node.stdin is not None
    node.stdin.close()  # the start goes on
    assert play.wait(READY_S) == 0, live.logs()
    assert 'ready' in live.log('node').read_text()


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
        time.sleep(0.03)
"""


def test_invalid_input_on_every_topic_changes_nothing(
    live: Live, bag: Path, expected: str
) -> None:
    live.start(*THREE)
    live.run('play', str(bag), '--rate', '10', '--quiet', '--duration', '3')
    with live.log('invalid_input').open('wb') as log:
        live.processes['invalid_input'] = subprocess.Popen(
            [sys.executable, '-c', INVALID_INPUT_SOURCE, str(START_NS)], env=live.environment,
            stdout=log, stderr=subprocess.STDOUT,
        )
    wait_for(lambda: live.log('invalid_input').read_text() == 'ready\n')
    live.run('play', str(bag), '--rate', '1', '--quiet', '--start', '3')
    assert live.log('invalid_input').read_text() == 'ready\n'
    live.stop('invalid_input', number=signal.SIGKILL)
    assert live.settled_map(expected) == expected, live.logs()
    refused = [line for line in live.logs().splitlines() if 'refused' in line]
    assert 3 <= len(refused) < 60  # Logged at a bounded rate.
    assert set(live.stop().values()) == {0}


def turned_about() -> Iterator[Recorded]:
    """Yield circles with images behind a mask, and odometry whose twist is empty."""
    for i, (stamp_ns, topic, kind, message) in enumerate(circles(3, 30)):
        if kind == 'odometry':
            angle = 2.0 * math.pi * (i // 2) / 30
            pose = Pose(2.0 * math.sin(angle), 2.0 - 2.0 * math.cos(angle), angle)
            message = odometry_message(stamp_ns, 0.0, 0.0, pose)
        else:
            pixels = picture(i // 2 % 30, 60, 80)
            pixels[:, :9] = 0
            message = image_message(stamp_ns, pixels)
        yield stamp_ns, topic, kind, message


def test_nodes_without_configuration_build_replay_map(tmp_path: Path) -> None:
    recording = str(write_bag(tmp_path / 'masked', turned_about()))
    maps = []
    for name, arguments in (('without', ['--no-inspect']), ('inspected', [])):
        out = tmp_path / name
        assert main(['replay', recording, *arguments, '--out', str(out), '--quiet']) == 0
        maps.append((out / 'map.json').read_text())
    assert maps[0] != maps[1]
    config = str(tmp_path / 'inspected' / 'config.yaml')
    for expected, parameters in zip(maps, ([], ['--params-file', config]), strict=True):
        with Live(tmp_path / 'live', None) as live:
            live.parameters = parameters
            live.start(*THREE)
            live.run('play', recording, '--rate', '0', '--lockstep', '--quiet')
            assert live.settled_map(expected) == expected, live.logs()


def test_real_recording_at_tenfold_speed_gives_replay_map(tmp_path: Path) -> None:
    recording = real_recording('rc_car_loops')
    settings = {**load_config('rc_car')[0].flat(), **PATIENT}
    part = ('--duration', '40')
    expected = offline(recording, tmp_path / 'offline', settings, *part)
    with Live(tmp_path / 'live', settings) as live:
        live.start(*THREE)
        live.run('play', str(recording), '--rate', '10', '--quiet', *part)
        assert live.settled_map(expected, 60.0) == expected, live.logs()
        assert set(live.stop().values()) == {0}
