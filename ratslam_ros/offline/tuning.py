# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Propose local-view parameters for a recording, from the recording alone.

The errors of matches that are supported by their neighbours (`ratslam_ros.offline.revisits`) and
of those that are not make two histograms. A good crop, template size and normalisation keeps them
apart, and the threshold belongs between them.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass, fields, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from ratslam_ros.core.config import LocalViewParameters
from ratslam_ros.core.vision.local_view import crop_window
from ratslam_ros.errors import UnusableInput, UnusableParameter
from ratslam_ros.offline.revisits import (
    MOST_FRAMES,
    NO_MATCH,
    Errors,
    Evidence,
    Film,
    Image,
    measure,
)
from ratslam_ros.results.plots import BLACK, BLUE, GREY, VERMILLION, new_figure, save_figure
from ratslam_ros.results.trajectory import NS_PER_S, thinned

SIZES = ((12, 8), (20, 12), (32, 16), (48, 24), (60, 10), (60, 20))
PATCHES = (0, 2, 4)
LEAST_FRAMES = 50
SCREENING_FRAMES = 700  # enough to rank candidates; the winner is measured on all frames

FALSE_WEIGHT = 4.0  # how many right recognitions one wrong one costs
CONCEDED = 0.05  # of the right ones, for a lower threshold: finer places, fewer mistakes
EQUAL_SCORE = 0.02  # candidates this close are equal; the better separated one wins
LEAST_D_PRIME = 2.3  # histograms closer than this are both of chance matches
UNLIKELY = 0.02  # share of chance matches let pass where no place is seen twice
STATIC = 0.15  # of the usual deviation over time: the robot itself, or a black border


@dataclass(frozen=True)
class Candidate:
    """How well a set of parameters keeps places apart.

    score: the share of frames that would be recognised rightly, less `FALSE_WEIGHT` times that
    of the wrong ones, at the threshold. d_prime: distance of the two histograms' means in
    standard deviations. recall, false_rate: shares of the supported and of the unsupported
    matches that the threshold lets pass.
    """

    parameters: LocalViewParameters
    score: float
    d_prime: float
    recall: float
    false_rate: float

    def describe(self) -> str:
        """Return the size, normalisation and crop in a few characters."""
        p = self.parameters
        crop = (f'x {p.image_crop_x_min}:{p.image_crop_x_max} '
                f'y {p.image_crop_y_min}:{p.image_crop_y_max}').replace('-1', '')
        return f'{p.template_x_size}x{p.template_y_size} patch {p.vt_patch_normalise} crop {crop}'


@dataclass(frozen=True)
class Proposal:
    """What to set, how well that separates, and why.

    settings: `local_view.name=value`, only what differs from the start. revisits: whether any
    place was seen twice. supported, unsupported, neighbour: match errors of the proposed
    parameters: of places seen again, of the best chance matches, and of frames half a second
    apart. sample: (H, W) uint8, a frame of the recording; window: x_min, x_max, y_min, y_max px
    of the crop in it.
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
        """Return the proposal for a terminal; its last line is for the command line."""
        lines = list(self.reasons)
        if self.revisits:
            lines += ['', f'{"candidate":38}{"score":>7}{"d-prime":>9}{"recall":>8}{"false":>7}']
            lines += [f'{c.describe():38}{c.score:7.2f}{c.d_prime:9.2f}{c.recall:8.2f}'
                      f'{c.false_rate:7.2f}' for c in self.candidates[:8]]
        settings = ' '.join(f'--set {setting}' for setting in self.settings)
        return '\n'.join([*lines, '', settings or 'nothing to change'])


def propose(frames: Iterable[tuple[int, Image]], start: LocalViewParameters | None = None,
            at_most: int = MOST_FRAMES) -> Proposal:
    """Propose a match threshold, a template size, a normalisation and a crop.

    Args:
        frames: stamp in ns and (H, W) uint8 grey image, in order of time; read once.
        start: what to begin with; the crop only shrinks, and what is not proposed stays.
        at_most: frames held in memory (shrunk), evenly spaced over the recording.

    Raises:
        UnusableInput: fewer than 50 frames, or frames of several sizes.
        UnusableParameter: the start does not fit the images.
    """
    start = start or LocalViewParameters()
    film = Film(start)
    kept = thinned(((stamp_ns, film.shrink(image)) for stamp_ns, image in frames), at_most)
    if len(kept) < LEAST_FRAMES:
        raise UnusableInput(f'{len(kept)} images to tune with, expected {LEAST_FRAMES} or more')
    time_s = np.array([stamp_ns - kept[0][0] for stamp_ns, _ in kept]) / NS_PER_S
    images = np.stack([image for _, image in kept])

    few = np.arange(0, len(images), -(-len(images) // SCREENING_FRAMES))
    known: dict[LocalViewParameters, Candidate] = {}

    def best_of(trials: Iterable[LocalViewParameters]) -> LocalViewParameters:
        for p in trials:
            if p not in known and _fits(images[0], p):
                known[p] = _judge(p, measure(images[few], time_s[few], p))
        top = max(c.score for c in known.values())
        equal = [p for p, c in known.items() if c.score >= top - EQUAL_SCORE]
        return max(equal, key=lambda p: known[p].d_prime)

    small = film.to_small(start)
    chosen = best_of([small])
    chosen = best_of(_crops(images, chosen))
    chosen = best_of(_sizes(chosen))
    evidence = measure(images, time_s, chosen)
    best = _judge(chosen, evidence)
    revisits = evidence.revisits and best.d_prime >= LEAST_D_PRIME
    if not revisits:
        evidence = measure(images, time_s, small)
        best = _chance(small, evidence)
    chance = evidence.is_unsupported if revisits else evidence.errors < NO_MATCH
    parameters = film.to_full(best.parameters)
    ranked = sorted(known.values(), key=lambda c: -c.score)
    return Proposal(
        parameters, _settings(start, parameters), revisits,
        tuple(replace(c, parameters=film.to_full(c.parameters)) for c in ranked),
        _reasons(best, evidence, revisits, time_s),
        evidence.errors[evidence.is_supported & revisits],
        evidence.errors[chance], evidence.neighbour,
        film.sample, crop_window(film.sample, parameters))


def _judge(p: LocalViewParameters, evidence: Evidence) -> Candidate:
    """Choose the threshold and say how well it separates."""
    right = np.sort(evidence.errors[evidence.is_supported])
    wrong = np.sort(evidence.errors[evidence.is_unsupported])
    if not evidence.revisits:
        return _chance(p, evidence)
    trial = np.unique(np.concatenate((right, wrong)))
    recall = np.searchsorted(right, trial, side='right') / len(right)
    false_rate = np.searchsorted(wrong, trial, side='right') / max(len(wrong), 1)
    value = recall - FALSE_WEIGHT * false_rate
    at = int(np.argmax(value >= value.max() - CONCEDED))
    told = np.isfinite(evidence.rank).sum()
    score = (recall[at] * len(right) - FALSE_WEIGHT * false_rate[at] * len(wrong)) / told
    spread = np.sqrt((right.var() + (wrong.var() if len(wrong) else right.var())) / 2.0)
    apart = (wrong.mean() if len(wrong) else right.max()) - right.mean()
    return Candidate(_with_threshold(p, float(trial[at])), float(score),
                     float(apart / max(spread, 1e-9)), float(recall[at]), float(false_rate[at]))


def _chance(p: LocalViewParameters, evidence: Evidence) -> Candidate:
    """Choose the threshold as if no place was seen twice."""
    errors = evidence.errors[evidence.errors < NO_MATCH]
    threshold = float(np.quantile(errors, UNLIKELY))
    return Candidate(_with_threshold(p, threshold), 0.0, 0.0, 0.0, UNLIKELY)


def _with_threshold(p: LocalViewParameters, threshold: float) -> LocalViewParameters:
    return replace(p, vt_match_threshold=float(f'{min(threshold, 1.0):.3g}'))


def _crops(images: NDArray[np.uint8], p: LocalViewParameters) -> Iterator[LocalViewParameters]:
    """Yield crops within that of `p`: without what never changes, and bands of the rest."""
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
    """Return the bounds of a profile without its static ends."""
    changing = np.flatnonzero(deviation > STATIC * np.median(deviation))
    return (int(changing[0]), int(changing[-1]) + 1) if len(changing) else (0, len(deviation))


def _sizes(p: LocalViewParameters) -> Iterator[LocalViewParameters]:
    """Yield the template sizes, the shift in proportion to the width, and normalisations."""
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
        reasons.append('so few frames of a long recording miss the very places that are seen '
                       'again, and the threshold comes out high: tune on a shorter part')
    if not revisits:
        return (*reasons,
                'no place is clearly seen twice, so there is nothing to learn from: crop and '
                'size stay as they were',
                f'the threshold {threshold:g} lets pass {UNLIKELY:.0%} of the best matches '
                'between different places; a longer memory offers more of them: rather lower it')
    told = int(np.isfinite(evidence.rank).sum())
    supported, unsupported = int(evidence.is_supported.sum()), int(evidence.is_unsupported.sum())
    reasons += [
        f'{supported} of {told} frames see a place again that was seen more than '
        f'{evidence.gap_s:.1f} s before; {unsupported} clearly do not',
        f'the threshold {threshold:g} recognises {best.recall:.0%} of the first and '
        f'{best.false_rate:.0%} of the second']
    if best.false_rate > 0.05 or best.recall < 0.6:
        reasons.append('the two overlap: expect missed or wrong recognitions')
    if unsupported < 20:
        reasons.append('hardly any frame shows a new place, so wrong recognitions could hardly '
                       'be seen: rather lower the threshold than raise it')
    return tuple(reasons)


def plot_proposal(proposal: Proposal, path: str | Path) -> Path:
    """Draw the two histograms with the threshold, the candidates, and the crop in a frame."""
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
    frame.set_title('what is compared', fontsize=10)
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
