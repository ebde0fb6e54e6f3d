# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Detection of revisits in a recording, without ground truth.

Every frame is compared with all earlier ones, by a neutral reduction of the whole image
(`NEUTRAL`) that does not depend on the parameters under test. The best match of a frame among
those at least a minimum time ago is either a revisit or a chance match. At a revisit, the frames
before and after match as well, in sequence, as in SeqSLAM, Milford and Wyeth (2012). For eight
neighbours of the frame, far enough apart for the view to have changed, this module computes the
share of the recording that matches the neighbour better than the frames expected from the
sequence. For a chance match, the expected share is one half.

`Evidence.same_place` holds the resulting probability-like measure for every pair of frames, with
which `ratslam_tuning.map_score` judges recognitions and maps.
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
from ratslam_ros.messages.json_schema import NS_PER_S
from ratslam_ros.recordings import ImageEvent, Recording, Selection, UndecodableImage

Image = NDArray[np.uint8]
Errors = NDArray[np.float32]
Ints = NDArray[np.int64]

NEUTRAL = LocalViewParameters(
    template_x_size=32, template_y_size=24, vt_shift_match=0, vt_patch_normalise=4
)
"""Reduction of the images for the evidence: small and illumination-invariant."""

NEUTRAL_SHIFTS_PX = (0, 2, 4)
"""Largest horizontal shifts of the comparison. Without shifts, places are distinguished by the
heading of the robot as well; with shifts, a place is recognised from other lanes."""

FEWER_SHIFTS_RATIO = 0.95
"""The smallest shift is used that finds at least this share of the revisits that any of them
finds."""

MAX_FRAME_COUNT = 2000
SMALL_WIDTH_PX, SMALL_HEIGHT_PX = 160, 60
"""Frames are shrunk by integer factors, to at least this size."""

MIN_GAP_S = 3.0
"""Minimum time between two views that are a revisit."""

DECORRELATION_RATIO = 0.85
"""The view has changed if the error exceeds this fraction of the median error of all pairs."""

NEIGHBOURS = (1, 2, 3, 4, -1, -2, -3, -4)
"""Offsets of the neighbours, in units of the time after which the view has changed."""

MIN_NEIGHBOUR_COUNT = 4
"""Number of neighbours that must be comparable."""

SUPPORTED_RANK, UNSUPPORTED_RANK = 0.2, 0.4
"""Limits on the mean rank: at most for a revisit, at least for a chance match."""

NEAR, FAR = 0.5, 1.5
"""Distance to the locally best match, in units of the time after which the view has changed, up
to which a match counts as the same place, and from which it counts as another one."""

MIN_SUPPORTED_COUNT, MIN_SUPPORTED_SHARE = 20, 0.1
"""With fewer revisits, the matches may all be chance matches."""

NO_MATCH = np.float32(np.inf)
"""Error of pairs that are not compared."""


def sample_frames(
    recording: Recording, selection: Selection, start_s: float = 0.0,
    duration_s: float | None = None, at_most: int = MAX_FRAME_COUNT, grey: str = 'luma',
) -> Iterator[tuple[int, Image]]:
    """Yield frames that are evenly spaced over a recording.

    Only these frames are decoded; undecodable ones are skipped.

    Args:
        recording: the recording.
        selection: its topics to use.
        start_s: skipped seconds at the start.
        duration_s: limit on the duration, None for the rest.
        at_most: approximate number of frames.
        grey: how colours become grey, as ``image_grey``.

    Yields:
        Stamp in ns, increasing, and (H, W) uint8 grey image.
    """
    length_ns = recording.end_ns - recording.start_ns - round(start_s * NS_PER_S)
    if duration_s is not None:
        length_ns = min(length_ns, round(duration_s * NS_PER_S))
    step_ns = length_ns / max(at_most - 1, 1)
    due_ns, last_ns = 0.0, -1
    for event in recording.events(selection, start_s, duration_s):
        if (isinstance(event, ImageEvent) and event.log_ns >= due_ns
                and event.stamp_ns > last_ns):
            # After a gap some frames may follow closely, so that jitter does not cost frames.
            due_ns = max(due_ns + step_ns, event.log_ns - 9.0 * step_ns)
            with contextlib.suppress(UndecodableImage):
                yield event.stamp_ns, event.grey(grey)
                last_ns = event.stamp_ns


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

    def window(self, p: LocalViewParameters) -> tuple[int, int, int, int]:
        """Return x_min, x_max, y_min, y_max of the crop in full-size frames."""
        window = crop_window(self.sample, p)
        return window.x_min, window.x_max, window.y_min, window.y_max

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
    """Revisits of a recording.

    Attributes:
        stamp_ns: (n,) stamps of the compared frames.
        match: (n,) index of the best match of each frame among those at least `gap` before it.
        rank: (n,) 0 to 1, mean share of the recording that matches the neighbours of the frame
            better than the sequence does; about 0.5 for chance matches, NaN if too few neighbours
            can be compared.
        same_place: (n, n) 0 to 1, [later, earlier]: whether two frames show the same place; NaN
            if unknown.
        lag: number of frames after which the view has changed.
        gap: minimum number of frames between two visits.
    """

    stamp_ns: Ints
    match: NDArray[np.intp]
    rank: Errors
    same_place: Errors
    lag: int
    gap: int

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

    @property
    def gap_s(self) -> float:
        """Minimum time between two visits, in s."""
        return self.gap * self.period_s

    @property
    def period_s(self) -> float:
        """Mean time between two compared frames, in s."""
        return float(self.stamp_ns[-1] - self.stamp_ns[0]) / NS_PER_S / (len(self.stamp_ns) - 1)


def measure(images: NDArray[np.uint8], stamp_ns: Ints) -> Evidence:
    """Compare each image with all earlier ones, and compute the support of the matches.

    Args:
        images: (n, H, W) uint8 grey.
        stamp_ns: (n,) increasing stamps.

    Raises:
        UnusableInput: the recording is too short for revisits.
    """
    views = np.stack([make_view(image, NEUTRAL) for image in images])
    found = [
        _evidence(compare_all(views, replace(NEUTRAL, vt_shift_match=shift_px)), stamp_ns)
        for shift_px in NEUTRAL_SHIFTS_PX
    ]
    counts = [int(evidence.is_supported.sum()) for evidence in found]
    return next(evidence for evidence, count in zip(found, counts, strict=True)
                if count >= FEWER_SHIFTS_RATIO * max(counts))


def _evidence(errors: Errors, stamp_ns: Ints) -> Evidence:
    """Compute the support of the matches from the (n, n) errors, which are overwritten."""
    n = len(errors)
    period_s = max(float(stamp_ns[-1] - stamp_ns[0]) / NS_PER_S / max(n - 1, 1), 1e-9)
    median_error = np.median(errors[np.tril_indices(n, -1)])
    lag = next((k for k in range(1, n // 8)
                if np.median(np.diagonal(errors, -k)) >= DECORRELATION_RATIO * median_error),
               n // 8)
    gap = max(2 * lag, round(MIN_GAP_S / period_s))
    if 2 * gap >= n:
        raise UnusableInput(f'the recording covers {n * period_s:.1f} s; expected at least '
                            f'{2 * gap * period_s:.1f} s, so that places can be seen again')
    row = np.arange(n)
    errors[row[:, np.newaxis] - row < gap] = NO_MATCH
    match = errors.argmin(axis=1)
    rank = _rank_of_sequences(errors, lag, gap)
    slope = UNSUPPORTED_RANK - SUPPORTED_RANK
    same_place = (np.clip((UNSUPPORTED_RANK - rank) / slope, 0.0, 1.0)
                  * np.clip(FAR - _frames_to_best(errors, 2 * lag) / lag, 0.0, 1.0) / (FAR - NEAR))
    return Evidence(stamp_ns, match, rank[row, match], same_place.astype(np.float32), lag, gap)


def _rank_of_sequences(errors: Errors, lag: int, gap: int) -> Errors:
    """Rank, for each pair of frames, the matches that the sequence predicts for the neighbours.

    The prediction for a neighbour is the interval from 0.5 to 1.8 times its offset after the
    match, because the speed may differ between the visits. It is compared with all intervals of
    that width.

    Args:
        errors: (n, n) match errors, [later, earlier].
        lag: number of frames between two neighbours.
        gap: minimum number of frames between two visits.

    Returns:
        (n, n) mean share of the intervals with a smaller error; NaN for pairs less than `gap`
        apart, and if fewer than `MIN_NEIGHBOUR_COUNT` neighbours can be compared.
    """
    n = len(errors)
    total, count = np.zeros((n, n), np.float32), np.zeros((n, n), np.int16)
    for steps in NEIGHBOURS:
        ahead = steps * lag
        low, high = sorted((round(0.5 * ahead), round(1.8 * ahead)))
        width = high - low + 1
        centre = low + width // 2
        least = minimum_filter1d(errors, width, axis=1, mode='constant', cval=NO_MATCH)
        for frame in range(max(0, -ahead), min(n, n - ahead)):
            intervals = frame + ahead - gap + 1
            first, last = max(0, -centre), min(frame - gap + 1, intervals - centre)
            if intervals < 2 * width or last <= first:
                continue
            row = least[frame + ahead, :intervals]
            ordered = np.sort(row)
            own = row[first + centre:last + centre]
            # Equal errors share the mean of their ranks.
            smaller = np.searchsorted(ordered, own) + np.searchsorted(ordered, own, side='right')
            total[frame, first:last] += smaller / (2.0 * intervals)
            count[frame, first:last] += 1
    total[count < MIN_NEIGHBOUR_COUNT] = np.nan
    return np.divide(total, np.maximum(count, 1), dtype=np.float32)


def _frames_to_best(errors: Errors, reach: int) -> NDArray[np.int64]:
    """Return, for each pair, the distance to the best match of the later frame within `reach`."""
    n = len(errors)
    best = errors.copy()
    distance = np.zeros((n, n), np.int64)
    for offset in sorted(range(-reach, reach + 1), key=abs):
        here = slice(max(0, -offset), n - max(0, offset))
        there = slice(max(0, offset), n - max(0, -offset))
        better = errors[:, there] < best[:, here]
        best[:, here][better] = errors[:, there][better]
        distance[:, here][better] = abs(offset)
    return distance


def compare_all(views: NDArray[np.uint8], p: LocalViewParameters) -> Errors:
    """Compute the match error of each view with each earlier one, as `LocalView` does.

    Args:
        views: (n, h, w) uint8, not panoramic.
        p: the parameters of the comparison, which is at every horizontal shift.

    Returns:
        (n, n) errors, [later, earlier]; `NO_MATCH` on and above the diagonal.
    """
    n, height, width = views.shape
    compared = width - 2 * p.vt_shift_match
    queries = np.ascontiguousarray(views[:, :, p.vt_shift_match:width - p.vt_shift_match])
    sums = np.full((n, n), -1, np.int32)
    _least_sums(queries, views, sums)
    errors = (sums / np.float32(255 * compared * height)).astype(np.float32)
    errors[sums < 0] = NO_MATCH
    return errors


@compiled
def _least_sums(queries: Image, templates: Image, sums: NDArray[np.int32]) -> None:
    """Fill the lower triangle of `sums` with the smallest SAD over the offsets."""
    n, height, compared = queries.shape
    for later in range(n):
        for earlier in range(later):
            least = np.int32(2**31 - 1)
            for offset in range(templates.shape[2] - compared + 1):
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
