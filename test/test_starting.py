# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Announcements of starting nodes end when the node is ready, and with its process."""

import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

from ratslam_ros.starting import announced, starting

SOURCE = """
import sys
from ratslam_ros.starting import announced, ready
with announced(sys.argv[1]):
    print('announced', flush=True)
    sys.stdin.readline()
    ready()
    print('ready', flush=True)
    sys.stdin.readline()
"""
ROOT = Path(__file__).parents[1]


@pytest.fixture(autouse=True)
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setenv('TMPDIR', str(tmp_path))
    monkeypatch.setattr('tempfile.tempdir', None)
    monkeypatch.setenv('ROS_DOMAIN_ID', '7')
    return tmp_path


@contextmanager
def process(node: str) -> Iterator['subprocess.Popen[str]']:
    """Start a process that announces a node; every further line on stdin lets it go on."""
    with subprocess.Popen(
        [sys.executable, '-c', SOURCE, node], cwd=ROOT, stdin=subprocess.PIPE,
        stdout=subprocess.PIPE, text=True,
    ) as started:
        try:
            assert started.stdout is not None and started.stdout.readline() == 'announced\n'
            yield started
        finally:
            started.kill()


def test_node_is_starting_until_it_is_ready() -> None:
    with process('pose_cells') as one, process('local_view'):
        assert starting() == ['local_view', 'pose_cells']
        assert one.stdin is not None and one.stdout is not None
        one.stdin.write('\n')
        one.stdin.flush()
        assert one.stdout.readline() == 'ready\n'
        assert starting() == ['local_view']


def test_killed_node_is_forgotten(folder: Path) -> None:
    with process('pose_cells') as one:
        one.kill()
        one.wait()
        assert starting() == []
    assert not list(folder.glob('*/*'))


def test_other_domains_are_not_listed(monkeypatch: pytest.MonkeyPatch) -> None:
    with process('pose_cells'):
        monkeypatch.setenv('ROS_DOMAIN_ID', '8')
        assert starting() == []


def test_unwritable_folder_announces_nothing(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr('tempfile.tempdir', '/proc/no/such/folder')
    with announced('pose_cells'):
        assert starting() == []


def test_announcement_ends_with_its_context() -> None:
    with announced('pose_cells'):
        assert starting() == ['pose_cells']
    assert starting() == []
