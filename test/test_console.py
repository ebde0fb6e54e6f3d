# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Notices and the progress bar."""

import time

import pytest

from ratslam_ros import console
from ratslam_ros.console import ProgressBar, ticking

RECORDING_S = 20.0


@pytest.fixture
def terminal(monkeypatch: pytest.MonkeyPatch) -> None:
    """Let standard error be a terminal."""
    monkeypatch.setattr(console, 'is_terminal', lambda: True)


@pytest.mark.usefixtures('terminal')
def test_bar_shows_selected_duration_and_status(capfd: pytest.CaptureFixture[str]) -> None:
    with ProgressBar(10.0, status=lambda: '3 templates') as bar:
        bar.update(4.0)
    err = capfd.readouterr().err
    assert '40%' in err and '4/10 s' in err and err.rstrip().endswith('3 templates')


@pytest.mark.usefixtures('terminal')
def test_bar_beyond_total_shows_total(capfd: pytest.CaptureFixture[str]) -> None:
    with ProgressBar(15.0) as bar:
        bar.update(15.3)
    assert '100%' in capfd.readouterr().err


@pytest.mark.usefixtures('terminal')
def test_bar_not_shown_prints_nothing(capfd: pytest.CaptureFixture[str]) -> None:
    with ProgressBar(RECORDING_S, shown=False) as bar:
        bar.update(1.0)
    assert capfd.readouterr() == ('', '')


@pytest.mark.usefixtures('terminal')
def test_bar_prints_nothing_before_early_error(capfd: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(ValueError), ProgressBar(RECORDING_S, delay_s=10.0) as bar:
        bar.update(1.0)
        raise ValueError
    assert capfd.readouterr() == ('', '')


@pytest.mark.usefixtures('terminal')
def test_bar_after_delay_is_shown_at_end(capfd: pytest.CaptureFixture[str]) -> None:
    with ProgressBar(RECORDING_S, delay_s=10.0) as bar:
        bar.update(20.0)
    assert '20/20 s' in capfd.readouterr().err


def test_bar_without_terminal_prints_nothing(capfd: pytest.CaptureFixture[str]) -> None:
    with ProgressBar(RECORDING_S) as bar:
        bar.update(20.0)
    assert capfd.readouterr() == ('', '')


@pytest.mark.usefixtures('terminal')
def test_ticking_shows_time_and_clears_its_line(
    capfd: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(console, 'TICK_PERIOD_S', 0.0)
    err = ''
    with ticking('loading:'), ticking('drawing:'):
        capfd.readouterr()  # the outer one may have begun before the inner one
        while 'drawing: 0 s\x1b[K\r' not in err:
            err += capfd.readouterr().err
    assert (err + capfd.readouterr().err).endswith('\x1b[K')


def test_ticking_prints_nothing_without_a_terminal(
    capfd: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(console, 'TICK_PERIOD_S', 0.0)
    with ticking('drawing:'):
        time.sleep(0.01)
    assert capfd.readouterr() == ('', '')
