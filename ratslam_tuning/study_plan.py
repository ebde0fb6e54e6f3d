# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Plan of a parameter study: recordings, parameters with their ranges, and the objective.

A study file is YAML; docs/tuning.md describes it.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
import yaml

from ratslam_ros.core.config import SECTIONS, Config, ParameterInfo, Value
from ratslam_ros.errors import RatslamError, UnusableInput, UnusableParameter
from ratslam_ros.files.config import DEFAULT, load_config
from ratslam_ros.limits import IMAGES_RATE_HZ
from ratslam_ros.recordings import Recording, Selection, open_recording
from ratslam_ros.results.evaluation import evaluate
from ratslam_ros.results.trajectory import Trajectory, read_tum
from ratslam_tuning.lap_phases import LapPhases, read_lap_phases
from ratslam_tuning.map_score import PRECISION_WEIGHT, f_measure, score_map
from ratslam_tuning.revisits import Evidence, FrameScaler, measure, sample_frames
from ratslam_tuning.trials import Span, Trial, run_trials

T = TypeVar('T')

LAP_TOLERANCE = 8
DEFAULT_TRIALS = 100
LOG_RATIO = 1000.0
"""Ranges over at least this ratio are searched on a logarithmic scale."""

PLAN_KEYS = {'name', 'config', 'set', 'recordings', 'parameters', 'trials', 'seed'}
RECORDING_KEYS = {
    'path', 'use', 'truth', 'lap_phase', 'lap_tolerance', 'start', 'duration', 'image_topic',
    'odom_topic', 'visual_odometry', 'images_rate',
}
RANGE_KEYS = {'low', 'high', 'step', 'log', 'values'}


@dataclass(frozen=True)
class Range:
    """Values of one parameter to search: a list, or an interval of numbers.

    Attributes:
        name: ``section.name``.
        values: the values; empty for an interval.
        low, high: the interval, both ends included; of integers if both are.
        step: difference between the values, None for any.
        log: whether small values are tried as densely as large ones.
    """

    name: str
    values: tuple[Value, ...] = ()
    low: float = 0.0
    high: float = 0.0
    step: float | None = None
    log: bool = False


@dataclass(frozen=True)
class StudyRecording:
    """A recording of a study, and how a map of it is judged.

    Attributes:
        path: the recording.
        search: whether it is used for the search; otherwise for validation.
        truth: TUM file with the true trajectory, None for none.
        lap_phase: CSV file with lap and place of each frame, None for none.
        lap_tolerance: largest distance between frames of the same place, in frames.
        span: the part of the recording to use.
        options: topics and frame rate, as for replay.
    """

    path: Path
    search: bool = True
    truth: Path | None = None
    lap_phase: Path | None = None
    lap_tolerance: int = LAP_TOLERANCE
    span: Span = field(default_factory=Span)
    options: Mapping[str, Any] = field(default_factory=dict)


@dataclass(frozen=True)
class Result:
    """Quality of one map.

    Attributes:
        value: objective, 0 to 1, larger is better.
        text: the figures that it was computed from.
    """

    value: float
    text: str


@dataclass(frozen=True)
class StudyPlan:
    """A parameter study.

    Attributes:
        name: name of the study in its storage.
        config: the initial configuration.
        recordings: at least one of them for the search.
        ranges: the parameters to search.
        trials: number of configurations to try.
        seed: seed of the sampler.
        notices: notices about the file of the initial configuration.
    """

    name: str
    config: Config
    recordings: tuple[StudyRecording, ...]
    ranges: tuple[Range, ...]
    trials: int = DEFAULT_TRIALS
    seed: int = 0
    notices: tuple[str, ...] = ()

    @property
    def initial(self) -> dict[str, Value]:
        """Values of the searched parameters in the initial configuration."""
        values = self.config.values()
        return {item.name: values[item.name.partition('.')[0]][item.name.partition('.')[2]]
                for item in self.ranges}

    @property
    def fingerprint(self) -> str:
        """Text that is equal for plans whose trials can be compared."""
        content = [[str(r.path), str(r.truth), str(r.lap_phase), r.lap_tolerance, str(r.span),
                    sorted(map(str, r.options.items()))] for r in self.recordings if r.search]
        return json.dumps([content, [str(item) for item in self.ranges],
                           self.config.with_values(self.initial).values()], sort_keys=True)


def read_plan(path: Path) -> StudyPlan:
    """Read a study file. Paths in it are relative to its folder.

    Raises:
        UnusableInput: the file or a file named in it cannot be read.
        UnusableParameter: a parameter is unknown, or a range is not valid for it.
    """
    try:
        document = yaml.safe_load(path.read_text(encoding='utf-8'))
    except (OSError, UnicodeDecodeError, yaml.YAMLError) as error:
        raise UnusableInput(f'{path} cannot be read: {" ".join(str(error).split())[:200]}; '
                            'expected a study file in YAML') from None
    try:
        return _plan(document, path)
    except RatslamError as error:
        raise type(error)(f'{path}: {error}') from None


def _plan(document: Any, path: Path) -> StudyPlan:
    plan = _mapping(document, 'the study', PLAN_KEYS)
    config, notices = load_config(_file_or_preset(plan.get('config', DEFAULT), path.parent))
    config = config.with_values(_mapping(plan.get('set') or {}, 'set'))
    entries = plan.get('recordings') or []
    if not isinstance(entries, list):
        raise UnusableInput('recordings is not a list; expected entries such as - path: FOLDER')
    recordings = tuple(_recording(entry, path.parent) for entry in entries)
    if not any(recording.search for recording in recordings):
        raise UnusableInput('there is no recording to search on; expected recordings, at least '
                            'one of them without use: validation')
    parameters = _mapping(plan.get('parameters') or {}, 'parameters')
    if not parameters:
        raise UnusableInput('there is nothing to vary; expected parameters, such as '
                            'pose_cells.pc_cell_x_size: {low: 0.1, high: 2}')
    ranges = tuple(_range(name, entry or {}, config) for name, entry in parameters.items())
    trials, seed = plan.get('trials', DEFAULT_TRIALS), plan.get('seed', 0)
    for name, number in (('trials', trials), ('seed', seed)):
        if not isinstance(number, int) or number < 0:
            raise UnusableInput(f'{name} is {number!r}; expected a whole number')
    return StudyPlan(str(plan.get('name', path.stem)), config, recordings, ranges, trials, seed,
                     tuple(notices))


def _mapping(value: Any, what: str, keys: set[str] | None = None) -> dict[str, Any]:
    if not isinstance(value, Mapping):
        raise UnusableInput(f'{what} is {value!r}; expected keys with values')
    unknown = sorted(str(key) for key in value if keys is not None and key not in keys)
    if keys is not None and unknown:
        raise UnusableInput(f'{what} has the unknown key {unknown[0]!r}; the keys are '
                            f'{", ".join(sorted(keys))}')
    return {str(key): item for key, item in value.items()}


def _file_or_preset(source: Any, folder: Path) -> str:
    path = folder / str(source)
    return str(path) if path.is_file() else str(source)


def _recording(entry: Any, folder: Path) -> StudyRecording:
    values = {'path': entry} if isinstance(entry, str) else _mapping(
        entry, 'a recording', RECORDING_KEYS)
    if 'path' not in values:
        raise UnusableInput('a recording has no path')
    use = values.get('use', 'search')
    if use not in ('search', 'validation'):
        raise UnusableInput(f'use is {use!r}; expected search or validation')
    if 'truth' in values and 'lap_phase' in values:
        raise UnusableInput(f'{values["path"]} has both truth and lap_phase; expected one')
    duration = values.get('duration')
    files = {key: folder / str(values[key]) for key in ('truth', 'lap_phase') if key in values}
    for key, file in files.items():
        if not file.is_file():
            raise UnusableInput(f'{key}: {file} does not exist')
    try:
        span = Span(float(values.get('start', 0.0)), None if duration is None else float(duration))
        tolerance = int(values.get('lap_tolerance', LAP_TOLERANCE))
        values |= {key: float(values[key]) for key in values if key == 'images_rate'}
    except (TypeError, ValueError):
        raise UnusableInput(
            'start, duration, lap_tolerance or images_rate is not a number'
        ) from None
    return StudyRecording(
        folder / str(values['path']), use == 'search', files.get('truth'), files.get('lap_phase'),
        tolerance, span,
        {key: values[key] for key in ('image_topic', 'odom_topic', 'visual_odometry',
                                      'images_rate') if key in values})


def _info(name: str) -> tuple[ParameterInfo, Value]:
    section, _, parameter = name.partition('.')
    for item, info, default in (SECTIONS[section].parameters() if section in SECTIONS else ()):
        if item == parameter:
            return info, default
    raise UnusableParameter(f'{name!r} names no parameter; expected section.name as in '
                            'docs/parameters.md')


def _range(name: str, entry: Any, config: Config) -> Range:
    """Return the range of a parameter; its own limits where the entry has none."""
    info, default = _info(name)
    if isinstance(entry, list):
        entry = {'values': entry}
    given = _mapping(entry, name, RANGE_KEYS)
    if 'values' in given or isinstance(default, (bool, str)):
        values = given.get('values', [False, True] if isinstance(default, bool)
                           else list(info.choices))
        if not isinstance(values, list) or len(values) < 2:
            raise UnusableParameter(f'{name}: expected values, a list of two or more')
        return Range(name, tuple(_checked(name, value) for value in values))
    low, high = given.get('low', info.low), given.get('high', info.high)
    for end in (low, high):
        if isinstance(end, bool) or not isinstance(end, (int, float)):
            raise UnusableParameter(f'{name}: {end!r} is not a number')
        if not info.low <= end <= info.high:
            raise UnusableParameter(f'{name}: {end:g} is out of range; expected '
                                    f'{info.low:g} to {info.high:g}')
    if not low < high:
        raise UnusableParameter(f'{name}: low is {low:g} and high {high:g}; expected low < high')
    kind = int if isinstance(default, int) else float
    log = bool(given.get('log', low > 0.0 and high / low >= LOG_RATIO))
    if log and low <= 0.0:
        raise UnusableParameter(f'{name}: log requires low above 0')
    step = given.get('step', 1 if kind is int else None)
    return Range(name, (), kind(low), kind(high), None if log else step, log)


def _checked(name: str, value: Any) -> Value:
    """Return a value of a list; whether it fits others is decided when it is tried."""
    if not isinstance(value, (bool, int, float, str)):
        raise UnusableParameter(f'{name}: {value!r} is not a value')
    return value


class Judge:
    """Computes the objective of maps of one recording.

    - With a true trajectory: 1 / (1 + ATE / ATE of the initial configuration), which is 0.5 for
      the initial configuration.
    - With lap phases: the F-measure of the recognition.
    - Otherwise: the score of ``ratslam tune``, by the revisits that the images show.
    """

    def __init__(self, recording: StudyRecording, initial: Config) -> None:
        """Prepare; the recording is read when the first map is judged."""
        self.recording = recording
        self._initial = initial

    @property
    def name(self) -> str:
        """Name for tables."""
        return self.recording.path.resolve().name

    def check(self) -> None:
        """Open the recording, select its topics, and read the truth or the laps.

        Raises:
            UnusableInput: one of them cannot be used.
        """
        images = self._with_recording(lambda _, selection: selection.image_topic is not None)
        if self.recording.truth is not None:
            self._truth  # noqa: B018 - reads the file
        elif self.recording.lap_phase is not None:
            self._phases  # noqa: B018
        elif not images:
            raise UnusableInput(f'{self.recording.path} has no images, so that its maps cannot '
                                'be judged by them; give truth or lap_phase')

    def judge(self, config: Config) -> Result:
        """Build the map of a configuration and compute its objective.

        Raises:
            UnusableInput: the recording cannot be used.
            UnusableParameter: the configuration does not fit the images.
        """
        trial = self._trial(config)
        if self.recording.truth is not None:
            ate_m = self._ate_m(trial)
            return Result(1.0 / (1.0 + ate_m / max(self._initial_ate_m, 1e-9)),
                          f'ATE {ate_m:.3f} m')
        if self.recording.lap_phase is not None:
            precision, recall = self._phases.recognition(
                trial.template_id, self.recording.lap_tolerance)
            return Result(f_measure(precision, recall, PRECISION_WEIGHT),
                          f'precision {precision:.3f}, recall {recall:.3f}')
        score = score_map(trial, self._evidence)
        return Result(score.total, (
            f'precision {score.precision:.3f}, recall {score.recall:.3f}, joined '
            f'{score.joined:.3f}, folded {score.folded:.3f}'))

    def _with_recording(self, use: Callable[[Recording, Selection], T]) -> T:
        options = dict(self.recording.options)
        rate_hz = options.pop('images_rate', IMAGES_RATE_HZ)
        with open_recording(self.recording.path, images_rate_hz=rate_hz) as recording:
            return use(recording, recording.select(**options))

    def _trial(self, config: Config) -> Trial:
        trials = self._with_recording(
            lambda recording, selection: run_trials(
                recording, selection, [config], self.recording.span))
        if isinstance(trials[0], UnusableParameter):
            raise trials[0]
        return trials[0]

    def _ate_m(self, trial: Trial) -> float:
        return evaluate(trial.map, self._truth).ate.rmse

    @cached_property
    def _truth(self) -> Trajectory:
        assert self.recording.truth is not None
        return read_tum(self.recording.truth)

    @cached_property
    def _phases(self) -> LapPhases:
        assert self.recording.lap_phase is not None
        return read_lap_phases(self.recording.lap_phase)

    @cached_property
    def _initial_ate_m(self) -> float:
        return self._ate_m(self._trial(self._initial))

    @cached_property
    def _evidence(self) -> Evidence:
        def read(recording: Recording, selection: Selection) -> Evidence:
            scaler = FrameScaler(self._initial.local_view)
            span = self.recording.span
            frames = [(stamp_ns, scaler.shrink(image)) for stamp_ns, image in sample_frames(
                recording, selection, span.start_s, span.duration_s)]
            if len(frames) < 2:
                raise UnusableInput(f'{recording.path} has {len(frames)} usable images')
            evidence = measure(np.stack([image for _, image in frames]),
                               np.array([stamp_ns for stamp_ns, _ in frames], np.int64))
            if not evidence.revisits:
                raise UnusableInput(f'{recording.path} shows too few revisits to judge maps by; '
                                    'give truth or lap_phase, or use another recording')
            return evidence

        return self._with_recording(read)
