# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Memory of the viewer and its page beside a simulated robot that explores.

    python benchmarks/viewer_memory.py [--minutes 10] [--shot FILE.png]

Starts `ratslam launch --view` with a robot of `ratslam simulate --live`, opens the page in
Chromium with software rendering, and prints every minute: the resident memory of the node
`viewer`, the JavaScript heap of the page after a garbage collection, and its numbers of geometries
and document elements. The records of the last minutes fill the memory at first, see `TAIL_NS` in
viewer/live_run.py. Needs Chromium and chromedriver. Linux only.
"""

from __future__ import annotations

import argparse
import signal
import tempfile
import time
from pathlib import Path
from typing import Any

from page_frame_rate import browser, descendants
from processes import resident_mb, started, use_own_domain, wait_for_text


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument('--minutes', type=int, default=10)
    parser.add_argument('--shot', type=Path, help='file for a screenshot at the end')
    options = parser.parse_args()
    use_own_domain()
    with tempfile.TemporaryDirectory(ignore_cleanup_errors=True) as temporary:
        folder = Path(temporary)
        nodes = started(
            folder / 'nodes.log', 'launch', '--view', '--no-browser', '--port', '0', '--config',
            'navigation', '--goal-follower', '--set', 'goal_follower.explore=true',
        )
        robot = driver = None
        try:
            url = wait_for_text(folder / 'nodes.log', nodes, r'http://\S+')
            viewer = child(nodes.pid, 'viewer')
            robot = started(folder / 'robot.log', 'simulate', '--live', '--plan', 'office')
            driver = browser(str(folder / 'profile'))
            driver.get(url)
            print('| minute | viewer, MB | page: heap, MB | geometries | elements |')
            print('| --- | --- | --- | --- | --- |')
            for minute in range(1, options.minutes + 1):
                time.sleep(60.0)
                print(f'| {minute} | ' + ' | '.join(row(driver, viewer)) + ' |', flush=True)
            if options.shot:
                driver.save_screenshot(str(options.shot))
        finally:
            if driver is not None:
                driver.quit()
            for process in (robot, nodes):
                if process is not None:
                    process.send_signal(signal.SIGINT)
            for process in (robot, nodes):
                if process is not None:
                    process.wait(30.0)


def row(driver: Any, viewer: int) -> list[str]:
    """Return the numbers of a minute as texts."""
    driver.execute_cdp_cmd('HeapProfiler.collectGarbage', {})
    heap = driver.execute_cdp_cmd('Runtime.getHeapUsage', {})['usedSize']
    geometries = driver.execute_script(
        'return window.__viserTestpoints.rendererInfo.memory.geometries'
    )
    elements = driver.execute_script('return document.querySelectorAll("*").length')
    return [f'{resident_mb(viewer):.0f}', f'{heap / 1e6:.1f}', str(geometries), str(elements)]


def child(parent: int, word: str) -> int:
    """Return the descendant of a process whose command contains a word."""
    for process in descendants(parent):
        if word in Path(f'/proc/{process}/cmdline').read_text().split('\0'):
            return process
    raise SystemExit(f'no process {word}')


if __name__ == '__main__':
    main()
