# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Local view: image -> ViewMatch, by exact search for the most similar template."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ratslam_ros.core.angles import wrap
from ratslam_ros.core.compiled import compiled
from ratslam_ros.core.config import LocalViewParameters
from ratslam_ros.core.image_window import Window, window_of

Image = NDArray[np.uint8]
Match = tuple[int, int, int]
"""Template id, horizontal offset, SAD."""

NO_TEMPLATE = -1


@dataclass(frozen=True, slots=True)
class ViewMatch:
    """Which template a view is.

    ``template_id`` is -1 for an image that could not be decoded. ``error`` is the exact minimum
    over the templates known before this view, 0 to 1, and -1 where there were none. (Where
    ``vt_recent_templates`` is set and an older template is named in place of a recent one, it is
    the exact minimum over the older ones.)
    ``relative_rad`` is the heading now minus the heading at learning (panoramic only).
    """

    template_id: int
    is_new: bool
    error: float
    relative_rad: float


UNDECODABLE = ViewMatch(NO_TEMPLATE, False, -1.0, 0.0)


class LocalView:
    """The memory of views."""

    def __init__(self, parameters: LocalViewParameters) -> None:
        self._p = parameters
        self._height = parameters.template_y_size
        self._width = parameters.template_x_size
        self._templates = np.empty((64, self._height, self._width), np.uint8)
        self._count = 0
        self._likely = 0
        if parameters.vt_panoramic:
            self._compared = self._width
            self._offsets = self._width
        else:
            self._compared = self._width - 2 * parameters.vt_shift_match
            self._offsets = 2 * parameters.vt_shift_match + 1
        self._compared_rows = self._height - 2 * parameters.vt_shift_match_y
        self._full_sum = 255.0 * self._compared * self._compared_rows

    @property
    def templates(self) -> NDArray[np.uint8]:
        """The templates learned so far: (n, template_y_size, template_x_size) uint8, read-only."""
        view = self._templates[: self._count]
        view.flags.writeable = False
        return view

    def __call__(self, image: Image) -> ViewMatch:
        """Recognise an image, or learn it as a new template.

        Args:
            image: (H, W) uint8 grey.

        Raises:
            UnusableParameter: the crop or template size does not fit the image.
        """
        view = make_view(image, self._p)
        match = self.match(view)
        if match is None:
            return ViewMatch(self.learn(view), True, -1.0, 0.0)
        recognised = self._recognised(view, match)
        if recognised is None:
            return ViewMatch(self.learn(view), True, match[2] / self._full_sum, 0.0)
        template_id, offset, sad = recognised
        self._likely = template_id
        return ViewMatch(template_id, False, sad / self._full_sum, self._relative_rad(offset))

    def _recognised(self, view: Image, match: Match) -> Match | None:
        """Return the best match if it is good enough, else the best older one if that is."""
        limit = self._p.vt_match_threshold * self._full_sum
        older = self._count
        if self._p.vt_recent_templates > 0:
            older = max(self._count - self._p.vt_recent_templates, 0)
        if match[0] < older:
            return match if match[2] <= limit else None
        if match[2] <= self._p.vt_recent_threshold * limit:
            return match
        older_match = self._match_first(view, older)
        return older_match if older_match is not None and older_match[2] <= limit else None

    def learn(self, view: Image) -> int:
        """Append a view, (template_y_size, template_x_size) uint8, and return its id."""
        if self._count == len(self._templates):
            grown = np.empty((2 * self._count, self._height, self._width), np.uint8)
            grown[: self._count] = self._templates
            self._templates = grown
        self._templates[self._count] = view
        self._likely = self._count
        self._count += 1
        return self._likely

    def match(self, view: Image) -> Match | None:
        """Return (template id, offset, SAD) of the best match, None where nothing is learned.

        Ties go to the lowest id, then to the lowest offset. algorithm.md, Local view, step 4.
        """
        return self._match_first(view, self._count)

    def _match_first(self, view: Image, count: int) -> Match | None:
        """Return what ``match`` does, of the oldest ``count`` templates only."""
        if count == 0:
            return None
        template_id, offset, sad = _search(
            self._templates, count, min(self._likely, count - 1), view, self._p.vt_panoramic,
            self._compared, self._offsets, self._p.vt_step_match, self._compared_rows,
        )  # fmt: skip
        return int(template_id), int(offset), int(sad)

    def _relative_rad(self, offset: int) -> float:
        if not self._p.vt_panoramic:
            return 0.0
        return wrap(-2.0 * math.pi * offset / self._width)


def make_view(image: Image, p: LocalViewParameters) -> Image:
    """Reduce a grey image to a view: crop, block means, normalise. Algorithm.md, steps 1 to 4.

    Args:
        image: (H, W) uint8 grey.
        p: crop, template size and normalisation.

    Returns:
        (template_y_size, template_x_size) uint8.

    Raises:
        UnusableParameter: the crop lies outside the image or is smaller than the template.
    """
    window = crop_window(image, p)
    view = np.empty((p.template_y_size, p.template_x_size), np.uint8)
    _make_view(
        image[window.y_min : window.y_max, window.x_min : window.x_max],
        p.vt_normalisation, p.vt_patch_normalise, p.vt_min_patch_normalisation_std, view,
    )  # fmt: skip
    return view


def crop_window(image: Image, p: LocalViewParameters) -> Window:
    """Return the part of the image that is compared; see ``make_view`` for what it raises."""
    return window_of(
        image,
        'local_view.image_crop',
        (p.image_crop_x_min, p.image_crop_x_max),
        (p.image_crop_y_min, p.image_crop_y_max),
        (p.template_x_size, p.template_y_size),
    )


@compiled
def _make_view(
    crop: Image, normalise_to: float, patch_radius: int, min_std: float, view: Image
) -> None:
    """Fill ``view`` (h, w) from ``crop`` (H, W); sums are exact integers or in fixed order."""
    height, width = crop.shape
    rows, columns = view.shape
    value = np.empty((rows, columns), np.float64)
    sums = np.empty(width, np.int64)
    for row in range(rows):
        top = row * height // rows
        bottom = (row + 1) * height // rows
        for x in range(width):
            sums[x] = 0
        for y in range(top, bottom):
            for x in range(width):
                sums[x] += crop[y, x]
        for column in range(columns):
            left = column * width // columns
            right = (column + 1) * width // columns
            total = 0
            for x in range(left, right):
                total += sums[x]
            value[row, column] = total / ((bottom - top) * (right - left) * 255.0)

    if normalise_to > 0.0:
        total_value = 0.0
        for row in range(rows):
            for column in range(columns):
                total_value += value[row, column]
        mean = total_value / (rows * columns)
        if mean > 0.0:  # a black view stays black
            for row in range(rows):
                for column in range(columns):
                    value[row, column] = min(value[row, column] * normalise_to / mean, 1.0)

    n = patch_radius
    patch_area = (2 * n + 1) * (2 * n + 1)
    for row in range(rows):
        for column in range(columns):
            v = value[row, column]
            if n > 0:
                mean = 0.0
                for dy in range(-n, n + 1):
                    y = min(max(row + dy, 0), rows - 1)
                    for dx in range(-n, n + 1):
                        mean += value[y, min(max(column + dx, 0), columns - 1)]
                mean /= patch_area
                # Two passes: a flat patch has a deviation of rounding errors at most, which
                # counts as none, where mean(v^2) - mean(v)^2 could even turn negative.
                variance = 0.0
                for dy in range(-n, n + 1):
                    y = min(max(row + dy, 0), rows - 1)
                    for dx in range(-n, n + 1):
                        d = value[y, min(max(column + dx, 0), columns - 1)] - mean
                        variance += d * d
                std = math.sqrt(variance / patch_area)
                if std <= 1e-12 or std < min_std:
                    v = 0.5
                else:
                    v = min(max(((v - mean) / std + 3.0) / 6.0, 0.0), 1.0)
            view[row, column] = math.floor(255.0 * v + 0.5)


@compiled
def _search(
    templates: NDArray[np.uint8],
    count: int,
    likely: int,
    view: Image,
    panoramic: bool,
    compared: int,
    offsets: int,
    step: int,
    compared_rows: int,
) -> tuple[np.int64, np.int64, np.int64]:
    """Return (id, offset, SAD) of the least SAD; ties: lowest id, then lowest offset.

    The view's middle ``compared_rows`` rows are compared at every vertical offset; among those
    that are equally good the lowest comes first.

    The likely template only sets the bound at which sums are broken off: every template whose
    sum could equal the minimum is still summed in full, so the result does not depend on it.
    """
    height, width = view.shape
    if panoramic:  # doubled, so that every turn of the view is one contiguous stretch
        query = np.empty((height, 2 * width), np.uint8)
        for y in range(height):
            for x in range(width):
                query[y, x] = view[y, x]
                query[y, width + x] = view[y, x]
    else:
        query = view
    falls = height - compared_rows + 1
    top = (height - compared_rows) // 2
    best_sad = np.int64(height) * width * 255 + 1
    best_id = np.int64(-1)
    best_offset = np.int64(0)
    for turn in range(2):
        first = likely if turn == 0 else 0
        last = likely + 1 if turn == 0 else count
        for candidate in range(first, last):
            template = templates[candidate]
            for fall in range(falls):
                for offset in range(0, offsets, step):
                    if panoramic:
                        from_view = (width - offset) % width
                        from_template = np.int64(0)
                    else:
                        from_view = np.int64(width - compared) // 2
                        from_template = np.int64(offset)
                    sad = np.int64(0)
                    for y in range(compared_rows):
                        # Slices, so that the loop needs no bounds arithmetic and becomes SIMD.
                        a = query[top + y, from_view : from_view + compared]
                        b = template[fall + y, from_template : from_template + compared]
                        row_sad = np.int32(0)
                        for x in range(a.shape[0]):
                            row_sad += abs(np.int32(a[x]) - np.int32(b[x]))
                        sad += row_sad
                        if sad >= best_sad:
                            break
                    if sad < best_sad:
                        best_sad = sad
                        best_id = np.int64(candidate)
                        best_offset = np.int64(offset)
        if turn == 0:  # search all again for a lower id that is as good
            best_sad += 1
    return best_id, best_offset, best_sad
