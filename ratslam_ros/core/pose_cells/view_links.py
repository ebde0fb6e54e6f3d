# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Links to recognised places: chains of experiences on known paths, and recognitions for the map.

Not in the papers; see docs/algorithm.md, "Links to recognised places".
"""

from __future__ import annotations

import math
from collections.abc import Callable, Set
from dataclasses import replace

from ratslam_ros.core.pose_cells.experiences import Experiences
from ratslam_ros.core.pose_cells.lengths import Lengths
from ratslam_ros.core.pose_cells.map_action import (
    NO_EXPERIENCE,
    Action,
    Extension,
    MapAction,
    Viewed,
)
from ratslam_ros.core.pose_cells.torus import Located
from ratslam_ros.core.pose_cells.visual_evidence import Observation, VisualEvidence


class ExperienceChains(Experiences):
    """Experiences that are created on known paths as well, beside those of earlier visits.

    Those of earlier visits, which they supersede, are pruned first.
    """

    def merge(self, component: int, into: int, moved: Callable[[Located], Located]) -> None:
        """Move the experiences of one component into another one, by ``moved``."""
        members = self.members(component)
        super().merge(component, into, moved)
        for i in sorted(members):
            self._supersede(i, members)

    def _decide(self, seen: Observation) -> Action:
        """Create an experience for a new template, and where the robot has moved on."""
        if not self._learns:
            return super()._decide(seen)
        if self._in(seen.component, seen.template_id) and self.current_id != NO_EXPERIENCE:
            threshold, scale = self._lengths.delta
            cells = math.hypot(*self._since_current[:2]) / self._lengths.cell_m
            if cells * scale < threshold:
                return 'none'
        return self._create(seen)

    def _create(self, seen: Observation) -> Action:
        action = super()._create(seen)
        if action == 'create':
            self._supersede(self.current_id)
        return action

    def _supersede(self, experience_id: int, kept: Set[int] = frozenset()) -> None:
        """Mark the older experiences of its template at its place: an experience replaces them.

        Args:
            experience_id: the experience.
            kept: experiences that are not marked.
        """
        own = self[experience_id]
        for i in self._in(own.component, own.template_id):
            older = self[i]
            if older.rank < own.rank and i not in kept and (
                self.are_same(own.located, older.located)
            ):
                cells = self._unwrapped_cells(experience_id, i)
                self._pruning.supersede(i, experience_id, cells * self._lengths.cell_m)


class Recognitions(Extension):
    """Adds to each action which experience the view was recognised as, and the view spacing."""

    def __init__(
        self, evidence: VisualEvidence, experiences: Experiences, lengths: Lengths
    ) -> None:
        self._evidence, self._experiences, self._lengths = evidence, experiences, lengths

    def extended(self, action: MapAction, view: Viewed) -> MapAction:
        """Return an action with the recognised experience, and how many views agree on it.

        Without chains only a new experience needs this: ``link`` and ``set`` go to known ones.
        """
        recognised_id, agreement = NO_EXPERIENCE, 0.0
        evidence, experiences = self._evidence, self._experiences
        is_linked = isinstance(experiences, ExperienceChains) or action.action == 'create'
        if is_linked and view.has_effect and evidence.agreement > 0.0:
            agreement = evidence.agreement
            # The experience that was created with the template may have been pruned. Others may
            # be at places that only look alike.
            learned_at = evidence.located(action.template_id, view.component)
            recognised_id = experiences.first_at(action.template_id, view.component, learned_at)
        return replace(
            action, recognised_id=recognised_id, agreement=agreement,
            view_spacing_m=self._lengths.scale_m,
        )
