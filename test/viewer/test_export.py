# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""An exported page: complete, bounded, offline, and played by a real browser."""

from __future__ import annotations

import base64
import json
import re
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from pages import SIZE, Page, wait_for
from viewer_doubles import FakeRun

pytest.importorskip('viser', reason='the extra [view] is not installed')
from ratslam_ros.errors import UnusableInput
from ratslam_ros.viewer import export
from ratslam_ros.viewer.export import MAX_FRAMES, MIN_FRAMES, export_html, record_html


def jpeg(level: int, width: int = 40) -> bytes:
    pixels = np.full((width // 2, width, 3), level, np.uint8)
    return cv2.imencode('.jpg', pixels)[1].tobytes()


class PicturedRun(FakeRun):
    """A run whose images become brighter."""

    width = 40

    def image_at(self, stamp_ns: int) -> bytes | None:
        part = (stamp_ns - self.begin_ns) / (self.end_ns - self.begin_ns)
        return jpeg(round(40 + 200 * part), self.width)


def content(page: str) -> dict[str, Any]:
    """Return the data of the overlay of a page."""
    found = re.search(r'<script type="application/json" id="run-data">(.*?)</script>', page, re.S)
    assert found
    return dict(json.loads(found[1]))


def test_page_has_texts_images_and_errors_of_every_frame() -> None:
    run = PicturedRun(60)
    data = content(record_html(run, 30, 3.0))
    assert data['title'] == 'test run' and len(data['frames']) == 30
    first, last = data['frames'][0], data['frames'][-1]
    assert first['time'].startswith('0:00 of 0:30') and last['time'].startswith('0:30 of 0:30')
    assert first['counts'] == 'places: 1 · links: 0 · loop closures: 0'
    assert last['counts'] == 'places: 20 · links: 20 · loop closures: 1'
    assert 'experience 0 created' in first['decision']
    assert last['views'] == len(data['views']) == 60
    assert sum(row[3] for row in data['views']) == 20
    brightness = [
        cv2.imdecode(np.frombuffer(base64.b64decode(image), np.uint8), 0).mean()
        for image in data['images']
    ]
    assert brightness == sorted(brightness) and brightness[0] < 50 and brightness[-1] > 200
    assert data['legend'] and all(len(row) == 2 for row in data['legend'])


def test_texts_of_run_cannot_end_the_script() -> None:
    run = FakeRun(3)
    run.title = '</script><script>alert(1)</script> & "quoted"'
    page = record_html(run, 2, 1.0)
    assert content(page)['title'] == run.title
    assert 'alert(1)</script>' not in page


def test_large_images_are_reduced_to_shown_size() -> None:
    run = PicturedRun(3)
    run.width = 1280
    for image in content(record_html(run, 2, 1.0))['images']:
        pixels = cv2.imdecode(np.frombuffer(base64.b64decode(image), np.uint8), 0)
        assert pixels.shape == (160, 320)


def test_undecodable_image_is_left_out() -> None:
    data = content(record_html(FakeRun(3), 2, 1.0))  # its images are no JPEG
    assert data['images'] == [] and data['frames'][-1]['image'] == -1


def test_policy_forbids_network_before_any_script() -> None:
    page = record_html(FakeRun(2), 2, 1.0)
    policy = re.search(r'http-equiv="Content-Security-Policy" content="([^"]*)"', page)
    assert policy and policy.start() < page.index('<script')
    assert "default-src 'none'" in policy[1]
    sources = set(policy[1].replace(';', ' ').split())
    assert not [source for source in sources if source in ('*', 'https:', 'http:', "'self'")]


def test_number_of_frames_is_limited(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    counts: list[int] = []

    def recorded(source: Any, count: int, *rest: Any, **options: Any) -> str:
        counts.append(count)
        return ''

    monkeypatch.setattr(export, 'record_html', recorded)
    for duration_s in (1e-3, 30.0, 1e9, 1e300):
        export_html(FakeRun(3), tmp_path / 'run.html', duration_s=duration_s)
    assert counts == [MIN_FRAMES, 300, MAX_FRAMES, MAX_FRAMES]


def test_large_run_is_exported_with_fewer_frames(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    counts: list[int] = []
    original = export.record_html

    def recorded(source: Any, count: int, *rest: Any, **options: Any) -> str:
        counts.append(count)
        return original(source, count, *rest, **options) + 15000 * count * ' '

    monkeypatch.setattr(export, 'record_html', recorded)
    limit = 1_500_000
    done = export_html(PicturedRun(40), tmp_path / 'run.html', duration_s=10, max_bytes=limit)
    assert counts[0] == 100 and 1 < len(counts) <= 4 and done.frames == counts[-1] < 50
    assert done.size == (tmp_path / 'run.html').stat().st_size <= limit
    assert export_html(PicturedRun(4), tmp_path / 'run.html', max_bytes=1).frames == MIN_FRAMES
    assert [path.name for path in tmp_path.iterdir()] == ['run.html']


def test_run_of_one_moment_becomes_a_single_frame(tmp_path: Path) -> None:
    done = export_html(FakeRun(1), tmp_path / 'run.html')
    assert done.frames == 1
    assert len(content((tmp_path / 'run.html').read_text('utf-8'))['frames']) == 1


def test_missing_folder_is_reported(tmp_path: Path) -> None:
    with pytest.raises(UnusableInput, match='none does not exist'):
        export_html(FakeRun(2), tmp_path / 'none/run.html', duration_s=1)


# In a browser

SET_TIME = """
const input = document.querySelector('.mantine-NumberInput-input');
const set = Object.getOwnPropertyDescriptor(HTMLInputElement.prototype, 'value').set;
set.call(input, arguments[0]);
input.dispatchEvent(new Event('input', {bubbles: true}));
"""
"""Sets the time of viser's player, as a user does who types it."""

OFFLINE = {'offline': True, 'latency': 0, 'downloadThroughput': 0, 'uploadThroughput': 0}


def blue_pixels(page: Page) -> int:
    """Return the number of pixels in the colour of the experiences, left of the overlay."""
    red, green, blue = np.moveaxis(page.picture()[:, : SIZE[0] - 320].astype(int), 2, 0)
    return int(np.count_nonzero((blue > 120) & (blue - red > 60) & (green < blue)))


def test_exported_page_plays_offline_in_browser(chromium: Any, tmp_path: Path) -> None:
    path = tmp_path / 'run with ümlaut.html'
    export_html(PicturedRun(80), path, duration_s=4)

    def frame() -> float:
        text = page.run("return document.getElementById('run')?.dataset.frame")
        return -1.0 if text is None else float(text)

    def show(at_s: float) -> str:
        """Show a moment of the animation, which then pauses; return the overlay's text."""
        page.run(SET_TIME, str(at_s))
        wait_for(lambda: abs(frame() - 10 * at_s) < 1.5)
        return str(page.run("return document.getElementById('run').innerText"))

    with Page(chromium) as page:
        page.driver.execute_cdp_cmd('Network.enable', {})
        page.driver.execute_cdp_cmd('Network.emulateNetworkConditions', OFFLINE)
        page.driver.get(path.as_uri())
        wait_for(lambda: frame() > 2)  # it plays by itself
        text = show(3.9)
        assert 'test run' in text and 'places: 20 · links: 20 · loop closures: 1' in text
        assert 'Legend' in text and 'match error, last minute' in text
        assert page.run("return document.querySelector('#run img').naturalWidth") == 40
        wait_for(lambda: blue_pixels(page) > 50)
        everything = blue_pixels(page)
        assert 'places: 3 · links: 2' in show(0.15)
        wait_for(lambda: blue_pixels(page) < everything / 2)
        assert 'places: 20' in show(3.9)
        wait_for(lambda: blue_pixels(page) > everything / 2)
        urls = page.run("return performance.getEntriesByType('resource').map(one => one.name)")
        assert [url for url in urls if not url.startswith(('file:', 'data:', 'blob:'))] == []
