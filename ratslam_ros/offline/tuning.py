# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""``ratslam tune``: propose local-view parameters for a recording, without ground truth.

The match errors of revisits and those of chance matches (`ratslam_ros.offline.revisits`) form two
histograms. A good crop, template size and normalisation separates them, and the threshold belongs
between them.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass, fields, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from ratslam_ros.core.config import LocalViewParameters
from ratslam_ros.core.vision.intensity import crop_window
from ratslam_ros.errors import UnusableInput, UnusableParameter
from ratslam_ros.messages.json_schema import NS_PER_S
from ratslam_ros.offline.revisits import (
    MAX_FRAME_COUNT,
    NO_MATCH,
    Errors,
    Evidence,
    FrameScaler,
    Image,
    measure,
)
from ratslam_ros.results.plots import BLACK, BLUE, GREY, VERMILLION, new_figure, save_figure
from ratslam_ros.results.trajectory import thinned

SIZES = ((12, 8), (20, 12), (32, 16), (48, 24), (60, 10), (60, 20))
PATCHES = (0, 2, 4)
MIN_FRAME_COUNT = 50
SCREENING_FRAME_COUNT = 700
"""Number of frames to rank the candidates with; the best one is measured on all frames."""

FALSE_WEIGHT_RATIO = 4.0
"""Cost of a wrong recognition relative to the gain of a right one."""

CONCEDED_SCORE = 0.05
"""Score given up for a lower threshold, which gives finer places and fewer wrong matches."""

EQUAL_SCORE = 0.02
"""Candidates whose scores differ by less are ranked by d-prime."""

MIN_D_PRIME = 2.3
"""If the histograms are closer than this, both are of chance matches."""

CHANCE_PASS_RATE = 0.02
"""Share of chance matches below the threshold if the recording has no revisits."""

STATIC_RATIO = 0.15
"""Rows and columns with a smaller fraction of the median deviation over time are static."""


@dataclass(frozen=True)
class Candidate:
    """A set of parameters, and how well it separates revisits from chance matches.

    score: share of frames recognised correctly at the threshold, minus `FALSE_WEIGHT_RATIO`
    times the share recognised wrongly. d_prime: distance between the means of the two histograms
    in standard deviations. recall, false_rate: shares of the revisits and of the chance matches
    below the threshold.
    """

    parameters: LocalViewParameters
    score: float
    d_prime: float
    recall: float
    false_rate: float

    def describe(self) -> str:
        """Format the size, normalisation and crop, at most 38 characters."""
        p = self.parameters
        crop = (f'x {p.image_crop_x_min}:{p.image_crop_x_max} '
                f'y {p.image_crop_y_min}:{p.image_crop_y_max}').replace('-1', '')
        return f'{p.template_x_size}x{p.template_y_size} patch {p.vt_patch_normalise} crop {crop}'


@dataclass(frozen=True)
class Proposal:
    """Proposed parameters, with the evidence for them.

    settings: `local_view.name=value` for the parameters that differ from the initial ones.
    revisits: False if the recording has no revisits. candidates: by score, best first.
    reasons: explanation in lines of text. supported, unsupported, neighbour: match errors with
    the proposed parameters of revisits, of chance matches, and of frames half a second apart.
    sample: (H, W) uint8, a frame of the recording. window: x_min, x_max, y_min, y_max of the
    crop in it, in pixels.
    """

    parameters: LocalViewParameters
    settings: tuple[str, ...]
    revisits: bool
    candidates: tuple[Candidate, ...]
    reasons: tuple[str, ...]
    supported: Errors
    unsupported: Errors
    neighbour: Errors
    sample: Image
    window: tuple[int, int, int, int]

    def format(self) -> str:
        """Format the proposal for a terminal; the last line has the options to copy."""
        lines = list(self.reasons)
        if self.revisits:
            lines += ['', f'{"candidate":38}{"score":>7}{"d-prime":>9}{"recall":>8}{"false":>7}']
            lines += [f'{c.describe():38}{c.score:7.2f}{c.d_prime:9.2f}{c.recall:8.2f}'
                      f'{c.false_rate:7.2f}' for c in self.candidates[:8]]
        settings = ' '.join(f'--set {setting}' for setting in self.settings)
        return '\n'.join([*lines, '', settings or 'the initial parameters are best'])


def propose(frames: Iterable[tuple[int, Image]], start: LocalViewParameters | None = None,
            at_most: int = MAX_FRAME_COUNT) -> Proposal:
    """Propose a match threshold, a template size, a normalisation and a crop.

    Args:
        frames: stamp in ns and (H, W) uint8 grey image, in temporal order; read once.
        start: initial parameters; the crop is only reduced, and other parameters are kept.
        at_most: number of frames held in memory (shrunk), evenly spaced over the recording.

    Raises:
        UnusableInput: fewer than 50 frames, frames of different sizes, or a recording too short
            for revisits.
        UnusableParameter: the initial parameters do not fit the images.
    """
    start = start or LocalViewParameters()
    scaler = FrameScaler(start)
    kept = thinned(((stamp_ns, scaler.shrink(image)) for stamp_ns, image in frames), at_most)
    if len(kept) < MIN_FRAME_COUNT:
        raise UnusableInput(f'{len(kept)} images to tune with, expected {MIN_FRAME_COUNT} or more')
    time_s = np.array([stamp_ns - kept[0][0] for stamp_ns, _ in kept]) / NS_PER_S
    images = np.stack([image for _, image in kept])

    few = np.arange(0, len(images), -(-len(images) // SCREENING_FRAME_COUNT))
    rated: dict[LocalViewParameters, Candidate] = {}

    def best_of(trials: Iterable[LocalViewParameters]) -> LocalViewParameters:
        for p in trials:
            if p not in rated and _fits(images[0], p):
                rated[p] = _rate(p, measure(images[few], time_s[few], p))
        top = max(c.score for c in rated.values())
        equal = [p for p, c in rated.items() if c.score >= top - EQUAL_SCORE]
        return max(equal, key=lambda p: rated[p].d_prime)

    small = scaler.to_small(start)
    chosen = best_of([small])
    chosen = best_of(_crops(images, chosen))
    chosen = best_of(_sizes(chosen))
    evidence = measure(images, time_s, chosen)
    best = _rate(chosen, evidence)
    revisits = evidence.revisits and best.d_prime >= MIN_D_PRIME
    if not revisits:
        evidence = measure(images, time_s, small)
        best = _rate_without_revisits(small, evidence)
    chance = evidence.is_unsupported if revisits else evidence.errors < NO_MATCH
    parameters = scaler.to_full(best.parameters)
    ranked = sorted(rated.values(), key=lambda c: -c.score)
    return Proposal(
        parameters, _settings(start, parameters), revisits,
        tuple(replace(c, parameters=scaler.to_full(c.parameters)) for c in ranked),
        _reasons(best, evidence, revisits, time_s),
        evidence.errors[evidence.is_supported & revisits],
        evidence.errors[chance], evidence.neighbour,
        scaler.sample, crop_window(scaler.sample, parameters))


def _rate(p: LocalViewParameters, evidence: Evidence) -> Candidate:
    """Choose the threshold and compute how well it separates."""
    right = np.sort(evidence.errors[evidence.is_supported])
    wrong = np.sort(evidence.errors[evidence.is_unsupported])
    if not evidence.revisits:
        return _rate_without_revisits(p, evidence)
    trial = np.unique(np.concatenate((right, wrong)))
    recall = np.searchsorted(right, trial, side='right') / len(right)
    false_rate = np.searchsorted(wrong, trial, side='right') / max(len(wrong), 1)
    value = recall - FALSE_WEIGHT_RATIO * false_rate
    at = int(np.argmax(value >= value.max() - CONCEDED_SCORE))
    count = np.isfinite(evidence.rank).sum()
    score = (recall[at] * len(right) - FALSE_WEIGHT_RATIO * false_rate[at] * len(wrong)) / count
    spread = np.sqrt((right.var() + (wrong.var() if len(wrong) else right.var())) / 2.0)
    distance = (wrong.mean() if len(wrong) else right.max()) - right.mean()
    return Candidate(_with_threshold(p, float(trial[at])), float(score),
                     float(distance / max(spread, 1e-9)), float(recall[at]), float(false_rate[at]))


def _rate_without_revisits(p: LocalViewParameters, evidence: Evidence) -> Candidate:
    """Choose the threshold by the rate of chance matches alone."""
    errors = evidence.errors[evidence.errors < NO_MATCH]
    threshold = float(np.quantile(errors, CHANCE_PASS_RATE))
    return Candidate(_with_threshold(p, threshold), 0.0, 0.0, 0.0, CHANCE_PASS_RATE)


def _with_threshold(p: LocalViewParameters, threshold: float) -> LocalViewParameters:
    return replace(p, vt_match_threshold=float(f'{min(threshold, 1.0):.3g}'))


def _crops(images: NDArray[np.uint8], p: LocalViewParameters) -> Iterator[LocalViewParameters]:
    """Yield crops within that of `p`: without static borders, and horizontal bands of the rest."""
    window = crop_window(images[0], p)
    part = images[:, window.y_min:window.y_max, window.x_min:window.x_max]
    deviation = part[::max(1, len(part) // 200)].std(axis=0)
    left, right = _changing(np.median(deviation, axis=0))
    top, bottom = _changing(np.median(deviation, axis=1))
    whole = replace(
        p, image_crop_x_min=window.x_min + left, image_crop_x_max=window.x_min + right,
        image_crop_y_min=window.y_min + top, image_crop_y_max=window.y_min + bottom)
    yield whole
    top, bottom = whole.image_crop_y_min, whole.image_crop_y_max
    third = (bottom - top) // 3
    yield replace(whole, image_crop_y_max=bottom - third)
    yield replace(whole, image_crop_y_max=(top + bottom) // 2)
    yield replace(whole, image_crop_y_min=top + third)
    yield replace(whole, image_crop_y_min=(top + bottom) // 2)


def _changing(deviation: NDArray[np.float64]) -> tuple[int, int]:
    """Return first and last + 1 index of a profile without its static ends."""
    changing = np.flatnonzero(deviation > STATIC_RATIO * np.median(deviation))
    return (int(changing[0]), int(changing[-1]) + 1) if len(changing) else (0, len(deviation))


def _sizes(p: LocalViewParameters) -> Iterator[LocalViewParameters]:
    """Yield all template sizes, with the shift in proportion to the width, and normalisations."""
    for width, height in dict.fromkeys(((p.template_x_size, p.template_y_size), *SIZES)):
        shift = min(round(p.vt_shift_match * width / p.template_x_size), (width - 1) // 2)
        for patch in dict.fromkeys((p.vt_patch_normalise, *PATCHES)):
            yield replace(p, template_x_size=width, template_y_size=height,
                          vt_shift_match=shift, vt_patch_normalise=patch)


def _fits(image: Image, p: LocalViewParameters) -> bool:
    try:
        crop_window(image, p)
    except UnusableParameter:
        return False
    return True


def _settings(start: LocalViewParameters, parameters: LocalViewParameters) -> tuple[str, ...]:
    return tuple(f'local_view.{field.name}={getattr(parameters, field.name)}'
                 for field in fields(parameters)
                 if getattr(parameters, field.name) != getattr(start, field.name))


def _reasons(best: Candidate, evidence: Evidence, revisits: bool,
             time_s: NDArray[np.float64]) -> tuple[str, ...]:
    threshold = best.parameters.vt_match_threshold
    period_s = float(time_s[-1]) / (len(time_s) - 1)
    reasons = [f'{len(time_s)} frames, {period_s:.2g} s apart, over {time_s[-1]:.0f} s']
    if period_s > 1.0:
        reasons.append('frames this sparse miss the places that are seen again, and the '
                       'threshold becomes too high: tune on a shorter recording')
    if not revisits:
        return (*reasons,
                'no place is clearly seen twice: crop, size and normalisation are not changed',
                f'{CHANCE_PASS_RATE:.0%} of the best matches between different places are below '
                f'the threshold {threshold:g}; it should rather be lower for a longer run')
    count = int(np.isfinite(evidence.rank).sum())
    supported, unsupported = int(evidence.is_supported.sum()), int(evidence.is_unsupported.sum())
    reasons += [
        f'{supported} of {count} frames show a place that was seen more than '
        f'{evidence.gap_s:.1f} s before; {unsupported} clearly show a new place',
        f'the threshold {threshold:g} recognises {best.recall:.0%} of the former and '
        f'{best.false_rate:.0%} of the latter']
    if best.false_rate > 0.05 or best.recall < 0.6:
        reasons.append('the two overlap: expect missed or wrong recognitions')
    if unsupported < 20:
        reasons.append('few frames show a new place, so that wrong recognitions can hardly be '
                       'measured: lower the threshold rather than raising it')
    return tuple(reasons)


def plot_proposal(proposal: Proposal, path: str | Path) -> Path:
    """Draw the two histograms with the threshold, the candidates, and the crop in a frame.

    Raises:
        UnusableInput: the file cannot be written.
    """
    from matplotlib.patches import Rectangle

    figure = new_figure(11.0, 6.4)
    grid = figure.add_gridspec(2, 2, width_ratios=(3, 2), height_ratios=(1, 1))
    histogram, frame = figure.add_subplot(grid[:, 0]), figure.add_subplot(grid[0, 1])
    table = figure.add_subplot(grid[1, 1])

    shown = [e for e in (proposal.supported, proposal.unsupported) if len(e)]
    top = 1.05 * max(float(e.max()) for e in (*shown, proposal.neighbour))
    bins = np.linspace(0.0, top, 60).tolist()
    for errors, colour, label in (
        (proposal.supported, BLUE, 'seen again'),
        (proposal.unsupported, VERMILLION, 'not seen before'),
    ):
        if len(errors):
            histogram.hist(errors, bins, color=colour, alpha=0.6, label=f'{label}: {len(errors)}',
                           weights=np.full(len(errors), 1.0 / len(errors)))
    histogram.hist(proposal.neighbour, bins, histtype='step', color=GREY,
                   label='frames up to half a second apart',
                   weights=np.full(len(proposal.neighbour), 1.0 / len(proposal.neighbour)))
    threshold = proposal.parameters.vt_match_threshold
    histogram.axvline(threshold, color=BLACK, linestyle='--', label=f'threshold {threshold:g}')
    histogram.set(xlabel='match error', ylabel='share of frames', xlim=(0.0, top))
    histogram.legend(fontsize=8)

    x_min, x_max, y_min, y_max = proposal.window
    frame.imshow(proposal.sample, cmap='gray', vmin=0, vmax=255)
    frame.add_patch(Rectangle((x_min - 0.5, y_min - 0.5), x_max - x_min, y_max - y_min,
                              fill=False, edgecolor=VERMILLION, linewidth=2.5))
    frame.set_title('crop', fontsize=10)
    frame.set_axis_off()

    table.set_axis_off()
    rows = [[c.describe(), f'{c.score:.2f}', f'{c.d_prime:.1f}', f'{c.recall:.2f}',
             f'{c.false_rate:.2f}'] for c in proposal.candidates[:8]]
    if proposal.revisits:
        cells = table.table(rows, colLabels=['candidate', 'score', "d'", 'recall', 'false'],
                            colWidths=[0.6, 0.1, 0.1, 0.1, 0.1], loc='center', cellLoc='left',
                            edges='horizontal')
        cells.auto_set_font_size(False)
        cells.set_fontsize(7)
    else:
        table.text(0.5, 0.5, 'no place is clearly seen twice', ha='center')
    return save_figure(figure, path)
