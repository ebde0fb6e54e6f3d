# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""``ratslam demo``: record a simulated robot in an office, and map the recording."""

from __future__ import annotations

import shutil
import statistics
import tempfile
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from ratslam_ros.core.config import AUTOMATIC, Config
from ratslam_ros.core.vision.match_threshold import RELATED_RATIO
from ratslam_ros.descriptors import encoder_of
from ratslam_ros.errors import UnusableInput
from ratslam_ros.offline.inspection import inspect
from ratslam_ros.offline.replay import ReplayOptions, ReplayOutcome, replay
from ratslam_ros.recordings import ImageEvent, Recording, Selection, open_recording
from ratslam_ros.results.evaluation import evaluate
from ratslam_ros.results.plots import draw_all
from ratslam_ros.results.trajectory import read_tum
from ratslam_simulator.aliasing import measure_aliasing
from ratslam_simulator.picture import draw_run
from ratslam_simulator.recording import SimulatedRun, write_recording

TITLE = 'demo: a simulated robot in an office'
"""Name of the run in the live view."""

LOOK_ALIKE_DISTANCE_M = 5.0
"""Distance beyond which a view that matches another is an alias, not a revisit."""


@dataclass(frozen=True)
class DemoFigures:
    """Errors of one simulated run: ATE RMSE in m after rigid alignment.

    map_m: of the final trajectory. estimate_m: of the pose estimates at the time.
    dead_reckoning_m: of the odometry alone. look_alike_share: share of the views that match one
    from more than `LOOK_ALIKE_DISTANCE_M` away.
    """

    seed: int
    map_m: float
    estimate_m: float
    dead_reckoning_m: float
    look_alike_share: float

    @property
    def ratio(self) -> float:
        """Error of the map relative to dead reckoning."""
        return self.map_m / self.dead_reckoning_m


def run_demo(
    config: Config, seed: int, folder: Path, progress: bool = True, look_ahead: bool = False
) -> str:
    """Simulate, replay, evaluate and draw one run.

    Args:
        config: all parameters of the replay.
        seed: random seed of world and noise.
        folder: folder for the results and the recording.
        config, config_name: all parameters, and the name or file that they come from.
        progress: show a progress bar.
        look_ahead: inspect the recording before the replay, as for a recording of one's own.

    Returns:
        The errors and the paths of the plots, as text.

    Raises:
        UnusableInput: the folder has a recording already, or cannot be written.
        KeyboardInterrupt: the replay was interrupted; its results are written.
    """
    run, outcome, figures = _run(config, seed, folder, progress, look_ahead, True)
    plots = [
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
            f'{LOOK_ALIKE_DISTANCE_M:.0f} m away',
            '',
            'error against the truth (ATE, m RMSE)',
            f'  dead reckoning            {figures.dead_reckoning_m:.2f}',
            f'  pose estimate at the time {figures.estimate_m:.2f}',
            f'  final map                 {figures.map_m:.2f}   '
            f'({figures.ratio:.2f} of dead reckoning)',
            '',
            f'recording: {run.recording}',
            *[f'plot:      {path}' for path in plots],
            'to replay this recording like one of your own:\n'
            f'  ratslam replay {run.recording} --truth {run.truth}',
        ]
    )


def run_seeds(config: Config, seeds: Iterable[int], look_ahead: bool = False) -> str:
    """Run several seeds without plots; return a table of the errors, with mean and worst."""
    rows = ['seed  map [m]  dead reckoning [m]  ratio  look-alikes']
    all_figures = []
    for seed in seeds:
        with tempfile.TemporaryDirectory() as folder:
            _, _, f = _run(config, seed, Path(folder), False, look_ahead)
        all_figures.append(f)
        rows.append(
            f'{f.seed:4d}  {f.map_m:7.2f}  {f.dead_reckoning_m:18.2f}  {f.ratio:5.2f}  '
            f'{f.look_alike_share:11.0%}'
        )
    maps = statistics.fmean(f.map_m for f in all_figures)
    dead_reckonings = statistics.fmean(f.dead_reckoning_m for f in all_figures)
    worst = max(all_figures, key=lambda f: f.ratio)
    rows.append(f'mean  {maps:7.2f}  {dead_reckonings:18.2f}  {maps / dead_reckonings:5.2f}')
    rows.append(
        f'worst {worst.map_m:7.2f}  {worst.dead_reckoning_m:18.2f}  {worst.ratio:5.2f}  '
        f'(seed {worst.seed})'
    )
    largest = max(all_figures, key=lambda f: f.map_m)
    rows.append(f'largest error {largest.map_m:.2f} m (seed {largest.seed})')
    return '\n'.join(rows)


def _run(
    config: Config, seed: int, folder: Path, progress: bool, look_ahead: bool,
    with_history: bool = False,
) -> tuple[SimulatedRun, ReplayOutcome, DemoFigures]:
    if (folder / 'recording').exists():
        raise UnusableInput(f'{folder} already has a recording; give another --out')
    try:
        run = write_recording(folder / 'recording', seed)
    except BaseException:
        # Do not leave an incomplete recording.
        shutil.rmtree(folder / 'recording', ignore_errors=True)
        raise
    with open_recording(run.recording) as recording:
        selection = recording.select()
        if look_ahead:
            config = inspect(recording, selection, config).config
        outcome = replay(
            recording, selection, config, folder,
            ReplayOptions(progress=progress, history=with_history, title=TITLE),
        )
        aliasing = _look_alike_share(recording, selection, run, config)
    truth = read_tum(run.truth)
    final, estimate, dead_reckoning = (
        evaluate(read_tum(folder / f'{name}.tum'), truth).ate.rmse
        for name in ('trajectory_final', 'trajectory', 'dead_reckoning')
    )
    return run, outcome, DemoFigures(seed, final, estimate, dead_reckoning, aliasing)


def _look_alike_share(
    recording: Recording, selection: Selection, run: SimulatedRun, config: Config
) -> float:
    """Return the share of views that match one from more than `LOOK_ALIKE_DISTANCE_M` away."""
    encoder = encoder_of(config.local_view)
    views: list[NDArray[np.uint8]] = []
    stamps_ns: list[int] = []
    for event in recording.events(selection):
        if isinstance(event, ImageEvent):
            view = encoder.encode(event.grey())
            if view is not None:
                views.append(view)
                stamps_ns.append(event.stamp_ns)
    nearest = np.searchsorted(run.truth_stamp_ns, stamps_ns).clip(max=len(run.truth_pose) - 1)
    seen, poses = np.array(views), run.truth_pose[nearest]
    threshold = config.local_view.vt_match_threshold
    if threshold == AUTOMATIC:
        # While driving, odometry lowers the threshold so that few look-alikes match; these are
        # the views that would match by the images alone.
        threshold = RELATED_RATIO * _unrelated_difference(seen, poses)
    return measure_aliasing(
        seen, poses, threshold, encoder.layout.shift_x, LOOK_ALIKE_DISTANCE_M
    ).look_alike_share


def _unrelated_difference(views: NDArray[np.uint8], poses: NDArray[np.float64]) -> float:
    """Return the median difference, 0 to 1, of views half a run apart at different places."""
    half = len(views) // 2
    away_m = np.hypot(*(poses[:half, :2] - poses[half : 2 * half, :2]).T)
    one, other = (v[away_m > LOOK_ALIKE_DISTANCE_M].astype(np.int16) for v in (
        views[:half], views[half : 2 * half]
    ))  # fmt: skip
    return float(np.median(np.abs(one - other).mean(axis=(1, 2)))) / 255.0
