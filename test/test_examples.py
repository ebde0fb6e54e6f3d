# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The scripts in examples/ do what they say, and are short enough to read.

The goal client runs beside live nodes: test/live/test_live_nodes.py.
"""

from __future__ import annotations

import json
import math
import os
import re
import runpy
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from helpers import PERIOD_NS, START_NS, picture

import ratslam_ros
from ratslam_ros.cli import main

ROOT = Path(__file__).parents[1]
EXAMPLES = ROOT / 'examples'
README_CODE = re.findall(r'(?s)```python\n(.*?)```', (ROOT / 'README.md').read_text('utf-8'))


@pytest.fixture
def run(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> Callable[..., str]:
    """Return a function that runs an example in an empty folder and returns what it prints."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv('MPLBACKEND', 'agg')

    def started(name: str, *words: object) -> str:
        monkeypatch.setattr(sys, 'argv', [name, *map(str, words)])
        runpy.run_path(str(EXAMPLES / name), run_name='__main__')
        return capsys.readouterr().out

    return started


def replayed(recording: Path, folder: Path, *options: str) -> Path:
    """Return the results of ``ratslam replay``."""
    words = ['replay', str(recording), *options, '--out', str(folder), '--quiet']
    assert main(words) == 0
    return folder


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
    limit = 90 if path.name == 'custom_stage.py' else 40
    assert len(path.read_text(encoding='utf-8').splitlines()) < limit


def test_map_images_gives_map_and_plots_of_replay(
    run: Callable[..., str], image_folder: Path, tmp_path: Path
) -> None:
    printed = run('map_images.py', image_folder, 'mine')
    assert printed.startswith('60 frames and 59 odometry messages ')
    theirs = replayed(image_folder, tmp_path / 'theirs')
    for name in ('map.json', 'map.png', 'matches.png'):
        assert (tmp_path / 'mine' / name).read_bytes() == (theirs / name).read_bytes()
    pytest.importorskip('networkx')
    assert run('map_as_graph.py', 'mine/map.json').startswith('0 to ')
    assert cv2.imread(str(tmp_path / 'graph.png')).std() > 0


@pytest.mark.parametrize('name', ['map_images.py', 'map_with_odometry.py'])
def test_example_without_arguments_prints_usage(name: str, run: Callable[..., str]) -> None:
    with pytest.raises(SystemExit, match=f'usage: python examples/{name} '):
        run(name)


def test_map_with_odometry_equals_replay_without_inspection(
    run: Callable[..., str], image_folder: Path, tmp_path: Path
) -> None:
    table = image_folder / 'table.csv'
    rows = [
        f'{START_NS + n * PERIOD_NS},{n:03}.png,{1.0 + n % 7 / 3.0},{0.1 * (n % 5)}'
        for n in range(60)
    ]
    table.write_text('\n'.join(['stamp_ns,image,speed_mps,yaw_rate_radps', *rows]))
    run('map_with_odometry.py', table)
    theirs = replayed(table, tmp_path / 'theirs', '--no-inspect')
    table.unlink()
    assert (tmp_path / 'map.json').read_bytes() == (theirs / 'map.json').read_bytes()


def test_images_fed_by_hand_equal_replay_without_inspection(
    image_folder: Path, tmp_path: Path
) -> None:
    slam = ratslam_ros.RatSLAM(head='visual_odometry')
    for n, path in enumerate(sorted(image_folder.iterdir())):
        slam.image(n * PERIOD_NS, cv2.imread(str(path), cv2.IMREAD_GRAYSCALE))
    slam.finish()
    mine = ratslam_ros.encode_map(slam.newest_ns, slam.experience_map)
    theirs = replayed(image_folder, tmp_path / 'theirs', '--no-inspect')
    assert mine == (theirs / 'map.json').read_text()


def test_notebook_runs_and_saves_a_map(
    image_folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    pytest.importorskip('networkx')
    (tmp_path / 'my_recording').symlink_to(image_folder)
    monkeypatch.setenv('MPLBACKEND', 'agg')
    monkeypatch.chdir(tmp_path)
    cells = json.loads((EXAMPLES / 'map_recording.ipynb').read_text())['cells']
    code = [''.join(cell['source']) for cell in cells if cell['cell_type'] == 'code']
    exec('\n'.join(code), {})
    assert (tmp_path / 'my_map' / 'map.json').exists()


@pytest.mark.parametrize('code', README_CODE, ids=['images', 'odometry', 'recognition'])
def test_readme_code_maps_the_files_that_it_names(
    code: str, image_folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    assert len(code.splitlines()) <= 13
    (tmp_path / 'my_images').symlink_to(image_folder)
    turn_rate = 2.0 * math.pi / 20 / (PERIOD_NS * 1e-9)  # a circle of 20 images
    rows = [
        f'{START_NS + n * PERIOD_NS},my_images/{n:03}.png,2.0,{turn_rate}\n' for n in range(60)
    ]
    (tmp_path / 'my_drive.csv').write_text(''.join(rows))
    monkeypatch.chdir(tmp_path)
    names: dict[str, Any] = {}
    exec(code, names)
    if 'slam' in names:
        graph = names['slam'].experience_map
        assert graph.link_count > len(graph)  # the later laps are recognised
    else:
        assert (tmp_path / 'my_map' / 'map.json').exists()


def test_custom_stage_continues_its_map(
    run: Callable[..., str], image_folder: Path, tmp_path: Path
) -> None:
    counts = []
    for _ in range(2):
        printed = run('custom_stage.py', image_folder, 'a.map')
        counts.append(int(printed.split()[0]))
    assert 20 <= counts[0] < counts[1]
    hashes = ratslam_ros.read_map(tmp_path / 'a.map').states['local_view']['state']['hashes']
    assert len(hashes) == 20  # The second session has recognised all views.


def test_custom_recording_is_replayed(tmp_path: Path) -> None:
    """In a process of its own, as users start an example."""
    images = np.stack([
        cv2.resize(picture(n % 20, 12, 16), (96, 72), interpolation=cv2.INTER_NEAREST)
        for n in range(60)
    ])
    twists = np.tile([2.0, 2.0 * np.pi / 2.0], (60, 1))
    stamps = np.arange(60) * 100_000_000 + 1
    np.savez(tmp_path / 'drive.npz', stamps_ns=stamps, images=images, twists=twists)
    printed = subprocess.run(
        [sys.executable, EXAMPLES / 'custom_recording.py', 'drive.npz', 'results'], cwd=tmp_path,
        env={**os.environ, 'PYTHONPATH': str(ROOT)}, capture_output=True, text=True, check=True,
    ).stdout
    assert printed.startswith('60 frames and 60 odometry messages ')
    assert (tmp_path / 'results' / 'map.json').exists()


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
