# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""One headless Chromium for all tests, a short recording, and commands that serve pages."""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterator
from contextlib import ExitStack
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest
from browser import chromium, new_page, viser

if TYPE_CHECKING:
    import viewer_page as panels
    from pages import View

    from ratslam_ros.viewer.app import Page
    from ratslam_ros.viewer.run_source import Controls, RunSource
    from ratslam_simulator.recording import SimulatedRun

__all__ = ['chromium', 'new_page', 'viser']  # fixtures of all folders with a browser

RECORDING_S = 30.0

def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    """Have one worker run all tests with a browser, which it starts once."""
    if config.pluginmanager.hasplugin('xdist'):
        for item in items:
            if 'chromium' in getattr(item, 'fixturenames', ()):
                item.add_marker(pytest.mark.xdist_group('browser'))


@pytest.fixture(scope='session')
def recording(tmp_path_factory: pytest.TempPathFactory) -> SimulatedRun:
    """Simulate the first seconds of the demo."""
    from ratslam_simulator.recording import write_recording

    return write_recording(tmp_path_factory.mktemp('recordings') / 'demo', 1, RECORDING_S)


@pytest.fixture
def results(tmp_path: Path) -> Path:
    """Return a folder with the history of a short run."""
    from viewer_doubles import records_of

    from ratslam_ros.history.file import HISTORY_NAME, HistoryMeta
    from ratslam_ros.history.writer import HistoryWriter

    folder = tmp_path / 'some run'
    folder.mkdir()
    writer = HistoryWriter(folder / HISTORY_NAME, HistoryMeta('run'))
    for number in range(60):
        for record in records_of(number):
            writer.add(record)
    writer.close()
    return folder


@pytest.fixture
def view(viser: Any, tmp_path: Path) -> Iterator[Callable[..., View]]:
    """Return a function that starts a ratslam command; all are ended after the test."""
    from pages import View

    with ExitStack() as stack:

        def start(*words: str, **variables: str) -> View:
            started = View(words, tmp_path, **variables)
            stack.callback(started.close)
            return started

        yield start


class Served:
    """A viewer in this process."""

    def __init__(self, page: Page) -> None:
        self.page, self.server = page, page.server

    @property
    def url(self) -> str:
        return self.server.url

    def wait_for_updates(self, count: int) -> None:
        """Wait until the loop has drawn a number of times."""
        for _ in range(count):
            called = threading.Event()
            self.page.post(called.set)
            assert called.wait(60.0)

    def close(self) -> None:
        self.page.close(10.0)


def _serving() -> Iterator[Callable[[RunSource, Controls], Served]]:
    from ratslam_ros.viewer.app import Page
    from ratslam_ros.viewer.server import ViewServer

    with ExitStack() as stack:

        def start(source: RunSource, controls: Controls) -> Served:
            served = Served(Page(ViewServer(port=0), source, controls))
            stack.callback(served.close)
            return served

        yield start


@pytest.fixture
def serve(viser: Any) -> Iterator[Callable[[RunSource, Controls], Served]]:
    """Return a function that shows a run in this process; all pages end after the test."""
    yield from _serving()


@pytest.fixture(scope='module')
def serving(viser: Any) -> Iterator[Callable[[RunSource, Controls], Served]]:
    """Return the same as ``serve``, for pages that the tests of a module share."""
    yield from _serving()


@pytest.fixture
def page(viser: Any) -> Iterator[panels.Page]:
    """Return the panels of a run of 60 steps, whose controls can do everything."""
    from viewer_doubles import FakeControls, FakeRun
    from viewer_page import ALL_ACTIONS, open_page

    with open_page(FakeRun(60), FakeControls(*ALL_ACTIONS)) as page:
        yield page
