# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Which frames of a recording show a place again, told without any truth.

Every frame is compared with all earlier ones. Its best match among those long ago is either the
same place seen again, or the best that chance offers. Which of the two it is, is told from its
company: where a place is seen again, the frames before and after match too, in step (the idea of
SeqSLAM, Milford and Wyeth, ICRA 2012). Eight neighbours are asked, each far enough from the next
for the view to have changed: which share of the recording matches it better than the stretch
that lies in step? By chance half of it.
"""

from __future__ import annotations

import contextlib
from collections.abc import Iterator
from dataclasses import dataclass, replace

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import minimum_filter1d

from ratslam_ros.core.common.compiled import compiled
from ratslam_ros.core.config import WHOLE, LocalViewParameters
from ratslam_ros.core.vision.local_view import crop_window, make_view
from ratslam_ros.errors import UnusableInput
from ratslam_ros.recordings import ImageEvent, Recording, UndecodableImage

Image = NDArray[np.uint8]
Errors = NDArray[np.float32]

MOST_FRAMES = 2000
SMALL_WIDTH, SMALL_HEIGHT = 160, 60  # frames are held no smaller than this

SAME_PLACE_S = 0.5
LEAST_GAP_S = 3.0  # what was seen less long ago is no return to a place
DECORRELATED = 0.85  # of the median error of any two frames: the view has changed
NEIGHBOURS = (1, 2, 3, 4, -1, -2, -3, -4)  # in units of the time after which the view has changed
SUPPORTED_RANK, UNSUPPORTED_RANK = 0.2, 0.4
LEAST_SUPPORTED, LEAST_SUPPORTED_SHARE = 20, 0.1  # fewer than these may be chance
NO_MATCH = np.float32(9.0)


def sample_frames(recording: Recording, image_topic: str | None = None,
                  at_most: int = MOST_FRAMES) -> Iterator[tuple[int, Image]]:
    """Yield stamp (ns) and grey image of frames evenly spaced over a recording.

    Only these are decoded; those that cannot be are left out.
    """
    selection = recording.select(image_topic, visual_odometry=True)
    step_ns = (recording.end_ns - recording.start_ns) / max(at_most - 1, 1)
    due_ns = float(recording.start_ns)
    for event in recording.events(selection):
        if isinstance(event, ImageEvent) and event.log_ns >= due_ns:
            # Behind a gap a few may follow closely, so that jitter does not cost frames.
            due_ns = max(due_ns + step_ns, event.log_ns - 9.0 * step_ns)
            with contextlib.suppress(UndecodableImage):
                yield event.stamp_ns, event.grey()


class Film:
    """Shrinks frames by whole factors, and parameters with them."""

    def __init__(self, start: LocalViewParameters) -> None:
        self._start = start
        self._seen = 0
        self.sample: Image = np.empty((0, 0), np.uint8)

    def shrink(self, image: Image) -> Image:
        """Return a frame small enough to hold; keep one in full as a sample."""
        if not self._seen:
            self.sample = image
            crop_window(image, self._start)  # says what is wrong with the start
        if image.shape != self.sample.shape:
            raise UnusableInput(f'an image of {image.shape} px among images of '
                                f'{self.sample.shape} px (height, width); choose one camera')
        self._seen += 1
        if self._seen & (self._seen - 1) == 0:  # the sample comes from about the middle
            self.sample = image.copy()
        kx, ky = self._factors()
        size = (image.shape[1] // kx, image.shape[0] // ky)
        return np.asarray(cv2.resize(image, size, interpolation=cv2.INTER_AREA), np.uint8)

    def to_small(self, p: LocalViewParameters) -> LocalViewParameters:
        """Return the parameters for a shrunken frame, with the crop in numbers."""
        kx, ky = self._factors()
        window = crop_window(self.sample, p)
        return self._scaled(replace(
            p, image_crop_x_min=window.x_min, image_crop_x_max=window.x_max,
            image_crop_y_min=window.y_min, image_crop_y_max=window.y_max), 1.0 / kx, 1.0 / ky)

    def to_full(self, p: LocalViewParameters) -> LocalViewParameters:
        """Return the parameters for a full frame; a crop to the edge is written as -1."""
        kx, ky = self._factors()
        height, width = self.sample.shape
        full = self._scaled(p, kx, ky)
        return replace(
            full,
            image_crop_x_max=full.image_crop_x_max if p.image_crop_x_max < width // kx else WHOLE,
            image_crop_y_max=full.image_crop_y_max if p.image_crop_y_max < height // ky else WHOLE)

    def _factors(self) -> tuple[int, int]:
        height, width = self.sample.shape
        return max(1, width // SMALL_WIDTH), max(1, height // SMALL_HEIGHT)

    @staticmethod
    def _scaled(p: LocalViewParameters, kx: float, ky: float) -> LocalViewParameters:
        return replace(
            p, image_crop_x_min=int(p.image_crop_x_min * kx),
            image_crop_x_max=int(p.image_crop_x_max * kx),
            image_crop_y_min=int(p.image_crop_y_min * ky),
            image_crop_y_max=int(p.image_crop_y_max * ky))


@dataclass(frozen=True)
class Evidence:
    """The best match of each frame among those long ago, and what speaks for it.

    errors: (n,) of the match. rank: (n,) 0 to 1, the share of the recording that its neighbours
    would rather match; 0.5 by chance, NaN where there is too little to tell. neighbour: (m,)
    errors of frames at most half a second apart.
    """

    errors: Errors
    rank: NDArray[np.float64]
    neighbour: Errors
    gap_s: float

    @property
    def is_supported(self) -> NDArray[np.bool_]:
        """(n,) bool: the same place seen again."""
        return self.rank <= SUPPORTED_RANK

    @property
    def is_unsupported(self) -> NDArray[np.bool_]:
        """(n,) bool: only the best that chance offers."""
        return self.rank >= UNSUPPORTED_RANK

    @property
    def revisits(self) -> bool:
        """Whether enough places were seen twice to learn from."""
        supported = int(np.sum(self.is_supported))
        share = LEAST_SUPPORTED_SHARE * float(np.isfinite(self.rank).sum())
        return supported >= max(LEAST_SUPPORTED, share)


def measure(images: NDArray[np.uint8], time_s: NDArray[np.float64],
            p: LocalViewParameters) -> Evidence:
    """Compare each of (n, H, W) images with all earlier ones and weigh the best matches.

    Raises UnusableInput where the recording is too short for anything to be long ago.
    """
    views = np.stack([make_view(image, p) for image in images])
    errors = compare_all(views, p)
    n = len(views)
    period_s = max(float(time_s[-1] - time_s[0]) / max(n - 1, 1), 1e-9)
    usual = np.median(errors[np.tril_indices(n, -1)])
    lag = next((k for k in range(1, n // 8)
                if np.median(np.diagonal(errors, -k)) >= DECORRELATED * usual), n // 8)
    gap = max(2 * lag, round(LEAST_GAP_S / period_s))
    if 2 * gap >= n:
        raise UnusableInput(f'the recording covers {n * period_s:.1f} s; to see anything again '
                            f'takes {2 * gap * period_s:.1f} s at least')
    last_near = max(1, int(SAME_PLACE_S / period_s))
    near = [np.diagonal(errors, -k).copy() for k in range(1, last_near + 1)]

    row = np.arange(n)
    errors[row[:, np.newaxis] - row < gap] = NO_MATCH
    match = errors.argmin(axis=1)
    ranks = [_rank_of_neighbours(errors, match, steps * lag, gap) for steps in NEIGHBOURS]
    told = np.isfinite(ranks).sum(axis=0)
    rank = np.where(told >= 4, np.nansum(ranks, axis=0) / np.maximum(told, 1), np.nan)
    return Evidence(errors[row, match], rank, np.concatenate(near), gap * period_s)


def _rank_of_neighbours(errors: Errors, match: NDArray[np.intp], ahead: int,
                        gap: int) -> NDArray[np.float64]:
    """Return, for the frame `ahead` of each, how its match in step ranks among all stretches.

    In step: half to nearly twice as far ahead of the match, as the speed may differ.
    """
    n = len(errors)
    low, high = sorted((round(0.5 * ahead), round(1.8 * ahead)))
    width = high - low + 1
    stretch = minimum_filter1d(errors, width, axis=1, mode='constant', cval=NO_MATCH)
    frame = np.arange(n)
    there, centre = frame + ahead, match + low + width // 2
    valid = (there >= gap + 2 * width) & (there < n) & (centre >= 0) & (centre <= there - gap)
    frame, there, centre = frame[valid], there[valid], centre[valid]
    rows = stretch[there]
    own = rows[np.arange(len(rows)), centre][:, np.newaxis]
    rank = np.full(n, np.nan)
    rank[frame] = (rows < own).sum(axis=1) / np.maximum((rows < NO_MATCH).sum(axis=1), 1)
    return rank


def compare_all(views: NDArray[np.uint8], p: LocalViewParameters) -> Errors:
    """Return the match error of each of (n, h, w) views with each earlier one, (n, n).

    [later, earlier], as `LocalView` compares a view with a template; elsewhere `NO_MATCH`.
    """
    n, height, width = views.shape
    if p.vt_panoramic:
        compared, offsets = width, width
        templates = np.concatenate((views, views), axis=2)
        queries = views
    else:
        compared, offsets = width - 2 * p.vt_shift_match, 2 * p.vt_shift_match + 1
        templates = views
        queries = np.ascontiguousarray(views[:, :, p.vt_shift_match:width - p.vt_shift_match])
    sums = np.full((n, n), -1, np.int32)
    _least_sums(queries, templates, offsets, p.vt_step_match, sums)
    errors = (sums / np.float32(255 * compared * height)).astype(np.float32)
    errors[sums < 0] = NO_MATCH
    return errors


@compiled
def _least_sums(queries: Image, templates: Image, offsets: int, step: int,
                sums: NDArray[np.int32]) -> None:
    """Fill the lower triangle of `sums` with the least SAD over the offsets."""
    n, height, compared = queries.shape
    for later in range(n):
        for earlier in range(later):
            least = np.int32(2**31 - 1)
            for offset in range(0, offsets, step):
                total = np.int32(0)
                for y in range(height):
                    a = queries[later, y]
                    b = templates[earlier, y, offset:offset + compared]
                    for x in range(compared):
                        total += abs(np.int32(a[x]) - np.int32(b[x]))
                    if total >= least:
                        break
                least = min(least, total)
            sums[later, earlier] = least
