# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""CPU share and memory of the node `viewer` beside a robot with a large map.

    python benchmarks/viewer_cpu_share.py [--experiences 20000] [--seconds 30]

This script publishes what the nodes of a driving robot publish, on the topics and at the rates of
a robot: odometry and poses at 30 Hz, images, views, actions, changes of the map, pose cells and
scans at 10 Hz. The viewer runs as a separate process. Its page is open in one browser, for which a
WebSocket client stands here, so that the drawing of the browser takes no time. It measures steady
driving, the 5 s after a loop closure that moves every experience, and a page that is closed. It
uses rclpy or its stand-in, whichever `import rclpy` finds. Linux only.
"""

from __future__ import annotations

import argparse
import array
import json
import math
import os
import signal
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any
from urllib.parse import urlsplit

import numpy as np
from processes import ROOT, cpu_s, resident_mb, started, use_own_domain, wait_for_text

RATE_HZ, ODOMETRY_PER_TICK = 10, 3
START_NS = 1_700_000_000_000_000_000
STEADY_ROWS, STEADY_LINKS = 20, 2
"""Experiences and links in a change while the robot drives in known surroundings."""
CHUNK = 1000
"""Experiences in a change after a loop closure, as many as the node of the map sends at once."""
CLOSURE_S = 5.0
CELLS = 500


def main() -> int:
    parser = argparse.ArgumentParser(description='CPU share of the node viewer.')
    parser.add_argument('--experiences', type=int, default=20_000)
    parser.add_argument('--seconds', type=float, default=30.0)
    options = parser.parse_args()
    use_own_domain()
    sys.path.insert(0, str(ROOT))
    from ratslam_ros.live import ros

    ros.require()
    with tempfile.TemporaryDirectory() as folder, ros.node('robot', ()) as node:
        process, url = start(Path(folder) / 'viewer.log')
        try:
            robot = Robot(node, options.experiences)
            browser = Browser(url)
            robot.run(5.0)
            robot.send_map()
            robot.run(10.0)  # the page gets the whole map
            results = {'steady driving': share(process, robot, options.seconds)}
            shares = []
            for _ in range(3):
                robot.close_loop()
                shares.append(share(process, robot, CLOSURE_S))
                robot.run(5.0)
            results['5 s after a loop closure'] = max(shares)
            print(f'{browser.received} messages, {browser.bytes / 1e6:.1f} MB sent to the page')
            browser.close()
            robot.run(2.0)
            results['page closed, within the grace time'] = share(process, robot, 10.0)
            print(f'{options.experiences} experiences, {os.cpu_count()} cores, '
                  f'{resident_mb(process.pid):.0f} MB resident')
            for name, value in results.items():
                print(f'{name}: {100 * value:.1f} % of a core')
        finally:
            process.send_signal(signal.SIGINT)
            code = process.wait(20.0)
    print(f'exit code {code}')
    return 0


def start(log: Path) -> tuple[subprocess.Popen[bytes], str]:
    """Start the viewer; return it and the address of its page."""
    process = started(
        log, 'run', 'viewer', '--ros-args', '-p', 'port:=0', '-p', 'open_browser:=false'
    )
    wait_for_text(log, process, 'ready')
    return process, wait_for_text(log, process, r'http\S+')


def share(process: subprocess.Popen[bytes], robot: Robot, seconds: float) -> float:
    before, start_s = cpu_s(process.pid), time.monotonic()
    robot.run(seconds)
    return (cpu_s(process.pid) - before) / (time.monotonic() - start_s)


class Browser:
    """A WebSocket client that reads everything, as a page does."""

    def __init__(self, url: str) -> None:
        import msgspec
        import viser
        from websockets.sync.client import connect

        parts = urlsplit(url)
        self._socket = connect(
            f'ws://{parts.netloc}{parts.path}', origin=f'http://{parts.netloc}',  # type: ignore[arg-type]
            subprotocols=[f'viser-v{viser.__version__}'],  # type: ignore[list-item]
            compression=None, max_size=None,
        )
        camera = {
            'type': 'ViewerCameraMessage', 'wxyz': (1.0, 0.0, 0.0, 0.0),
            'position': (0.0, 0.0, 50.0), 'fov': 1.0, 'near': 0.1, 'far': 1000.0,
            'image_height': 720, 'image_width': 1280, 'look_at': (0.0, 0.0, 0.0),
            'up_direction': (0.0, 1.0, 0.0),
        }
        self._socket.send(msgspec.msgpack.encode(camera))
        self.received = self.bytes = 0
        threading.Thread(target=self._read, daemon=True).start()

    def _read(self) -> None:
        for data in self._socket:
            self.received += 1
            self.bytes += len(data)

    def close(self) -> None:
        """Leave the page."""
        self._socket.close()


class Robot:
    """Publishes what the nodes of a robot publish."""

    def __init__(self, node: Any, count: int) -> None:
        from diagnostic_msgs.msg import DiagnosticArray
        from geometry_msgs.msg import PoseStamped
        from nav_msgs.msg import Odometry
        from sensor_msgs.msg import Image, LaserScan, PointCloud2
        from std_msgs.msg import String

        from ratslam_ros.core.mapping.map_changes import LinkRows
        from ratslam_ros.ros.qos import LATCHED, RESULT, STATE, VIEW

        self._links = LinkRows
        self.count, self._tick, self._sequence = count, 0, 0
        self._next_s = time.monotonic()
        rng = np.random.default_rng(1)
        ids = np.arange(count)
        row, column = np.divmod(ids, 200)
        snake = np.where(row % 2 == 0, column, 199 - column)
        self._poses = np.stack([snake * 0.5, row * 0.5, 0.0 * ids], axis=1)
        self._rng = rng
        kinds = {
            'odom': (Odometry, RESULT), 'experience_map/pose': (PoseStamped, STATE),
            'image': (Image, RESULT), 'local_view/template': (String, RESULT),
            'local_view/matched': (Image, VIEW), 'pose_cells/action': (String, RESULT),
            'pose_cells/cells': (PointCloud2, VIEW), 'pose_cells/packets': (String, VIEW),
            'scan': (LaserScan, RESULT), 'experience_map/changes': (String, STATE),
            'experience_map/status': (String, LATCHED), '/diagnostics': (DiagnosticArray, STATE),
        }
        self._out = {
            topic: node.create_publisher(kind, topic, qos) for topic, (kind, qos) in kinds.items()
        }
        self._image = rng.integers(0, 255, (240, 320), np.uint8)
        self._chunks: Iterator[Any] = iter(())

    @property
    def stamp_ns(self) -> int:
        """Stamp of the current tick."""
        return START_NS + self._tick * (1_000_000_000 // RATE_HZ)

    def run(self, seconds: float) -> None:
        """Drive in real time."""
        for _ in range(round(seconds * RATE_HZ)):
            self._next_s = max(self._next_s + 1.0 / RATE_HZ, time.monotonic() - 0.2)
            time.sleep(max(self._next_s - time.monotonic(), 0.0))
            self._publish()

    def send_map(self) -> None:
        """Send the whole map, in the next changes."""
        self._sequence = 0
        self._chunks = self._all(True)

    def close_loop(self) -> None:
        """Move all experiences, in the next changes."""
        self._poses[:, :2] += self._rng.normal(0.0, 0.05, (self.count, 2))
        self._chunks = self._all(False)

    def _all(self, is_first: bool) -> Iterator[Any]:
        for begin in range(0, self.count, CHUNK):
            ids = np.arange(begin, min(begin + CHUNK, self.count))
            yield self._change(ids, ids if is_first else ids[:0], is_first and begin == 0)

    def _change(self, ids: Any, links: Any, restart: bool = False) -> Any:
        from ratslam_ros.core.mapping.map_changes import ExperienceRows, LinkRows, MapChange

        links = links[links > 0]
        n = len(links)
        return MapChange(
            self.stamp_ns, self.count, self._tick % self.count, restart,
            ExperienceRows(ids, ids, self._poses[ids], np.zeros(len(ids), np.int64)),
            LinkRows(
                np.stack([links - 1, links], axis=1), np.full((n, 3), 0.5), np.full(n, 1.0),
                np.full(n, 0.5), np.full(n, 1 + self._tick), np.zeros(n, np.bool_), ('',) * n,
            ),
        )

    def _steady(self) -> Any:
        ids = (self._tick + np.arange(STEADY_ROWS)) % self.count
        self._poses[ids, :2] += 0.001
        return self._change(ids, ids[:STEADY_LINKS])

    def _publish(self) -> None:
        from std_msgs.msg import String

        from ratslam_ros.core.pose_cells.active_cells import ActiveCells
        from ratslam_ros.core.pose_cells.map_action import MapAction
        from ratslam_ros.core.pose_cells.torus import Place
        from ratslam_ros.core.vision.local_view import ViewMatch
        from ratslam_ros.messages.json_schema import encode
        from ratslam_ros.messages.map_changes import MapChangePayload
        from ratslam_ros.messages.mapping import ActionPayload, TemplatePayload
        from ratslam_ros.messages.pose_cells import PacketsPayload
        from ratslam_ros.ros.convert import image_message, point_cloud
        from ratslam_ros.ros.mapping.match_pictures import joined

        out, at = self._out, self._tick % self.count
        self._motion()
        stamp_ns = self.stamp_ns
        out['image'].publish(image_message(stamp_ns, 'camera', np.roll(self._image, at, 1)))
        match = ViewMatch(at, False, 0.01 + 0.005 * math.sin(at), 0.0, 0.05)
        out['local_view/template'].publish(
            String(data=encode(TemplatePayload.of(stamp_ns, match, START_NS)))
        )
        small = self._image[:16, :60]
        out['local_view/matched'].publish(image_message(stamp_ns, 'camera', joined(small, small)))
        action = MapAction(
            'set', max(at - 1, 0), at, at, 0.0, Place(10.0, 10.0, 18.0), None, at, 1.0, 1.0
        )
        out['pose_cells/action'].publish(
            String(data=encode(ActionPayload.of(stamp_ns, self._tick, action, START_NS)))
        )
        cells = self._rng.integers(0, 30, (CELLS, 3))
        activity = self._rng.random(CELLS)
        points = np.column_stack([cells, activity])
        out['pose_cells/cells'].publish(point_cloud(stamp_ns, 'pose_cells', points, 'activity'))
        active = ActiveCells(cells, activity, np.array([[9.0, 9.0, 9.0, 0.9]]), np.empty((0, 4)))
        out['pose_cells/packets'].publish(
            String(data=encode(PacketsPayload.of(stamp_ns, (30, 30, 36), active)))
        )
        change = next(self._chunks, None) or self._steady()
        out['experience_map/changes'].publish(
            String(data=encode(MapChangePayload.of(change, self._sequence, 1, 'map')))
        )
        self._sequence += 1
        if self._tick % RATE_HZ == 0:
            self._report(stamp_ns)
        self._tick += 1

    def _motion(self) -> None:
        from geometry_msgs.msg import PoseStamped
        from nav_msgs.msg import Odometry
        from sensor_msgs.msg import LaserScan

        from ratslam_ros.core.common.pose import Pose
        from ratslam_ros.ros.convert import header_of, pose_message

        x_m, y_m, _ = self._poses[self._tick % self.count]
        for k in range(ODOMETRY_PER_TICK):
            stamp_ns = self.stamp_ns + k * 33_000_000
            pose = pose_message(Pose(x_m + 0.05 * k, y_m, 0.1))
            odometry = Odometry(header=header_of(stamp_ns, 'odom'), child_frame_id='base_link')
            odometry.pose.pose = pose
            self._out['odom'].publish(odometry)
            self._out['experience_map/pose'].publish(
                PoseStamped(header=header_of(stamp_ns, 'map'), pose=pose)
            )
        self._out['scan'].publish(LaserScan(
            header=header_of(self.stamp_ns, 'laser'), angle_min=-math.pi,
            angle_increment=math.tau / 360, range_max=10.0, ranges=array.array('f', [2.0] * 360),
        ))

    def _report(self, stamp_ns: int) -> None:
        from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
        from std_msgs.msg import String

        sec, nanosec = divmod(stamp_ns, 10**9)
        self._out['experience_map/status'].publish(String(data=json.dumps({
            'schema_version': 1, 'stamp': {'sec': sec, 'nanosec': nanosec}, 'status': 'idle',
            'explore': False, 'behaviour': '', 'reason': '', 'experience_id': 0, 'neighbours': [],
            'goal': None, 'remaining_s': None, 'replanned': 0, 'switched': 0, 'queue': [],
            'outcomes': [],
        })))
        for name in ('local_view', 'pose_cells', 'experience_map', 'goal_follower'):
            values = [KeyValue(key=f'key {k}', value=str(k)) for k in range(20)]
            self._out['/diagnostics'].publish(DiagnosticArray(status=[DiagnosticStatus(
                level=DiagnosticStatus.OK, name=f'ratslam: {name}', message='all messages used',
                values=values,
            )]))


if __name__ == '__main__':
    sys.exit(main())
