# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The demo: a simulated office, a recording of it, and the map that comes of it."""

from __future__ import annotations

import shutil
import statistics
import tempfile
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from ratslam_ros.core.config import Config
from ratslam_ros.core.vision.local_view import make_view
from ratslam_ros.errors import UnusableInput
from ratslam_ros.files.config import load_config
from ratslam_ros.offline.replay import ReplayOptions, ReplayOutcome, replay
from ratslam_ros.recordings import ImageEvent, Recording, Selection, open_recording
from ratslam_ros.results.evaluation import evaluate
from ratslam_ros.results.plots import draw_all
from ratslam_ros.results.trajectory import read_tum
from ratslam_ros.simulator.aliasing import measure_aliasing
from ratslam_ros.simulator.picture import draw_run
from ratslam_ros.simulator.recording import SimulatedRun, write_recording

PRESET = 'pioneer'
LOOK_ALIKE_M = 5.0


@dataclass(frozen=True)
class DemoFigures:
    """How one simulated run came out; errors are ATE RMSE after rigid alignment."""

    seed: int
    map_m: float
    believed_m: float
    dead_reckoning_m: float
    look_alike_share: float

    @property
    def ratio(self) -> float:
        """The map's error over that of dead reckoning."""
        return self.map_m / self.dead_reckoning_m


def run_demo(seed: int, folder: Path, progress: bool = True) -> str:
    """Simulate, replay, evaluate and draw; return the figures and the pictures' paths as text."""
    run, outcome, figures = _run(seed, folder, progress)
    pictures = [
        *draw_all(folder, run.truth),
        draw_run(run, folder / 'world.png'),
    ]
    if outcome.interrupted:
        raise KeyboardInterrupt
    s = outcome.summary
    return '\n'.join(
        [
            f'{run.duration_s:.0f} s of a simulated Pioneer in an office, replayed in '
            f'{s["wall_s"]:.1f} s ({s["times_realtime"]:.0f}x real time)',
            f'{s["templates"]} templates, {s["experiences"]} experiences, {s["links"]} links, '
            f'{s["loop_closures"]} loop closures',
            f'{figures.look_alike_share:.0%} of the views have a look-alike more than '
            f'{LOOK_ALIKE_M:.0f} m away',
            '',
            'error against the truth (ATE, m RMSE)',
            f'  dead reckoning          {figures.dead_reckoning_m:.2f}',
            f'  believed on the way     {figures.believed_m:.2f}',
            f'  the map                 {figures.map_m:.2f}   '
            f'({figures.ratio:.2f} of dead reckoning)',
            '',
            f'recording: {run.recording}',
            *[f'picture:   {path}' for path in pictures],
            f'once more, as with a recording of your own:\n  ratslam replay {run.recording} '
            f'--config {PRESET} --truth {run.truth}',
        ]
    )


def run_seeds(seeds: Iterable[int]) -> str:
    """Run several seeds without pictures; return a table with mean and worst."""
    rows = ['seed  map [m]  dead reckoning [m]  ratio  look-alikes']
    all_figures = []
    for seed in seeds:
        with tempfile.TemporaryDirectory() as folder:
            _, _, f = _run(seed, Path(folder), False)
        all_figures.append(f)
        rows.append(
            f'{f.seed:4d}  {f.map_m:7.2f}  {f.dead_reckoning_m:18.2f}  {f.ratio:5.2f}  '
            f'{f.look_alike_share:11.0%}'
        )
    maps = statistics.fmean(f.map_m for f in all_figures)
    reckoned = statistics.fmean(f.dead_reckoning_m for f in all_figures)
    worst = max(all_figures, key=lambda f: f.ratio)
    rows.append(f'mean  {maps:7.2f}  {reckoned:18.2f}  {maps / reckoned:5.2f}')
    rows.append(
        f'worst {worst.map_m:7.2f}  {worst.dead_reckoning_m:18.2f}  {worst.ratio:5.2f}  '
        f'(seed {worst.seed})'
    )
    return '\n'.join(rows)


def _run(
    seed: int, folder: Path, progress: bool
) -> tuple[SimulatedRun, ReplayOutcome, DemoFigures]:
    if (folder / 'recording').exists():
        raise UnusableInput(f'{folder} holds a recording already; give another --out')
    config, _ = load_config(PRESET)
    try:
        run = write_recording(folder / 'recording', seed)
    except BaseException:
        shutil.rmtree(folder / 'recording', ignore_errors=True)  # half a recording is none
        raise
    with open_recording(run.recording) as recording:
        selection = recording.select()
        outcome = replay(
            recording, selection, config, folder, ReplayOptions(progress=progress)
        )
        aliasing = _look_alike_share(recording, selection, run, config)
    truth = read_tum(run.truth)
    final, believed, dead_reckoning = (
        evaluate(read_tum(folder / f'{name}.tum'), truth).ate.rmse
        for name in ('trajectory_final', 'trajectory', 'dead_reckoning')
    )
    return run, outcome, DemoFigures(seed, final, believed, dead_reckoning, aliasing)


def _look_alike_share(
    recording: Recording, selection: Selection, run: SimulatedRun, config: Config
) -> float:
    """Return the share of views that match one from more than 5 m away."""
    views: list[NDArray[np.uint8]] = []
    stamps_ns: list[int] = []
    for event in recording.events(selection):
        if isinstance(event, ImageEvent):
            views.append(make_view(event.grey(), config.local_view))
            stamps_ns.append(event.stamp_ns)
    nearest = np.searchsorted(run.truth_stamp_ns, stamps_ns).clip(max=len(run.truth_pose) - 1)
    p = config.local_view
    return measure_aliasing(
        np.array(views), run.truth_pose[nearest], p.vt_match_threshold, p.vt_shift_match,
        LOOK_ALIKE_M,
    ).look_alike_share  # fmt: skip
