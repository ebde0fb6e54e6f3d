# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Latency from image to map, and CPU share of the live nodes, in one process and in several.

    python benchmarks/live_latency.py [--seconds 30] [--width 640] [--visual-odometry] [--map]

This script publishes images of 640x480 (rgb8; in any case 4:3) at 30 Hz and odometry at 50 Hz,
stamped when they are sent: first to all nodes in one process, as `ratslam launch` starts them,
then to a process for each node. It uses whichever runtime ``import rclpy`` finds: rclpy in a shell
with ROS 2, its stand-in otherwise. Linux only. With --map, the nodes save a map file; the step
times are those of taking the state, which is all that delays a message.
"""

from __future__ import annotations

import argparse
import json
import math
import signal
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

import numpy as np
from processes import ROOT, cpu_s, started, use_own_domain, wait_for_text

IMAGE_HZ, ODOMETRY_HZ = 30.0, 50.0
COLUMNS, ROWS = 32, 24
"""Size of an image in squares of one colour."""
VIEWS = 90
"""Number of different images; the camera rotates once in this many."""

WARM_UP_S = 3.0
"""Time before the measurement begins."""


def main() -> int:
    parser = argparse.ArgumentParser(description='Latency and CPU share of the live nodes.')
    parser.add_argument('--seconds', type=float, default=30.0)
    parser.add_argument('--width', type=int, default=640, choices=range(32, 1953, 32),
                        metavar='PX', help='width of the images, a multiple of 32 (default: 640)')
    parser.add_argument('--visual-odometry', action='store_true',
                        help='odometry from the camera: four nodes instead of three')
    parser.add_argument('--map', action='store_true', help='save a map file while mapping')
    options = parser.parse_args()
    use_own_domain()
    sys.path.insert(0, str(ROOT))
    from ratslam_ros.live import ros

    ros.require()
    names = ['local_view', 'pose_cells', 'experience_map']
    if options.visual_odometry:
        names.insert(0, 'visual_odometry')
    one_process = ['single_process', '--stages', ','.join(names)]
    settings = {'one process': [one_process], 'a process per node': [[name] for name in names]}
    for title, commands in settings.items():
        print(f'\n{title}\n')
        measure(commands, options)
    return 0


def measure(commands: list[list[str]], options: argparse.Namespace) -> None:
    """Run the processes of one setting, and print the report.

    Args:
        commands: words after `ratslam run`, for each process.
        options: the options of this script.
    """
    from ratslam_ros.live import ros

    with tempfile.TemporaryDirectory() as folder, ros.node('benchmark', ()) as node:
        nodes = start(commands, Path(folder), options.map)
        try:
            bench = Bench(node, options.visual_odometry, len(commands) > 1, options.width)
            bench.run(WARM_UP_S)
            before = {name: cpu_s(process.pid) for name, process in nodes.items()}
            start_s = time.monotonic()
            bench.clear()
            bench.run(options.seconds)
            took_s = time.monotonic() - start_s
            after = {name: cpu_s(process.pid) for name, process in nodes.items()}
        finally:
            for process in nodes.values():
                process.send_signal(signal.SIGINT)
            codes = {name: process.wait(20.0) for name, process in nodes.items()}
    shares = {name: (after[name] - before[name]) / took_s for name in nodes}
    print(report(bench, shares, codes))


def start(
    commands: list[list[str]], folder: Path, has_map: bool
) -> dict[str, subprocess.Popen[bytes]]:
    """Start the processes, and wait until they are ready; return them by name."""
    nodes = {}
    for name, *words in commands:
        has_graph = name in ('experience_map', 'single_process')
        words += ['--ros-args', *(['-p', 'map_period_s:=0.0'] if has_graph else [])]
        if has_map:
            words += ['-p', f'map:={folder / "bench.ratslam"}']
        nodes[name] = started(folder / name, 'run', name, *words)
    for name, process in nodes.items():
        wait_for_text(folder / name, process, 'ready')
    return nodes


class Bench:
    """Publishes inputs on schedule and records the arrival times of the results."""

    def __init__(self, node: Any, visual_odometry: bool, is_split: bool, width: int) -> None:
        from diagnostic_msgs.msg import DiagnosticArray
        from geometry_msgs.msg import PoseStamped
        from nav_msgs.msg import Odometry
        from sensor_msgs.msg import Image
        from std_msgs.msg import String

        from ratslam_ros.ros.qos import INPUT, LATCHED, RESULT, STATE

        self._node, self._square = node, width // COLUMNS
        self._images = node.create_publisher(Image, 'image', RESULT)
        self._odometry = None
        if not visual_odometry:
            self._odometry = node.create_publisher(Odometry, 'odom', RESULT)
        node.create_subscription(String, 'pose_cells/action', self._on_action, INPUT)
        node.create_subscription(String, 'experience_map/map', self._on_map, LATCHED)
        node.create_subscription(PoseStamped, 'experience_map/pose', self._on_pose, INPUT)
        node.create_subscription(DiagnosticArray, '/diagnostics', self._on_diagnostics, STATE)
        self.saving_ms: dict[str, tuple[str, str]] = {}
        """Median and 99th percentile of the time in which each node takes its state, in ms."""
        self._messages = [self._image(view) for view in range(VIEWS)]
        self._sent_s: dict[int, float] = {}
        self._acted: dict[int, float] = {}
        self._applied: dict[int, float] = {}
        self._poses: list[tuple[int, float]] = []
        # One process subscribes to each topic once.
        readers = (1 + visual_odometry, 2) if is_split else (1, 1)
        while self._images.get_subscription_count() < readers[0] or (
            self._odometry is not None and self._odometry.get_subscription_count() < readers[1]
        ):
            self._spin(0.05)
        self._spin(1.0)

    def clear(self) -> None:
        """Discard all measurements."""
        for times_s in (self._sent_s, self._acted, self._applied):
            times_s.clear()
        self._poses.clear()

    def run(self, duration_s: float) -> None:
        """Publish images and odometry for a duration."""
        start_s = time.monotonic()
        image = odometry = 0
        while (now_s := time.monotonic() - start_s) < duration_s:
            if now_s >= image / IMAGE_HZ:
                self._send_image(image)
                image += 1
            elif self._odometry is not None and now_s >= odometry / ODOMETRY_HZ:
                self._send_odometry(odometry)
                odometry += 1
            else:
                ahead_s = min(image / IMAGE_HZ, odometry / ODOMETRY_HZ) - now_s
                self._spin(max(min(ahead_s, 0.001), 0.0))
        self._spin(0.2)

    def latencies_ms(self) -> dict[str, list[float]]:
        """Return the times from each image to its action, to the map and to the next pose."""
        found: dict[str, list[float]] = {'action': [], 'map': [], 'pose at odometry': []}
        for stamp_ns, sent_s in self._sent_s.items():
            if stamp_ns in self._acted:
                found['action'].append(1e3 * (self._acted[stamp_ns] - sent_s))
            applied_s = self._applied.get(stamp_ns)
            if applied_s is None:
                continue
            found['map'].append(1e3 * (applied_s - sent_s))
            after = [s for _, s in self._poses if s >= applied_s]
            if after:
                found['pose at odometry'].append(1e3 * (min(after) - sent_s))
        return found

    @property
    def images(self) -> int:
        """Number of images sent."""
        return len(self._sent_s)

    def _send_image(self, number: int) -> None:
        from ratslam_ros.ros.convert import time_of

        message = self._messages[number % VIEWS]
        stamp_ns = time.time_ns()
        message.header.stamp = time_of(stamp_ns)
        self._sent_s[stamp_ns] = time.monotonic()
        self._images.publish(message)

    def _send_odometry(self, number: int) -> None:
        from nav_msgs.msg import Odometry

        from ratslam_ros.ros.convert import header_of

        message = Odometry(header=header_of(time.time_ns(), 'odom'), child_frame_id='base_link')
        message.twist.twist.linear.x = 1.0
        message.twist.twist.angular.z = 2.0 * math.pi * IMAGE_HZ / VIEWS  # as the images rotate
        message.pose.pose.orientation.w = 1.0
        self._odometry.publish(message)  # type: ignore[union-attr]

    def _image(self, view: int) -> Any:
        """Return an image of a camera that rotates in a room textured with noise."""
        import array

        from sensor_msgs.msg import Image

        coarse = np.random.default_rng(1).integers(0, 256, (ROWS, VIEWS, 3), dtype=np.uint8)
        squares = np.roll(coarse, view, axis=1)[:, :COLUMNS]
        turned = squares.repeat(self._square, 0).repeat(self._square, 1)
        data = array.array('B', np.ascontiguousarray(turned).tobytes())
        height, width, _ = turned.shape
        return Image(height=height, width=width, encoding='rgb8', step=3 * width, data=data)

    @property
    def size(self) -> str:
        """Width and height of the images."""
        return f'{COLUMNS * self._square}x{ROWS * self._square}'

    def _on_action(self, message: Any) -> None:
        self._acted[stamp_of(message.data)] = time.monotonic()

    def _on_map(self, message: Any) -> None:
        # Only the stamp is decoded, because decoding a large map takes long.
        at = message.data.index('"stamp"')
        end = message.data.index('}', at) + 1
        self._applied[stamp_of('{' + message.data[at:end] + '}')] = time.monotonic()

    def _on_diagnostics(self, message: Any) -> None:
        for status in message.status:
            values = {item.key: item.value for item in status.values}
            if 'map_file_p99_ms' in values:
                name = status.name.rpartition(' ')[2]
                self.saving_ms[name] = values['map_file_median_ms'], values['map_file_p99_ms']

    def _on_pose(self, message: Any) -> None:
        stamp = message.header.stamp
        self._poses.append((stamp.sec * 10**9 + stamp.nanosec, time.monotonic()))

    def _spin(self, duration_s: float) -> None:
        import rclpy

        rclpy.spin_once(self._node, timeout_sec=duration_s)


def stamp_of(payload: str) -> int:
    """Return the stamp of a JSON payload, in ns."""
    stamp = json.loads(payload)['stamp']
    return int(stamp['sec']) * 10**9 + int(stamp['nanosec'])


def report(bench: Bench, shares: dict[str, float], codes: dict[str, int]) -> str:
    """Return latencies, CPU shares and exit codes as Markdown tables."""
    import rclpy

    real = getattr(rclpy, '__file__', None) is not None
    lines = [
        f'runtime: {"rclpy" if real else "stand-in"}, {bench.images} images of {bench.size} '
        f'at {IMAGE_HZ:g} Hz, odometry at {ODOMETRY_HZ:g} Hz',
        '',
        '| from sending the image to | images | median ms | p99 ms | p99.9 ms | worst ms |',
        '| --- | --- | --- | --- | --- | --- |',
    ]
    for name, values in bench.latencies_ms().items():
        if values:
            lines.append(
                f'| {name} | {len(values)} | {np.median(values):.1f} | '
                f'{np.percentile(values, 99):.1f} | {np.percentile(values, 99.9):.1f} | '
                f'{max(values):.1f} |'
            )
    lines += ['', '| node | share of a core | exit code |', '| --- | --- | --- |']
    for name, share in shares.items():
        lines.append(f'| {name} | {100 * share:.1f} % | {codes[name]} |')
    lines.append(f'| together | {100 * sum(shares.values()):.1f} % | |')
    if bench.saving_ms:
        lines += ['', '| taking the state | median ms | p99 ms |', '| --- | --- | --- |']
        lines += [f'| {name} | {one} | {other} |' for name, (one, other) in
                  sorted(bench.saving_ms.items())]
    return '\n'.join(lines)


if __name__ == '__main__':
    sys.exit(main())
