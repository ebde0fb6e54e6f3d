# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Cost of the live view in Chromium with software rendering: frame rate, processors, bytes.

    python benchmarks/page_frame_rate.py [--experiences 3000 20000] [--seconds 5]

Draws nothing first, then a synthetic run of a number of experiences at 10 Hz, first in steady
driving (a new experience at every update), then for 5 s after a loop closure in which all poses
move at every map message. The browser is asked for frames without pause, and the frames that its
renderer has drawn are counted; without that it draws only on changes. `server` and `browser` are
seconds of processor time per second. The server's includes the synthetic run, which is listed
alone as `run`. On a loaded machine, compare the browser's `ms per frame` instead of the frame
rate: processor time of all of its threads. Chromium starts as on a machine without a graphics
card: it renders WebGL by SwiftShader and composes the page without it. Needs Chromium and
chromedriver. Linux only.
"""

from __future__ import annotations

import argparse
import os
import sys
import tempfile
import threading
import time
from contextlib import suppress
from pathlib import Path
from typing import Any

from processes import parent_and_cpu_s
from selenium import webdriver
from selenium.webdriver.chrome.service import Service

from ratslam_ros.viewer.scene import RunScene
from ratslam_ros.viewer.server import ViewServer

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / 'test/viewer'))

from synthetic_runs import SyntheticRun

PERIOD_S = 0.1
CLOSURE_S = 5.0
SETTLING_S = 5.0
MAP_MESSAGES = 5
"""Number of updates between two map messages after a closure: 2 Hz."""

OPTIONS = (
    '--headless=new', '--no-sandbox', '--disable-quic', '--no-first-run', '--disable-sync',
    '--disable-background-networking', '--disable-component-update', '--disable-gpu',
    '--enable-unsafe-swiftshader', '--window-size=1280,720',
)

RENDERER = """
const gl = document.createElement('canvas').getContext('webgl2');
const info = gl.getExtension('WEBGL_debug_renderer_info');
return gl.getParameter(info.UNMASKED_RENDERER_WEBGL);
"""

COUNT_FRAMES = """
const [seconds, done] = arguments;
const view = window.__viserMutable, info = window.__viserTestpoints.rendererInfo;
const first = info.render.frame, start = performance.now();
function tick() {
  view.requestRender();
  const passed = performance.now() - start;
  if (passed < 1000 * seconds) return requestAnimationFrame(tick);
  done([1000 * (info.render.frame - first) / passed, info.render.calls]);
}
requestAnimationFrame(tick);
"""


def browser(folder: str) -> webdriver.Chrome:
    options = webdriver.ChromeOptions()
    options.binary_location = '/usr/bin/chromium'
    for option in (*OPTIONS, f'--user-data-dir={folder}'):
        options.add_argument(option)
    driver = webdriver.Chrome(options=options, service=Service('/usr/bin/chromedriver'))
    driver.set_script_timeout(120)
    return driver


def descendants(process: int) -> dict[int, float]:
    """Return the processor times in s of all descendants of a process."""
    parents, times = {}, {}
    for path in Path('/proc').glob('[0-9]*/stat'):
        number = int(path.parent.name)
        with suppress(OSError):  # it has ended
            parents[number], times[number] = parent_and_cpu_s(number)
    open_parents, found = [process], {}
    while open_parents:
        parent = open_parents.pop()
        children = [number for number, p in parents.items() if p == parent]
        found |= {number: times[number] for number in children}
        open_parents += children
    return found


def tree_cpu_s(process: int) -> float:
    """Return the processor time in s of all descendants of a process."""
    return sum(descendants(process).values())


class Drive:
    """Draws the run in a thread, as the viewer's loop does."""

    def __init__(self, server: Any, count: int) -> None:
        self.server, self.run = server, SyntheticRun(count)
        self.state = self.run.state()
        self.scene = RunScene(server)
        self.closing_until_s = 0.0
        self.update_s = self.run_s = self.longest_s = 0.0
        self.stop = threading.Event()
        self.thread = threading.Thread(target=self.loop)

    def end(self) -> None:
        """Stop driving."""
        self.stop.set()
        if self.thread.ident is not None:
            self.thread.join()

    def loop(self) -> None:
        """Drive and draw until ``stop`` is set."""
        updates = 0
        while not self.stop.is_set():
            begun_s = time.monotonic()
            cpu_s = time.thread_time()
            records = self.run.step()
            if begun_s < self.closing_until_s and updates % MAP_MESSAGES == 0:
                records += self.run.close()
            for record in records:
                self.state.apply(record)
            applied_s = time.thread_time()
            with self.server.atomic():
                self.scene.update(self.state)
            done_s = time.thread_time()
            self.run_s += applied_s - cpu_s
            self.update_s += done_s - applied_s
            self.longest_s = max(self.longest_s, done_s - applied_s)
            updates += 1
            self.stop.wait(max(0.0, begun_s + PERIOD_S - time.monotonic()))


def measure(drive: Drive, driver: Any, seconds: float) -> dict[str, float]:
    sent = count_bytes(drive.server)
    start_s, cpu_s = time.monotonic(), time.process_time()
    browser_s, run_s, sent_0 = tree_cpu_s(os.getpid()), drive.run_s, sent[0]
    update_s, drive.longest_s = drive.update_s, 0.0
    fps, calls = driver.execute_async_script(COUNT_FRAMES, seconds)
    passed_s = time.monotonic() - start_s
    browser_s = tree_cpu_s(os.getpid()) - browser_s
    return {
        'fps': fps, 'draw calls': calls,
        'server': (time.process_time() - cpu_s) / passed_s,
        'update': (drive.update_s - update_s) / passed_s,
        'run': (drive.run_s - run_s) / passed_s,
        'longest ms': 1e3 * drive.longest_s,
        'browser': browser_s / passed_s,
        'ms per frame': 1e3 * browser_s / max(fps * passed_s, 1.0),
        'kB/s': (sent[0] - sent_0) / 1e3 / passed_s,
    }


def count_bytes(server: Any) -> list[int]:
    """Count the bytes of queued arrays and assets, before compression."""
    known = getattr(server, '_bench_bytes', None)
    if known is not None:
        return known
    total = [0]
    push = server.scene._websock_interface.queue_message

    def counted(message: Any) -> None:
        props = getattr(message, 'props', None) or getattr(message, 'updates', {})
        values = props.values() if isinstance(props, dict) else vars(props).values()
        total[0] += 60 + sum(
            getattr(value, 'nbytes', len(value) if isinstance(value, bytes) else 8)
            for value in values
        )
        push(message)

    server.scene._websock_interface.queue_message = counted  # type: ignore[method-assign]
    server._bench_bytes = total  # type: ignore[attr-defined]
    return total


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument('--experiences', type=int, nargs='+', default=[3000, 20000])
    parser.add_argument('--seconds', type=float, default=CLOSURE_S)
    parser.add_argument('--shots', type=Path, help='folder for a screenshot of each state')
    arguments = parser.parse_args()
    for count in arguments.experiences:
        server = ViewServer(port=0)
        drive = Drive(server.viser, count)
        with tempfile.TemporaryDirectory(ignore_cleanup_errors=True) as folder:
            driver = browser(folder)
            try:
                driver.get(server.url)
                time.sleep(SETTLING_S)
                load, cores = os.getloadavg()[0], os.cpu_count()
                print(f'{count} experiences, {driver.execute_script(RENDERER)}, {cores} cores, '
                      f'load average {load:.1f}')
                for name in ('empty', 'steady', 'closure'):
                    if name == 'steady':
                        drive.thread.start()
                        time.sleep(SETTLING_S)
                    elif name == 'closure':
                        drive.closing_until_s = time.monotonic() + arguments.seconds
                    found = measure(drive, driver, arguments.seconds)
                    print(f'  {name:8}' + '  '.join(f'{k} {v:.3g}' for k, v in found.items()),
                          flush=True)
                    if arguments.shots:
                        driver.save_screenshot(str(arguments.shots / f'{count}_{name}.png'))
                print(f'  detail: {drive.scene.detail or "not reduced"}')
            finally:
                drive.end()
                driver.quit()
                server.stop()


if __name__ == '__main__':
    main()
