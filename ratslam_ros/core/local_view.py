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
from ratslam_ros.core.image_window import Window, plain, window_of
from ratslam_ros.core.sad import LANES, sad_of_lanes
from ratslam_ros.core.state import State
from ratslam_ros.errors import UnusableInput

Image = NDArray[np.uint8]
Values = NDArray[np.float64]
Match = tuple[int, int, int]
"""Template id, horizontal offset, SAD."""

NO_TEMPLATE = -1


@dataclass(frozen=True, slots=True)
class ViewMatch:
    """Which template a view is.

    ``template_id`` is -1 for an image that could not be decoded, and for one that is unknown
    while nothing is learned. ``error`` is the exact minimum
    over all templates known before this view, 0 to 1, and -1 where there were none.
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
        self.mapping = True
        """Whether unknown views are learned; else they are template -1."""
        self._height = parameters.template_y_size
        self._width = parameters.template_x_size
        self._rows = self._height - 2 * parameters.vt_shift_match_y
        if parameters.vt_panoramic:
            self._columns = self._width
            self._offsets = self._width
        else:
            self._columns = self._width - 2 * parameters.vt_shift_match
            self._offsets = 2 * parameters.vt_shift_match + 1
        self._full_sum = 255.0 * self._columns * self._rows
        # For each vertical offset the rows that it compares, column by column, so that whatever
        # a horizontal offset compares is one stretch of memory.
        self._falls = 2 * parameters.vt_shift_match_y + 1
        self._packed = np.empty((64, self._falls, self._width * self._rows), np.uint8)
        self._count = 0
        self._likely = 0

    def __len__(self) -> int:
        return self._count

    @property
    def templates(self) -> NDArray[np.uint8]:
        """The templates learned so far: (n, template_y_size, template_x_size) uint8, a copy."""
        out = np.empty((self._count, self._height, self._width), np.uint8)
        shape = self._count, self._width, self._rows
        for fall in range(self._falls):
            part = self._packed[: self._count, fall].reshape(shape)
            out[:, fall : fall + self._rows] = part.transpose(0, 2, 1)
        return out

    def template(self, template_id: int) -> Image:
        """Return one template: (template_y_size, template_x_size) uint8, a copy."""
        out = np.empty((self._height, self._width), np.uint8)
        for fall in range(self._falls):
            part = self._packed[template_id, fall].reshape(self._width, self._rows)
            out[fall : fall + self._rows] = part.T
        return out

    def __call__(self, image: Image) -> ViewMatch:
        """Recognise an image, or learn it as a new template.

        Args:
            image: (H, W) uint8 grey.

        Raises:
            UnusableParameter: the crop or template size does not fit the image.
        """
        view = make_view(image, self._p)
        match = self.match(view)
        recognised = None if match is None else self._recognised(view, match)
        error = -1.0 if match is None else match[2] / self._full_sum
        if recognised is None:
            if not self.mapping:
                return ViewMatch(NO_TEMPLATE, False, error, 0.0)
            return ViewMatch(self.learn(view), True, error, 0.0)
        template_id, offset, _ = recognised
        self._likely = template_id
        return ViewMatch(template_id, False, error, self._relative_rad(offset))

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
        if self._count == len(self._packed):
            grown = np.empty((2 * self._count, *self._packed.shape[1:]), np.uint8)
            grown[: self._count] = self._packed
            self._packed = grown
        for fall in range(self._falls):
            self._packed[self._count, fall] = view[fall : fall + self._rows].T.reshape(-1)
        self._likely = self._count
        self._count += 1
        return self._likely

    def state(self) -> State:
        """Return all that was learned, for ``restore``."""
        return {'templates': self.templates, 'likely': self._likely}

    def restore(self, state: State) -> None:
        """Take what ``state`` gave for the present memory, which must be empty.

        Raises:
            UnusableInput: it is of templates of another size.
        """
        templates = state['templates']
        if templates.dtype != np.uint8 or templates.shape[1:] != (self._height, self._width):
            raise UnusableInput(
                f'the templates are {templates.shape[1:]} of {templates.dtype}; expected '
                f'{(self._height, self._width)} of uint8: template_y_size and template_x_size '
                'must be those of the run that saved'
            )
        for view in templates:
            self.learn(view)
        self._likely = int(state['likely'])

    def match(self, view: Image) -> Match | None:
        """Return (template id, offset, SAD) of the best match, None where nothing is learned.

        Ties go to the lowest id, then to the lowest offset. algorithm.md, Local view, step 4.
        """
        return self._match_first(view, self._count)

    def _match_first(self, view: Image, count: int) -> Match | None:
        """Return what ``match`` does, of the oldest ``count`` templates only."""
        if count == 0:
            return None
        p = self._p
        rows = view[p.vt_shift_match_y : p.vt_shift_match_y + self._rows]
        if p.vt_panoramic:  # twice round, so that every turn of the view is one stretch
            query = np.concatenate([rows.T, rows.T]).reshape(-1)
        else:
            query = rows[:, p.vt_shift_match : p.vt_shift_match + self._columns].T.reshape(-1)
        template_id, offset, sad = _search(
            self._packed[:count], min(self._likely, count - 1), query, p.vt_panoramic,
            self._rows, self._columns * self._rows, self._offsets, p.vt_step_match,
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
        plain(image), *window, p.vt_normalisation, p.vt_patch_normalise,
        p.vt_min_patch_normalisation_std, view,
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
    image: Image, x_min: int, x_max: int, y_min: int, y_max: int,
    normalise_to: float, patch_radius: int, min_std: float, view: Image,
) -> None:  # fmt: skip
    """Fill ``view`` (h, w) from a window of an image; sums are exact or in fixed order."""
    height, width = y_max - y_min, x_max - x_min
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
                sums[x] += image[y_min + y, x_min + x]
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

    if patch_radius > 0:
        _normalise_patches(value, patch_radius, min_std, view)
        return
    for row in range(rows):
        for column in range(columns):
            view[row, column] = math.floor(255.0 * value[row, column] + 0.5)


@compiled
def _normalise_patches(value: Values, n: int, min_std: float, view: Image) -> None:
    """Fill ``view`` from ``value`` (h, w), each pixel by mean and deviation of its patch."""
    rows, columns = value.shape
    area = (2 * n + 1) * (2 * n + 1)
    # Sums over the patch's columns first, then over its rows; edges replicated. From the view's
    # mean on, so that little is cancelled in the squares.
    middle = 0.0
    for row in range(rows):
        for column in range(columns):
            middle += value[row, column]
    middle /= rows * columns
    sums = np.zeros((rows, columns))
    squares = np.zeros((rows, columns))
    for row in range(rows):
        for dx in range(-n, n + 1):
            for column in range(columns):
                v = value[row, min(max(column + dx, 0), columns - 1)] - middle
                sums[row, column] += v
                squares[row, column] += v * v
    total = np.empty(columns)
    total_square = np.empty(columns)
    for row in range(rows):
        total[:] = 0.0
        total_square[:] = 0.0
        for dy in range(-n, n + 1):
            y = min(max(row + dy, 0), rows - 1)
            for column in range(columns):
                total[column] += sums[y, column]
                total_square[column] += squares[y, column]
        for column in range(columns):
            mean = middle + total[column] / area
            variance = total_square[column] / area - (mean - middle) * (mean - middle)
            if variance < 1e-8:
                # Here rounding counts: again, exactly. A flat patch then has a deviation of
                # rounding errors at most, which counts as none.
                variance = 0.0
                for dy in range(-n, n + 1):
                    y = min(max(row + dy, 0), rows - 1)
                    for dx in range(-n, n + 1):
                        d = value[y, min(max(column + dx, 0), columns - 1)] - mean
                        variance += d * d
                variance /= area
            std = math.sqrt(variance)
            if std <= 1e-12 or std < min_std:
                v = 0.5
            else:
                v = min(max(((value[row, column] - mean) / std + 3.0) / 6.0, 0.0), 1.0)
            view[row, column] = math.floor(255.0 * v + 0.5)


@compiled
def _search(
    packed: NDArray[np.uint8],
    likely: int,
    query: Image,
    panoramic: bool,
    rows: int,
    length: int,
    offsets: int,
    step: int,
) -> tuple[int, int, int]:
    """Return (id, offset, SAD) of the least SAD; ties: lowest id, vertical, horizontal offset.

    The likely templates only set the bound at which sums are broken off: every template whose
    sum could equal the minimum is still summed in full, so the result does not depend on it.
    """
    pieces = length - length % LANES
    best_sad = length * 255 + 1
    best_id = -1
    best_offset = 0
    for turn in range(2):
        # The view is most likely that of the last match or of those that were learned next.
        first = likely if turn == 0 else 0
        last = min(likely + 4, packed.shape[0]) if turn == 0 else packed.shape[0]
        for candidate in range(first, last):
            for fall in range(packed.shape[1]):
                template = packed[candidate, fall]
                for offset in range(0, offsets, step):
                    if panoramic:
                        in_query = (offsets - offset) % offsets * rows
                        in_template = 0
                    else:
                        in_query = 0
                        in_template = offset * rows
                    sad = 0
                    at = 0
                    while at < pieces and sad < best_sad:
                        sad += sad_of_lanes(query, in_query + at, template, in_template + at)
                        at += LANES
                    while at < length and sad < best_sad:
                        difference = np.int64(query[in_query + at])
                        sad += int(abs(difference - np.int64(template[in_template + at])))
                        at += 1
                    if sad < best_sad:
                        best_sad = sad
                        best_id = candidate
                        best_offset = offset
        if turn == 0:  # search all again for a lower id that is as good
            best_sad += 1
    return best_id, best_offset, best_sad
