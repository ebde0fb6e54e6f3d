# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Headless Chromium with software rendering, for the pictures of the documentation."""

from __future__ import annotations

import io
import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

from PIL import Image
from selenium import webdriver

FLAGS = (
    '--headless=new', '--no-sandbox', '--no-first-run', '--disable-quic', '--disable-sync',
    '--disable-background-networking', '--disable-component-update', '--hide-scrollbars',
    '--use-angle=swiftshader', '--enable-unsafe-swiftshader',
)
POLL_S = 0.05


@contextmanager
def chromium(width: int, height: int) -> Iterator[Any]:
    """Start Chromium with a page of a size in px; it ends with the context.

    Raises:
        SystemExit: Chromium or its driver is not installed.
    """
    driver, browser = shutil.which('chromedriver'), shutil.which('chromium')
    if driver is None or browser is None:
        raise SystemExit('no chromium or chromedriver: apt install chromium chromium-driver')
    options = webdriver.ChromeOptions()
    options.binary_location = browser
    with tempfile.TemporaryDirectory(ignore_cleanup_errors=True) as profile:
        for flag in (*FLAGS, f'--user-data-dir={profile}'):
            options.add_argument(flag)
        started = webdriver.Chrome(options, webdriver.ChromeService(driver))
        try:
            resize(started, width, height)
            started.execute_cdp_cmd(  # as with a graphics card
                'Page.addScriptToEvaluateOnNewDocument',
                {'source': 'window.keepAntialiasing = true'},
            )
            yield started
        finally:
            started.quit()


def resize(browser: Any, width: int, height: int) -> None:
    """Change the size of the page, in px."""
    browser.execute_cdp_cmd(
        'Emulation.setDeviceMetricsOverride',
        {'width': width, 'height': height, 'deviceScaleFactor': 1, 'mobile': False},
    )


def wait_for(condition: Callable[[], Any], what: str, timeout_s: float = 60.0) -> Any:
    """Return the first true value of a condition.

    Raises:
        SystemExit: there was none in time.
    """
    end_s = time.monotonic() + timeout_s
    while not (value := condition()):
        if time.monotonic() > end_s:
            raise SystemExit(f'{what}: not within {timeout_s:g} s')
        time.sleep(POLL_S)
    return value


def picture(browser: Any) -> Image.Image:
    """Return what the page shows."""
    return Image.open(io.BytesIO(browser.get_screenshot_as_png())).convert('RGB')


def close_notifications(browser: Any) -> None:
    """Close the notices of viser, such as the one that the rendering is slow."""
    browser.execute_script(
        "document.querySelectorAll('.mantine-Notification-closeButton').forEach(b => b.click())"
    )


def draw(browser: Any) -> None:
    """Wait until the page has drawn all that it has received."""
    browser.execute_async_script(
        'const done = arguments[0]; let n = 4;'
        'const next = () => (n-- ? requestAnimationFrame(next) : done());'
        'requestAnimationFrame(next);'
    )


def ratslam(*command: str) -> None:
    """Run a ratslam command.

    Raises:
        SystemExit: it failed.
    """
    if subprocess.run([sys.executable, '-m', 'ratslam_ros', *command], check=False).returncode:
        raise SystemExit(f'failed: ratslam {" ".join(command)}')
