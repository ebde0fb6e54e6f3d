# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Make the pictures of docs/view.md: a viewer is started as by a user, and shown in Chromium.

    python tools/view_screenshots.py                # of the demo and of a simulated robot
    python tools/view_screenshots.py --only camera  # some of them

It needs the extra [dev], chromium and chromium-driver. Look at every picture afterwards.
"""

from __future__ import annotations

import argparse
import os
import queue
import re
import signal
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
from chromium import chromium, close_notifications, draw, picture, ratslam, resize, wait_for
from PIL import Image
from selenium.webdriver.common.action_chains import ActionChains
from selenium.webdriver.common.by import By
from selenium.webdriver.common.keys import Keys

ROOT = Path(__file__).parents[1]

WINDOW = (1280, 720)
TALL = (1280, 1500)
"""Size of the page in px: as a whole, and for panels, which are shown in full length."""

DOMAIN = {
    'ROS_DOMAIN_ID': str(1 + os.getpid() % 100), 'ROS_AUTOMATIC_DISCOVERY_RANGE': 'LOCALHOST'
}
"""Keeps the nodes apart from others on this machine and its network."""

NODES = (
    'launch', '--view', '--config', 'navigation', '--goal-follower', '--set',
    'goal_follower.explore=true',
)
ROBOT = ('simulate', '--live', '--plan', 'office', '--rate', '2', '--quiet')
EXPLORED_S = 75.0
"""Live nodes and a simulated robot, and time for it to explore before it gets a goal."""

CENTRE = "arguments[0].scrollIntoView({block: 'center'})"
"""Script that shows an element; at the top, the time control may cover it."""

MARGIN_PX = 8
START_S, REPLAY_S, STOP_S = 90.0, 180.0, 10.0
PARTS = ('run', 'export', 'robot')
QUALITY = 82
"""Quality of WebP for pictures with the map."""


class Viewer:
    """A running ``ratslam`` command with its page."""

    def __init__(self, browser: Any, url: str) -> None:
        self.browser, self.url = browser, url

    def open(self, size: tuple[int, int]) -> None:
        """Load the page with a size in px, and wait until it shows something."""
        resize(self.browser, *size)
        self.browser.get(self.url)
        wait_for(lambda: self.tabs(), 'the page of the viewer shows no panels')
        self.settle(3.0)

    def settle(self, seconds: float = 1.0) -> None:
        """Wait for what the loop sends, close viser's notices, and wait for the drawing."""
        time.sleep(seconds)
        close_notifications(self.browser)
        time.sleep(0.5)
        draw(self.browser)

    def text(self) -> str:
        """Return the visible texts."""
        return str(self.browser.find_element(By.TAG_NAME, 'body').text)

    def tabs(self) -> dict[str, Any]:
        """Return the tabs by their names."""
        found = self.browser.find_elements(By.CSS_SELECTOR, '[role=tab]')
        return {tab.text.strip(): tab for tab in found}

    def tab(self, name: str) -> None:
        """Select a tab.

        Raises:
            SystemExit: there is none with this name.
        """
        tabs = self.tabs()
        if name not in tabs:
            raise SystemExit(f'no tab {name!r}; there are {", ".join(tabs)}')
        self.browser.execute_script(CENTRE, tabs[name])
        tabs[name].click()
        self.settle()

    def panel(self, name: str) -> Image.Image:
        """Return the picture of a tab with its content."""
        self.tab(name)
        box = self.browser.execute_script(
            "const r = arguments[0].closest('[data-dock-group]').getBoundingClientRect();"
            'return [r.left, r.top, r.right, r.bottom]',
            self.tabs()[name],
        )
        return without_empty_end(picture(self.browser).crop(tuple(map(round, box))))

    def press(self, key: str) -> None:
        """Press a key with the focus on the map."""
        self.browser.execute_script('document.activeElement?.blur()')
        ActionChains(self.browser).send_keys(key).perform()
        self.settle()

    def choose(self, label: str, row: int) -> None:
        """Choose an entry of the dropdown with a label, by its number."""
        field = self.browser.find_element(
            By.XPATH, f'//label[normalize-space()="{label}"]/following::input[1]'
        )
        self.browser.execute_script(CENTRE, field)
        field.click()
        options = wait_for(
            lambda: [
                option
                for option in self.browser.find_elements(By.CSS_SELECTOR, '[role=option]')
                if option.is_displayed()
            ],
            f'the dropdown {label!r} is empty',
        )
        options[min(row, len(options) - 1)].click()
        self.settle(2.0)

    def click_map(self, until: str) -> None:
        """Click on points of the map, from its middle outwards, until the page shows a text.

        Raises:
            SystemExit: no point did.
        """
        canvas = self.browser.find_element(By.CSS_SELECTOR, 'canvas')
        for x, y in spiral(step=14, count=200):
            ActionChains(self.browser).move_to_element_with_offset(canvas, x, y).click().perform()
            time.sleep(0.35)
            if until in self.text():
                self.settle(2.0)
                return
        raise SystemExit(f'no click on the map showed {until!r}')


def spiral(step: int, count: int) -> Iterator[tuple[int, int]]:
    """Return points on a spiral around the origin, about ``step`` apart."""
    for k in range(count):
        radius, angle = step * np.sqrt(k), 2.4 * k
        yield round(radius * np.cos(angle)), round(radius * np.sin(angle))


def without_empty_end(panel: Image.Image) -> Image.Image:
    """Return a picture without the rows at its end that have a single colour."""
    pixels = np.asarray(panel).astype(int)[:, MARGIN_PX:-MARGIN_PX]
    used = np.flatnonzero(np.ptp(pixels, axis=1).max(axis=1) > MARGIN_PX)
    last = int(used[-1]) if len(used) else panel.height
    return panel.crop((0, 0, panel.width, min(panel.height, last + 2 * MARGIN_PX)))


@contextmanager
def running(*command: str, output: int = subprocess.DEVNULL) -> Iterator[subprocess.Popen[str]]:
    """Start a ratslam command; it ends with the context."""
    process = subprocess.Popen(
        [sys.executable, '-u', '-m', 'ratslam_ros', *command],
        stdout=output, stderr=subprocess.STDOUT, text=True, start_new_session=True,
        env={**os.environ, **DOMAIN},
    )
    try:
        yield process
    finally:
        process.send_signal(signal.SIGINT)
        try:
            process.wait(STOP_S)
        except subprocess.TimeoutExpired:
            os.killpg(process.pid, signal.SIGKILL)


@contextmanager
def viewer(browser: Any, *command: str) -> Iterator[Viewer]:
    """Start a ratslam command that shows its run; it ends with the context."""
    words = (*command, '--no-browser', '--port', '0')
    with running(*words, output=subprocess.PIPE) as process:
        yield Viewer(browser, url_of(process))


def url_of(process: subprocess.Popen[str]) -> str:
    """Return the address of the page that a command prints.

    Raises:
        SystemExit: it printed none.
    """
    lines: queue.Queue[str] = queue.Queue()
    threading.Thread(
        target=lambda: [lines.put(line) for line in process.stdout or ()], daemon=True
    ).start()
    output: list[str] = []

    def url() -> str:
        while not lines.empty():
            output.append(lines.get())
        found = re.search(r'http://\S+', ''.join(output))
        if found is None and process.poll() is not None:
            raise SystemExit(f'no page is shown: {"".join(output)}')
        return '' if found is None else found[0]

    return str(wait_for(url, 'the command prints no address', START_S))


Save = Callable[[str, Image.Image], None]


def of_replay(shown: Viewer, save: Save) -> None:
    """Make the pictures of a replay that has come to its end."""
    shown.open(WINDOW)
    wait_for(lambda: 'end of the run' in shown.text(), 'the replay does not end', REPLAY_S)
    shown.settle(3.0)
    save('view_window', picture(shown.browser))
    shown.press('t')
    save('view_dark', picture(shown.browser))
    shown.press('t')
    resize(shown.browser, *TALL)
    shown.settle()
    for name in ('Camera and match', 'Pose cells', 'Map', 'Parameters', 'Help'):
        save(file_of(name), shown.panel(name))
    shown.tab('Select')
    shown.choose('Loop closures', 1)
    save('view_select_closure', shown.panel('Select'))
    resize(shown.browser, *WINDOW)
    shown.click_map('visits')
    resize(shown.browser, *TALL)
    save('view_select_experience', shown.panel('Select'))


def of_robot(shown: Viewer, save: Save) -> None:
    """Make the pictures of a simulated robot that drives to a goal."""
    time.sleep(EXPLORED_S)
    shown.open(WINDOW)
    shown.tab('Select')
    shown.click_map('last visit')  # an experience: the ground may be too far from the map
    shown.press('g')
    shown.settle(3.0)
    save('view_route', picture(shown.browser))
    resize(shown.browser, *TALL)
    save('view_drive', shown.panel('Drive'))


def of_export(browser: Any, page: Path, save: Save) -> None:
    """Make the picture of an exported page."""
    shown = Viewer(browser, page.as_uri())
    resize(shown.browser, *WINDOW)
    browser.get(shown.url)
    time.sleep(8.0)
    close_notifications(browser)
    browser.find_element(By.TAG_NAME, 'body').send_keys(Keys.SPACE)
    draw(browser)
    save('view_export', picture(browser))


def file_of(tab: str) -> str:
    """Return the name of a tab's picture."""
    return 'view_' + tab.lower().replace(' ', '_')


def write(folder: Path, name: str, image: Image.Image) -> None:
    """Write a picture as WebP; panels, which are text, without loss."""
    path = folder / f'{name}.webp'
    image.save(path, quality=QUALITY, method=6, lossless=image.width < WINDOW[0] // 2)
    print(f'{path.name}: {image.width} x {image.height}, {path.stat().st_size} bytes')


def main() -> None:
    """Make the pictures."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument('--only', help='write only pictures whose names contain this')
    parser.add_argument('--out', type=Path, default=ROOT / 'docs/images')
    parser.add_argument('--demo', help='results of ratslam demo; without it, the demo runs')
    parser.add_argument('--parts', nargs='+', choices=PARTS, default=PARTS)
    options = parser.parse_args()

    def save(name: str, image: Image.Image) -> None:
        if not options.only or options.only in name:
            options.out.mkdir(parents=True, exist_ok=True)
            write(options.out, name, image)

    with tempfile.TemporaryDirectory() as folder, chromium(*WINDOW) as browser:
        demo = options.demo
        if demo is None and {'run', 'export'} & set(options.parts):
            demo = f'{folder}/demo'
            ratslam('demo', '--quiet', '--out', demo)
        if 'run' in options.parts:
            recording = f'{demo}/recording'
            words = ('view', recording, '--truth', f'{recording}/truth.tum')
            with viewer(browser, *words, '--out', f'{folder}/replay') as shown:
                of_replay(shown, save)
        if 'export' in options.parts:
            page = Path(folder) / 'run.html'
            ratslam('view', demo, '--export', str(page))
            of_export(browser, page, save)
        if 'robot' in options.parts:
            with viewer(browser, *NODES) as shown, running(*ROBOT):
                of_robot(shown, save)


if __name__ == '__main__':
    main()
