# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Kept logs that cannot be repeated are refused in one line; live runs: test/live."""

from __future__ import annotations

import os
from pathlib import Path

import msgspec
import pytest

from ratslam_ros.chain import Chain
from ratslam_ros.cli import main
from ratslam_ros.core.config import Config
from ratslam_ros.errors import UnusableInput
from ratslam_ros.files.config import to_yaml
from ratslam_ros.maps.input_log import VERSION
from ratslam_ros.maps.kept_log import Beginning, LogKeeper, kept_runs
from ratslam_ros.offline.replay_log import LogReplay, mapping_runs

STAGES = 'local_view', 'pose_cells', 'experience_map'


def keep(path: Path, *parts: str, **changes: object) -> None:
    """Keep the beginning of a run of a process."""
    beginning = Beginning(parts, to_yaml(Config()), VERSION)
    LogKeeper(path, parts).begin(1, msgspec.structs.replace(beginning, **changes), {})


def parts(path: Path) -> list[tuple[str, ...]]:
    return [run.beginning.parts for run in mapping_runs(path)]


def test_runs_of_all_processes_are_needed(tmp_path: Path) -> None:
    path = tmp_path / 'a.map'
    with pytest.raises(UnusableInput, match='has no log; expected one'):
        mapping_runs(path)
    keep(path, 'experience_map', chain=Chain('pose_cells'))
    with pytest.raises(UnusableInput, match='no log of pose_cells; expected logs of all'):
        mapping_runs(path)
    keep(path, 'pose_cells', chain=Chain('local_view', True))
    with pytest.raises(UnusableInput, match='no log of local_view'):
        mapping_runs(path)
    keep(path, 'local_view', chain=Chain(is_followed=True))
    assert parts(path) == [(stage,) for stage in STAGES]


def test_runs_that_had_ended_before_are_others(tmp_path: Path) -> None:
    path = tmp_path / 'a.map'
    keep(path, 'visual_odometry')
    keep(path, *STAGES)
    mapping, odometry = kept_runs(path)
    assert mapping.beginning.parts == STAGES
    os.utime(odometry.folder / '000000001.json', (1, 1))
    assert parts(path) == [STAGES]


@pytest.mark.parametrize(('changes', 'reason'), [
    ({'own_stages': ('mine.Views',)}, r'used mine\.Views'),
    ({'version': '0.1.0'}, r'of ratslam_ros 0\.1\.0; expected 0.1.0, log format 2: repeat it'),
])
def test_runs_that_would_differ_are_refused(
    tmp_path: Path, changes: dict[str, object], reason: str
) -> None:
    keep(path := tmp_path / 'a.map', *STAGES, **changes)
    with pytest.raises(UnusableInput, match=reason):
        LogReplay(mapping_runs(path)[0])


def test_damaged_beginning_is_reported(tmp_path: Path) -> None:
    keep(path := tmp_path / 'a.map', *STAGES)
    [run] = kept_runs(path)
    (run.folder / '000000001.json').write_bytes(b'{"parts": 3}')
    with pytest.raises(UnusableInput, match='ratslam map drop-log'):
        mapping_runs(path)


def test_options_of_a_recording_are_refused(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    for option in ('--no-inspect', '--set', '--map'):
        value = {'--set': ['local_view.vt_max=9'], '--map': ['b.map']}.get(option, [])
        assert main(['replay', str(tmp_path / 'a.map'), '--log', option, *value]) == 2
        assert f'leave out {option}' in capsys.readouterr().err
