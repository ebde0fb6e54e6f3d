# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The viewer in a browser."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from pages import Page, Relay, wait_for
from viewer_doubles import FakeControls, FakeRun

NewPage = Callable[[str], Page]


def test_page_shows_run_and_keeps_it_after_reload(serve: Any, new_page: NewPage) -> None:
    served = serve(FakeRun(40), FakeControls())
    page = new_page(served.url)
    page.wait_for_text('0:19.5 of 0:19.5')
    page.reload()
    page.wait_for_text('0:19.5 of 0:19.5')
    page.wait_for_text('template 19')


def test_two_browsers_show_the_same_moment(serve: Any, new_page: NewPage) -> None:
    served = serve(FakeRun(40), FakeControls())
    one, other = new_page(served.url), new_page(served.url)
    wait_for(lambda: served.server.client_count == 2)
    one.click('Begin')
    one.wait_for_text('0:00.0 of 0:19.5')
    other.wait_for_text('0:00.0 of 0:19.5')


def test_growing_run_is_followed(serve: Any, new_page: NewPage) -> None:
    run = FakeRun(3, is_growing=True)
    page = new_page(serve(run, FakeControls()).url)
    page.wait_for_text('of 0:01.0')
    before = page.received_count
    run.grow(4)
    page.wait_for_text('of 0:03.0')
    assert page.received_count > before


def test_nothing_is_sent_while_nothing_changes(serve: Any, new_page: NewPage) -> None:
    served = serve(FakeRun(40), FakeControls())
    page = new_page(served.url)
    page.wait_for_text('0:19.5 of 0:19.5')
    before = page.received_count
    ticks: list[int] = []
    served.app.post(lambda: ticks.append(1))
    wait_for(lambda: ticks)
    for _ in range(10):
        served.app.post(lambda: ticks.append(1))
    wait_for(lambda: len(ticks) > 10)
    assert page.received_count - before < 100


def test_error_of_a_callback_is_shown_and_loop_continues(serve: Any, new_page: NewPage) -> None:
    run = FakeRun(3, is_growing=True)
    served = serve(run, FakeControls())
    page = new_page(served.url)

    def fail() -> None:
        raise ValueError('the wheel is off')

    wait_for(lambda: served.server.viser.get_clients())
    served.app.post(fail)
    page.wait_for_text('the wheel is off')
    run.grow(4)
    page.wait_for_text('of 0:03.0')


def test_stalled_browser_catches_up_and_stops_no_other(serve: Any, new_page: NewPage) -> None:
    run = FakeRun(3, is_growing=True)
    served = serve(run, FakeControls())
    relay = Relay(served.server.port)
    try:
        stalled = new_page(served.url.replace(f':{served.server.port}', f':{relay.port}'))
        other = new_page(served.url)
        stalled.wait_for_text('of 0:01.0')
        relay.stall()
        run.grow(4)
        other.wait_for_text('of 0:03.0')
        assert 'of 0:01.0' in stalled.text
        relay.resume()
        stalled.wait_for_text('of 0:03.0')
    finally:
        relay.close()
