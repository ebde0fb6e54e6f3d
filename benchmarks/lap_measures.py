# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Measures of maps of recordings of laps, and replays as with nothing configured.

The folder of a recording of laps has a file `lap_phase.csv` with the lap and the place on the lap,
`ref_frame`, of each frame. Two frames show the same place if the cyclic distance of their
`ref_frame` is at most the tolerance of the recording. Frames with `ref_frame` -1 have no label and
are left out of all measures.

- precision and recall: a frame of lap 2 or later counts as recognised if its template was first
  seen in an earlier lap and more than half a lap of frames before. The recognition is correct if
  the first frame of the template shows the same place. Precision = correct / recognised, recall =
  correct / frames of lap 2 or later. Frames whose template was first seen in a frame without label
  count for neither.
- spread: median distance on the map between frames of different laps with equal `ref_frame`,
  relative to the diameter of the map, which is the largest distance between two frames.
- turns for each lap: median difference of the unwrapped heading between a visit of a place and the
  next one, more than a quarter of a lap of frames later, in whole turns, without the sign. The
  spread cannot see a map that turns twice for each lap. Visits with a gap of the odometry of more
  than max_odom_gap_s between them are left out, because the turn in the gap is unknown. hall_car
  was set back to its start after its first lap, and then drives 290 of 695 places twice.
"""

from __future__ import annotations

import argparse
import csv
import math
import multiprocessing
import tempfile
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import ProcessPoolExecutor, as_completed
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple, TypeVar

import numpy as np
from numpy.typing import NDArray
from recording_variants import DOUBLE, ORIGINAL, VARIANTS, ChangedRecording, Variant, variant_of
from scipy.spatial.distance import pdist

from ratslam_ros.core.config import Config, InputParameters
from ratslam_ros.core.warm_up import warm_up
from ratslam_ros.errors import RatslamError
from ratslam_ros.files.config import load_config, parse_setting
from ratslam_ros.offline.inspection import inspect
from ratslam_ros.offline.replay import ReplayOptions, replay
from ratslam_ros.recordings import ImageEvent, Recording, Selection, open_recording
from ratslam_ros.results.trajectory import read_tum
from ratslam_tuning.lap_phases import LapPhases, read_lap_phases
from ratslam_tuning.map_score import poses_at

Task = TypeVar('Task')
Result = TypeVar('Result')

ROOT = Path(__file__).resolve().parents[1]

MAX_GAP_NS = round(1e9 * InputParameters().max_odom_gap_s)
"""Longest interval between messages of the odometry over which the motion is known."""


@dataclass(frozen=True)
class Laps:
    """A recording of laps.

    tolerance: largest distance between frames of the same place, in frames. turns: whole turns of
    the robot on a lap. has_odometry: whether it contains odometry. folder: name of the folder.
    base: variant that the recording is made of.
    """

    name: str
    tolerance: int
    turns: float = 1.0
    has_odometry: bool = False
    folder: str = ''
    base: str = ORIGINAL

    def path(self, data: Path) -> Path:
        """Return the path of the recording in a folder of recordings."""
        return data / (self.folder or self.name)

    def open(self, data: Path, variant: str = ORIGINAL) -> ChangedRecording:
        """Open the variant of the recording with this name."""
        path = self.path(data)
        images = path / 'images'
        source = open_recording(images if images.is_dir() else path)
        base = ChangedRecording(source, VARIANTS[self.base])
        return ChangedRecording(base, self.variant(variant)[0])

    def variant(self, name: str) -> tuple[Variant, str]:
        """Return the variant with a name, and what it changes."""
        return variant_of(name, self.name, self.has_odometry)


LAPS = {
    laps.name: laps
    for laps in (
        Laps('rc_car_loops', 8, has_odometry=True),
        Laps('rc_car_eight', 10, turns=0.0, has_odometry=True),
        Laps('rc_car_other_way', 11, has_odometry=True),
        Laps('lab_car', 8),
        Laps('donkeycar_track', 5),
        Laps('home_robot', 8),
        Laps('home_robot_640', 8, folder='home_robot', base=DOUBLE),
        Laps('outdoor_car', 4),
        Laps('hall_car', 15),
    )
}


class Frames(NamedTuple):
    """Columns of frames.csv, (n,) each: stamps in ns and template ids."""

    stamp_ns: NDArray[np.int64]
    template_id: NDArray[np.int64]


def read_frames(path: Path) -> Frames:
    """Read stamps and template ids from frames.csv."""
    with open(path, newline='') as file:
        rows = list(csv.DictReader(file))
    return Frames(
        np.array([int(row['stamp_ns']) for row in rows]),
        np.array([int(row['template_id']) for row in rows]),
    )


def template_ids(folder: Path, stamp_ns: NDArray[np.int64]) -> list[int]:
    """Return the template ids at (n,) stamps of the results of a replay; -1: none."""
    frames = read_frames(folder / 'frames.csv')
    template_of = dict(zip(frames.stamp_ns.tolist(), frames.template_id.tolist(), strict=True))
    return [template_of.get(stamp, -1) for stamp in stamp_ns.tolist()]


class LapMeasures(NamedTuple):
    """Measures of a map of a recording of laps, as defined in the module docstring."""

    precision: float
    recall: float
    spread: float
    turns: float
    reckoned_spread: float
    """Spread of dead reckoning."""

    def is_right(self, turns: float) -> bool:
        """Return whether the map is right, given the true turns for each lap."""
        return (
            self.precision >= 0.9 and self.recall >= 0.7 and self.spread <= 0.05
            and abs(self.turns - turns) <= 0.2
        )


class RecognitionErrors(NamedTuple):
    """What the false recognitions of a recording of laps have in common, and its labels."""

    errors: int
    errors_near: float
    """Share of the errors of at most twice the tolerance."""
    errors_avoidable: float
    """Share of the errors for which an earlier lap had learned a template of the right place."""
    errors_repeated: float
    """Share of the errors whose place is, within the tolerance, the median of the places where
    other laps recognised the template: only the label of its first frame differs from theirs."""
    precision_least_certain: float
    """Precision in the quarter of recognitions whose labels are least certain: column ncc of
    lap_phase.csv, the smaller one of the frame and of the first frame of its template."""
    precision_most_certain: float
    """The same of the most certain quarter."""


def read_certainty(path: Path) -> NDArray[np.float64] | None:
    """Return the column ncc of lap_phase.csv, None if there is none."""
    with open(path, newline='') as file:
        rows = list(csv.DictReader(file))
    return np.array([float(row['ncc']) for row in rows]) if 'ncc' in rows[0] else None


def recognition_errors(
    phases: LapPhases, ids: list[int], tolerance: int, certainty: NDArray[np.float64]
) -> RecognitionErrors:
    """Return what the false recognitions have in common.

    Args:
        phases: laps and places of the n frames of the recording.
        ids: their templates.
        tolerance: largest distance between frames of the same place, in frames.
        certainty: (n,) certainty of their labels.
    """
    lap, place = phases.lap, phases.place
    _, is_recognised, first, apart = phases.matches(ids)
    firsts = np.unique(first[(np.array(ids) >= 0) & (place[first] >= 0)])
    wrong = np.flatnonzero(is_recognised & (apart > tolerance))
    avoidable = repeated = 0
    for frame in wrong.tolist():
        known = firsts[(firsts < frame - phases.lap_length / 2) & (lap[firsts] < lap[frame])]
        avoidable += bool((phases.apart(place[known], place[frame]) <= tolerance).any())
        others = is_recognised & (first == first[frame]) & (lap != lap[frame])
        away = (place[others] - place[frame] + phases.lap_length // 2) % phases.lap_length
        if len(away):
            repeated += abs(float(np.median(away)) - phases.lap_length // 2) <= tolerance
    if not is_recognised.any():
        return RecognitionErrors(0, 0.0, 0.0, 0.0, math.nan, math.nan)
    least = np.minimum(certainty, certainty[first])[is_recognised]
    right = (apart <= tolerance)[is_recognised]
    low, high = np.quantile(least, (0.25, 0.75))
    count = max(len(wrong), 1)
    return RecognitionErrors(
        len(wrong), float((apart[wrong] <= 2 * tolerance).sum() / count), avoidable / count,
        repeated / count, float(right[least <= low].mean()), float(right[least >= high].mean()),
    )


def measure(
    folder: Path, phases: LapPhases, stamp_ns: NDArray[np.int64], tolerance: int
) -> LapMeasures:
    """Return the measures of the results of a replay.

    Args:
        folder: folder of the results.
        phases: laps and places of the n frames of the recording.
        stamp_ns: (n,) stamps of the frames.
        tolerance: largest distance between frames of the same place, in frames.
    """
    ids = template_ids(folder, stamp_ns)
    trajectory = read_tum(folder / 'trajectory_final.tum')
    position_m, heading_rad = poses_at(trajectory, stamp_ns)
    reckoned_m, _ = poses_at(read_tum(folder / 'dead_reckoning.tum'), stamp_ns)
    after_gap_ns = trajectory.stamp_ns[1:][np.diff(trajectory.stamp_ns) > MAX_GAP_NS]
    part = np.searchsorted(after_gap_ns, stamp_ns, side='right')
    return LapMeasures(
        *phases.recognition(ids, tolerance), spread(position_m, phases),
        turns(heading_rad, phases, part), spread(reckoned_m, phases),
    )


def revisits(phases: LapPhases) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """Return all pairs of a frame and one of a later lap with the same place."""
    earlier, later = [], []
    for place in np.unique(phases.place[phases.place >= 0]):
        frames = np.flatnonzero(phases.place == place)
        i, j = np.nonzero(phases.lap[frames][:, None] < phases.lap[frames])
        earlier.append(frames[i])
        later.append(frames[j])
    return np.concatenate(earlier), np.concatenate(later)


def distances_m(position_m: NDArray[np.float64], phases: LapPhases) -> tuple[float, float]:
    """Return the median distance of revisits, nan if there are none, and the diameter.

    Args:
        position_m: (n, 2) positions of the frames.
        phases: laps and places of the frames.
    """
    earlier, later = revisits(phases)
    apart_m = np.linalg.norm(position_m[earlier] - position_m[later], axis=1)
    median_m = float(np.median(apart_m)) if len(apart_m) else math.nan
    return median_m, float(pdist(position_m[phases.place >= 0]).max())


def spread(position_m: NDArray[np.float64], phases: LapPhases) -> float:
    """Return the spread of (n, 2) positions of the frames."""
    median_m, diameter_m = distances_m(position_m, phases)
    return median_m / diameter_m


def turns(
    heading_rad: NDArray[np.float64], phases: LapPhases, part: NDArray[np.intp]
) -> float:
    """Return the turns for each lap, nan if no place was visited twice in one part.

    Args:
        heading_rad: (n,) unwrapped headings of the frames.
        phases: laps and places of the frames.
        part: (n,) number of the part of each frame, in which all motions are known.
    """
    difference_rad: list[float] = []
    for place in np.unique(phases.place[phases.place >= 0]):
        frames = np.flatnonzero(phases.place == place)
        is_next = (np.diff(frames) > phases.lap_length / 4) & (np.diff(part[frames]) == 0)
        difference_rad += np.diff(heading_rad[frames])[is_next].tolist()
    return abs(float(np.median(difference_rad))) / math.tau if difference_rad else math.nan


def image_stamps(recording: Recording, selection: Selection) -> NDArray[np.int64]:
    """Return the stamps of all images of a recording, in ns."""
    return np.array([
        event.stamp_ns for event in recording.events(selection) if isinstance(event, ImageEvent)
    ])


@dataclass(frozen=True)
class Setup:
    """Configuration of replays, and whether each recording is inspected first.

    fixed: names of the parameters that the inspection keeps.
    """

    config: Config
    look_ahead: bool = True
    fixed: tuple[str, ...] = ()

    @classmethod
    def of(cls, options: argparse.Namespace) -> Setup:
        """Return the setup of the options of ``add_options``."""
        values = dict(map(parse_setting, options.set))
        config = load_config(options.config)[0].with_values(values)
        return cls(config, options.config is None and not options.no_inspect, tuple(values))

    @staticmethod
    def add_options(parser: argparse.ArgumentParser) -> None:
        """Add the options that `of` evaluates."""
        parser.add_argument('--data', type=Path, default=ROOT.parent / 'shared' / 'data')
        parser.add_argument('--config', metavar='FILE|PRESET', help='default: none, inspected')
        parser.add_argument('--set', action='append', default=[], metavar='section.name=value')
        parser.add_argument('--no-inspect', action='store_true')

    def replay(self, recording: Recording, out: Path) -> tuple[dict[str, Any], tuple[str, ...]]:
        """Replay a recording; return the content of summary.json and the inspection's lines."""
        selection, config, lines = recording.select(), self.config, ()
        if self.look_ahead:
            found = inspect(recording, selection, config, self.fixed)
            config, lines = found.config, found.lines
        options = ReplayOptions(progress=False)
        return replay(recording, selection, config, out, options).summary, lines


def in_processes(
    work: Callable[[Task], Result], tasks: Iterable[Task], jobs: int,
    start: Callable[[], object] = warm_up,
) -> Iterator[tuple[Task, Result | RatslamError]]:
    """Work on tasks in new processes; yield each with its result, or its error, at its end.

    Args:
        work: called with each task; a function of a module, or a partial of one.
        tasks: hashable arguments.
        jobs: number of processes.
        start: called once in each process.
    """
    context = multiprocessing.get_context('spawn')
    with ProcessPoolExecutor(jobs, context, start) as pool:
        running = {pool.submit(work, task): task for task in tasks}
        for future in as_completed(running):
            try:
                yield running[future], future.result()
            except RatslamError as error:
                yield running[future], error


@dataclass(frozen=True)
class LapRun:
    """Measures, errors, content of summary.json, and lines of the inspection of a replay.

    The errors are None if the labels have no certainty.
    """

    measures: LapMeasures
    errors: RecognitionErrors | None
    summary: dict[str, Any]
    lines: tuple[str, ...]


def run_laps(
    data: Path, laps: Laps, setup: Setup, variant: str = ORIGINAL, out: Path | None = None,
    count: int | None = None,
) -> LapRun:
    """Replay a variant of a recording of laps, and measure the map.

    Args:
        data: folder of the recordings.
        laps: the recording.
        setup: configuration.
        variant: its name.
        out: folder for the results, None for a temporary one.
        count: number of laps from the start that are replayed, None for all.
    """
    if out is None:
        with tempfile.TemporaryDirectory() as temporary:
            return run_laps(data, laps, setup, variant, Path(temporary), count)
    table = laps.path(data) / 'lap_phase.csv'
    phases, certainty = read_lap_phases(table), read_certainty(table)
    with laps.open(data, variant) as recording, laps.open(data) as original:
        selection = original.select()
        stamp_ns = np.array([
            recording.stamp_ns(stamp) for stamp in image_stamps(original, selection).tolist()
        ])
        if count is not None and (phases.lap > count).any():
            end = Variant(until_ns=int(stamp_ns[np.argmax(phases.lap > count)]))
            recording = ChangedRecording(recording, end)
        used = np.isin(stamp_ns, image_stamps(recording, selection))
        summary, lines = setup.replay(recording, out)
    phases = phases.only(used)
    errors = None if certainty is None else recognition_errors(
        phases, template_ids(out, stamp_ns), laps.tolerance, certainty
    )
    return LapRun(measure(out, phases, stamp_ns, laps.tolerance), errors, summary, lines)
