# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""``ratslam view`` and ``--view``, as a user starts them."""

from __future__ import annotations

import threading
import urllib.request
from collections.abc import Callable
from contextlib import nullcontext
from pathlib import Path
from types import SimpleNamespace
from typing import Any
from urllib.parse import urlsplit

import pytest
from camera_stream import camera_stream
from helpers import ODOM_TOPIC, circles, write_bag
from pages import Page, View, wait_for

from ratslam_ros.cli.main import main, parser
from ratslam_ros.cli.options import words_of
from ratslam_ros.cli.view_command import _Replays, _show

QUIET = ('--no-browser', '--port', '0')
NewPage = Callable[[str], Page]
Start = Callable[..., View]
Refusal = Callable[..., str]


def test_view_of_recording_shows_its_replay_until_interrupted(
    view: Start, new_page: NewPage, recording: Any, tmp_path: Path
) -> None:
    started = view('view', str(recording.recording), *QUIET)
    page = new_page(started.url)
    page.wait_for_text(r'of 0:30\.0')
    page.click('Begin')
    page.wait_for_text(r'0:00\.\d of 0:30\.0')
    wait_for(lambda: (tmp_path / 'results' / 'latest' / 'map.json').is_file())
    assert started.interrupt() < 10.0  # 2 s on a machine without load
    assert started.wait() == 0
    assert not [line for line in started.errors if 'Error' in line]


def test_view_of_results_serves_them_and_warns_of_other_machines(
    view: Start, results: Path
) -> None:
    started = view('view', str(results), '--host', '0.0.0.0', *QUIET)
    address = urlsplit(started.url)
    page = urllib.request.urlopen(f'http://127.0.0.1:{address.port}{address.path}')
    assert page.status == 200
    (line,) = started.errors
    assert line.startswith('warning: other machines')
    assert started.interrupt() < 10.0
    assert started.wait() == 0


def test_interrupt_ends_running_replay(view: Start, recording: Any) -> None:
    started = view('replay', str(recording.recording), '--view', *QUIET)
    assert urllib.request.urlopen(started.url).status == 200
    assert started.interrupt() < 10.0
    # Its output ends when the child has ended, too.
    assert started.wait() in (0, 130)
    assert not [line for line in started.errors if 'Traceback' in line]


def test_camera_is_shown_until_interrupted_and_its_results_are_complete(
    view: Start, new_page: NewPage, tmp_path: Path
) -> None:
    kept = tmp_path / 'kept.mcap'
    with camera_stream(None) as url:
        started = view('camera', url, '--record', str(kept), *QUIET)
        page = new_page(started.url)
        page.wait_for_text(r'of (?!0:00)\d+:\d\d')
        started.interrupt()
        assert started.wait() == 0
    assert not [line for line in started.errors if 'Error' in line]
    latest = tmp_path / 'results' / 'latest'
    assert (latest / 'map.png').is_file()
    replayed = tmp_path / 'replayed'
    assert main(['replay', str(kept), '--no-inspect', '--quiet', '--out', str(replayed)]) == 0
    assert (latest / 'map.json').read_bytes() == (replayed / 'map.json').read_bytes()


def test_absent_camera_is_refused_before_the_page(refusal: Refusal) -> None:
    assert '/dev/video97' in refusal('camera', '97', *QUIET)


def test_view_of_nothing_ends_in_one_line(refusal: Refusal) -> None:
    assert 'nosuch' in refusal('view', 'nosuch', *QUIET)


def test_recording_without_images_is_refused_before_the_page(
    refusal: Refusal, tmp_path: Path
) -> None:
    bag = write_bag(tmp_path / 'bag', [m for m in circles(1, 5) if m[1] == ODOM_TOPIC])
    assert 'holds no images' in refusal('view', str(bag), *QUIET)
    assert 'holds no images' in refusal('replay', str(bag), '--view', *QUIET)


def test_options_of_replay_are_refused_for_results(refusal: Refusal, results: Path) -> None:
    line = refusal('view', str(results), '--set', 'local_view.vt_shift_match=2', *QUIET)
    assert '--set has no effect' in line


def test_view_of_live_simulator_names_launch(refusal: Refusal) -> None:
    assert 'ratslam launch --view' in refusal('simulate', '--live', '--view', *QUIET)


def test_another_replay_has_its_settings_and_its_own_folder(
    recording: Any, tmp_path: Path
) -> None:
    replays = _Replays(
        ['replay', str(recording.recording), '--quiet', '--duration=2'], tmp_path / 'run', 'demo',
        False, None,
    )
    first = replays.start()
    assert first.is_growing
    assert first.begin_ns == first.end_ns == 0
    assert replays.take_request() is None
    replays.request(['local_view.vt_shift_match=3'])
    second = replays.take_request()
    assert second is not None
    assert 'vt_shift_match=3' in second.title
    assert wait_for(replays.poll) is not None
    assert 'vt_shift_match: 3' in (tmp_path / 'run-2' / 'config.yaml').read_text()
    assert not first.is_growing
    assert not second.is_growing
    assert replays.followed.open()
    opened = replays.followed.run
    assert opened.title == second.title
    assert opened.end_ns > opened.begin_ns > 0
    assert not opened.is_growing


def test_failing_replay_ends_in_one_line(
    viser: Any, signals: None, recording: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch,
    capfd: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.chdir(tmp_path)
    assert main(['view', str(recording.recording), '--start', '1000', *QUIET]) == 2
    (line,) = capfd.readouterr().err.splitlines()
    assert 'the start at 1000 s is outside' in line


def test_reason_of_failed_replay_is_a_notice(tmp_path: Path) -> None:
    replays = _Replays(['replay', 'nosuch'], tmp_path / 'run', 'demo', False, None)
    run = replays.start()
    code, reason = wait_for(replays.poll)
    assert code == 2
    assert reason in run.notices
    assert not run.is_growing


@pytest.mark.parametrize(
    'words',
    [
        ['replay', 'a b', '--set', 'a.b=1', '--set', 'c.d=-2', '--landmarks', '--start', '-3'],
        ['replay', 'x', '--image-topic', '/a', '--duration', '4.5', '--no-inspect'],
        ['view', 'x', '--visual-odometry', '--truth', 'truth.tum', '--images-rate', '3'],
        ['camera', '2', '--record', 'a.mcap', '--map', 'm', '--set', 'a.b=1'],
        ['simulate', '--people', '0', '--obstacle', 'a', '--obstacle', 'b', '--noise', '0'],
    ],
    ids=lambda words: words[0],
)
def test_options_survive_as_arguments(words: list[str]) -> None:
    options = parser().parse_args(words)
    again = parser().parse_args([words[0], *words_of(options.parser, options)])
    assert vars(again) == {**vars(options), 'parser': again.parser}


def test_error_that_ends_drawing_ends_the_command(monkeypatch: pytest.MonkeyPatch) -> None:
    error = RuntimeError('no memory')
    page = SimpleNamespace(error=error, close=lambda within_s: None)
    monkeypatch.setattr('ratslam_ros.viewer.app.Page', lambda *_: page)
    monkeypatch.setattr('ratslam_ros.cli.view_command._announce', lambda *_: None)
    signals = SimpleNamespace(received=False)
    monkeypatch.setattr(
        'ratslam_ros.cli.view_command.StopSignals', lambda: nullcontext(signals)
    )
    timer = threading.Timer(5.0, lambda: setattr(signals, 'received', True))
    timer.start()
    with pytest.raises(RuntimeError, match='no memory'):
        _show(*[SimpleNamespace(browser=False)] * 4)  # type: ignore[arg-type]
    timer.cancel()
