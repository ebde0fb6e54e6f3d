# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Days of driving at the limits of the map: memory, file size, step time and routes, by the hour.

    PYTHONPATH=. python benchmarks/soak.py [--hours 48] [--seed 1] [--out results/benchmarks]

A robot drives at random through a warehouse with 3x3 junctions (`simulated_town.py` at a smaller
scale), and maps it with the defaults. Without limits, the map would grow by 7,000 experiences per
hour, and have 1,450 templates. `exp_max` and `vt_max` are lower, so that both are removed and
learned again all the time. Odometry has noise, and the light varies. The map is saved as by live
nodes, at cuts of stamps. After each hour, routes are planned to places that were named after the
first one. A route is drivable if it ends within 2 m of the place, and the experiences of each of
its links were seen at places at most 4 m from each other. The simulation runs as fast as possible.
Linux only.
"""

from __future__ import annotations

import argparse
import sys
import time
from array import array
from pathlib import Path

import cv2
import matplotlib
import numpy as np
from simulated_town import At, Camera, Town, drive, resident_mb

from ratslam_ros.core.common.odometry import Odometry, Twist
from ratslam_ros.core.common.pose import Pose
from ratslam_ros.core.navigation.route_planner import RoutePlanner
from ratslam_ros.core.warm_up import warm_up
from ratslam_ros.errors import UnreachableGoal
from ratslam_ros.files.config import load_config, to_yaml
from ratslam_ros.maps import Cut, MapMeta, MapStore, read_map
from ratslam_ros.pipeline.items import ViewStep
from ratslam_ros.pipeline.ratslam import RatSLAM

matplotlib.use('Agg')
import matplotlib.pyplot as plt

ROOT = Path(__file__).resolve().parents[1]
IMAGE_HZ, CUT_S = 4, 10
WAREHOUSE = Town(
    lot_m=1.2, block=8, eye_m=0.6, fov_deg=60.0, lane_m=0.0, corner_m=0.8, columns=3,
    speed_mps=1.0, turning_mps=0.5, brake_mps2=0.5, sway_m=0.05, light=0.1, known=1.0,
)
LIMITS = {'pose_cells.exp_max': 1500, 'local_view.vt_max': 1300}
NOISE = 0.02
GOALS = 20
ARRIVED_M, LINK_M = 2.0, 4.0
START_NS = 1_000_000_000


class Soak:
    """A robot that has been driving for a while, and its map file."""

    def __init__(self, seed: int, path: Path) -> None:
        self._rng = np.random.default_rng(seed)
        self._camera = Camera(WAREHOUSE, seed, 160, 120)
        self._drive = drive(WAREHOUSE, seed, 1.0 / IMAGE_HZ)
        config = load_config(None)[0].with_values(LIMITS)
        self.slam = RatSLAM(config)
        self._planner = RoutePlanner(config.goal_recall, self.slam.experience_map)
        self.path = path
        meta = MapMeta('soak', configuration=to_yaml(config))
        self.store = MapStore(path, list(self.slam.state()), meta, print)
        self._seen: dict[int, tuple[float, float]] = {}
        """True position at the last visit of each experience."""
        self.goals: list[tuple[float, float]] = []
        self._step = self._cut = 0
        self._image = np.empty((120, 160, 3), np.uint8)

    def hour(self) -> list[float]:
        """Drive for an hour; return hour, step times, memory, file size, counts and routes."""
        times_ms = array('d')
        state_ms = array('d')
        for _ in range(3600 * IMAGE_HZ):
            self._step += 1
            stamp_ns = START_NS + self._step * 1_000_000_000 // IMAGE_HZ
            at = next(self._drive)
            self._camera.take(at, stamp_ns / 1e9, self._image)
            grey = cv2.cvtColor(self._image, cv2.COLOR_BGR2GRAY)
            odometry = self._odometry(at, stamp_ns)
            start_s = time.thread_time()
            steps = [*self.slam.odometry(odometry), *self.slam.image(stamp_ns, grey)]
            times_ms.append((time.thread_time() - start_s) * 1e3)
            if any(isinstance(step, ViewStep) for step in steps):
                current = self.slam.experience_map.current_id
                if current is not None:
                    self._seen[current] = at.x_m, at.y_m
            if self._step % (CUT_S * IMAGE_HZ) == 0:
                self._cut += 1
                start_s = time.thread_time()
                states = self.slam.state()
                state_ms.append((time.thread_time() - start_s) * 1e3)
                self.store.cut(Cut(self._cut, stamp_ns), states)
                assert self.store.flush(60.0)  # The simulation is faster than a robot.
        if not self.goals:
            known = sorted(self._seen)
            chosen = self._rng.choice(len(known), GOALS, replace=False)
            self.goals = [self._seen[known[n]] for n in chosen]
        files = [self.path, self.path.with_name(f'{self.path.name}-wal')]
        size_mb = sum(file.stat().st_size for file in files if file.exists()) / 1e6
        core = self.slam.experience_map
        return [
            self._step / IMAGE_HZ / 3600, float(np.median(times_ms)),
            float(np.percentile(times_ms, 99.9)), float(np.percentile(state_ms, 99)),
            resident_mb(), size_mb, len(core), len(self.slam.local_view),
            core.link_count, self._drivable_routes(),
        ]

    def _odometry(self, at: At, stamp_ns: int) -> Odometry:
        noise = 1.0 + NOISE * self._rng.standard_normal(2)
        twist = Twist(at.speed_mps * float(noise[0]), at.turn_radps * float(noise[1]))
        return Odometry(stamp_ns, twist, Pose(0.0, 0.0, 0.0))

    def _drivable_routes(self) -> int:
        """Return to how many of the goals there is a route, all of whose links can be driven."""
        found = 0
        ids = sorted(self._seen)
        positions = np.array([self._seen[i] for i in ids])
        routes = self._planner.temporal_map()
        for goal in self.goals:
            gaps = np.hypot(*(positions - goal).T)
            try:
                route = routes.route_to(ids[int(np.argmin(gaps))])
            except UnreachableGoal:
                continue
            way = np.array([self._seen[i] for i in route.experience_ids])
            links_m = np.hypot(*np.diff(way, axis=0).T)
            found += bool(gaps.min() <= ARRIVED_M and (links_m <= LINK_M).all())
        return found


COLUMNS = (
    'hour', 'step ms', '99.9 %', 'state ms', 'memory MB', 'file MB', 'experiences', 'templates',
    'links', f'routes of {GOALS}',
)


def plot(rows: list[list[float]], path: Path) -> None:
    """Plot what has to be flat."""
    table = np.array(rows)
    figure, axes = plt.subplots(2, 2, figsize=(10, 6), sharex=True)
    for axis, columns, label in zip(
        axes.flat, ((1, 2), (4,), (5,), (9,)),
        ('time per image, ms: median and 99.9 %', 'memory, MB', 'map file, MB',
         f'drivable routes, of {GOALS}'), strict=True,
    ):
        for column in columns:
            axis.plot(table[:, 0], table[:, column])
        axis.set_title(label)
        axis.set_ylim(bottom=0)
        axis.grid(alpha=0.3)
    for axis in axes[1]:
        axis.set_xlabel('hours of driving')
    figure.tight_layout()
    figure.savefig(path, dpi=80)


def main() -> None:
    """Print a row for each hour, and plot them."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument('--hours', type=int, default=48)
    parser.add_argument('--seed', type=int, default=1)
    parser.add_argument('--out', type=Path, default=ROOT / 'results' / 'benchmarks')
    options = parser.parse_args()
    options.out.mkdir(parents=True, exist_ok=True)
    path = options.out / 'soak.map'
    if path.exists():
        sys.exit(f'{path} exists; remove it, or choose another folder with --out')
    warm_up()
    soak = Soak(options.seed, path)
    rows = []
    print('| ' + ' | '.join(COLUMNS) + ' |\n|' + ' --- |' * len(COLUMNS), flush=True)
    for _ in range(options.hours):
        rows.append(soak.hour())
        print('| ' + ' | '.join(f'{value:.4g}' for value in rows[-1]) + ' |', flush=True)
    states = soak.slam.state()
    soak.store.close()
    saved = read_map(path)
    print(f'{path}: {path.stat().st_size / 1e6:.1f} MB; parts {", ".join(saved.states)}')
    assert saved.states.keys() == states.keys()
    plot(rows, options.out / 'soak.png')
    print(f'plot: {options.out / "soak.png"}')


if __name__ == '__main__':
    main()
