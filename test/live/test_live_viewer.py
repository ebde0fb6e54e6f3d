# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The live view beside the nodes, as a user starts it: it shows the map and does not change it."""

from __future__ import annotations

import re
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import suppress
from pathlib import Path
from urllib.parse import urlsplit

import pytest
from helpers import SMALL_IMAGES, circles, set_options, write_bag
from processes import Commands, wait_for

from ratslam_ros.cli import main
from ratslam_ros.history.history_run import HistoryRun

viser = pytest.importorskip('viser', reason='the extra [view] is not installed')

SET = set_options(SMALL_IMAGES)


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
        )
        # viser counts a browser once its camera is known.
        self._socket.send(msgspec.msgpack.encode({
            'type': 'ViewerCameraMessage', 'wxyz': (1.0, 0.0, 0.0, 0.0),
            'position': (0.0, 0.0, 50.0), 'fov': 1.0, 'near': 0.1, 'far': 1000.0,
            'image_height': 720, 'image_width': 1280, 'look_at': (0.0, 0.0, 0.0),
            'up_direction': (0.0, 1.0, 0.0),
        }))

        self.received = 0
        """Number of received messages; each holds what was drawn at one time."""
        threading.Thread(target=self._read, daemon=True).start()

    def _read(self) -> None:
        with suppress(Exception):  # the viewer ends first
            for _ in self._socket:
                self.received += 1

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
    with log.open('w') as out:
        process = subprocess.Popen(
            [sys.executable, '-m', 'ratslam_ros', *words], cwd=log.parent, text=True,
            env=commands.environment, stdin=subprocess.DEVNULL, stdout=out, stderr=out,
        )
    commands._running.append(process)
    return process


def test_map_is_that_of_a_replay_with_the_view_open(
    commands: Commands, here, tmp_path: Path, page: list[Page]
) -> None:
    bag = write_bag(tmp_path / 'circles', list(circles(2, 20)))
    out = tmp_path / 'replay'
    assert main(['replay', str(bag), '--out', str(out), '--quiet', '--config', 'extended',
                 *SET]) == 0
    expected = (out / 'map.json').read_text()
    log = tmp_path / 'launch.log'
    nodes = start(
        commands, log, 'launch', '--config', 'extended', *SET, '--view', '--port', '0',
        '--no-browser',
    )
    url = lines_until(nodes, log, r'http://127.0.0.1:\S+')[0]
    lines_until(nodes, log, r'(?s)(?:ready.*){4}')
    page.append(Page(url))
    wait_for(lambda: page[0].received > 0)
    code, _, err = here('play', str(bag), '--rate', '4', '--lockstep', '--quiet')
    assert code == 0, err
    found = ''
    end_s = time.monotonic() + 30.0
    while found != expected and time.monotonic() < end_s:
        words = 'experience_map/map', '--once', '--field', 'data', '--timeout', '10'
        code, found, err = here('echo', *words)
        found = found.rstrip('\n')
    assert found == expected, log.read_text()
    wait_for(lambda: page[0].received > 10)
    nodes.send_signal(signal.SIGINT)
    assert nodes.wait(20.0) == 0, log.read_text()
    assert 'Traceback' not in log.read_text()


def test_viewer_records_without_a_browser_if_asked(
    commands: Commands, here, tmp_path: Path
) -> None:
    from geometry_msgs.msg import PoseWithCovarianceStamped

    from ratslam_ros.live import ros
    from ratslam_ros.ros.convert import header_of
    from ratslam_ros.ros.qos import STATE

    log, kept = tmp_path / 'viewer.log', tmp_path / 'kept.sqlite'
    viewer = start(
        commands, log, 'run', 'viewer', '--ros-args', '-p', 'port:=0', '-p',
        'open_browser:=false', '-p', f'history_file:={kept}',
    )
    with ros.node('robot', ()) as node:
        topic = 'experience_map/pose_with_covariance'
        pose = node.create_publisher(PoseWithCovarianceStamped, topic, STATE)
        wait_for(pose.get_subscription_count)
        for k in range(10):
            pose.publish(PoseWithCovarianceStamped(header=header_of(10**18 + k * 10**8, 'map')))
            time.sleep(0.11)
    viewer.send_signal(signal.SIGINT)
    assert viewer.wait(20.0) == 0, log.read_text()
    history = HistoryRun(kept)
    assert history.end_ns > history.begin_ns > 0
    assert history.seek(history.end_ns).pose is not None


def test_missing_package_is_named_with_the_command(
    ros: None, refusal: Callable[..., str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, 'viser', None)
    assert 'the live view needs viser' in refusal('run', 'viewer')
