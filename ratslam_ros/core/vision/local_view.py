# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Local view: place recognition by exact search for the most similar template.

Ball et al. (2013); docs/algorithm.md, "Local view". Additions take the place of ``Recognition``.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ratslam_ros.core.common.angles import wrap
from ratslam_ros.core.common.freshness import Freshness
from ratslam_ros.core.common.odometry import MotionFromOdometry, Odometry
from ratslam_ros.core.common.saved import Field, Saved, count
from ratslam_ros.core.common.state import State
from ratslam_ros.core.config import (
    InputParameters,
    LocalViewParameters,
    MemoryParameters,
    additions,
)
from ratslam_ros.core.vision.built_in import BUILT_IN, INTENSITY, built_in_encoder
from ratslam_ros.core.vision.encoder import Encoder, Image, View
from ratslam_ros.core.vision.image_window import cropped
from ratslam_ros.core.vision.recognition import FIXED_THRESHOLD, Recognition
from ratslam_ros.core.vision.template_memory import Match, TemplateMemory
from ratslam_ros.errors import UnusableInput

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
    were none."""
    relative_rad: float
    """Present heading minus the heading at which the template was learned. 0 for forward cameras
    if ``vt_shift_fov_deg`` is 0."""
    threshold: float = FIXED_THRESHOLD
    """The automatic threshold that ``error`` was compared with; -1 if the threshold is fixed."""
    related_count: int = 0
    """Number of newest templates that show the same scene as the view, apart from gradual changes;
    0 if ``vt_recent_templates`` is not automatic. The pose cells measure the distance between two
    scenes by it, from which they derive the size of a cell (core/pose_cells/lengths.py)."""
    removed: tuple[int, ...] = ()
    """Ids of the templates that were removed to make room for this one; they are not reused."""


UNDECODABLE = ViewMatch(NO_TEMPLATE, False, -1.0, 0.0)
"""Result for an image that could not be decoded, or has too little structure to be recognised."""


class EncodedView(NamedTuple):
    """Result of ``LocalView.encode``: a view, None if the image has too little structure."""

    view: View | None


class LocalView(Saved):
    """Place recognition with a growing memory of templates."""

    SAVED = (
        Field('templates', '', 'u1', ('templates', '', ''), save=lambda own: own.templates,
              is_fixed=True),
        Field('descriptor', '', str, save=lambda own: own._p.vt_descriptor,
              when=lambda own: own._p.vt_descriptor != INTENSITY),
        Field('threshold', '_recognition.threshold', additions.MATCH_THRESHOLD, optional=True),
        Field('sequence', '_recognition.sequence', additions.SEQUENCES, optional=True),
        Field('look_alikes', '_recognition.look_alikes', additions.LOOK_ALIKES, optional=True),
        count('low_texture', 'low_texture', optional=True),
        Field('motion', '_recognition.motion', MotionFromOdometry, optional=True),
        # Left out while no template has been removed.
        Field('template_ids', '', 'i8', ('templates',), 0, save=lambda own: own.template_ids,
              when=lambda own: own._memory.next_id != len(own),
              fits=('distinct numbers', lambda ids, _: len(set(ids.tolist())) == len(ids))),
        count('next_id', '', save=lambda own: own._memory.next_id,
              when=lambda own: own._memory.next_id != len(own)),
        Field('freshness', '_freshness', Freshness, optional=True),
    )

    def __init__(
        self, parameters: LocalViewParameters, encoder: Encoder | None = None,
        inputs: InputParameters = InputParameters(), memory: MemoryParameters = MemoryParameters(),
    ) -> None:
        """Create a memory without templates.

        Args:
            parameters: all parameters of the local view.
            encoder: reduces images to views; None: the built-in one that ``vt_descriptor`` names.
            inputs: the odometry that tells look-alikes apart.
            memory: what is forgotten at the limit ``vt_max``.

        Raises:
            UnusableParameter: ``vt_descriptor`` is not built in.
        """
        p = self._p = self._created_with = parameters
        self.mapping = True
        """Whether unknown views are learned; otherwise they are reported as template -1."""
        self.low_texture = 0
        """Number of images with too little structure, neither recognised nor learned."""
        self._encoder = built_in_encoder(p) if encoder is None else encoder
        self._layout = self._encoder.layout
        self._memory = TemplateMemory(self._layout)
        fading = memory.forget_share, memory.forget_after_s
        self._freshness = Freshness(*fading) if p.vt_max > 0 else None
        recognition = additions.AUTOMATIC_RECOGNITION.instead_of(Recognition, p)
        self._recognition = recognition(p, self._memory, self._layout, inputs)

    def __len__(self) -> int:
        return len(self._memory)

    def reconfigure(self, parameters: LocalViewParameters) -> None:
        """Continue with other values, from the next message on.

        Raises:
            UnusableParameter: a parameter differs that cannot change; nothing is changed.
        """
        self._created_with.check_change(parameters)
        self._p = parameters
        self._recognition.reconfigure(parameters)

    @property
    def templates(self) -> NDArray[np.uint8]:
        """All templates, in the order of ``template_ids``: (n, height, width) uint8, read only."""
        return self._memory.views()

    @property
    def template_ids(self) -> NDArray[np.int64]:
        """(n,) ids of ``templates``: 0 to n - 1 as long as none was removed."""
        return self._memory.ids

    def __contains__(self, template_id: int) -> bool:
        """Return whether a template is known; an id may be that of a removed one."""
        return template_id in self._memory

    def template(self, template_id: int) -> View:
        """Return a copy of one template: (height, width) uint8."""
        return self._memory.view(template_id)

    def picture(self, view: View) -> Image:
        """Return a view for display: its planes side by side."""
        planes = view.reshape(self._layout.planes, -1, self._layout.width)
        return np.concatenate(list(planes), 1)

    @property
    def wants_colour(self) -> bool:
        """Whether ``encode`` uses the colour image."""
        return self._encoder.wants_colour

    def encode(self, image: Image, colour: Image | None = None) -> View | None:
        """Return the view of an image, as it is compared; None if it has too little structure.

        Args:
            image: (H, W) uint8, greyscale.
            colour: (H, W, 3) uint8 in BGR order, None if it is unknown.

        Raises:
            UnusableParameter: the crop or template size does not fit the image.
        """
        p = self._p
        if additions.STRUCTURE.is_selected(p) and (
            additions.STRUCTURE.load()(image, cropped(image, p)) < p.vt_min_structure
        ):
            return None
        if colour is not None and self.wants_colour:
            return self._encoder.encode(colour)
        return self._encoder.encode(image)

    @property
    def encodes_ahead(self) -> bool:
        """Whether another thread may call ``encode``; a model may be bound to its thread."""
        return self._p.vt_descriptor in BUILT_IN

    def shift_of(self, relative_rad: float) -> int:
        """Return the columns by which a view is shifted relative to a template that it matches."""
        p = self._p
        field_rad = 2.0 * math.pi if self._layout.panoramic else math.radians(p.vt_shift_fov_deg)
        return round(relative_rad / field_rad * p.template_x_size) if field_rad > 0.0 else 0

    def follow(self, odometry: Odometry) -> None:
        """Follow the robot; called before the images that are at least a second later."""
        self._recognition.follow(odometry)

    def relocated(self) -> None:
        """Continue after the robot may have been moved unobserved."""
        self._recognition.relocated()

    def match(
        self, image: Image, stamp_ns: int = 0, encoded: EncodedView | None = None
    ) -> ViewMatch:
        """Recognise an image, or learn it as a new template.

        Args:
            image: (H, W) uint8, greyscale.
            stamp_ns: stamp of the image; used if ``vt_max`` limits the number of templates.
            encoded: result of ``encode`` for the image; None: compute it.

        Raises:
            UnusableParameter: the crop or template size does not fit the image.
        """
        view = self.encode(image) if encoded is None else encoded.view
        if view is None:
            self.low_texture += 1
            return UNDECODABLE
        if self._freshness is not None and self.mapping:
            self._freshness.advance(stamp_ns)
        recognition = self._recognition
        recognised, min_sad, related_count = recognition.of(view, self.mapping)
        error = -1.0 if min_sad is None else min_sad / self._memory.full_sum
        threshold = recognition.estimated_threshold
        if recognised is not None:
            if self._freshness is not None and self.mapping:
                self._freshness.observe(recognised.template_id)
            relative_rad = self.relative_rad(recognised.offset)
            return ViewMatch(
                recognised.template_id, False, error, relative_rad, threshold, related_count
            )
        if not self.mapping:
            return ViewMatch(NO_TEMPLATE, False, error, 0.0, threshold, related_count)
        removed = self._to_remove()
        for template_id in removed:
            self._memory.remove(template_id)
        new_id = self.learn(view)
        recognition.learned(new_id, removed)
        return ViewMatch(new_id, True, error, 0.0, threshold, related_count, removed)

    def _to_remove(self) -> tuple[int, ...]:
        """Select the templates to remove for ``vt_max``: several if a larger memory was loaded."""
        removed: list[int] = []
        while self._freshness is not None and len(self._freshness) >= self._p.vt_max:
            template_id = self._freshness.candidate()
            assert template_id is not None  # every template may be removed
            self._freshness.remove(template_id)
            removed.append(template_id)
        return tuple(removed)

    def learn(self, view: View) -> int:
        """Add a view, (height, width) uint8, as a template; return its id."""
        template_id = self._memory.append(view)
        if self._freshness is not None:
            self._freshness.add(template_id)
        return template_id

    def restore(self, state: State) -> None:
        """Load a state returned by ``state`` into this memory, which must be empty.

        Raises:
            UnusableInput: the templates have another size or type, or are of another descriptor.
        """
        found = state.get('descriptor', INTENSITY), *state['templates'].shape[1:]
        expected = self._p.vt_descriptor, self._layout.height, self._layout.width
        if found != expected:
            raise UnusableInput(
                f'the templates are {found}; expected {expected}: vt_descriptor, template_y_size '
                'and template_x_size must be those of the run that saved them'
            )
        super().restore(state)

    def _restored(self, state: State) -> None:
        templates = state['templates']
        ids = state.get('template_ids', np.arange(len(templates)))
        self._memory.restore(templates, ids, int(state.get('next_id', len(templates))))
        if self._freshness is not None and 'freshness' not in state:  # saved without a limit
            for template_id in ids.tolist():
                self._freshness.add(template_id)
        if 'look_alikes' in state:
            self._recognition.reconfigure(self._p)

    def best_match(self, view: View, limit: int | None = None) -> Match | None:
        """Return the best match regardless of the threshold, or None if there is none.

        Args:
            view: (height, width) uint8.
            limit: largest SAD of a match; None: any.
        """
        return self._memory.search(view).best(limit=limit)

    def relative_rad(self, offset: int) -> float:
        """Return the heading relative to that of a template, for the offset of their match."""
        p = self._p
        if self._layout.panoramic:
            return wrap(-2.0 * math.pi * offset / p.template_x_size)
        # After a turn to the left, the content of the template appears further right in the view.
        shift = self._layout.shift_x - offset
        return math.radians(p.vt_shift_fov_deg) * shift / p.template_x_size
