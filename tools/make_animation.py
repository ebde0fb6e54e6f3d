# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Make the animation of README.md: the demo, exported as a page and played in Chromium.

    python tools/make_animation.py                    # docs/images/view.webp, of the demo
    python tools/make_animation.py results/latest     # of any run

It needs the extra [dev], chromium and chromium-driver.
"""

from __future__ import annotations

import argparse
import tempfile
from pathlib import Path
from typing import Any

from chromium import chromium, close_notifications, draw, picture, ratslam, wait_for
from PIL import Image

ROOT = Path(__file__).parents[1]

WIDTH, HEIGHT = 1200, 676
"""Size of the page in px; the bar with the time control, below the scene, is cut off."""

SCALE = 0.7
"""Size of the animation relative to that of the page."""

DURATION_S, FRAMES_PER_S, LAST_S = 18.0, 5, 2.0
"""Length and rate of the animation, and time for which the last frame stays."""

MAX_BYTES = 2_000_000
QUALITIES = (80, 70, 60, 50, 40, 30, 20)
"""Qualities of WebP; the best one that fits into the limit is taken."""

SET_TIME = """
const input = document.querySelector('.mantine-NumberInput-input');
const set = Object.getOwnPropertyDescriptor(HTMLInputElement.prototype, 'value').set;
set.call(input, arguments[0]);
input.dispatchEvent(new Event('input', {bubbles: true}));
"""
"""Sets the time of viser's player, as a user does who types it; the player then pauses."""


def frames(page: Path) -> list[Image.Image]:
    """Return pictures of an exported page at equal distances of time."""
    found: list[Image.Image] = []
    with chromium(WIDTH, HEIGHT) as browser:
        browser.get(page.as_uri())
        wait_for(lambda: shown_s(browser) is not None, 'the exported page shows no frame')
        bar = wait_for(lambda: bar_height(browser), 'the exported page has no time control')
        count = round(DURATION_S * FRAMES_PER_S)
        last_s = -1.0
        for number in range(1, count + 1):
            at_s = DURATION_S * number / count - 0.01
            browser.execute_script(SET_TIME, f'{at_s:.3f}')
            draw(browser)
            now_s = wait_for(lambda last_s=last_s: later(browser, last_s), f'frame {number}')
            last_s = now_s
            close_notifications(browser)
            draw(browser)
            shown = picture(browser).crop((0, 0, WIDTH, HEIGHT - bar))
            size = (round(shown.width * SCALE), round(shown.height * SCALE))
            found.append(shown.resize(size, Image.Resampling.LANCZOS))
    return found


def shown_s(browser: Any) -> float | None:
    """Return the moment of the run that the page shows, in s."""
    text = browser.execute_script("return document.getElementById('run')?.dataset.frame")
    return None if text is None else float(text)


def later(browser: Any, last_s: float) -> float | None:
    """Return the moment that the page shows, if it is a later one."""
    now_s = shown_s(browser)
    return now_s if now_s is not None and now_s > last_s else None


def bar_height(browser: Any) -> int:
    """Return the height of the bar with the time control, in px."""
    height = browser.execute_script(
        "const scene = document.querySelector('#root canvas');"
        'return scene ? innerHeight - scene.getBoundingClientRect().bottom : 0'
    )
    return round(height)


def save(pictures: list[Image.Image], path: Path) -> int:
    """Write an animation that is at most ``MAX_BYTES`` large, and return its size.

    Raises:
        SystemExit: it is larger with the lowest quality.
    """
    durations = [1000 // FRAMES_PER_S] * len(pictures)
    durations[-1] = round(1000 * LAST_S)
    for quality in QUALITIES:
        pictures[0].save(
            path, save_all=True, append_images=pictures[1:], duration=durations, loop=0,
            quality=quality, method=4, minimize_size=False, kmin=30, kmax=60,
        )
        if path.stat().st_size <= MAX_BYTES:
            print(f'{path}: {path.stat().st_size} bytes, quality {quality}')
            return path.stat().st_size
    raise SystemExit(f'{path} exceeds {MAX_BYTES} bytes at the lowest quality: reduce SCALE')


def main() -> None:
    """Make the animation."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument('results', nargs='?', help='folder of a run; without it, the demo runs')
    parser.add_argument('--out', type=Path, default=ROOT / 'docs/images/view.webp')
    options = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        page = Path(folder) / 'run.html'
        export = ('--export', str(page), '--export-duration', str(DURATION_S))
        if options.results is None:
            ratslam('demo', '--quiet', '--out', f'{folder}/demo')
            # The name of the recording becomes the title.
            recording = Path(folder, 'demo/recording').rename(Path(folder, 'RatSLAM demo'))
            words = (str(recording), '--truth', str(recording / 'truth.tum'))
            ratslam('view', *words, '--out', f'{folder}/results', *export)
        else:
            ratslam('view', options.results, *export)
        save(frames(page), options.out)


if __name__ == '__main__':
    main()
