# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Nodes with a map file that are killed and started again: same map as without, byte for byte."""

from __future__ import annotations

import json
import re
import signal
import subprocess
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest
from helpers import circles, write_bag
from processes import wait_for
from test_live_nodes import SMALL, THREE, Live, offline, ratslam

from ratslam_ros.live.launch import nodes
from ratslam_ros.maps import read_map
from ratslam_ros.pipeline.choice import DEFAULT, TOPIC

PLAY_S = 60.0


@pytest.fixture(scope='module')
def bag(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_bag(tmp_path_factory.mktemp('recording') / 'circles', list(circles(6, 30)))


@pytest.fixture(scope='module')
def expected(bag: Path, tmp_path_factory: pytest.TempPathFactory) -> str:
    return offline(bag, tmp_path_factory.mktemp('offline'), SMALL)


@pytest.fixture
def live(tmp_path: Path) -> Iterator[Live]:
    file = str(tmp_path / 'office.ratslam')
    # A process of a loaded machine may take seconds to start, in which its neighbours get nothing.
    settings = {**SMALL, 'memory.map': file, 'inputs.flush_after_s': 10.0}
    with Live(tmp_path / 'live', settings) as live:
        live.arguments = nodes(DEFAULT, TOPIC, split=True)
        yield live


@contextmanager
def playing(
    live: Live, bag: Path, *arguments: str, lockstep: bool = True
) -> Iterator[subprocess.Popen[bytes]]:
    """Play a recording until the end."""
    options = ['--lockstep'] if lockstep else []
    command = ratslam('play', str(bag), '--quiet', *options, *arguments)
    with live.log('player').open('wb') as log:
        player = subprocess.Popen(
            command, env=live.environment, cwd=live.folder, stdout=log, stderr=log
        )
    try:
        yield player
        assert player.wait(PLAY_S) == 0, live.logs()
    finally:
        player.kill()
        player.wait()


def wait_for_cut(live: Live, node: str) -> None:
    """Wait until a node has saved its state."""
    live.run(
        'echo', 'ratslam/cut', '--once', '--field', 'data', '--timeout', '20', timeout_s=40.0
    )


def restart(live: Live, *nodes: str) -> None:
    """Kill nodes, and start them again at once."""
    live.stop(*nodes, number=signal.SIGKILL)
    live.start(*nodes)


def restored_s(live: Live, node: str) -> float:
    """Return the stamp from which a restarted node has continued."""
    end_s = time.monotonic() + 20.0
    while True:
        found = re.search(r'continued from the map at (\S+) s', live.log(node).read_text())
        if found or time.monotonic() > end_s:
            assert found, live.logs()
            return float(found[1])
        time.sleep(0.05)


def test_killed_nodes_continue_and_build_the_undisturbed_map(
    live: Live, bag: Path, expected: str, tmp_path: Path
) -> None:
    """First single nodes, then all at once, as in a power cut."""
    live.start(*THREE)
    with playing(live, bag, '--rate', '2'):
        wait_for_cut(live, 'local_view')
        restart(live, 'local_view')
        restored_s(live, 'local_view')
        restart(live, 'pose_cells', 'experience_map')
        restored_s(live, 'pose_cells')
        restored_s(live, 'experience_map')
        restart(live, *THREE)
        assert len({restored_s(live, node) for node in THREE}) == 1
    assert live.settled_map(expected) == expected, live.logs()
    assert live.stop() == dict.fromkeys(THREE, 0), live.logs()
    assert 'lost' not in live.logs()
    [file] = tmp_path.glob('office*')
    saved = read_map(file)
    assert saved.states.keys() == set(THREE)
    assert len(saved.states['experience_map']['core']['poses']) == len(
        json.loads(expected)['experiences']
    )


def test_images_that_nobody_sends_again_are_reported_as_lost(live: Live, bag: Path) -> None:
    """A camera cannot repeat its images: the ids of their templates are not used again."""
    live.start(*THREE)
    options = '--duration', '12', '--ros-args', '-r', 'ratslam/cut:=not_connected'
    with playing(live, bag, *options, lockstep=False):
        wait_for_cut(live, 'local_view')
        live.stop('local_view', number=signal.SIGKILL)
        live.run('echo', 'image', '--once', '--field', 'header.stamp')  # it is lost
        live.start('local_view')
    report = r'image (from \S+ s to \S+ s is|after \S+ s may be) lost|of image may be lost'
    wait_for(lambda: re.search(report, live.logs()))
    assert json.loads(live.map())['experiences']
    logs = live.logs()
    assert 'gone back to an earlier memory' not in logs
    assert 'empty memory' not in logs
