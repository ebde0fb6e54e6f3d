# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Local view: place recognition by exact search for the most similar template.

See docs/algorithm.md, "Local view".
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from ratslam_ros.core.common.angles import wrap
from ratslam_ros.core.common.compiled import compiled
from ratslam_ros.core.common.state import State
from ratslam_ros.core.config import LocalViewParameters
from ratslam_ros.core.vision.image_window import Window, contiguous, window_of
from ratslam_ros.core.vision.template_memory import Match, TemplateMemory
from ratslam_ros.errors import UnusableInput

Image = NDArray[np.uint8]
Values = NDArray[np.float64]

NO_TEMPLATE = -1
"""Template id of views that match no template and are not learned."""


@dataclass(frozen=True, slots=True)
class ViewMatch:
    """Result of matching one view with the templates."""

    template_id: int
    """The matched or new template. -1 if the image could not be decoded, or if it matches no
    template while learning is off."""
    is_new: bool
    """Whether the view was learned as a new template."""
    error: float
    """Minimum mean absolute difference to the templates known before, from 0 to 1. -1 if there
    were none, or if the view is unknown and ``vt_exact_error`` is off."""
    relative_rad: float
    """Present heading minus the heading at which the template was learned. 0 for forward cameras
    if ``vt_shift_fov_deg`` is 0."""


UNDECODABLE = ViewMatch(NO_TEMPLATE, False, -1.0, 0.0)
"""Result for an image that could not be decoded."""


class ViewMatcher(Protocol):
    """What RatSLAM needs of a local view; a class of your own with this method can replace it."""

    def match(self, image: Image) -> ViewMatch:
        """Return the template that an image, (H, W) uint8 grey, shows; new ids count from 0."""
        ...


class LocalView:
    """Place recognition with a growing memory of templates."""

    def __init__(self, parameters: LocalViewParameters) -> None:
        p = self._p = parameters
        self.mapping = True
        """Whether unknown views are learned; otherwise they are reported as template -1."""
        self._size = p.template_y_size, p.template_x_size
        self._memory = TemplateMemory(
            p.template_x_size, p.template_y_size, p.vt_shift_match, p.vt_shift_match_y,
            p.vt_step_match, panoramic=p.vt_panoramic, signed=p.vt_patch_normalise > 0,
        )  # fmt: skip
        self._limit = math.floor(p.vt_match_threshold * self._memory.full_sum)
        self._recent_limit = math.floor(
            p.vt_recent_threshold * (p.vt_match_threshold * self._memory.full_sum)
        )

    def __len__(self) -> int:
        return len(self._memory)

    @property
    def templates(self) -> NDArray[np.uint8]:
        """Copy of all templates: (n, template_y_size, template_x_size) uint8."""
        return self._memory.views()

    def template(self, template_id: int) -> Image:
        """Return a copy of one template: (template_y_size, template_x_size) uint8."""
        return self._memory.view(template_id)

    def match(self, image: Image) -> ViewMatch:
        """Recognise an image, or learn it as a new template.

        Args:
            image: (H, W) uint8, greyscale.

        Raises:
            UnusableParameter: the crop or template size does not fit the image.
        """
        view = make_view(image, self._p)
        recognised, min_sad = self._search(view)
        error = -1.0 if min_sad is None else min_sad / self._memory.full_sum
        if recognised is not None:
            relative_rad = self._relative_rad(recognised.offset)
            return ViewMatch(recognised.template_id, False, error, relative_rad)
        if not self.mapping:
            return ViewMatch(NO_TEMPLATE, False, error, 0.0)
        return ViewMatch(self.learn(view), True, error, 0.0)

    def _search(self, view: Image) -> tuple[Match | None, int | None]:
        """Return the match within its threshold, if any, and the minimum SAD, if computed."""
        search = self._memory.search(view)
        best = search.best(limit=None if self._p.vt_exact_error else self._limit)
        if best is None:
            return None, None
        older = len(self) - self._p.vt_recent_templates
        if self._p.vt_recent_templates == 0 or best.template_id < older:
            return best if best.sad <= self._limit else None, best.sad
        if best.sad <= self._recent_limit:
            return best, best.sad
        return search.best(max(older, 0), self._limit), best.sad

    def learn(self, view: Image) -> int:
        """Add a view, (template_y_size, template_x_size) uint8, as a template; return its id."""
        return self._memory.append(view)

    def state(self) -> State:
        """Return the learned templates, for ``restore``."""
        return {'templates': self.templates}

    def restore(self, state: State) -> None:
        """Load a state returned by ``state`` into this memory, which must be empty.

        Raises:
            UnusableInput: the templates have another size or type.
        """
        templates = state['templates']
        if templates.dtype != np.uint8 or templates.shape[1:] != self._size:
            raise UnusableInput(
                f'the templates are {templates.shape[1:]} of {templates.dtype}; expected '
                f'{self._size} of uint8: template_y_size and template_x_size '
                'must equal those of the run that saved them'
            )
        for view in templates:
            self.learn(view)

    def best_match(self, view: Image) -> Match | None:
        """Return the best match regardless of the threshold, or None if there are no templates.

        Ties go to the lowest template id, then to the lowest offset.
        """
        return self._memory.search(view).best()

    def _relative_rad(self, offset: int) -> float:
        p = self._p
        if p.vt_panoramic:
            return wrap(-2.0 * math.pi * offset / p.template_x_size)
        # After a turn to the left, the content of the template appears further right in the view.
        return math.radians(p.vt_shift_fov_deg) * (p.vt_shift_match - offset) / p.template_x_size


def make_view(image: Image, p: LocalViewParameters) -> Image:
    """Reduce a greyscale image to a view: crop, downsample by block means, and normalise.

    Args:
        image: (H, W) uint8, greyscale.
        p: crop, template size and normalisation.

    Returns:
        (template_y_size, template_x_size) uint8.

    Raises:
        UnusableParameter: the crop exceeds the image or is smaller than the template.
    """
    window = crop_window(image, p)
    view = np.empty((p.template_y_size, p.template_x_size), np.uint8)
    _make_view(
        contiguous(image), *window, p.vt_normalisation, p.vt_patch_normalise,
        p.vt_min_patch_normalisation_std, view,
    )  # fmt: skip
    return view


def crop_window(image: Image, p: LocalViewParameters) -> Window:
    """Return the crop of an image that is compared.

    Raises:
        UnusableParameter: the crop exceeds the image or is smaller than the template.
    """
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
    """Fill ``view`` (h, w) from a window of an image; sums are exact or in a fixed order."""
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
        if mean > 0.0:  # A black view stays black.
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
    """Fill ``view`` from ``value`` (h, w), normalised by mean and deviation of each patch."""
    rows, columns = value.shape
    area = (2 * n + 1) * (2 * n + 1)
    # Separable box sums, columns first, with replicated edges. The mean of the view is subtracted
    # first, to reduce cancellation in the sums of squares.
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
                # Rounding errors dominate so small a variance: compute it by the definition. A
                # uniform patch then has a deviation of at most 1e-12.
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
