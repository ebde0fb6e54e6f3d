# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Time in which a robot sees 90 % of a floor, along walls and by the exits of known places.

    python benchmarks/floor_coverage.py [--seeds 10] [--first 1] [--set SECTION.NAME=VALUE]

Reachable cells are those of the floor plan at whose centre the robot's body fits, connected to its
start. A cell is seen once a beam of the laser, which covers 180 degrees ahead, has passed its
centre while the robot was within 2 m of it; `8 m` is the whole range of the laser. An exploration
ends at 90 % within 2 m, or after an hour, which then counts as the time. With exits,
`goal_follower.explore_by` is `exits`. Preset `navigation`; one run per core.
"""

from __future__ import annotations

import argparse
import math
import time
from functools import partial
from pathlib import Path
from typing import NamedTuple

import numpy as np
from navigation import PLANS, Setting, map_error_m, mean, pooled
from scipy.ndimage import label

from ratslam_simulator.bodies import room_for
from ratslam_simulator.samples import Sample, ScanSample
from ratslam_simulator.simulation import Simulator

SHARE, LIMIT_S = 0.9, 3600.0
"""Share of the reachable cells that must be seen, and longest exploration."""

REACHES_M = 2.0, 8.0
"""Distances within which a cell is seen; the first one ends the exploration."""


class Coverage:
    """Reachable cells of a floor, and from how near each has been seen."""

    def __init__(self, simulator: Simulator) -> None:
        """Watch a robot at its start."""
        cell_m, at = simulator.plan.cell_m, simulator.truth
        room = room_for(simulator.world.solid, cell_m, simulator.options.robot.body_radius_m)
        parts, _ = label(room, np.ones((3, 3)))
        rows, columns = np.nonzero(parts == parts[int(at.y_m / cell_m), int(at.x_m / cell_m)])
        self._x_m, self._y_m = (columns + 0.5) * cell_m, (rows + 0.5) * cell_m
        self._seen_m = np.full(len(rows), math.inf)
        self._laser = simulator.options.lasers[0]
        simulator.watchers.append(self._watch)

    def shares(self) -> list[float]:
        """Return the share of the cells that was seen within each of REACHES_M."""
        return [float((self._seen_m <= reach_m).mean()) for reach_m in REACHES_M]

    def _watch(self, sample: Sample) -> None:
        if not isinstance(sample, ScanSample):
            return
        x_m, y_m = self._x_m - sample.truth.x_m, self._y_m - sample.truth.y_m
        away_m = np.hypot(x_m, y_m)
        bearing_rad = np.remainder(np.arctan2(y_m, x_m) - sample.truth.heading_rad, math.tau)
        bearing_rad = np.where(bearing_rad > math.pi, bearing_rad - math.tau, bearing_rad)
        beam = np.rint((bearing_rad - self._laser.first_rad) / self._laser.step_rad).astype(int)
        is_ahead = (beam >= 0) & (beam < self._laser.beams)
        free_m = sample.ranges_m[np.clip(beam, 0, self._laser.beams - 1)]
        is_seen = is_ahead & (away_m <= np.minimum(free_m, self._laser.range_max_m))
        np.minimum(self._seen_m, away_m, where=is_seen, out=self._seen_m)


class CoverageRow(NamedTuple):
    """Times to see SHARE of the cells within each of REACHES_M, the share, and RMSE of the map."""

    times_s: tuple[float, ...]
    share: float
    map_m: float


def coverage_run(setting: Setting, job: tuple[str, str, int]) -> CoverageRow:
    """Explore a floor until it is seen."""
    plan, explore_by, seed = job
    loop = setting.loop(seed, plan, goal_follower__explore_by=explore_by)
    coverage = Coverage(loop.simulator)
    end_s = setting.explore_s(LIMIT_S / 60.0)
    times_s = [end_s] * len(REACHES_M)

    def is_over() -> bool:
        for number, share in enumerate(coverage.shares()):
            if share >= SHARE:
                times_s[number] = min(times_s[number], loop.now_s)
        return loop.now_s >= min(end_s, times_s[0])

    loop.run(loop.exploring, is_over)
    return CoverageRow(tuple(times_s), coverage.shares()[0], map_error_m(loop))


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=(__doc__ or '').partition('\n')[0])
    parser.add_argument('--seeds', type=int, default=10, help='number of seeds (default: 10)')
    parser.add_argument('--first', type=int, default=1, help='first seed (default: 1)')
    parser.add_argument('--set', action='append', default=[], metavar='SECTION.NAME=VALUE')
    options = parser.parse_args()
    setting = Setting('', 1.0, 0, Path(), 0.0, tuple(options.set))
    seeds = range(options.first, options.first + options.seeds)
    began = time.perf_counter()
    jobs = [(p, by, seed) for p in PLANS for by in ('walls', 'exits') for seed in seeds]
    found = dict(zip(jobs, pooled(partial(coverage_run, setting), jobs), strict=True))
    print('           floor  explore_by  90 % within 2 m [s]  worst  within 8 m [s]  '
          'seen in the end  map [m]')
    for plan in PLANS:
        for by in ('walls', 'exits'):
            rows = [found[plan, by, seed] for seed in seeds]
            near_s, far_s = zip(*(row.times_s for row in rows), strict=True)
            print(f'{Path(plan).stem:>16}  {by:>10}  {mean(near_s):19.0f}  {max(near_s):5.0f}  '
                  f'{mean(far_s):14.0f}  {mean([row.share for row in rows]):15.2f}  '
                  f'{mean([row.map_m for row in rows]):7.2f}')
    print(f'{time.perf_counter() - began:.0f} s')


if __name__ == '__main__':
    main()
