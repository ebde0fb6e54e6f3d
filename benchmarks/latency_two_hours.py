# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Latency of the live nodes over two simulated hours at 30 Hz, run as fast as possible.

    python benchmarks/latency_two_hours.py [--hours 2] [--seed 1] [--viewer] [--out FOLDER]

A robot with a 160x120 camera at 30 Hz and wheel odometry at 50 Hz drives through a warehouse
(`simulated_town.py` at a smaller scale), half of the time in new places, so that its memory keeps
growing.
The live nodes run in this process on one executor over real DDS, on rclpy or its stand-in,
whichever `import rclpy` finds. They receive images and odometry in stamp order, and the next image
only when the map has processed the previous one. The time measured per image includes publishing,
transport, the three nodes, and the map message, which is sent at its live rate in simulated time.
Rendering is not measured. The map and its markers have no subscribers; with `--viewer`, processes
subscribe to the map and to its changes, which are otherwise not published. Linux only.

The map node sends its messages in short steps between the messages that it processes. The report
contains the longest of these steps, and the longest time in which the node processed a message
while the thread that publishes the map was active.
"""

from __future__ import annotations

import argparse
import gc
import math
import resource
import subprocess
import sys
import tempfile
import time
from array import array
from collections import defaultdict
from collections.abc import Callable
from pathlib import Path
from typing import Any

import cv2
import matplotlib
import numpy as np
from numpy.typing import NDArray
from processes import ROOT, use_own_domain
from simulated_town import At, Camera, Laps, Town, drive, resident_mb

matplotlib.use('Agg')
import matplotlib.pyplot as plt

WIDTH, HEIGHT, IMAGE_HZ, ODOMETRY_HZ = 160, 120, 30, 50
STEPS_HZ = 150  # a common multiple of both rates
BUDGET_MS = 1e3 / IMAGE_HZ
MINUTE = 60 * IMAGE_HZ
START_S = 1000
WAREHOUSE = Town(
    lot_m=1.2, block=8, eye_m=0.6, fov_deg=60.0, lane_m=0.0, corner_m=0.8, columns=0,
    speed_mps=1.0, turning_mps=0.5, brake_mps2=0.5, sway_m=0.05, light=0.1, known=20.0,
)
SETTINGS = {
    'local_view.vt_normalisation': 0.4,
    'local_view.vt_match_threshold': 0.02,
    'pose_cells.pc_dim_xy': 50,
    'pose_cells.pc_cell_x_size': 0.25,
    'pose_cells.exp_delta_pc_threshold': 1.0,
}
"""Parameters that differ from the preset extended."""
ODOMETRY_NOISE = 0.02
SENDING_MS = 0.3
"""Time of the checks per image above which a part of a message was sent."""
GROUPS = {
    'local view': ('decode', 'prepare', 'local_view.image'),
    'pose cells': ('pose_cells.odometry', 'pose_cells.template'),
    'experience map': ('experience_map.odometry', 'experience_map.action'),
    'map message': ('sending',),
}
"""Parts of the report -> their timing steps; the remaining time is transport."""


class NodeLaps(Laps):
    """Stopwatch that replaces those of the nodes."""

    def summary_ms(self) -> dict[str, dict[str, float]]:
        """Return no times, so that the diagnostics contain none."""
        return {}

    def timed(self, step: str, function: Callable[..., Any]) -> Callable[..., Any]:
        """Return a function whose calls are timed."""

        def measured(*args: Any) -> Any:
            with self(step):
                return function(*args)

        return measured

    def collection(self, phase: str, info: dict[str, int]) -> None:
        """Time Python's full garbage collections, as one of gc.callbacks."""
        if info['generation'] < 2:
            return
        if phase == 'start':
            self._since_s = time.perf_counter()
        else:
            self.s['collection'].append(time.perf_counter() - self._since_s)


class SimulatedClock:
    """Replacement of the module ``time`` for sending the map: simulated time plus time worked."""

    thread_time = staticmethod(time.thread_time)

    def __init__(self) -> None:
        self.at_s = 0.0
        self.work_since_s: float | None = None

    def monotonic(self) -> float:
        """Return the stamp of the newest message plus the time worked since, in seconds."""
        since_s = self.work_since_s
        return self.at_s + (0.0 if since_s is None else time.perf_counter() - since_s)


class Bench:
    """The three nodes and the robot that publishes to them."""

    def __init__(self, seed: int, viewer: bool) -> None:
        import rclpy
        from nav_msgs.msg import Odometry
        from rclpy.executors import SingleThreadedExecutor
        from sensor_msgs.msg import Image

        from ratslam_ros.ros.experience_map_node import ExperienceMapNode
        from ratslam_ros.ros.local_view_node import LocalViewNode
        from ratslam_ros.ros.mapping import map_changes, map_sender, sliced_publisher
        from ratslam_ros.ros.pose_cells_node import PoseCellsNode
        from ratslam_ros.ros.qos import RESULT

        self.laps = NodeLaps()
        self._clock = SimulatedClock()
        self.local_view = LocalViewNode()
        self.pose_cells = PoseCellsNode()
        self.map = ExperienceMapNode()
        map_changes.time = map_sender.time = sliced_publisher.time = self._clock
        self._measure_messages()
        self._nodes = self.local_view, self.pose_cells, self.map
        self._robot = rclpy.create_node('robot', use_global_arguments=False)
        self._executor = SingleThreadedExecutor()
        for node in (*self._nodes, self._robot):
            self._executor.add_node(node)
        for node in self._nodes:
            node.diagnostics.times = self.laps
        self._images = self._robot.create_publisher(Image, 'image', RESULT)
        self._odometry = self._robot.create_publisher(Odometry, 'odom', RESULT)
        self._spin_until(
            lambda: self._images.get_subscription_count() == 1
            and self._odometry.get_subscription_count() == 2
            and all(node.count_publishers(topic) for node, topic in (
                (self.pose_cells, 'local_view/template'), (self.map, 'pose_cells/action')))
        )
        self._viewers = [
            subprocess.Popen(
                [sys.executable, '-m', 'ratslam_ros', 'echo', topic, '--field', 'data'],
                stdout=subprocess.DEVNULL,
            )
            for topic in ('experience_map/map', 'experience_map/changes') if viewer
        ]
        self._spin_until(lambda: self.map._changes._changes.get_subscription_count() == viewer)
        self._camera = Camera(WAREHOUSE, seed, WIDTH, HEIGHT)
        self._rng = np.random.default_rng((seed, 2))
        self._frame = np.empty((HEIGHT, WIDTH, 3), np.uint8)
        self._taken: defaultdict[str, int] = defaultdict(int)
        self.times_s: defaultdict[str, array[float]] = defaultdict(lambda: array('d'))
        self.sizes: list[tuple[int, int, int, float]] = []
        """Templates, experiences, links and resident memory in MB at the end of every minute."""
        self.maps: list[tuple[int, float, float]] = []
        """Experiences of every map message, time of writing it and simulated time from the first
        to the last step, in s."""
        self.known = 0
        """Images taken at places where the robot has been before."""
        self._busy_s = 0.0
        self.cpu_s = 0.0
        """Processor time of the work; less than the wall time if other processes use the cores."""

    def run(self, images: int, seed: int) -> None:
        """Publish a number of images, and the odometry up to each."""
        waiting = None
        odometry_ns = 0
        for step, at in enumerate(drive(WAREHOUSE, seed, 1.0 / STEPS_HZ)):
            stamp_ns = START_S * 10**9 + step * 10**9 // STEPS_HZ
            self._clock.at_s = stamp_ns * 1e-9
            if step % (STEPS_HZ // ODOMETRY_HZ) == 0:
                self._work(self._odometry.publish, self._odometry_message(stamp_ns, at))
                odometry_ns = stamp_ns
            if step % (STEPS_HZ // IMAGE_HZ) == 0:
                message = self._image_message(stamp_ns, at)
                self._work(self._images.publish, message)
                waiting = stamp_ns
                self.known += at.times_before > 0
            if waiting is not None and odometry_ns >= waiting:
                self._work(self._settle, waiting, odometry_ns)
                self._record()
                waiting = None
                if len(self.times_s['all']) == images:
                    return

    def close(self) -> None:
        """Destroy the nodes."""
        for process in self._viewers:
            process.kill()
            process.wait()
        for node in self._nodes:
            node.close()
        for node in (*self._nodes, self._robot):
            self._executor.remove_node(node)
            node.destroy_node()
        self._executor.shutdown()

    @property
    def lost(self) -> dict[str, int]:
        """Number of messages that the nodes dropped, by reason."""
        return {
            f'{node.get_name()} {reason}': number
            for node in self._nodes
            for reason, number in node.diagnostics.counts.items()
            if number
        }

    def _measure_messages(self) -> None:
        """Time the steps in which the map node sends messages, and those next to its thread."""
        node, sender = self.map, self.map._sender
        send = self.laps.timed('sending', node._send)

        def sent() -> None:
            before_s = time.thread_time()
            send()
            self.laps.s['sending, processor'].append(time.thread_time() - before_s)

        node._send = sent
        sender._send = self.laps.timed('publishing', sender._send)
        process, publish = node.host.feed, sender._publish

        def processed(*args: Any) -> None:
            is_publishing = sender._thread is not None and sender._thread.is_alive()
            with self.laps('beside the thread' if is_publishing else 'without the thread'):
                process(*args)

        def published() -> None:
            written_s = self._clock.monotonic() - sender._begun_s
            self.maps.append((len(node._core), sender._worked_s, written_s))
            publish()

        node.host.feed, sender._publish = processed, published

    def _work(self, do: Callable[..., Any], *args: Any) -> None:
        """Call a function and add its time to the work of the present image."""
        start_s = self._clock.work_since_s = time.perf_counter()
        cpu_s = time.process_time()
        do(*args)
        self.cpu_s += time.process_time() - cpu_s
        self._busy_s += time.perf_counter() - start_s
        self._clock.work_since_s = None

    def _settle(self, image_ns: int, odometry_ns: int) -> None:
        """Wait until all nodes have processed these messages and their consequences."""
        self._spin_until(
            lambda: self.map._stage.action_ns >= image_ns
            and (self.map.host.pipeline.order.newest_of('odometry') or 0) >= odometry_ns
            and (self.pose_cells.host.pipeline.order.newest_of('odometry') or 0) >= odometry_ns
        )

    def _spin_until(self, condition: Callable[[], bool]) -> None:
        end_s = time.monotonic() + 60.0
        while not condition():
            self._executor.spin_once(timeout_sec=0.1)
            if time.monotonic() > end_s:
                dropped = f'dropped: {self.lost}; {self.local_view.error}'
                sys.exit(f'the nodes have stopped processing; {dropped}')

    def _record(self) -> None:
        """Record the times of the last image by part."""
        times = self.times_s
        times['all'].append(self._busy_s)
        self._busy_s = 0.0
        for group, steps in GROUPS.items():
            times[group].append(sum(self._since_last(step) for step in steps))
        if len(times['all']) % MINUTE == 0:
            core = self.map._core
            self.sizes.append(
                (len(self.local_view._core), len(core), core.link_count, resident_mb())
            )

    def _since_last(self, step: str) -> float:
        done = self.laps.s[step]
        before, self._taken[step] = self._taken[step], len(done)
        return sum(done[before:])

    def _odometry_message(self, stamp_ns: int, at: At) -> Any:
        from nav_msgs.msg import Odometry

        from ratslam_ros.ros.convert import header_of

        message = Odometry(header=header_of(stamp_ns, 'odom'), child_frame_id='base_link')
        slip = 1.0 + ODOMETRY_NOISE * self._rng.standard_normal(2)
        message.twist.twist.linear.x = at.speed_mps * slip[0]
        message.twist.twist.angular.z = at.turn_radps * slip[1]
        message.pose.pose.orientation.w = 1.0
        return message

    def _image_message(self, stamp_ns: int, at: At) -> Any:
        from ratslam_ros.ros.convert import image_message

        self._camera.take(at, stamp_ns * 1e-9, self._frame)
        return image_message(stamp_ns, 'camera', cv2.cvtColor(self._frame, cv2.COLOR_BGR2GRAY))


def lags_ms(all_ms: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the latency of the map for each image, if images arrived at 30 Hz and queued."""
    lag_ms = np.empty_like(all_ms)
    queued_ms = 0.0
    for i, took_ms in enumerate(all_ms):
        lag_ms[i] = queued_ms + took_ms
        queued_ms = max(lag_ms[i] - BUDGET_MS, 0.0)
    return lag_ms


def parts_ms(bench: Bench) -> dict[str, NDArray[np.float64]]:
    """Return the times per image by part; the map message takes 0 if none was sent."""
    parts = {name: np.array(times) * 1e3 for name, times in bench.times_s.items()}
    parts['transport and rest'] = parts['all'] - sum(parts[name] for name in GROUPS)
    parts['all'] = parts.pop('all')
    return parts


def report(bench: Bench) -> str:
    parts = parts_ms(bench)
    images = len(parts['all'])
    ten = max(min(10 * MINUTE, images // 2), 1)
    minutes = ten / MINUTE
    core = bench.map._core
    lines = [
        f'{images} images of {WIDTH}x{HEIGHT} at {IMAGE_HZ} Hz, odometry at {ODOMETRY_HZ} Hz: '
        f'{images / MINUTE / 60:.2f} h simulated, {parts["all"].sum() / 1e3:.0f} s of work '
        f'({bench.cpu_s:.0f} s of processor)',
        'extended except ' + ', '.join(f'{key}={value}' for key, value in SETTINGS.items()),
        f'{bench.known / images:.0%} of the images at places seen before; at the end '
        f'{len(bench.local_view._core)} templates, {len(core)} experiences, '
        f'{core.link_count} links; dropped: {bench.lost or "nothing"}',
        f'ms per image              median, first {minutes:.3g} min   last {minutes:.3g} min'
        '   ratio     p99   worst',
    ]
    for name, times_ms in parts.items():
        sent = times_ms > SENDING_MS if name == 'map message' else np.full(images, True)
        first, last = (np.median(part[there]) if there.any() else math.nan for part, there in (
            (times_ms[:ten], sent[:ten]), (times_ms[-ten:], sent[-ten:])))
        lines.append(
            f'  {name:34} {first:8.3f}        {last:8.3f}   {last / first:5.2f} '
            f'{np.percentile(times_ms[sent], 99):7.2f} {times_ms[sent].max():7.1f}'
        )
    lag_ms = lags_ms(parts['all'])
    over = np.mean(parts['all'] > BUDGET_MS)
    lines += [
        '  (map message: only images with which a part of one was written)',
        f'over the budget of {BUDGET_MS:.1f} ms   {over:.2%} of the images; latency of the map if '
        f'images arrived at {IMAGE_HZ} Hz and queued: {np.median(lag_ms):.1f} ms (median), '
        f'{np.percentile(lag_ms, 99):.1f} ms (p99), {lag_ms.max():.0f} ms (worst)',
        f'share of a core          {parts["all"][:ten].mean() / BUDGET_MS:.1%} at the start, '
        f'{parts["all"][-ten:].mean() / BUDGET_MS:.1%} at the end',
        *map_lines(bench),
    ]
    collections_ms = 1e3 * np.array(bench.laps.s['collection'] or [0.0])
    lines.append(
        f'garbage collection       {len(bench.laps.s["collection"])} full ones, worst '
        f'{collections_ms.max():.0f} ms; included in the worst times above'
    )
    peak_mb = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
    if bench.sizes:
        first_mb, last_mb = bench.sizes[0][3], bench.sizes[-1][3]
        lines.append(
            f'memory                   peak {peak_mb:.0f} MB; {first_mb:.0f} MB after a minute, '
            f'{last_mb:.0f} MB at the end'
        )
    return '\n'.join(lines)


def map_parts_ms(bench: Bench) -> dict[str, NDArray[np.float64]]:
    """Return the times of writing and publishing every map message."""
    written = np.array([written_s for _, written_s, _ in bench.maps])
    published = np.array(bench.laps.s['publishing'])[: len(written)]
    return {'writing the text': 1e3 * written, 'publishing (in a thread)': 1e3 * published}


def map_lines(bench: Bench) -> list[str]:
    """Return the report's lines on the map message."""
    experiences = np.array([count for count, _, _ in bench.maps])
    last = experiences > 0.9 * experiences[-1]
    lines = [f'map message: {len(bench.maps)} sent; with {experiences[-1]} experiences']
    for name, times_ms in map_parts_ms(bench).items():
        own = last[: len(times_ms)]
        lines.append(
            f'  {name:24} {np.median(times_ms[own]):7.2f} ms, worst {times_ms[own].max():.1f} ms'
        )
    spans_s = np.array([span_s for _, _, span_s in bench.maps])[last]
    lines.append(
        f'  first to last step       {np.median(spans_s):7.2f} s, worst {spans_s.max():.1f} s'
    )
    for name, step in (
        ('delay of a message by sending', 'sending'),
        ('the same, processor time', 'sending, processor'),
        ('processing a message beside the thread', 'beside the thread'),
        ('processing a message otherwise', 'without the thread'),
    ):
        times_ms = 1e3 * np.array(bench.laps.s[step] or [0.0])
        lines.append(
            f'  {name:40} p99.9 {np.percentile(times_ms, 99.9):6.2f} ms, worst '
            f'{times_ms.max():6.2f} ms, above 5 ms: {np.count_nonzero(times_ms > 5.0)} of '
            f'{len(times_ms)}'
        )
    return lines


def plot(bench: Bench, path: Path) -> None:
    figure, (times, maps, sizes) = plt.subplots(3, 1, figsize=(9, 13), layout='constrained')
    window = MINUTE if len(bench.times_s['all']) >= 5 * MINUTE else MINUTE // 6
    for name, times_ms in parts_ms(bench).items():
        windows = [times_ms[i : i + window] for i in range(0, len(times_ms), window)]
        if name == 'map message':
            windows = [part[part > SENDING_MS] for part in windows]
        windows = [part if len(part) else np.array([math.nan]) for part in windows]
        minute = (np.arange(len(windows)) + 0.5) * window / MINUTE
        (line,) = times.plot(minute, [np.median(part) for part in windows], label=name)
        p99 = [np.percentile(part, 99) for part in windows]
        times.plot(minute, p99, color=line.get_color(), linestyle=':')
    times.axhline(BUDGET_MS, color='grey', linestyle='--', label=f'{BUDGET_MS:.0f} ms')
    span = '1 min' if window == MINUTE else '10 s'
    times.set(xlabel='simulated time, min', yscale='log',
              ylabel=f'ms per image, per {span}: median, p99 dotted')
    times.legend(ncols=4, loc='lower left', bbox_to_anchor=(0.0, 1.0))  # above the curves
    experiences = [count for count, _, _ in bench.maps]
    for name, times_ms in map_parts_ms(bench).items():
        maps.plot(experiences[: len(times_ms)], times_ms, '.', markersize=2, label=name)
    maps.axhline(BUDGET_MS, color='grey', linestyle='--')
    most = max(np.percentile(values, 99.5) for values in map_parts_ms(bench).values())
    maps.set(xlabel='experiences', ylabel='ms per map message', ylim=(0.0, 1.3 * most))
    maps.legend()
    minute = np.arange(len(bench.sizes)) + 1
    for i, name in enumerate(('templates', 'experiences', 'links')):
        sizes.plot(minute, [size[i] for size in bench.sizes], label=name)
    sizes.set(xlabel='simulated time, min', ylabel='number')
    sizes.legend(loc='upper left')
    memory = sizes.twinx()
    resident = [size[3] for size in bench.sizes]
    memory.plot(minute, resident, color='grey', label='memory')
    memory.set(ylabel='resident memory, MB', ylim=(0.0, 1.2 * max(resident, default=1.0)))
    memory.legend(loc='lower right')
    figure.savefig(path, dpi=100)


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument('--hours', type=float, default=2.0)
    parser.add_argument('--seed', type=int, default=1)
    parser.add_argument('--viewer', action='store_true', help='subscribe to the map')
    parser.add_argument('--out', type=Path, default=ROOT / 'results' / 'benchmarks')
    options = parser.parse_args()
    options.out.mkdir(parents=True, exist_ok=True)
    use_own_domain()
    from ratslam_ros.core.warm_up import warm_up
    from ratslam_ros.files.config import load_config, to_yaml
    from ratslam_ros.live import ros

    ros.require()
    import rclpy

    warm_up()
    with tempfile.TemporaryDirectory() as folder:
        parameters = Path(folder) / 'warehouse.yaml'
        parameters.write_text(to_yaml(load_config('extended')[0].with_values(SETTINGS)))
        rclpy.init(args=['--ros-args', '--params-file', str(parameters)])
        try:
            bench = Bench(options.seed, options.viewer)
            try:
                gc.collect()
                gc.freeze()  # as the nodes do after start-up
                gc.callbacks.append(bench.laps.collection)
                bench.run(round(options.hours * 60 * MINUTE), options.seed)
                print(report(bench))
            finally:
                bench.close()
        finally:
            rclpy.try_shutdown()
    path = options.out / 'two_hours.png'
    plot(bench, path)
    print(f'plot: {path}')
    return 0


if __name__ == '__main__':
    sys.exit(main())
