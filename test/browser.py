# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Fixtures: one headless Chromium for all tests, and tabs in it."""

from __future__ import annotations

import shutil
from collections.abc import Callable, Iterator
from contextlib import ExitStack
from typing import TYPE_CHECKING, Any

import pytest

if TYPE_CHECKING:
    from pages import Page

FLAGS = (
    '--headless=new', '--no-sandbox', '--no-first-run', '--disable-quic', '--disable-sync',
    '--disable-background-networking', '--disable-component-update', '--disable-dev-shm-usage',
    '--disable-background-timer-throttling', '--disable-renderer-backgrounding',
    '--disable-backgrounding-occluded-windows', '--hide-scrollbars', '--mute-audio',
    '--disable-gpu', '--enable-unsafe-swiftshader',
)


@pytest.fixture(scope='session')
def viser() -> Any:
    """Return viser; skip the test if the extra is not installed."""
    return pytest.importorskip('viser', reason='the extra [view] is not installed')


@pytest.fixture(scope='session')
def chromium(viser: Any, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Any]:
    """Start Chromium; skip the test if it is not installed."""
    webdriver = pytest.importorskip('selenium.webdriver', reason='selenium is not installed')
    binary = shutil.which('chromium') or shutil.which('google-chrome')
    driver = shutil.which('chromedriver')
    if binary is None or driver is None:
        pytest.skip(f'no {"chromedriver" if binary else "chromium"}: apt install chromium-driver')
    folder = tmp_path_factory.mktemp('chromium')
    options = webdriver.ChromeOptions()
    options.binary_location = binary
    for flag in (*FLAGS, f'--user-data-dir={folder / "profile"}', '--window-size=1280,720'):
        options.add_argument(flag)
    service = webdriver.ChromeService(driver, log_output=str(folder / 'chromedriver.log'))
    started = webdriver.Chrome(options, service)
    started.set_script_timeout(60)
    yield started
    started.quit()


@pytest.fixture
def new_page(chromium: Any) -> Iterator[Callable[[str], Page]]:
    """Return a function that opens an address in a new tab; they are closed after the test."""
    from pages import Page

    with ExitStack() as stack:
        yield lambda url: stack.enter_context(Page(chromium)).open(url)
