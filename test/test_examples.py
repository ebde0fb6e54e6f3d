# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The scripts in examples/ run as their users would run them, and are short enough to read."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path
from shutil import copy

import cv2
import numpy as np
import pytest
from helpers import circles, live_environment, picture, write_bag

import ratslam_ros

ROOT = Path(__file__).parents[1]
EXAMPLES = ROOT / 'examples'


def run(tmp_path: Path, name: str, *words: object) -> str:
    """Run an example in an empty folder; return what it prints."""
    done = subprocess.run(
        [sys.executable, str(EXAMPLES / name), *map(str, words)], cwd=tmp_path,
        env={**os.environ, **live_environment(), 'MPLBACKEND': 'agg'},
        capture_output=True, text=True, check=False,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    return done.stdout


@pytest.fixture(scope='module')
def image_folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return 60 images in which 20 views repeat, larger than the default template."""
    folder = tmp_path_factory.mktemp('images')
    for n in range(60):
        pixels = cv2.resize(picture(n % 20, 12, 16), (96, 72), interpolation=cv2.INTER_NEAREST)
        cv2.imwrite(str(folder / f'{n:03}.png'), pixels)
    return folder


@pytest.mark.parametrize('path', sorted(EXAMPLES.glob('*.py')), ids=lambda path: path.name)
def test_example_is_short(path: Path) -> None:
    limit = 75 if path.name == 'custom_stage.py' else 40
    assert len(path.read_text(encoding='utf-8').splitlines()) < limit


def test_map_images_writes_a_map_that_becomes_a_graph(image_folder: Path, tmp_path: Path) -> None:
    printed = run(tmp_path, 'map_images.py', image_folder)
    assert printed.startswith('60 images, 20 templates, ')
    content = json.loads((tmp_path / 'map.json').read_text())
    assert len(content['experiences']) >= 20
    pytest.importorskip('networkx')
    printed = run(tmp_path, 'map_as_graph.py', 'map.json')
    assert printed.startswith('0 to ')
    plot = cv2.imread(str(tmp_path / 'graph.png'))
    assert plot is not None
    assert plot.std() > 0


def test_map_images_of_unpadded_names_sorts_numbers(image_folder: Path, tmp_path: Path) -> None:
    (tmp_path / 'unpadded').mkdir()
    for path in image_folder.iterdir():
        copy(path, tmp_path / 'unpadded' / f'{int(path.stem)}.png')
    run(tmp_path, 'map_images.py', image_folder, 'padded.json')
    run(tmp_path, 'map_images.py', 'unpadded', 'unpadded.json')
    assert (tmp_path / 'unpadded.json').read_text() == (tmp_path / 'padded.json').read_text()


def test_custom_stage_continues_its_map(image_folder: Path, tmp_path: Path) -> None:
    counts = []
    for _ in range(2):
        printed = run(tmp_path, 'custom_stage.py', image_folder, 'a.map')
        counts.append(int(printed.split()[0]))
    assert 20 <= counts[0] < counts[1]
    hashes = ratslam_ros.read_map(tmp_path / 'a.map').states['local_view']['hashes']
    assert len(hashes) == 20  # The second session has recognised all views.


def test_custom_recording_is_replayed(tmp_path: Path) -> None:
    images = np.stack([
        cv2.resize(picture(n % 20, 12, 16), (96, 72), interpolation=cv2.INTER_NEAREST)
        for n in range(60)
    ])  # fmt: skip
    twists = np.tile([2.0, 2.0 * np.pi / 2.0], (60, 1))
    stamps = np.arange(60) * 100_000_000 + 1
    np.savez(tmp_path / 'drive.npz', stamps_ns=stamps, images=images, twists=twists)
    printed = run(tmp_path, 'custom_recording.py', 'drive.npz', 'results')
    assert "'frames': 60, 'odometry': 60, 'templates': 23" in printed
    assert (tmp_path / 'results' / 'map.json').exists()


def test_goal_client_prints_a_route(tmp_path: Path) -> None:
    """With rclpy, or with the stand-in in its place, against a live map."""
    from ratslam_ros.errors import UnusableInput
    from ratslam_ros.live.ros import require

    try:
        require()
    except UnusableInput as error:
        pytest.skip(str(error))
    bag = write_bag(tmp_path / 'bag', circles())
    sizes = ['--set', 'local_view.template_x_size=16', '--set', 'local_view.template_y_size=8']
    environment = {**os.environ, **live_environment()}
    command = [sys.executable, '-m', 'ratslam_ros']
    nodes = subprocess.Popen(
        [*command, 'launch', *sizes], cwd=tmp_path, env=environment,
        stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL,
    )  # fmt: skip
    try:
        subprocess.run(
            [*command, 'play', str(bag), '--rate', '0', '--lockstep', '--quiet', '--wait', '60'],
            cwd=tmp_path, env=environment, check=True, timeout=120,
        )  # fmt: skip
        code = (
            'import runpy, sys\n'
            'from rclpy_standin import install\n'
            'install()\n'
            'sys.argv[:] = sys.argv[1:]\n'
            'runpy.run_path(sys.argv[0], run_name="__main__")\n'
        )
        client = subprocess.run(
            [sys.executable, '-c', code, str(EXAMPLES / 'goal_client.py'), '0.0', '0.0'],
            cwd=tmp_path, env=environment, capture_output=True, text=True, timeout=60,
            check=False,
        )  # fmt: skip
    finally:
        nodes.terminate()
        nodes.wait(30)
    assert client.returncode == 0, client.stderr
    poses = [tuple(map(float, line.split())) for line in client.stdout.splitlines()]
    assert poses
    assert all(len(pose) == 2 for pose in poses)


def test_public_names_are_importable_and_listed() -> None:
    for name in ratslam_ros.__all__:
        assert getattr(ratslam_ros, name) is not None
        assert name in dir(ratslam_ros)
    with pytest.raises(AttributeError, match='no attribute'):
        ratslam_ros.nothing_of_this_name  # noqa: B018


def test_import_of_the_package_alone_loads_no_dependency() -> None:
    code = 'import sys, ratslam_ros; print(*(set(sys.modules) & {"numpy", "numba", "cv2"}))'
    done = subprocess.run(
        [sys.executable, '-c', code], cwd=ROOT, capture_output=True, text=True, check=True
    )
    assert done.stdout.strip() == ''
