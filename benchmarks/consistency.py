# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Consistency of the pose's covariance: how many errors lie within its 95 % bound.

    python benchmarks/consistency.py [--seeds 20] [--minutes 12] [--only ROW ...]

The error is that of the robot's pose relative to the place where it was recognised last with full
agreement, at first the first place of the map: estimated pose in the frame of this place on the
map, against the true pose in the frame of the robot when the place was learned. It is divided by
the covariance (normalised estimation error squared, NEES; Bar-Shalom, Li and Kirubarajan, 2001,
section 5.4), and compared with the 95 % quantile of the chi-square distribution: 90 to 98 % should
lie below. A recognition of a wrong place counts as an error like any other.

lecture_hall, tuc_corridor and demo are replayed with nothing configured. The truth of the first
two has no headings: positions alone are compared, and the heading at a place is the direction of
travel. floors: the simulated robot of the preset navigation explores; its truth is exact.
"""

from __future__ import annotations

import argparse
import math
import tempfile
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

import numpy as np
from defaults_on_recordings import ROUTES
from lap_measures import ROOT
from lecture_hall import convert
from navigation import PLANS
from numpy.typing import NDArray

from ratslam_ros.core.common.angles import wrap
from ratslam_ros.core.common.pose import Pose, composed, inverse
from ratslam_ros.core.config import Config
from ratslam_ros.core.mapping.experience_map import ExperienceMap
from ratslam_ros.core.mapping.pose_covariance import isotropic
from ratslam_ros.core.pose_cells.map_action import NO_EXPERIENCE
from ratslam_ros.core.warm_up import warm_up
from ratslam_ros.files.config import load_config
from ratslam_ros.offline.inspection import inspect
from ratslam_ros.offline.replay import ReplayOptions, replay
from ratslam_ros.pipeline.experience_map import ExperienceMapStage
from ratslam_ros.pipeline.items import MapStep, NumberedAction
from ratslam_ros.pipeline.stage import Output
from ratslam_ros.recordings import open_recording
from ratslam_ros.results.trajectory import Trajectory, read_tum
from ratslam_simulator.closed_loop import ClosedLoop
from ratslam_simulator.config import SimulatorParameters, make_simulator
from ratslam_simulator.recording import write_recording

CHI_SQUARE_95 = {2: 5.991, 3: 7.815}
"""95 % quantiles of the chi-square distribution, for position and for pose."""

TRUTH = 0.01, 0.005
"""Error of the truth of a recording and of its interpolation, in m and rad."""

EXACT = 0.001, 0.0005
"""Its error on floors, where every view has a true pose. The errors of the robot are not much
larger than ``TRUTH``. It is not 0, as the covariance of the first poses is."""

LEAST_M = 0.15
"""Half the distance travelled from which on it has a direction."""


class Sample(NamedTuple):
    """A view: the robot's pose relative to the place of its last recognition, and its covariance.

    ``learned_ns``, ``learned``: stamp at which the place was learned, and pose of the robot in the
    frame of the place then.
    """

    stamp_ns: int
    learned_ns: int
    learned: Pose
    relative: Pose
    covariance: NDArray[np.float64]


class Samples:
    """Collects a sample for each view, and the stamps at which places were learned."""

    def __init__(self) -> None:
        self.taken: list[Sample] = []
        self._learned: dict[int, tuple[int, Pose]] = {}
        self._place_id = NO_EXPERIENCE
        self._last_m2 = 0.0

    def add(self, stamp_ns: int, step: MapStep, graph: ExperienceMap) -> None:
        """Add the result of one action."""
        action, update = step.action, step.update
        if action.action == 'create' and graph.current_id == action.target_id:
            self._learned[action.target_id] = stamp_ns, action.relative_pose
            if action.target_id == self._place_id:
                self._place_id = NO_EXPERIENCE  # pruned
        elif action.action in ('link', 'set') and not update.reason:
            self._place_id = action.target_id
        covariance = graph.covariance.matrix.copy()
        last_m2, self._last_m2 = self._last_m2, float(np.trace(covariance[:2, :2]))
        for event in update.events:
            if event.outcome != 'rejected' and self._last_m2 < last_m2:  # it was used
                self._place_id = event.target_id
        if self._place_id == NO_EXPERIENCE:
            self._place_id = graph.current_id
        relative, is_known = graph.seen_from(self._place_id), graph.localisation != 'unknown'
        if self._place_id in self._learned and relative is not None and is_known:
            learned = self._learned[self._place_id]
            self.taken.append(Sample(stamp_ns, *learned, relative, covariance))


class Truth:
    """True poses over time, interpolated."""

    def __init__(self, stamp_ns: NDArray[np.int64], poses: NDArray[np.float64]) -> None:
        """Args: stamps, (n,), and poses, (n, 3); unknown headings are NaN."""
        self._stamp_ns, self._poses = stamp_ns, poses

    @classmethod
    def of(cls, truth: Trajectory) -> Truth:
        """Return the poses of a file; without headings, the directions of travel."""
        heading_rad = truth.heading_rad
        if not truth.has_heading:
            heading_rad = np.full(len(truth), math.nan)
            ahead = truth.position_m[6:] - truth.position_m[:-6]
            directions = np.arctan2(ahead[:, 1], ahead[:, 0])
            moves = np.hypot(ahead[:, 0], ahead[:, 1]) > 2.0 * LEAST_M
            heading_rad[3:-3] = np.where(moves, directions, math.nan)
        return cls(truth.stamp_ns, np.column_stack([truth.position_m, heading_rad]))

    def at(self, stamp_ns: int) -> Pose | None:
        """Return the pose at a stamp, None outside the table and in gaps of more than 1 s."""
        n = int(np.searchsorted(self._stamp_ns, stamp_ns))
        if not 0 < n < len(self._stamp_ns):
            return None
        from_ns, to_ns = self._stamp_ns[n - 1 : n + 1].tolist()
        if to_ns - from_ns > 10**9:
            return None
        before, after = self._poses[n - 1 : n + 1]
        share = (stamp_ns - from_ns) / (to_ns - from_ns)
        x_m, y_m, _ = (before + share * (after - before)).tolist()
        return Pose(x_m, y_m, wrap(before[2] + share * wrap(after[2] - before[2])))


class Result(NamedTuple):
    """Errors of the samples of one run.

    ``nees``: normalised errors squared. ``dimensions``: 3, or 2 for positions alone. ``error_m``,
    ``std_m``: errors of the position, and their expected root mean square.
    """

    nees: NDArray[np.float64]
    dimensions: int
    error_m: NDArray[np.float64]
    std_m: NDArray[np.float64]

    def line(self, name: str) -> str:
        """Format the row."""
        below = float(np.mean(self.nees <= CHI_SQUARE_95[self.dimensions]))
        verdict = 'pass' if 0.9 <= below <= 0.98 else 'FAIL'
        return (
            f'{name:18} {len(self.nees):6d}   {self.dimensions}   {100.0 * below:5.1f}   '
            f'{np.mean(self.nees):8.2f}   {np.median(self.error_m):5.2f}   '
            f'{np.quantile(self.error_m, 0.95):5.2f}   {np.median(self.std_m):5.2f}   {verdict}'
        )


def compared(
    samples: Samples, truth: Truth, has_heading: bool, std: tuple[float, float] = TRUTH
) -> Result:
    """Compare the samples with the truth, whose error has the standard deviations ``std``."""
    dimensions = 3 if has_heading else 2
    own = isotropic(*std)
    rows = []
    for sample in samples.taken:
        here, there = truth.at(sample.stamp_ns), truth.at(sample.learned_ns)
        if here is None or there is None or math.isnan(there.heading_rad):
            continue
        place = composed(there, inverse(sample.learned))
        error = composed(inverse(sample.relative), composed(inverse(place), here))
        used = np.array(error)[:dimensions]
        covariance = (sample.covariance + own)[:dimensions, :dimensions]
        rows.append((
            used @ np.linalg.solve(covariance, used), math.hypot(error.x_m, error.y_m),
            math.sqrt(covariance[0, 0] + covariance[1, 1]),
        ))
    nees, error_m, std_m = np.array(rows).T
    return Result(nees, dimensions, error_m, std_m)


def replayed(path: Path, truth_path: Path) -> Result:
    """Replay a recording as with nothing configured, and compare."""
    samples = Samples()

    class Observed(ExperienceMapStage):
        """The stage, which adds samples."""

        def _act(self, stamp_ns: int, item: NumberedAction) -> tuple[Output, ...]:
            outputs = super()._act(stamp_ns, item)
            samples.add(stamp_ns, outputs[0].item, self.core)
            return outputs

    with tempfile.TemporaryDirectory() as out, open_recording(path) as recording:
        selection = recording.select()
        config = inspect(recording, selection, Config(), ()).config
        options = ReplayOptions(progress=False, stages=(Observed,))
        replay(recording, selection, config, Path(out), options)
    truth = read_tum(truth_path)
    return compared(samples, Truth.of(truth), truth.has_heading)


def explored(plan: str, minutes: float) -> Result:
    """Let the simulated robot explore a floor, and compare."""
    samples, simulator = Samples(), make_simulator(SimulatorParameters(plan=plan, seed=1))
    loop = ClosedLoop(simulator, load_config('navigation')[0], 1)
    graph = loop.experience_map
    loop.ratslam.pipeline.observe(
        'update', lambda stamp_ns, step: samples.add(stamp_ns, step, graph)
    )
    loop.explore(60.0 * minutes)
    stamps_ns = np.array(loop.log.stamp_ns, np.int64)
    truth = Truth(stamps_ns, loop.log.truths())
    return compared(samples, truth, has_heading=True, std=EXACT)


def joined(results: list[Result]) -> Result:
    """Return the samples of several runs as one result."""
    nees, dimensions, error_m, std_m = zip(*results, strict=True)
    return Result(
        np.concatenate(nees), dimensions[0], np.concatenate(error_m), np.concatenate(std_m)
    )


def rows(options: argparse.Namespace) -> Iterator[tuple[str, Result]]:
    """Yield name and result of each row."""
    wanted = options.only or (*ROUTES, 'demo', 'floors')
    with tempfile.TemporaryDirectory() as temporary:
        for name in (name for name in ROUTES if name in wanted):
            if (options.data / name).is_dir():
                yield name, replayed(*convert(options.data, Path(temporary), ROUTES[name][0]))
            else:
                print(f'{name}: skipped, {options.data / name} not found')
        runs = []
        for seed in range(1, options.seeds + 1) if 'demo' in wanted else ():
            run = write_recording(Path(temporary) / f'demo_{seed}', seed)
            runs.append(replayed(run.recording, run.truth))
            yield f'demo, seed {seed}', runs[-1]
        if runs:
            yield f'demo, {len(runs)} seeds', joined(runs)
    for plan in PLANS if 'floors' in wanted else ():
        yield Path(plan).stem, explored(plan, options.minutes)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument('--data', type=Path, default=ROOT.parent / 'shared' / 'data')
    parser.add_argument('--seeds', type=int, default=20, help='runs of the demo (default: 20)')
    parser.add_argument('--minutes', type=float, default=12.0,
                        help='exploration of each floor (default: 12)')
    parser.add_argument('--only', action='append', choices=(*ROUTES, 'demo', 'floors'),
                        help='compute only this row; may be repeated')
    options = parser.parse_args()
    warm_up()
    print('                    views   d   <95 %       NEES   error [m]    95 %   std [m]')
    for name, result in rows(options):
        print(result.line(name), flush=True)


if __name__ == '__main__':
    main()
