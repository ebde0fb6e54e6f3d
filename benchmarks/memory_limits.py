# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Maps with a limited memory: error and size at several limits, with each policy.

    python benchmarks/memory_limits.py [--seeds N] [--after SECONDS] [--only TEXT]
    python benchmarks/memory_limits.py --data ../shared/data [--after SECONDS]

The recordings are those of ``ratslam demo``: a robot drives about 400 s through an office, and
returns to most places. A run without limits gives the numbers of templates and experiences that
the limits are shares of. Each row is the mean over all seeds:

- templates, experiences: the largest numbers held at a time
- kB: size of the saved map
- map, estimate: ATE RMSE of the final map and of the pose estimates at the time, in m; the worst
  seed in brackets
- closures: loop closures
- match: mean time of the local view per image, in ms

With --data, the real recordings of laps are mapped instead, with their presets and limits of
templates; lap_measures.py defines precision, recall and spread.
"""

from __future__ import annotations

import argparse
import statistics
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

from lap_measures import LAPS, Setup, run_laps
from navigation import pooled
from place_recognition import TUNED_LAPS, TunedLaps

from ratslam_ros.core.config import Config
from ratslam_ros.event_inputs import odometry_from_event
from ratslam_ros.files.config import load_config
from ratslam_ros.maps import MapMeta, save_map
from ratslam_ros.pipeline.ratslam import RatSLAM
from ratslam_ros.recordings import ImageEvent, OdometryEvent, open_recording
from ratslam_ros.results.evaluation import evaluate
from ratslam_ros.results.trajectory import read_tum
from ratslam_ros.results.writer import Results
from ratslam_simulator.recording import write_recording

SHARES = 0.75, 0.5, 0.35, 0.25
"""Limits, as shares of the numbers without limits."""

PARTS = 'local_view', 'pose_cells', 'experience_map'


@dataclass(frozen=True)
class Row:
    """Figures of one run."""

    templates: int
    experiences: int
    kilobytes: float
    map_m: float
    estimate_m: float
    closures: int
    match_ms: float


class Stopwatch:
    """Time spent in the local view."""

    def __init__(self) -> None:
        self.total_s = 0.0

    @contextmanager
    def __call__(self, name: str) -> Iterator[None]:
        """Time one step."""
        start_s = time.perf_counter()
        yield
        if name == 'local_view.image':
            self.total_s += time.perf_counter() - start_s


def map_recording(recording_path: Path, truth: Path, config: Config) -> Row:
    """Map one recording."""
    watch, images = Stopwatch(), 0
    slam = RatSLAM(config, stopwatch=watch)
    assert slam.local_view is not None
    templates = experiences = 0
    with tempfile.TemporaryDirectory() as name, open_recording(recording_path) as recording:
        folder = Path(name)
        results = Results(folder, config)
        for event in recording.events(recording.select()):
            if isinstance(event, OdometryEvent):
                steps = slam.odometry(odometry_from_event(event))
            elif isinstance(event, ImageEvent):
                steps = slam.image(event.stamp_ns, event.grey())
                images += 1
                templates = max(templates, len(slam.local_view))
            else:
                continue
            for step in steps:
                results.add(step)
            experiences = max(experiences, len(slam.experience_map))
        for step in slam.finish():
            results.add(step)
        results.finish(slam.experience_map, {})
        save_map(folder / 'map', slam.state(), MapMeta())
        size = (folder / 'map').stat().st_size
        errors = [
            evaluate(read_tum(folder / f'{trajectory}.tum'), read_tum(truth)).ate.rmse
            for trajectory in ('trajectory_final', 'trajectory')
        ]
    return Row(
        templates, experiences, size / 1000, errors[0], errors[1], results.closures.count,
        1000.0 * watch.total_s / images,
    )


def settings(full: Row) -> Iterator[tuple[str, dict[str, Any]]]:
    """Yield a name and the parameters of each row."""
    values: dict[str, Any]
    for share in SHARES:
        exp_max = round(share * full.experiences)
        for policy in ('visits', 'freshness'):
            values = {'pose_cells.exp_max': exp_max, 'pose_cells.exp_forget': policy}
            yield f'exp_max {share:.0%}, {policy}', values
    for share in SHARES:
        vt_max = round(share * full.templates)
        for fading in (0.0, 0.5, 1.0):
            values = {'local_view.vt_max': vt_max, 'memory.forget_share': fading}
            yield f'vt_max {share:.0%}, forget_share {fading:g}', values
    for share in SHARES:
        yield f'both {share:.0%}, freshness', {
            'local_view.vt_max': round(share * full.templates),
            'pose_cells.exp_max': round(share * full.experiences),
            'pose_cells.exp_forget': 'freshness',
        }


def one_seed(config: Config, changes: dict[str, Any], only: str, seed: int) -> dict[str, Row]:
    """Return the rows of one recording by name; those whose name contains ``only``."""
    with tempfile.TemporaryDirectory() as folder:
        run = write_recording(Path(folder) / 'recording', seed)
        recording, truth = Path(run.recording), Path(run.truth)
        full = map_recording(recording, truth, config)
        rows = {'no limit': full}
        for name, values in settings(full):
            if only not in name:
                continue
            rows[name] = map_recording(recording, truth, config.with_values({**values, **changes}))
    return rows


def lap_rows(data: Path, laps: TunedLaps, after_s: float) -> Iterator[str]:
    """Map a recording of laps at several limits of templates; yield the rows of the table."""
    config, _ = load_config(laps.preset)
    count = 0
    for share in (1.0, *SHARES):
        for fading in (0.0, 0.5, 1.0) if share < 1.0 else (0.5,):
            limited = config.with_values({
                'local_view.vt_max': round(share * count), 'memory.forget_share': fading,
                'memory.forget_after_s': after_s,
            })
            run = run_laps(data, LAPS[laps.folder], Setup(limited, look_ahead=False))
            precision, recall, spread = run.measures[:3]
            count = count or run.summary['templates']
            yield (
                f'{laps.folder:16s} {share:5.0%} {fading:12.1f}  {precision:9.3f}  {recall:6.3f}  '
                f'{spread:6.4f}'
            )


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=(__doc__ or '').partition('\n')[0])
    parser.add_argument('--seeds', type=int, default=5, help='number of seeds (default: 5)')
    parser.add_argument('--first', type=int, default=1, help='first seed (default: 1)')
    parser.add_argument('--config', default='extended', help='preset or file')
    parser.add_argument(
        '--after', type=float, default=100.0, help='forget_after_s of both memories (default: 100)'
    )
    parser.add_argument('--only', default='', help='compute only rows that contain this text')
    parser.add_argument('--data', type=Path, help='folder of the real recordings of laps')
    options = parser.parse_args()
    if options.data is not None:
        print('recording        limit forget_share  precision  recall  spread')
        for laps in TUNED_LAPS:
            for row in lap_rows(options.data, laps, options.after):
                print(row, flush=True)
        return
    config, _ = load_config(options.config)
    changes = {'memory.forget_after_s': options.after}
    seeds = range(options.first, options.first + options.seeds)
    found = pooled(partial(one_seed, config, changes, options.only), seeds)
    print(
        f'{"":30s} templates  experiences     kB      map [m]  estimate [m]  closures  match [ms]'
    )
    for name in found[0]:
        rows = [rows[name] for rows in found]
        mean = {
            key: statistics.fmean(getattr(row, key) for row in rows)
            for key in Row.__dataclass_fields__
        }
        print(
            f'{name:30s} {mean["templates"]:9.0f}  {mean["experiences"]:11.0f}  '
            f'{mean["kilobytes"]:5.0f}  {mean["map_m"]:4.2f} ({max(r.map_m for r in rows):.2f})  '
            f'{mean["estimate_m"]:5.2f} ({max(r.estimate_m for r in rows):.2f})  '
            f'{mean["closures"]:8.0f}  {mean["match_ms"]:10.2f}'
        )


if __name__ == '__main__':
    main()
