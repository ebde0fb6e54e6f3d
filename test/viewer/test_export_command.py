# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""``ratslam view --export``: a run becomes a file, and wrong uses are reported in one line."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest
from graphs import corridor

from ratslam_ros.cli.main import main
from ratslam_ros.history.file import HISTORY_NAME
from ratslam_ros.messages.mapping import encode_map


def test_history_is_exported(results: Path, capsys: pytest.CaptureFixture[str]) -> None:
    pytest.importorskip('viser', reason='the extra [view] is not installed')
    page = results / 'run.html'
    words = ['view', str(results), '--export', str(page), '--export-duration', '2']
    assert main(words) == 0
    assert capsys.readouterr().out == f'{page}: 20 moments, {page.stat().st_size / 1e6:.1f} MB\n'
    text = page.read_text('utf-8')
    assert 'places: 20 · links: 20' in text


def test_export_says_why_a_run_is_not_shown_as_a_whole(
    results: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    pytest.importorskip('viser', reason='the extra [view] is not installed')
    (results / HISTORY_NAME).write_bytes(b'damaged')
    (results / 'map.json').write_text(encode_map(10**9, corridor()), encoding='utf-8')
    assert main(['view', str(results), '--export', str(results / 'run.html')]) == 0
    written = capsys.readouterr()
    assert 'only the final state can be shown' in written.err
    assert 'one moment' in written.out


@pytest.mark.parametrize(('file', 'expected'), [
    ('run.txt', 'expected the name of a page, FILE.html'),
    ('none/run.html', 'none does not exist'),
])
def test_unusable_file_is_reported_before_any_work(
    results: Path, file: str, expected: str, refusal: Callable[..., str]
) -> None:
    words = 'view', str(results / 'no recording'), '--export', str(results / file)
    assert expected in refusal(*words)


@pytest.mark.parametrize('duration', ['0', '-1', 'nan', 'inf', 'long'])
def test_unusable_duration_is_reported(duration: str, refusal: Callable[..., str]) -> None:
    words = 'view', 'run', '--export', 'run.html', f'--export-duration={duration}'
    assert '--export-duration' in refusal(*words)
