# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""``ratslam simulate``: a robot explores a floor plan and then drives to goals on its map."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from contextlib import ExitStack
from dataclasses import fields
from pathlib import Path

from ratslam_ros.core.config import Config
from ratslam_ros.core.vision.prepared_image import PreparedImage
from ratslam_ros.errors import UnusableInput
from ratslam_ros.files.config import to_yaml
from ratslam_ros.history.file import HISTORY_NAME, HistoryMeta
from ratslam_ros.history.recorder import Recorder
from ratslam_ros.history.writer import HistoryWriter
from ratslam_ros.images import Frame
from ratslam_ros.pipeline.items import Step
from ratslam_ros.results.plots import draw_all
from ratslam_ros.results.trajectory import tum_line
from ratslam_ros.results.writer import Results
from ratslam_ros.version import __version__
from ratslam_simulator.closed_loop import ClosedLoop, scan_from_sample
from ratslam_simulator.config import SimulatorParameters, make_simulator
from ratslam_simulator.recording import TRUTH_FILE, RecordingWriter
from ratslam_simulator.samples import ImageSample, Sample, ScanSample
from ratslam_simulator.simulation import Simulator
from ratslam_simulator.tour import Tour, table, write_table


def simulate(
    parameters: SimulatorParameters, config: Config, folder: Path, *, explore_s: float,
    goals: Sequence[str] | None, random_goals: int, record: Path | None, progress: bool,
    history: bool,
) -> str:
    """Simulate exploration and goals; write results, plots and `trials.csv`.

    Args:
        parameters: the simulated robot and its world.
        config: parameters of RatSLAM and of the navigation.
        folder: folder for the results.
        explore_s: duration of the exploration in s.
        goals: names of places of the plan, in order; None for all that were named.
        random_goals: number of random goals among the visited places, in place of `goals`; 0 for
            none.
        record: folder for a recording of all sensor data, None for none.
        progress: show a progress bar.
        history: write history.sqlite.

    Returns:
        A report of the exploration, a table of the goals, and the paths of the plots.

    Raises:
        UnusableInput: plan, start, obstacles or goals are invalid, or a file cannot be written.
        UnusableParameter: a value is out of range.
    """
    simulator = make_simulator(parameters)
    places = simulator.plan.places
    unknown = [name for name in goals or () if name not in places]
    if unknown:
        names = ', '.join(places) or 'none: give --random-goals'
        raise UnusableInput(
            f'the plan has no place {", ".join(unknown)}; its places are {names}'
        )
    with ExitStack() as stack:
        if record is not None:
            writer = stack.enter_context(RecordingWriter(record, simulator.options))
            simulator.watchers.append(writer.write)
        results = Results(folder, config)
        file = folder / HISTORY_NAME if history else None
        loop = _RecordingLoop(simulator, config, parameters.seed, results, file)
        try:
            tour = Tour(loop, goals, random_goals, progress)
            explored = tour.explore(explore_s)
            trials = [tour.attempt(name, folder) for name in tour.goals(parameters.seed)]
            loop.finish()
        except BaseException:
            results.discard()
            loop.discard()
            raise
    summary = {
        **results.summary(loop.experience_map), 'duration_s': loop.now_s,
        'driven_m': simulator.odometer_m, 'collisions': simulator.collisions,
        'goals': len(trials), 'succeeded': sum(trial.succeeded for trial in trials),
        'simulator': {item.name: getattr(parameters, item.name) for item in fields(parameters)},
    }
    results.finish(loop.experience_map, summary)
    truth = folder / TRUTH_FILE
    truth.write_text(''.join(map(tum_line, loop.log.stamp_ns, loop.log.truth)), encoding='ascii')
    write_table(trials, folder / 'trials.csv')
    plots = [
        *tour.plots, tour.draw_floor(trials, folder / 'floor.png'),
        *draw_all(folder, truth),
    ]
    return '\n'.join([explored, *table(trials), *map(str, plots)])


class _RecordingLoop(ClosedLoop):
    """Closed loop that writes the result of every step, and a history if it has a file."""

    def __init__(
        self, simulator: Simulator, config: Config, seed: int, results: Results,
        history: Path | None,
    ) -> None:
        super().__init__(simulator, config, seed)
        self._results = results
        self._recorder: Recorder | None = None
        if history is not None:
            meta = HistoryMeta(history.absolute().parent.name, __version__, to_yaml(config))
            self._recorder = Recorder(self.ratslam, lambda: HistoryWriter(history, meta))
            simulator.watchers.append(self._watch)

    def _watch(self, sample: Sample) -> None:
        assert self._recorder is not None
        if isinstance(sample, ImageSample):
            self._recorder.add_image(
                sample.stamp_ns, Frame(sample.image, 'mono8'), PreparedImage(sample.image)
            )
        elif isinstance(sample, ScanSample) and sample.laser == 0:  # one scan is shown
            self._recorder.add_scan(scan_from_sample(sample, self.simulator))

    def _note(self, steps: Iterable[Step]) -> None:
        steps = list(steps)
        for step in steps:
            self._results.add(step)
            if self._recorder is not None:
                self._recorder.add(step)
        super()._note(steps)

    def finish(self) -> None:
        """Process all held messages, and complete the history."""
        self._note(self.ratslam.finish())
        if self._recorder is not None:
            self._recorder.close()

    def discard(self) -> None:
        """Remove the history of a simulation that has failed."""
        if self._recorder is not None:
            self._recorder.discard()
