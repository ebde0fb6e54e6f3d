# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Search for the parameters of the local view that separate revisits from chance matches.

Each frame is matched with all frames at least a minimum time before it. The evidence
(`ratslam_tuning.revisits`) divides the matches into right and wrong ones. A good descriptor,
crop, template size and normalisation gives different errors to the two, and the threshold belongs
between them.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from ratslam_ros.core.config import LocalViewParameters
from ratslam_ros.core.vision.intensity import crop_window
from ratslam_ros.core.vision.local_view import LocalView
from ratslam_ros.descriptors import encoder_of
from ratslam_ros.errors import UnusableParameter
from ratslam_tuning.revisits import Errors, Evidence

SIZES: dict[str, tuple[tuple[int, int], ...]] = {
    'intensity': ((12, 8), (20, 12), (28, 28), (32, 16), (48, 24), (60, 10), (60, 20), (80, 20)),
    'gradients': ((8, 6), (12, 9), (16, 8), (16, 12), (24, 12)),
}
"""Template sizes to try with each descriptor, in pixels or cells."""

PATCHES: dict[str, tuple[int, ...]] = {'intensity': (0, 2, 4, 7)}
"""Radii of the patch normalisation to try, for descriptors that have it."""

SHIFT_SHARES = ((0.0, 0.0), (0.05, 0.05), (0.1, 0.0), (0.1, 0.08))
"""Largest horizontal and vertical shift, as shares of the template size."""

SCREENING_FRAME_COUNT = 700
"""Number of frames that the candidates are compared on."""

FALSE_WEIGHT_RATIO = 4.0
"""Cost of a wrong recognition relative to the gain of a right one."""

CONCEDED_SCORE = 0.02
"""Score given up for a lower threshold, which gives finer places and fewer wrong matches."""

STATIC_RATIO = 0.15
"""Rows and columns with a smaller fraction of the median deviation over time are static."""


@dataclass(frozen=True)
class ViewRating:
    """How well a set of parameters separates right matches from wrong ones.

    Attributes:
        parameters: the parameters, with the best threshold.
        score: share of the revisits recognised at the threshold, minus `FALSE_WEIGHT_RATIO` times
            the wrong recognitions relative to the number of revisits.
        right, wrong: errors of the matches that show the same place, and of all others.
    """

    parameters: LocalViewParameters
    score: float
    right: Errors
    wrong: Errors


class ViewSearch:
    """Rates parameters of the local view on the frames of a recording."""

    def __init__(self, images: NDArray[np.uint8], evidence: Evidence) -> None:
        """Prepare the frames.

        Args:
            images: (n, H, W) uint8 grey, the frames of the evidence.
            evidence: their revisits.
        """
        self._images = images
        self._evidence = evidence
        self._few = np.arange(0, len(images), -(-len(images) // SCREENING_FRAME_COUNT))
        self._rated: dict[LocalViewParameters, ViewRating | None] = {}

    def best(self, start: LocalViewParameters, count: int) -> list[ViewRating]:
        """Return the best ratings, best first, in different template sizes.

        The crop, the template size with the normalisation, and the shifts are varied one after
        the other. Parameters that do not fit the images are skipped.

        Args:
            start: initial parameters.
            count: number of ratings to return.
        """
        found: dict[LocalViewParameters, ViewRating] = {}
        chosen = start
        for variants in (self._crops, _sizes, _shifts):
            for p in (chosen, *variants(chosen)):
                rating = self.rate(p)
                if rating is not None:
                    found[p] = rating
            if not found:
                return []
            chosen = max(found, key=lambda p: found[p].score)
        best: dict[tuple[int, int], ViewRating] = {}
        for rating in sorted(found.values(), key=lambda rating: -rating.score):
            p = rating.parameters
            best.setdefault((p.template_x_size, p.template_y_size), rating)
        return list(best.values())[:count]

    def rate(self, p: LocalViewParameters) -> ViewRating | None:
        """Choose the threshold, and compute how well it separates; None if `p` does not fit."""
        if p not in self._rated:
            try:
                self._rated[p] = self._rate(p)
            except UnusableParameter:
                self._rated[p] = None
        return self._rated[p]

    def _rate(self, p: LocalViewParameters) -> ViewRating:
        errors, same = self._matches(p)
        supported = self._evidence.is_supported[self._few]
        judged = np.isfinite(same) & (supported | self._evidence.is_unsupported[self._few])
        is_right = judged & supported & (same >= 0.5)
        right, wrong = errors[is_right], errors[judged & ~is_right]
        count = max(int(np.sum(judged & supported)), 1)
        trial = np.unique(errors[judged])
        gain = np.searchsorted(np.sort(right), trial, side='right')
        loss = np.searchsorted(np.sort(wrong), trial, side='right')
        value = (gain - FALSE_WEIGHT_RATIO * loss) / count
        if not len(trial) or value.max() <= 0.0:
            return ViewRating(p, 0.0, right, wrong)
        at = int(np.argmax(value >= value.max() - CONCEDED_SCORE))
        threshold = float(f'{min(float(trial[at]), 1.0):.3g}')
        return ViewRating(
            replace(p, vt_match_threshold=threshold), float(value.max()), right, wrong)

    def _matches(self, p: LocalViewParameters) -> tuple[Errors, Errors]:
        """Return error and correctness of the best match of each frame, NaN if there is none."""
        memory = LocalView(replace(p, vt_match_threshold=1.0, vt_recent_templates=0, vt_max=0),
                           encoder_of(p))
        memory.mapping = False
        same = np.full(len(self._few), np.nan, np.float32)
        errors = np.full(len(self._few), np.nan, np.float32)
        learned: list[int] = []
        older_row = 0
        for row, frame in enumerate(self._few.tolist()):
            while older_row < row and self._few[older_row] <= frame - self._evidence.gap:
                older = int(self._few[older_row])
                older_row += 1
                view = memory.encode(self._images[older])
                if view is not None:
                    memory.learn(view)
                    learned.append(older)
            match = memory.match(self._images[frame])
            if match.template_id >= 0:
                errors[row] = match.error
                same[row] = self._evidence.same_place[frame, learned[match.template_id]]
        return errors, same

    def _crops(self, p: LocalViewParameters) -> Iterator[LocalViewParameters]:
        """Yield the crop without static borders, and horizontal bands of it."""
        window = crop_window(self._images[0], p)
        part = self._images[:, window.y_min:window.y_max, window.x_min:window.x_max]
        deviation = part[::max(1, len(part) // 200)].std(axis=0)
        left, right = _changing(np.median(deviation, axis=0))
        top, bottom = _changing(np.median(deviation, axis=1))
        whole = replace(
            p, image_crop_x_min=window.x_min + left, image_crop_x_max=window.x_min + right,
            image_crop_y_min=window.y_min + top, image_crop_y_max=window.y_min + bottom)
        yield whole
        top, bottom = whole.image_crop_y_min, whole.image_crop_y_max
        third, half = (bottom - top) // 3, (bottom - top) // 2
        for first, last in ((top, bottom - third), (top, bottom - half), (top + third, bottom),
                            (top + half, bottom), (top + third // 2, bottom - third)):
            yield replace(whole, image_crop_y_min=first, image_crop_y_max=last)


def _changing(deviation: NDArray[np.float64]) -> tuple[int, int]:
    """Return first and last + 1 index of a profile without its static ends."""
    changing = np.flatnonzero(deviation > STATIC_RATIO * np.median(deviation))
    return (int(changing[0]), int(changing[-1]) + 1) if len(changing) else (0, len(deviation))


def _sizes(p: LocalViewParameters) -> Iterator[LocalViewParameters]:
    """Yield all template sizes and normalisations, with the shifts in proportion."""
    for width, height in SIZES.get(p.vt_descriptor, ()):
        shift_x = min(round(p.vt_shift_match * width / p.template_x_size), (width - 1) // 2)
        shift_y = min(round(p.vt_shift_match_y * height / p.template_y_size), (height - 1) // 2)
        for patch in PATCHES.get(p.vt_descriptor, (p.vt_patch_normalise,)):
            yield replace(p, template_x_size=width, template_y_size=height, vt_shift_match=shift_x,
                          vt_shift_match_y=shift_y, vt_patch_normalise=patch)


def _shifts(p: LocalViewParameters) -> Iterator[LocalViewParameters]:
    """Yield shifts in proportion to the template size."""
    for share_x, share_y in SHIFT_SHARES:
        yield replace(p, vt_shift_match=round(share_x * p.template_x_size),
                      vt_shift_match_y=round(share_y * p.template_y_size))


def descriptors(p: LocalViewParameters) -> Iterator[LocalViewParameters]:
    """Yield the parameters with each built-in descriptor, that of `p` first."""
    yield p
    for name, (size, *_) in SIZES.items():
        if name != p.vt_descriptor:
            width, height = size
            yield replace(p, vt_descriptor=name, template_x_size=width, template_y_size=height,
                          vt_shift_match=1, vt_shift_match_y=0)
