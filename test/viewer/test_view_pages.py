# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The viewer in a browser: what reaches the page, whatever happens to page, network and code."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from typing import Any

import pytest
from pages import Page, Relay, wait_for
from viewer_doubles import FakeControls, FakeRun

STALL_S = 5.0
"""Duration of a stall of the network."""

NewPage = Callable[[str], Page]


class Shown:
    """A growing run and a page that shows it; the tests share them, as loading takes seconds."""

    def __init__(self, served: Any, run: FakeRun, page: Page) -> None:
        self.served, self.run, self.page = served, run, page

    @property
    def end(self) -> str:
        """The end of the run as the page shows it."""
        half_seconds = len(self.run.stamps) - 1
        return rf'of 0:{half_seconds // 2:02d}\.{5 * (half_seconds % 2)}'


@pytest.fixture(scope='module')
def shown(chromium: Any, serving: Any) -> Iterator[Shown]:
    run = FakeRun(3, is_growing=True)
    served = serving(run, FakeControls())
    with Page(chromium) as page:
        yield Shown(served, run, page.open(served.url))


def test_growing_run_is_followed(shown: Shown) -> None:
    shown.page.wait_for_text(shown.end)
    before = shown.page.received_count
    shown.run.grow(4)
    shown.page.wait_for_text(shown.end)
    assert shown.page.received_count > before


def test_software_rendering_has_no_antialiasing(shown: Shown) -> None:
    drawn = "document.querySelector('canvas[data-engine]').getContext('webgl2')"
    wait_for(lambda: shown.page.run(f'return Boolean({drawn.partition(".get")[0]})'))
    attributes = shown.page.run(f'return {drawn}.getContextAttributes()')
    assert not attributes['antialias']
    assert attributes['preserveDrawingBuffer']  # all else is as viser has it


def test_error_of_a_callback_is_shown_and_loop_continues(shown: Shown) -> None:
    def fail() -> None:
        raise ValueError('the wheel is off')

    wait_for(lambda: shown.served.server.viser.get_clients())
    shown.served.page.post(fail)
    shown.page.wait_for_text('the wheel is off')
    shown.run.grow(2)
    shown.page.wait_for_text(shown.end)


def test_reloaded_page_shows_the_same(shown: Shown) -> None:
    shown.page.reload()
    shown.page.wait_for_text(shown.end)
    shown.page.wait_for_text('live: following')


def test_removed_lines_free_their_memory(shown: Shown) -> None:
    def count() -> int:
        return int(
            shown.page.run('return window.__viserTestpoints.rendererInfo.memory.geometries')
        )

    def change_theme() -> None:
        scene.dark = not scene.dark

    scene = shown.served.page.scene
    wait_for(lambda: count() > 3, 'a drawn map')
    before = most = count()
    for _ in range(8):  # every change draws all lines anew
        shown.served.page.post(change_theme)
        shown.served.wait_for_updates(5)
        most = max(most, count())
    wait_for(lambda: count() <= before + 3, f'{before} geometries again, after {most}')


def test_stalled_browser_catches_up_and_stops_no_other(shown: Shown, new_page: NewPage) -> None:
    port = shown.served.server.port
    relay = Relay(port)
    try:
        stalled = new_page(shown.served.url.replace(f':{port}', f':{relay.port}'))
        stalled.wait_for_text(shown.end)
        relay.stall()
        end_s = time.monotonic() + STALL_S
        before = shown.end
        while time.monotonic() < end_s:  # the other page shows every step meanwhile
            shown.run.grow(1)
            shown.page.wait_for_text(shown.end)
        stalled.wait_for_text(before)
        relay.resume()
        stalled.wait_for_text(shown.end)
        # Both are browsers of one run: what one does, the other shows.
        stalled.click('Pause')
        shown.page.wait_for_text('paused')
        stalled.click('Begin')
        shown.page.wait_for_text(r'0:00\.0 of')
    finally:
        relay.close()
