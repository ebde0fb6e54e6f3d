# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""``ratslam demo``: record a simulated robot in an office, and map the recording."""

from __future__ import annotations

import shlex
import shutil
import statistics
import tempfile
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path

from ratslam_ros.console import ProgressBar, print_notice, ticking
from ratslam_ros.core.config import Config, Value
from ratslam_ros.offline.map_recording import MapResult, map_recording
from ratslam_ros.results.evaluation import evaluate
from ratslam_ros.results.trajectory import Trajectory, read_tum
from ratslam_ros.results.writer import unwritable
from ratslam_simulator.office_tour import usual_duration_s
from ratslam_simulator.picture import draw_run
from ratslam_simulator.recording import TRUTH_FILE, SimulatedRun, write_recording

TITLE = 'demo: a simulated robot in an office'
"""Name of the run in the live view."""

RECORDING_BYTES = 20e6
"""About the size of the recording."""


@dataclass(frozen=True)
class DemoFigures:
    """Errors of one simulated run: ATE RMSE in m after rigid alignment.

    map_m: of the final trajectory. estimate_m: of the pose estimates at the time.
    dead_reckoning_m: of the odometry alone.
    """

    seed: int
    map_m: float
    estimate_m: float
    dead_reckoning_m: float

    @property
    def ratio(self) -> float:
        """Error of the map relative to dead reckoning."""
        return self.map_m / self.dead_reckoning_m


def run_demo(
    config: Config | None, settings: Mapping[str, Value], seed: int, folder: Path,
    progress: bool,
) -> str:
    """Simulate, replay, evaluate and draw one run.

    Args:
        config, settings: all parameters, and those that are changed. Without ``config``, the
            recording is inspected, as one of one's own.
        seed: random seed of world and noise.
        folder: folder for the results and the recording.
        progress: show progress bars.

    Returns:
        The errors and the paths of the plots, as text.

    Raises:
        UnusableInput: the folder cannot be written.
        KeyboardInterrupt: the replay was interrupted; its results are written.
    """
    run, truth, result, figures = _run(config, settings, seed, folder, progress, True)
    if progress:
        print_notice('drawing the plots')
    with ticking('drawing:', progress):
        plots = [*result.plot(truth), draw_run(run, folder / 'world.png')]
    if result.interrupted:
        raise KeyboardInterrupt
    s = result.summary
    return '\n'.join(
        [
            f'{run.duration_s:.0f} s of a simulated Pioneer in an office, replayed in '
            f'{s["wall_s"]:.1f} s ({s["times_realtime"]:.0f}x real time)',
            f'{s["templates"]} templates, {s["experiences"]} experiences, {s["links"]} links, '
            f'{s["loop_closures"]} loop closures',
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
            '  ' + shlex.join(
                ['ratslam', 'replay', str(run.recording), '--truth', str(run.truth)]
            ),
        ]
    )


def run_seeds(
    config: Config | None, settings: Mapping[str, Value], seeds: Iterable[int], progress: bool
) -> str:
    """Run several seeds without plots; return a table of the errors, with mean and worst."""
    rows = ['seed  map [m]  dead reckoning [m]  ratio']
    all_figures = []
    for seed in seeds:
        with tempfile.TemporaryDirectory() as folder:
            *_, f = _run(config, settings, seed, Path(folder), progress, False)
        all_figures.append(f)
        rows.append(
            f'{f.seed:4d}  {f.map_m:7.2f}  {f.dead_reckoning_m:18.2f}  {f.ratio:5.2f}'
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
    config: Config | None, settings: Mapping[str, Value], seed: int, folder: Path, progress: bool,
    with_history: bool,
) -> tuple[SimulatedRun, Trajectory, MapResult, DemoFigures]:
    if (folder / 'recording' / TRUTH_FILE).exists():  # of the run that is overwritten
        shutil.rmtree(folder / 'recording')
    try:
        with ProgressBar(usual_duration_s(), shown=progress, label='simulating ') as bar:
            run = write_recording(folder / 'recording', seed, report=bar.update)
    except BaseException as error:
        shutil.rmtree(folder / 'recording', ignore_errors=True)  # It is incomplete.
        if isinstance(error, OSError):
            raise unwritable(folder, error, RECORDING_BYTES) from None
        raise
    result = map_recording(
        run.recording, folder, config=config, settings=settings, history=with_history,
        quiet=not progress,
    )
    truth = read_tum(run.truth)
    final, estimate, dead_reckoning = (
        evaluate(read_tum(folder / f'{name}.tum'), truth).ate.rmse
        for name in ('trajectory_final', 'trajectory', 'dead_reckoning')
    )
    return run, truth, result, DemoFigures(seed, final, estimate, dead_reckoning)
