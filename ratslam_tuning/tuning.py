# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""``ratslam tune``: propose a configuration for a recording, without ground truth.

Candidates are the default configuration, all presets, and variations of the best of them. Each
candidate builds a map from the recording, or from a part of it with many revisits. The maps are
scored by the revisits that sequences of images show (`ratslam_tuning.map_score`). One half
of the revisits selects the candidate; the other half decides whether it replaces the default.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from ratslam_ros.core.config import Config, LocalViewParameters, Value, VisualOdometryParameters
from ratslam_ros.core.config.parameter import AUTOMATIC
from ratslam_ros.errors import UnusableInput, UnusableParameter
from ratslam_ros.files.config import DEFAULT
from ratslam_ros.messages.json_schema import NS_PER_S
from ratslam_ros.recordings import Recording, Selection
from ratslam_ros.results.plots import BLACK, BLUE, GREY, VERMILLION, new_figure, save_figure
from ratslam_ros.results.trajectory import thinned
from ratslam_tuning.map_score import MapScore, Rows, poses_at, score_map
from ratslam_tuning.revisits import (
    MAX_FRAME_COUNT,
    Evidence,
    FrameScaler,
    Image,
    measure,
    sample_frames,
)
from ratslam_tuning.trials import WHOLE_SPAN, Span, Trial, run_trials
from ratslam_tuning.view_search import ViewRating, ViewSearch, descriptors

MIN_FRAME_COUNT = 50
SCREENED_FRAME_COUNT = 3000
"""Number of images of the part of a long recording that all candidates are replayed on."""

FINALIST_COUNT = 3
"""Number of candidates that are replayed on the whole recording, beside the default."""

BLOCK_COUNT = 10
"""Number of blocks of equally many revisits; every second one is held out."""

MIN_BLOCK_REVISITS = 3
EQUAL_SCORE = 0.02
"""Differences below this are noise. Of nearly equal candidates, the one tried first is preferred:
the default, then presets, then variations. The default is replaced by a candidate whose score is
higher by at least this, and by the standard error, on both halves of the revisits."""

LARGE_GAIN = 0.1
CONCEDED = 0.01
"""Unless the gain is large, neither precision nor recall, joined revisits or unfolded places may
be lower than those of the default by more than this."""

VIEWS_PER_DESCRIPTOR = 2
SHOWN_COUNT = 8
FIELDS_OF_VIEW_DEG = (60.0, 90.0, 120.0, 150.0)
"""Tried if the field of view is neither recorded nor set nor estimated while driving."""

MOTION_PARAMETERS = {
    'inputs.odom_source', 'inputs.odom_rotation_gain', 'inputs.odom_turn_per_m',
    'inputs.max_odom_gap_s', 'pose_cells.odom_calibration',
}
"""Parameters of the odometry."""


@dataclass(frozen=True)
class Candidate:
    """A configuration and its map.

    Attributes:
        name: short description.
        trial: the map, with the configuration.
        score: score on the revisits that candidates are selected by.
        held_out: score on the other revisits.
    """

    name: str
    trial: Trial
    score: MapScore
    held_out: MapScore

    def format(self) -> str:
        """Format the candidate as a row below `HEADER`."""
        s, h = self.score, self.held_out
        return (f'{self.name[:44]:44}{s.total:7.3f}{h.total:10.3f}{h.precision:11.2f}'
                f'{h.recall:8.2f}{h.joined:8.2f}{h.folded:8.2f}{self.trial.loop_closures:10d}')


HEADER = (f'{"candidate":44}{"score":>7}{"held out":>10}{"precision":>11}{"recall":>8}'
          f'{"joined":>8}{"folded":>8}{"closures":>10}')


@dataclass(frozen=True)
class Proposal:
    """Proposed configuration, with the evidence for it.

    Attributes:
        config: the proposed configuration.
        settings: `section.name=value` for the parameters that differ from the default.
        reasons: explanation in lines of text.
        chosen: its candidate, None if no candidate was tried.
        default: candidate of the default configuration, likewise.
        runner_up: the best other candidate with another local view, None if there is none.
        candidates: those to show, best first.
        rating: errors of right and wrong matches with the proposed local view, None if it does
            not fit the frames.
        sample: (H, W) uint8, a frame of the recording.
        window: x_min, x_max, y_min, y_max of the crop in it, in pixels.
    """

    config: Config
    settings: tuple[str, ...]
    reasons: tuple[str, ...]
    chosen: Candidate | None
    default: Candidate | None
    runner_up: Candidate | None
    candidates: tuple[Candidate, ...]
    rating: ViewRating | None
    sample: Image
    window: tuple[int, int, int, int]

    def format(self) -> str:
        """Format the proposal for a terminal."""
        lines = list(self.reasons)
        if self.candidates:
            lines += ['', HEADER]
            for candidate in self.candidates:
                marks = [name for name, other in (('proposed', self.chosen),
                                                  ('runner-up', self.runner_up))
                         if candidate is other]
                lines.append(f'{candidate.format()}  {" ".join(marks)}'.rstrip())
        lines += ['', 'different from the default:' if self.settings else
                  'the default configuration is proposed']
        return '\n'.join([*lines, *(f'  {setting}' for setting in self.settings)])


def propose(
    recording: Recording,
    selection: Selection,
    default: Config,
    others: Mapping[str, Config],
    span: Span = WHOLE_SPAN,
    report: Callable[[str], None] = lambda line: None,
) -> Proposal:
    """Propose a configuration for a recording.

    Args:
        recording: the recording; it must have images.
        selection: its topics to use.
        default: the configuration to compare with.
        others: further configurations to try, by name.
        span: the part of the recording to use.
        report: called with a line of text before each stage.

    Raises:
        UnusableInput: fewer than 50 images, or images of different sizes.
        UnusableParameter: the default does not fit the images.
    """
    scaler = FrameScaler(default.local_view)
    frames = sample_frames(
        recording, selection, span.start_s, span.duration_s,
        grey=default.inputs.image_grey,
    )
    kept = thinned(((stamp_ns, scaler.shrink(image)) for stamp_ns, image in frames),
                   MAX_FRAME_COUNT)
    if len(kept) < MIN_FRAME_COUNT:
        raise UnusableInput(f'{len(kept)} images to tune with, expected {MIN_FRAME_COUNT} or more')
    stamp_ns = np.array([stamp for stamp, _ in kept], np.int64)
    images = np.stack([image for _, image in kept])
    report(f'searching {len(images)} images for revisits')
    duration_s = (stamp_ns[-1] - stamp_ns[0]) / NS_PER_S
    seen = f'{len(images)} images over {duration_s:.0f} s'
    try:
        evidence = measure(images, stamp_ns)
    except UnusableInput as error:
        return _without_revisits(default, scaler, (f'{seen}: {error}',))
    supported = int(evidence.is_supported.sum())
    seen += (f'; {supported} show a place that was seen more than {evidence.gap_s:.1f} s before, '
             f'{int(evidence.is_unsupported.sum())} a new place')
    if not evidence.revisits:
        return _without_revisits(default, scaler, (
            seen, 'too few revisits to compare maps with: drive some loops twice, or tune on a '
            'longer part of the recording'))
    search = _Search(recording, selection, span, evidence, default, report)
    views = ViewSearch(images, evidence)
    for stage in (_presets(default, others), _views(search, views, scaler), _variations(search),
                  _variations(search)):
        search.try_all(stage)
    search.finish()
    return _proposal(search, views, scaler, seen)


def _without_revisits(default: Config, scaler: FrameScaler, reasons: tuple[str, ...]) -> Proposal:
    return Proposal(default, (), reasons, None, None, None, (), None, scaler.sample,
                    scaler.window(default.local_view))


class _Search:
    """The candidates tried so far, on a part of the recording or on all of it."""

    def __init__(
        self, recording: Recording, selection: Selection, span: Span, evidence: Evidence,
        default: Config, report: Callable[[str], None],
    ) -> None:
        self.default = default
        self.evidence = evidence
        self.visual_odometry = selection.odom_topic is None
        self.calibrated = recording.calibration(selection) is not None
        self._recording, self._selection, self.report = recording, selection, report
        self._span = span
        self._part = _part_with_revisits(recording, selection, span, evidence)
        self._scans = selection.scan_topic is not None
        blocks = _blocks(evidence)
        self._selected = np.flatnonzero(blocks % 2 == 0)
        self._held_out = np.flatnonzero(blocks % 2 == 1)
        self._held_out_blocks = [np.flatnonzero(blocks == block)
                                 for block in range(1, BLOCK_COUNT, 2)]
        self._tried: dict[Config, Candidate | None] = {}

    @property
    def candidates(self) -> list[Candidate]:
        """Candidates that fit the recording, in the order of the trials."""
        return [candidate for candidate in self._tried.values() if candidate is not None]

    @property
    def best(self) -> Candidate:
        """The first of the candidates within `EQUAL_SCORE` of the best score."""
        return ranked(self.candidates)[0]

    def try_all(self, named: Iterator[tuple[str, Config]]) -> None:
        """Run the trials of configurations that have not been tried yet."""
        fresh: dict[Config, str] = {}
        for name, config in named:
            if not self._scans:
                config = config.with_values({'experience_map.exp_align_scans': False})
            if config not in self._tried:
                fresh.setdefault(config, name)
        if not fresh:
            return
        part = self._part
        self.report(f'replaying {len(fresh)} configurations'
                     + ('' if part == self._span else f' on {part.duration_s:.0f} s'))
        self._run(fresh, part)

    def finish(self) -> None:
        """Replay the finalists and the default on the whole recording if only a part was used."""
        if self._part == self._span:
            return
        finalists = with_different_views(ranked(self.candidates))[:FINALIST_COUNT]
        names = {self.default_candidate.trial.config: DEFAULT,
                 **{candidate.trial.config: candidate.name for candidate in finalists}}
        self._tried.clear()
        self.report(f'replaying {len(names)} configurations on the whole recording')
        self._run(names, self._span)

    @property
    def default_candidate(self) -> Candidate:
        """The candidate with the default configuration, which is tried first."""
        return self.candidates[0]

    def _run(self, named: Mapping[Config, str], part: Span) -> None:
        trials = run_trials(self._recording, self._selection, list(named), part)
        for (config, name), trial in zip(named.items(), trials, strict=True):
            if isinstance(trial, UnusableParameter):
                if name == DEFAULT:
                    raise trial
                self._tried[config] = None
                continue
            self._tried[config] = Candidate(
                name, trial, score_map(trial, self.evidence, self._selected),
                score_map(trial, self.evidence, self._held_out))

    @property
    def contender(self) -> Candidate | None:
        """The best candidate that exceeds the default on the selected revisits."""
        default = self.default_candidate
        return next((candidate for candidate in ranked(self.candidates)
                     if is_better(candidate.score, default.score)), None)

    def is_confirmed(self, candidate: Candidate) -> bool:
        """Return whether a candidate exceeds the default on the held-out revisits."""
        other = self.default_candidate
        gain = candidate.held_out.total - other.held_out.total
        gains = [score_map(candidate.trial, self.evidence, rows).total
                 - score_map(other.trial, self.evidence, rows).total
                 for rows in self._held_out_blocks if _revisit_count(self.evidence, rows)]
        error = float(np.std(gains, ddof=1)) / math.sqrt(len(gains)) if len(gains) > 1 else 0.0
        return is_better(candidate.held_out, other.held_out) and gain >= error


def is_better(score: MapScore, default: MapScore) -> bool:
    """Return whether a score exceeds that of the default clearly, and in every respect."""
    gain = score.total - default.total
    if gain >= LARGE_GAIN:
        return True
    pairs = ((score.precision, default.precision), (score.recall, default.recall),
             (score.joined, default.joined), (default.folded, score.folded))
    return gain >= EQUAL_SCORE and all(mine >= other - CONCEDED for mine, other in pairs)


def ranked(candidates: list[Candidate]) -> list[Candidate]:
    """Return the candidates, best first; of nearly equal ones, the one tried first.

    Candidates without loop closures come last.
    """
    left = sorted(candidates, key=lambda c: (c.trial.loop_closures == 0, -c.score.total))
    order = {id(candidate): index for index, candidate in enumerate(candidates)}
    if left and left[0].trial.loop_closures:
        top = left[0].score.total - EQUAL_SCORE
        first = min((c for c in left if c.trial.loop_closures and c.score.total >= top),
                    key=lambda c: order[id(c)])
        left.remove(first)
        left.insert(0, first)
    return left


def with_different_views(candidates: list[Candidate]) -> list[Candidate]:
    """Return the first candidate with each set of local view parameters."""
    first: dict[LocalViewParameters, Candidate] = {}
    for candidate in candidates:
        first.setdefault(candidate.trial.config.local_view, candidate)
    return list(first.values())


def _blocks(evidence: Evidence) -> Rows:
    """Return the number of the block of each frame: consecutive, with equally many revisits."""
    supported = evidence.is_supported.astype(np.intp)
    before: Rows = np.cumsum(supported) - supported
    return np.minimum(before * BLOCK_COUNT // max(int(supported.sum()), 1), BLOCK_COUNT - 1)


def _revisit_count(evidence: Evidence, rows: Rows) -> bool:
    return int(evidence.is_supported[rows].sum()) >= MIN_BLOCK_REVISITS


def _part_with_revisits(
    recording: Recording, selection: Selection, span: Span, evidence: Evidence
) -> Span:
    """Return the part of a long recording that has the most revisits within itself."""
    stamp_ns = evidence.stamp_ns
    duration_s = float(stamp_ns[-1] - stamp_ns[0]) / NS_PER_S
    length_s = (recording.end_ns - recording.start_ns) / NS_PER_S
    image_count = recording.count().get(selection.image_topic or '', 0) * min(
        duration_s / max(length_s, 1e-9), 1.0)
    if image_count <= SCREENED_FRAME_COUNT:
        return span
    frames = max(round(len(stamp_ns) * SCREENED_FRAME_COUNT / image_count), 2)
    revisit = np.flatnonzero(evidence.is_supported)
    starts = np.linspace(0, len(stamp_ns) - frames, 21).astype(int).tolist()
    begin = max(starts, key=lambda first: int(np.sum(
        (revisit < first + frames) & (evidence.match[revisit] >= first))))
    since_s = float(stamp_ns[begin] - stamp_ns[0]) / NS_PER_S
    return Span(span.start_s + since_s, frames * evidence.period_s)


# Candidates


def _presets(default: Config, others: Mapping[str, Config]) -> Iterator[tuple[str, Config]]:
    yield DEFAULT, default
    yield from others.items()


def _views(search: _Search, views: ViewSearch,
           scaler: FrameScaler) -> Iterator[tuple[str, Config]]:
    """Yield the best local views of each descriptor, with the best back ends."""
    search.report('comparing local views')
    best = search.best.trial.config
    bases = list(dict.fromkeys((best, search.default)))
    for start in _starts(search):
        try:
            found = views.best(scaler.to_small(start), VIEWS_PER_DESCRIPTOR)
        except UnusableParameter:
            continue
        for rating in found:
            view = scaler.to_full(rating.parameters)
            for base in bases:
                name = describe_view(view) + (', default back end' if base != best else '')
                yield name, replace(base, local_view=view)
                if not view.vt_recent_templates:
                    fine = replace(view, vt_recent_templates=10, vt_recent_threshold=0.4)
                    yield f'{name}, recent 10', replace(base, local_view=fine)


def _starts(search: _Search) -> Iterator[LocalViewParameters]:
    """Yield the best local view tried so far with each descriptor."""
    order = [candidate.trial.config.local_view for candidate in ranked(search.candidates)]
    for start in descriptors(search.default.local_view):
        yield next((p for p in order if p.vt_descriptor == start.vt_descriptor), start)


def _variations(search: _Search) -> Iterator[tuple[str, Config]]:
    """Yield single changes of the best candidate; called again, changes of that result."""
    best = search.best
    for name, changes in _changes(search):
        yield from _changed(best, name, changes)


def _changed(base: Candidate, name: str,
             changes: Mapping[str, Value]) -> Iterator[tuple[str, Config]]:
    try:
        yield f'{base.name}, {name}', base.trial.config.with_values(changes)
    except UnusableParameter:
        return


def _changes(search: _Search) -> Iterator[tuple[str, dict[str, Value]]]:
    """Yield names and values of single changes."""
    config = search.best.trial.config
    view, cells = config.local_view, config.pose_cells
    if view.vt_match_threshold != AUTOMATIC:
        for factor in (0.85, 1.18):
            threshold = float(f'{view.vt_match_threshold * factor:.3g}')
            yield f'threshold {threshold:g}', {'local_view.vt_match_threshold': threshold}
        yield 'automatic threshold', {'local_view.vt_match_threshold': AUTOMATIC}
    if cells.pc_cell_x_size > 0.0:
        for factor in (0.5, 2.0):
            size = float(f'{cells.pc_cell_x_size * factor:.3g}')
            yield f'cells of {size:g} m', {'pose_cells.pc_cell_x_size': size}
    for delta in (0.7, 2.0):
        if cells.exp_delta_pc_threshold not in (delta, AUTOMATIC):
            yield f'delta {delta:g}', {'pose_cells.exp_delta_pc_threshold': delta}
    motion = {key: value for key, value in search.default.flat().items()
              if key.startswith('visual_odometry.') or key in MOTION_PARAMETERS}
    yield 'motion of the default', motion
    guessed = config.visual_odometry.camera_fov_deg == VisualOdometryParameters.camera_fov_deg
    is_known = search.calibrated or config.pose_cells.odom_calibration
    if search.visual_odometry and guessed and not is_known:
        for fov_deg in FIELDS_OF_VIEW_DEG:
            yield f'field of view {fov_deg:g}', {'visual_odometry.camera_fov_deg': fov_deg}


def describe_view(p: LocalViewParameters) -> str:
    """Format descriptor, size, normalisation and crop."""
    crop = ''
    if (p.image_crop_x_min, p.image_crop_x_max, p.image_crop_y_min, p.image_crop_y_max) != (
            0, -1, 0, -1):
        crop = (f' crop {p.image_crop_x_min}:{p.image_crop_x_max} '
                f'{p.image_crop_y_min}:{p.image_crop_y_max}').replace('-1', '')
    patch = f' patch {p.vt_patch_normalise}' if p.vt_patch_normalise else ''
    return f'{p.vt_descriptor} {p.template_x_size}x{p.template_y_size}{patch}{crop}'


# Result


def _proposal(search: _Search, views: ViewSearch, scaler: FrameScaler, seen: str) -> Proposal:
    order = ranked(search.candidates)
    default, contender = search.default_candidate, search.contender
    chosen = contender if contender and search.is_confirmed(contender) else default
    others = [candidate for candidate in order if candidate is not chosen]
    view = chosen.trial.config.local_view
    runner_up = next((c for c in others if c.trial.config.local_view != view), None)
    shown = [chosen, *others[:SHOWN_COUNT - 1]]
    if default not in shown:
        shown.append(default)
    reasons = [seen, _reason(chosen, default, contender)]
    if not chosen.trial.loop_closures:
        reasons.append('places are seen again, but no candidate closes a loop: check the odometry '
                       'and the crop')
    config = chosen.trial.config
    try:
        rating = views.rate(scaler.to_small(config.local_view))
    except UnusableParameter:
        rating = None
    return Proposal(
        config, _settings(search.default, config), tuple(reasons), chosen, default,
        runner_up, tuple(shown), rating, scaler.sample,
        scaler.window(config.local_view))


def _reason(chosen: Candidate, default: Candidate, contender: Candidate | None) -> str:
    if chosen is not default:
        return (f'proposed: {chosen.name}, held-out score {chosen.held_out.total:.3f}; '
                f'default {default.held_out.total:.3f}')
    if contender is None:
        return ('the default is proposed: no candidate is clearly better than its score of '
                f'{default.score.total:.3f}')
    return (f'the default is proposed, held-out score {default.held_out.total:.3f}: '
            f'{contender.name} reaches {contender.held_out.total:.3f}, not clearly more')


def _settings(default: Config, config: Config) -> tuple[str, ...]:
    before = default.flat()
    return tuple(
        f'{key}={value}' for key, value in config.flat().items() if value != before[key])


def plot_proposal(proposal: Proposal, path: str | Path) -> Path:
    """Draw the match errors, the crop, and the maps of the proposal and of the default.

    Raises:
        UnusableInput: the file cannot be written.
    """
    from matplotlib.patches import Rectangle

    figure = new_figure(11.0, 8.0)
    grid = figure.add_gridspec(2, 2)
    histogram, frame = figure.add_subplot(grid[0, 0]), figure.add_subplot(grid[0, 1])
    rating = proposal.rating
    if rating is not None and len(rating.right) + len(rating.wrong):
        top = 1.05 * max(float(e.max()) for e in (rating.right, rating.wrong) if len(e))
        bins = np.linspace(0.0, top, 60).tolist()
        for errors, colour, label in ((rating.right, BLUE, 'same place'),
                                      (rating.wrong, VERMILLION, 'other place')):
            histogram.hist(errors, bins, color=colour, alpha=0.6, label=f'{label}: {len(errors)}')
        threshold = proposal.config.local_view.vt_match_threshold
        if threshold != AUTOMATIC:
            histogram.axvline(threshold, color=BLACK, linestyle='--',
                              label=f'threshold {threshold:g}')
        histogram.set(xlabel='error of the best match with an earlier frame',
                      ylabel='number of frames', xlim=(0.0, top))
        histogram.set_title('local view of the proposal', fontsize=10)
        histogram.legend(fontsize=8)
    else:
        histogram.set_axis_off()
        histogram.text(0.5, 0.5, 'no place is clearly seen twice', ha='center')

    x_min, x_max, y_min, y_max = proposal.window
    frame.imshow(proposal.sample, cmap='gray', vmin=0, vmax=255)
    frame.add_patch(Rectangle((x_min - 0.5, y_min - 0.5), x_max - x_min, y_max - y_min,
                              fill=False, edgecolor=VERMILLION, linewidth=2.5))
    frame.set_title('crop', fontsize=10)
    frame.set_axis_off()

    second = proposal.runner_up if proposal.chosen is proposal.default else proposal.default
    for column, (title, candidate) in enumerate((('proposed', proposal.chosen),
                                                 ('compared', second))):
        axes = figure.add_subplot(grid[1, column])
        if candidate is None:
            axes.set_axis_off()
            continue
        path_m, _ = poses_at(candidate.trial.map, candidate.trial.view_ns)
        seen_again = candidate.trial.first_seen < np.arange(len(candidate.trial.view_ns))
        axes.plot(*path_m.T, color=GREY, linewidth=0.7)
        axes.plot(*path_m[seen_again].T, linestyle='', marker='.', markersize=2, color=BLUE)
        axes.set_aspect('equal', 'datalim')
        score = candidate.held_out
        axes.set_title(f'{title}: {candidate.name}\nheld-out score {score.total:.3f}, precision '
                       f'{score.precision:.2f}, recall {score.recall:.2f}, joined '
                       f'{score.joined:.2f}, folded {score.folded:.2f}', fontsize=9)
        axes.tick_params(labelsize=7)
    return save_figure(figure, path)
