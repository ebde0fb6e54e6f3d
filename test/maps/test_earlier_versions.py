# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Maps of earlier versions: test/data/maps/README.md says what they contain."""

from __future__ import annotations

import gzip
from pathlib import Path

import pytest
from helpers import twist
from states import differences

from ratslam_ros import load_map
from ratslam_ros.errors import UnusableInput
from ratslam_ros.files.config import stored_config
from ratslam_ros.maps import read_map
from ratslam_ros.maps.system import save_map
from ratslam_ros.offline.map_upkeep import problems

DATA = Path(__file__).parents[1] / 'data/maps'


@pytest.fixture
def path(tmp_path: Path) -> Path:
    path = tmp_path / 'f2468ff.ratslam'
    path.write_bytes(gzip.decompress((DATA / 'f2468ff.ratslam.gz').read_bytes()))
    return path


def test_map_of_f2468ff_is_opened_completely_and_continued(path: Path, tmp_path: Path) -> None:
    assert problems(path) == ([], [])
    config, _ = stored_config(read_map(path).meta.configuration, str(path))
    slam = load_map(path)
    assert slam.local_view is not None
    assert len(slam.local_view) == 28
    assert len(slam.experience_map) == 45
    assert slam.experience_map.link_count == 44
    states = read_map(path).states
    [goal] = states['experience_map']['goals']['named']
    assert goal[0] == 'desk'
    slam.begin_session()
    slam.odometry(twist(slam.newest_ns + 10**9, 0.5, 0.0))
    save_map(slam, tmp_path / 'new.ratslam', config)
    new = read_map(tmp_path / 'new.ratslam').states
    assert not list(differences(new['local_view']['core'], states['local_view']['core']))
    assert new['experience_map']['goals']['named'] == [goal]


def test_folder_of_earlier_memory_files_is_refused_in_one_line(tmp_path: Path) -> None:
    (tmp_path / 'experience_map.npz').write_bytes(b'')
    with pytest.raises(UnusableInput, match=r'is a folder; expected a map file .*npz'):
        read_map(tmp_path)
