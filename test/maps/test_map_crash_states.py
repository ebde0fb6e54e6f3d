# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Power failures and failing calls of the disk: the short form of tools/crash_states.py."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

pytest.importorskip('apsw', reason='apsw (extra dev) records what SQLite writes')

import crash_states
import recording_disk
from crash_states import check_crashes, check_failures

from ratslam_ros.maps import schema


@pytest.fixture(autouse=True)
def scratch(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setattr('tempfile.tempdir', str(tmp_path))
    return tmp_path


def test_every_crash_leaves_the_state_before_or_after(scratch: Path) -> None:
    operations, states, problems = check_crashes(40, 2, limit=80, seed=1, scratch=scratch)
    assert problems == []
    assert states >= 80
    assert operations > 300


def test_missing_syncs_are_found(scratch: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The check is able to fail: without syncs of SQLite, maps are lost or damaged."""
    execute = recording_disk.Database.execute

    def without_sync(database: Any, text: str, *values: Any) -> Any:
        return execute(database, text.replace('synchronous = FULL', 'synchronous = OFF'), *values)

    monkeypatch.setattr(recording_disk.Database, 'execute', without_sync)
    assert check_crashes(40, 1, limit=60, seed=1, scratch=scratch)[-1]


def test_missing_sync_of_the_folder_is_found(
    scratch: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    for module in ('schema', 'saving', 'file_writer'):
        monkeypatch.setattr(f'ratslam_ros.maps.{module}.sync_folder', lambda path: None)
    assert schema.sync_folder(scratch) is None
    assert check_crashes(40, 1, limit=10, seed=1, scratch=scratch)[-1]


@pytest.mark.parametrize(('failure', 'fails_for'), [('EIO', 1), ('ENOSPC', 4)])
def test_failing_calls_damage_nothing(failure: str, fails_for: int, scratch: Path) -> None:
    count, problems = check_failures(failure, fails_for, limit=5, seed=1, scratch=scratch)
    assert problems == []
    assert count == 5


@pytest.mark.filterwarnings('ignore::pytest.PytestUnraisableExceptionWarning')
def test_failing_call_while_a_map_is_created_damages_nothing(scratch: Path) -> None:
    """SQLite ignores that it cannot delete its first journal; the map then has no log."""
    problems: list[str] = []
    for number in range(1, 25):
        crash_states._fail_at(number, 1, 'EIO', scratch, problems)
    assert problems == []
