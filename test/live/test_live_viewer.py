# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The live view beside the nodes, as a user starts it: it shows the map and does not change it."""

from __future__ import annotations

import re
import signal
import subprocess
import time
from collections import Counter
from collections.abc import Iterator
from pathlib import Path
from typing import Any
from urllib.parse import urlsplit

import pytest
from helpers import circles, write_bag
from processes import Commands, wait_for

from ratslam_ros.cli import main
from ratslam_ros.history.history_run import HistoryRun

viser = pytest.importorskip('viser', reason='the extra [view] is not installed')

SETTINGS = {
    'local_view.template_x_size': 16, 'local_view.template_y_size': 8,
    'local_view.vt_shift_match': 2, 'pose_cells.pc_cell_x_size': 0.5,
    'pose_cells.exp_delta_pc_threshold': 1.0,
}  # fmt: skip
SET = [word for key, value in SETTINGS.items() for word in ('--set', f'{key}={value}')]


class Page:
    """A WebSocket client that receives what a browser would."""

    def __init__(self, url: str) -> None:
        import msgspec
        from websockets.sync.client import connect

        parts = urlsplit(url)
        self._socket = connect(
            f'ws://{parts.netloc}{parts.path}', origin=f'http://{parts.netloc}',  # type: ignore[arg-type]
            subprotocols=[f'viser-v{viser.__version__}'],  # type: ignore[list-item]
            compression=None, max_size=None,
        )  # fmt: skip
        # viser counts a browser once its camera is known.
        self._socket.send(msgspec.msgpack.encode({
            'type': 'ViewerCameraMessage', 'wxyz': (1.0, 0.0, 0.0, 0.0),
            'position': (0.0, 0.0, 50.0), 'fov': 1.0, 'near': 0.1, 'far': 1000.0,
            'image_height': 720, 'image_width': 1280, 'look_at': (0.0, 0.0, 0.0),
            'up_direction': (0.0, 1.0, 0.0),
        }))  # fmt: skip

    def received(self) -> Counter[str]:
        """Return how many messages of each type are waiting."""
        kinds: Counter[str] = Counter()
        while True:
            try:
                data = self._socket.recv(timeout=0.5)
            except TimeoutError:
                return kinds
            assert isinstance(data, bytes)
            kinds.update(re.findall(r'[A-Z][A-Za-z]+Message', data.decode(errors='replace')))

    def close(self) -> None:
        self._socket.close()


@pytest.fixture
def page() -> Iterator[list[Page]]:
    opened: list[Page] = []
    yield opened
    for one in opened:
        one.close()


def lines_until(process: subprocess.Popen[str], log: Path, pattern: str) -> re.Match[str]:
    """Wait until the log of a process matches a pattern."""

    def found() -> re.Match[str] | None:
        assert process.poll() is None, log.read_text()
        return re.search(pattern, log.read_text())

    return wait_for(found)  # type: ignore[no-any-return]


def start(commands: Commands, log: Path, *words: str) -> subprocess.Popen[str]:
    """Start a command whose output goes to a file, so that nothing has to read it."""
    import sys

    with log.open('w') as out:
        process = subprocess.Popen(
            [sys.executable, '-m', 'ratslam_ros', *words], cwd=log.parent, text=True,
            env=commands.environment, stdin=subprocess.DEVNULL, stdout=out, stderr=out,
        )  # fmt: skip
    commands._running.append(process)
    return process


def test_map_is_that_of_a_replay_with_the_view_open(
    commands: Commands, tmp_path: Path, page: list[Page]
) -> None:
    bag = write_bag(tmp_path / 'circles', list(circles(3, 30)))
    out = tmp_path / 'replay'
    assert main(['replay', str(bag), '--out', str(out), '--quiet', '--config', 'default',
                 *SET]) == 0  # fmt: skip
    expected = (out / 'map.json').read_text()
    log, history = tmp_path / 'launch.log', tmp_path / 'kept.sqlite'
    nodes = start(
        commands, log, 'launch', '--config', 'default', *SET, '--view', '--port', '0',
        '--no-browser',
    )  # fmt: skip
    url = lines_until(nodes, log, r'http://127.0.0.1:\S+')[0]
    lines_until(nodes, log, r'(?s)(?:ready.*){4}')
    page.append(Page(url))
    watched = commands.start_python(WATCHED)
    assert watched.wait(30.0) == 0, watched.communicate()
    code, _, err = commands.run('play', str(bag), '--rate', '2', '--lockstep', '--quiet')
    assert code == 0, err
    found = ''
    end_s = time.monotonic() + 30.0
    while found != expected and time.monotonic() < end_s:
        code, found, err = commands.run(
            'echo', 'experience_map/map', '--once', '--field', 'data', '--timeout', '10'
        )
        found = found.rstrip('\n')
    assert found == expected, log.read_text()
    kinds = page[0].received()
    assert sum(kinds.values()) > 100, kinds
    nodes.send_signal(signal.SIGINT)
    assert nodes.wait(20.0) == 0, log.read_text()
    assert 'Traceback' not in log.read_text()
    assert not history.exists()


WATCHED = """
import time
with ros.node('observer', ()) as node:
    print('started', flush=True)
    end_s = time.monotonic() + 20.0
    while node.count_subscribers('/experience_map/changes') < 1:
        assert time.monotonic() < end_s
        time.sleep(0.05)
"""
"""Waits until the viewer has subscribed."""


def test_unwatched_viewer_subscribes_to_nothing_but_records_if_asked(
    commands: Commands, tmp_path: Path
) -> None:
    log, kept = tmp_path / 'viewer.log', tmp_path / 'kept.sqlite'
    options = ('--ros-args', '-p', 'port:=0', '-p', 'open_browser:=false')
    idle = start(commands, log, 'run', 'viewer', *options)
    lines_until(idle, log, 'ready')
    recorder = start(
        commands, tmp_path / 'recorder.log', 'run', 'viewer', *options, '-p',
        f'history_file:={kept}', '-r', '__node:=recorder',
    )  # fmt: skip
    lines_until(recorder, tmp_path / 'recorder.log', 'ready')
    asked = commands.start_python(POSES)
    out, err = asked.communicate(timeout=60.0)
    assert asked.returncode == 0, err
    assert out.split() == ['recorder']
    for process in (idle, recorder):
        process.send_signal(signal.SIGINT)
        assert process.wait(20.0) == 0
    history = HistoryRun(kept)
    assert history.end_ns > history.begin_ns > 0
    assert history.seek(history.end_ns).pose is not None


POSES = """
import time
from geometry_msgs.msg import PoseStamped
from ratslam_ros.nodes.convert import header_of
from ratslam_ros.nodes.qos import STATE
with ros.node('robot', ()) as node:
    pose = node.create_publisher(PoseStamped, 'experience_map/pose', STATE)
    end_s = time.monotonic() + 20.0
    while pose.get_subscription_count() < 1:
        assert time.monotonic() < end_s
        time.sleep(0.05)
    names = [one.node_name for one in node.get_subscriptions_info_by_topic('/experience_map/pose')]
    print(*names, flush=True)
    for k in range(20):
        pose.publish(PoseStamped(header=header_of(10**18 + k * 10**8, 'map')))
        time.sleep(0.11)
"""


def test_view_without_its_package_leaves_the_nodes_running(
    commands: Commands, tmp_path: Path
) -> None:
    """A module of the name viser that cannot be imported stands for a missing package."""
    (tmp_path / 'viser.py').write_text('raise ImportError("no viser here")')
    path = commands.environment['PYTHONPATH']
    commands.environment['PYTHONPATH'] = f'{tmp_path}:{path}'
    log = tmp_path / 'launch.log'
    nodes = start(
        commands, log, 'launch', '--config', 'default', '--single-process', '--view',
        '--no-browser',
    )  # fmt: skip
    lines_until(nodes, log, r"pip install 'ratslam_ros\[view\]'")
    lines_until(nodes, log, 'ready')
    time.sleep(0.5)
    assert nodes.poll() is None, log.read_text()
    assert 'Traceback' not in log.read_text()
    nodes.send_signal(signal.SIGINT)
    assert nodes.wait(20.0) == 0, log.read_text()
