# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Merging of map files: the command, its report and its plot."""

from __future__ import annotations

import argparse
import json
from pathlib import Path

import pytest
from shared_worlds import Robot

from ratslam_ros.cli.map_command import add_map
from ratslam_ros.errors import UnusableInput
from ratslam_ros.files.config import to_yaml
from ratslam_ros.maps import MapMeta, read_map, save_map


def save(path: Path, robot: Robot) -> Path:
    save_map(path, robot.slam.state(), MapMeta(configuration=to_yaml(robot.config)))
    return path


def merge(*arguments: object) -> int:
    parser = argparse.ArgumentParser()
    add_map(parser.add_subparsers())
    options = parser.parse_args(['map', 'merge', *map(str, arguments)])
    return int(options.run(options))


@pytest.fixture(scope='module')
def maps(tmp_path_factory: pytest.TempPathFactory) -> list[Path]:
    folder = tmp_path_factory.mktemp('maps')
    return [
        save(folder / 'monday.map', Robot(0, noise=1).forward(60)),
        save(folder / 'tuesday.map', Robot(30, noise=2).forward(60)),
        save(folder / 'upstairs.map', Robot(0, floor=2, noise=1).forward(40)),
    ]


def test_map_files_are_merged_with_report_and_plot(
    maps: list[Path], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / 'all.map'
    assert merge(*maps, '-o', out) == 0
    text = capsys.readouterr().out
    assert 'monday.map and tuesday.map share' in text or 'tuesday.map and monday.map' in text
    assert '2 components remain' in text
    report = json.loads((tmp_path / 'all.map.json').read_text())
    assert {row['name'] for row in report['sessions']} == {path.name for path in maps}
    assert report['merged']['components'] == 2
    assert report['fused']['templates'] >= 25
    assert (tmp_path / 'all.map.png').stat().st_size > 10_000
    merged = read_map(out)
    assert len(merged.states['experience_map']['core']['labels']) == (
        report['merged']['experiences']
    )


def test_existing_file_is_kept_without_force(maps: list[Path], tmp_path: Path) -> None:
    out = tmp_path / 'taken'
    out.write_text('mine')
    with pytest.raises(UnusableInput, match='exists; give another name'):
        merge(*maps[:2], '-o', out)
    assert out.read_text() == 'mine'


def test_unusable_files_are_refused_in_one_line(maps: list[Path], tmp_path: Path) -> None:
    broken = tmp_path / 'broken.map'
    broken.write_bytes(b'no map at all')
    for path, expected in ((broken, 'not a map file'), (tmp_path / 'none', 'does not exist')):
        with pytest.raises(UnusableInput, match=expected) as error:
            merge(maps[0], path, '-o', tmp_path / 'out')
        assert '\n' not in str(error.value)
    assert not (tmp_path / 'out').exists()


def test_map_without_configuration_is_refused(maps: list[Path], tmp_path: Path) -> None:
    save_map(tmp_path / 'old', read_map(maps[0]).states, MapMeta())
    with pytest.raises(UnusableInput, match='does not record its configuration'):
        merge(tmp_path / 'old', maps[1], '-o', tmp_path / 'out')
