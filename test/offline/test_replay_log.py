# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Kept logs that cannot be repeated are refused in one line; live runs: test/live."""

from __future__ import annotations

from pathlib import Path

import msgspec
import pytest

from ratslam_ros.cli import main
from ratslam_ros.core.config import Config
from ratslam_ros.errors import UnusableInput
from ratslam_ros.files.config import to_yaml
from ratslam_ros.maps.input_log import VERSION
from ratslam_ros.maps.kept_log import Beginning, LogKeeper, kept_runs
from ratslam_ros.offline.replay_log import LogReplay, mapping_run

STAGES = 'local_view', 'pose_cells', 'experience_map'


def keep(path: Path, *parts: str, **changes: object) -> None:
    """Keep the beginning of a run of a process."""
    beginning = Beginning(parts, to_yaml(Config()), VERSION)
    LogKeeper(path, parts).begin(1, msgspec.structs.replace(beginning, **changes), {})


def test_logs_of_split_nodes_are_refused(tmp_path: Path) -> None:
    path = tmp_path / 'a.map'
    with pytest.raises(UnusableInput, match='has no log; expected one'):
        mapping_run(path)
    for stage in STAGES:
        keep(path, stage)
    with pytest.raises(UnusableInput, match='without --split'):
        mapping_run(path)
    keep(path, *STAGES[1:])
    assert mapping_run(path).beginning.parts == STAGES[1:]


@pytest.mark.parametrize(('changes', 'reason'), [
    ({'own_stages': ('mine.Views',)}, r'used mine\.Views'),
    ({'version': '0.1.0'}, r'of ratslam_ros 0\.1\.0; expected 0.1.0, log format 2: repeat it'),
])
def test_runs_that_would_differ_are_refused(
    tmp_path: Path, changes: dict[str, object], reason: str
) -> None:
    keep(path := tmp_path / 'a.map', *STAGES, **changes)
    with pytest.raises(UnusableInput, match=reason):
        LogReplay(mapping_run(path))


def test_damaged_beginning_is_reported(tmp_path: Path) -> None:
    keep(path := tmp_path / 'a.map', *STAGES)
    [run] = kept_runs(path)
    (run.folder / '000000001.json').write_bytes(b'{"parts": 3}')
    with pytest.raises(UnusableInput, match='ratslam map drop-log'):
        mapping_run(path)


def test_options_of_a_recording_are_refused(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    for option in ('--no-inspect', '--set', '--map'):
        value = {'--set': ['local_view.vt_max=9'], '--map': ['b.map']}.get(option, [])
        assert main(['replay', str(tmp_path / 'a.map'), '--log', option, *value]) == 2
        assert f'leave out {option}' in capsys.readouterr().err
