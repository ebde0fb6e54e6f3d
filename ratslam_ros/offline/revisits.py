# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Detection of revisits in a recording, without ground truth.

Every frame is compared with all earlier ones. Its best match among frames at least a minimum time
ago is either a revisit or a chance match. At a revisit, the frames before and after match as well,
in sequence, as in SeqSLAM, Milford and Wyeth (2012). For eight neighbours of the frame, far
enough apart for the view to have changed, this module computes the share of the recording that
matches the neighbour better than the frames expected from the sequence. For a chance match, the
expected share is one half.
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
from ratslam_ros.core.vision.intensity import crop_window, make_view
from ratslam_ros.errors import UnusableInput
from ratslam_ros.recordings import ImageEvent, Recording, UndecodableImage

Image = NDArray[np.uint8]
Errors = NDArray[np.float32]

MAX_FRAME_COUNT = 2000
SMALL_WIDTH_PX, SMALL_HEIGHT_PX = 160, 60
"""Frames are shrunk by integer factors, to at least this size."""

SAME_PLACE_S = 0.5
"""Frames at most this far apart are taken as views of the same place."""

MIN_GAP_S = 3.0
"""Minimum time between two views that are a revisit."""

DECORRELATION_RATIO = 0.85
"""The view has changed if the error exceeds this fraction of the median error of all pairs."""

NEIGHBOURS = (1, 2, 3, 4, -1, -2, -3, -4)
"""Offsets of the neighbours, in units of the time after which the view has changed."""

SUPPORTED_RANK, UNSUPPORTED_RANK = 0.2, 0.4
"""Limits on the mean rank: at most for a revisit, at least for a chance match."""

MIN_SUPPORTED_COUNT, MIN_SUPPORTED_SHARE = 20, 0.1
"""With fewer revisits, the matches may all be chance matches."""

NO_MATCH = np.float32(9.0)
"""Error of pairs that are not compared; real errors are at most 1."""


def sample_frames(recording: Recording, image_topic: str | None = None,
                  at_most: int = MAX_FRAME_COUNT) -> Iterator[tuple[int, Image]]:
    """Yield frames that are evenly spaced over a recording.

    Only these frames are decoded; undecodable ones are skipped.

    Args:
        recording: the recording.
        image_topic: its camera topic; None for the only one.
        at_most: approximate number of frames.

    Yields:
        Stamp in ns and (H, W) uint8 grey image.
    """
    selection = recording.select(image_topic, visual_odometry=True)
    step_ns = (recording.end_ns - recording.start_ns) / max(at_most - 1, 1)
    due_ns = float(recording.start_ns)
    for event in recording.events(selection):
        if isinstance(event, ImageEvent) and event.log_ns >= due_ns:
            # After a gap some frames may follow closely, so that jitter does not cost frames.
            due_ns = max(due_ns + step_ns, event.log_ns - 9.0 * step_ns)
            with contextlib.suppress(UndecodableImage):
                yield event.stamp_ns, event.grey()


class FrameScaler:
    """Shrinks frames by integer factors, and scales the crop parameters accordingly.

    sample: (H, W) uint8, a frame in full size from about the middle of the recording.
    """

    def __init__(self, start: LocalViewParameters) -> None:
        self._start = start
        self._count = 0
        self.sample: Image = np.empty((0, 0), np.uint8)

    def shrink(self, image: Image) -> Image:
        """Return the shrunk frame, uint8; store some frames in full size as the sample.

        Raises:
            UnusableInput: the frame differs in size from the first one.
            UnusableParameter: the initial crop does not fit the frame.
        """
        if not self._count:
            self.sample = image
            crop_window(image, self._start)  # Raises if the crop does not fit.
        if image.shape != self.sample.shape:
            raise UnusableInput(f'an image of {image.shape} px among images of '
                                f'{self.sample.shape} px (height, width); choose one camera')
        self._count += 1
        if self._count & (self._count - 1) == 0:
            self.sample = image.copy()
        kx, ky = self._factors()
        size = (image.shape[1] // kx, image.shape[0] // ky)
        return np.asarray(cv2.resize(image, size, interpolation=cv2.INTER_AREA), np.uint8)

    def to_small(self, p: LocalViewParameters) -> LocalViewParameters:
        """Return the parameters for shrunk frames, with explicit crop limits."""
        kx, ky = self._factors()
        window = crop_window(self.sample, p)
        return self._scaled(replace(
            p, image_crop_x_min=window.x_min, image_crop_x_max=window.x_max,
            image_crop_y_min=window.y_min, image_crop_y_max=window.y_max), 1.0 / kx, 1.0 / ky)

    def to_full(self, p: LocalViewParameters) -> LocalViewParameters:
        """Return the parameters for full-size frames; a crop to the edge is -1."""
        kx, ky = self._factors()
        height, width = self.sample.shape
        full = self._scaled(p, kx, ky)
        return replace(
            full,
            image_crop_x_max=full.image_crop_x_max if p.image_crop_x_max < width // kx else WHOLE,
            image_crop_y_max=full.image_crop_y_max if p.image_crop_y_max < height // ky else WHOLE)

    def _factors(self) -> tuple[int, int]:
        height, width = self.sample.shape
        return max(1, width // SMALL_WIDTH_PX), max(1, height // SMALL_HEIGHT_PX)

    @staticmethod
    def _scaled(p: LocalViewParameters, kx: float, ky: float) -> LocalViewParameters:
        return replace(
            p, image_crop_x_min=int(p.image_crop_x_min * kx),
            image_crop_x_max=int(p.image_crop_x_max * kx),
            image_crop_y_min=int(p.image_crop_y_min * ky),
            image_crop_y_max=int(p.image_crop_y_max * ky))


@dataclass(frozen=True)
class Evidence:
    """Best match of each frame among frames at least `gap_s` before it, and its support.

    errors: (n,) errors of the best matches. rank: (n,) 0 to 1, mean share of the recording that
    matches the neighbours of the frame better than the sequence does; about 0.5 for chance
    matches, NaN if too few neighbours can be compared. neighbour: (m,) errors of frames at most
    half a second apart.
    """

    errors: Errors
    rank: NDArray[np.float64]
    neighbour: Errors
    gap_s: float

    @property
    def is_supported(self) -> NDArray[np.bool_]:
        """(n,) bool: revisits."""
        return self.rank <= SUPPORTED_RANK

    @property
    def is_unsupported(self) -> NDArray[np.bool_]:
        """(n,) bool: chance matches."""
        return self.rank >= UNSUPPORTED_RANK

    @property
    def revisits(self) -> bool:
        """Whether there are enough revisits to choose parameters from."""
        supported = int(np.sum(self.is_supported))
        count = MIN_SUPPORTED_SHARE * float(np.isfinite(self.rank).sum())
        return supported >= max(MIN_SUPPORTED_COUNT, count)


def measure(images: NDArray[np.uint8], time_s: NDArray[np.float64],
            p: LocalViewParameters) -> Evidence:
    """Compare each image with all earlier ones, and compute the support of the best matches.

    Args:
        images: (n, H, W) uint8 grey.
        time_s: (n,) increasing times.
        p: the parameters of the comparison.

    Raises:
        UnusableInput: the recording is too short for revisits.
    """
    views = np.stack([make_view(image, p) for image in images])
    errors = compare_all(views, p)
    n = len(views)
    period_s = max(float(time_s[-1] - time_s[0]) / max(n - 1, 1), 1e-9)
    median_error = np.median(errors[np.tril_indices(n, -1)])
    lag = next((k for k in range(1, n // 8)
                if np.median(np.diagonal(errors, -k)) >= DECORRELATION_RATIO * median_error),
               n // 8)
    gap = max(2 * lag, round(MIN_GAP_S / period_s))
    if 2 * gap >= n:
        raise UnusableInput(f'the recording covers {n * period_s:.1f} s; expected at least '
                            f'{2 * gap * period_s:.1f} s, so that places can be seen again')
    last_near = max(1, int(SAME_PLACE_S / period_s))
    near = [np.diagonal(errors, -k).copy() for k in range(1, last_near + 1)]

    row = np.arange(n)
    errors[row[:, np.newaxis] - row < gap] = NO_MATCH
    match = errors.argmin(axis=1)
    ranks = [_rank_of_neighbours(errors, match, steps * lag, gap) for steps in NEIGHBOURS]
    count = np.isfinite(ranks).sum(axis=0)
    rank = np.where(count >= 4, np.nansum(ranks, axis=0) / np.maximum(count, 1), np.nan)
    return Evidence(errors[row, match], rank, np.concatenate(near), gap * period_s)


def _rank_of_neighbours(errors: Errors, match: NDArray[np.intp], ahead: int,
                        gap: int) -> NDArray[np.float64]:
    """Rank the match that the sequence predicts for the frame `ahead` of each frame.

    The prediction is the interval from 0.5 to 1.8 times `ahead` after the match, because the
    speed may differ between the visits. It is compared with all intervals of that width.

    Args:
        errors: (n, n) match errors, [later, earlier].
        match: (n,) index of the best match of each frame.
        ahead: number of frames to the neighbour; negative for the frames before.
        gap: minimum number of frames between two visits.

    Returns:
        (n,) share of the intervals with a smaller error, NaN at the ends of the recording.
    """
    n = len(errors)
    low, high = sorted((round(0.5 * ahead), round(1.8 * ahead)))
    width = high - low + 1
    interval_errors = minimum_filter1d(errors, width, axis=1, mode='constant', cval=NO_MATCH)
    frame = np.arange(n)
    neighbour, centre = frame + ahead, match + low + width // 2
    valid = ((neighbour >= gap + 2 * width) & (neighbour < n)
             & (centre >= 0) & (centre <= neighbour - gap))
    frame, neighbour, centre = frame[valid], neighbour[valid], centre[valid]
    rows = interval_errors[neighbour]
    own = rows[np.arange(len(rows)), centre][:, np.newaxis]
    rank = np.full(n, np.nan)
    rank[frame] = (rows < own).sum(axis=1) / np.maximum((rows < NO_MATCH).sum(axis=1), 1)
    return rank


def compare_all(views: NDArray[np.uint8], p: LocalViewParameters) -> Errors:
    """Compute the match error of each view with each earlier one, as `LocalView` does.

    Args:
        views: (n, h, w) uint8.
        p: the parameters of the comparison.

    Returns:
        (n, n) errors, [later, earlier]; `NO_MATCH` on and above the diagonal.
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
    """Fill the lower triangle of `sums` with the smallest SAD over the offsets."""
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
