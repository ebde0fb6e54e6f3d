# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Recognition with an automatic threshold, by sequences of views, and without look-alikes.

Not in the papers; see docs/algorithm.md, "Automatic threshold" and "Sequences of views".
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ratslam_ros.core.common.odometry import Odometry
from ratslam_ros.core.config import AUTOMATIC, InputParameters, LocalViewParameters
from ratslam_ros.core.config.additions import LOOK_ALIKES, uses_odometry
from ratslam_ros.core.vision.encoder import Layout, View
from ratslam_ros.core.vision.match_threshold import MatchThreshold
from ratslam_ros.core.vision.recognition import FIXED_THRESHOLD, Recognised, Recognition
from ratslam_ros.core.vision.sequence_matcher import SequenceMatcher
from ratslam_ros.core.vision.template_memory import Match, Search, TemplateMemory


class AutomaticRecognition(Recognition):
    """Recognition with a threshold that is estimated from the views."""

    def __init__(
        self, parameters: LocalViewParameters, memory: TemplateMemory, layout: Layout,
        inputs: InputParameters,
    ) -> None:
        super().__init__(parameters, memory, layout, inputs)
        self._threshold = MatchThreshold(parameters, memory.full_sum, layout.typical)
        self._sequence = SequenceMatcher(layout)
        if self._threshold.estimates:
            self.threshold, self.sequence = self._threshold, self._sequence
        self.look_alikes = LOOK_ALIKES.of(parameters, layout)

    def reconfigure(self, parameters: LocalViewParameters) -> None:
        """Continue with other values of the parameters; what was measured is kept."""
        super().reconfigure(parameters)
        self._threshold.reconfigure(parameters)
        self._use_ratio()

    @property
    def estimated_threshold(self) -> float:  # type: ignore[override]
        """Largest mean difference of a match, from 0 to 1; -1 if it is fixed."""
        return self._threshold.value if self._threshold.is_automatic else FIXED_THRESHOLD

    def follow(self, odometry: Odometry) -> None:
        """Follow the robot, to tell look-alikes apart."""
        if self.look_alikes is None or not self.motion.accepts(odometry):
            return
        if not odometry.scale_known:
            return  # With an unknown field of view, closed loops seem to lead away.
        motion = self.motion.update(odometry)
        if motion is not None:
            self.look_alikes.move(motion)

    def relocated(self) -> None:
        """Continue after the robot may have been moved unobserved."""
        super().relocated()
        self._sequence.clear(self._memory.next_id)
        if self.look_alikes is not None:
            self.look_alikes.relocated()

    def learned(self, template_id: int, removed: Sequence[int]) -> None:
        """Record a new template, and those that were removed before."""
        if self.look_alikes is not None:
            for one in removed:
                self.look_alikes.forget(one)
            self.look_alikes.learned(template_id)

    def of(self, view: View, learn: bool) -> Recognised:
        """Recognise a view; ``learn``: whether it is learned otherwise."""
        if self.look_alikes is not None and learn:
            self.look_alikes.see(view)
            self._use_ratio()
        threshold, search = self._threshold, self._memory.search(view)
        first_recent = self._first_recent(search)
        threshold.adapt(first_recent, search.sads, learn)
        match, min_sad = self._best(
            search, first_recent, threshold.limit, threshold.recent_limit
        )
        if match is not None and self._is_elsewhere(match.template_id):
            match = None
        if threshold.estimates:
            match = self._by_sequence(view, search, match, learn)
        is_automatic = self._p.vt_recent_templates == AUTOMATIC
        related_count = len(self._memory) - first_recent if is_automatic else 0
        return Recognised(match, min_sad, related_count)

    def _use_ratio(self) -> None:
        if self.look_alikes is not None and uses_odometry(self._p):
            self._threshold.use_ratio(self.look_alikes.ratio)

    def _is_elsewhere(self, template_id: int) -> bool:
        """Return whether odometry contradicts a match."""
        return (
            self.look_alikes is not None and uses_odometry(self._p)
            and self.look_alikes.contradicts(template_id)
        )

    def _by_sequence(
        self, view: View, search: Search, single: Match | None, learn: bool
    ) -> Match | None:
        """Return the match of a view, or else that of the sequence of views that it continues.

        While mapping, views that are recognised count for nothing in the sequence, and templates
        that were learned in the present light, that is in this session, are no candidates.
        """
        sequence = self._sequence
        count = self._memory.rank(sequence.first_id) if learn else len(self._memory)
        is_open = single is None or not learn
        is_old = single is not None and self._memory.rank(single.template_id) < count
        is_due = count > 0 and sequence.is_due(view, self._threshold.recent_limit)
        if is_due and (is_open or is_old):
            sads = search.sads(range(count)) if is_open else None
            sequence.add(view, np.sort(self._memory.ids)[:count], sads)
        if is_due and is_open:
            found = sequence.match(sequence.unrecognised if learn else 1)
            # If places are known to look alike, their sequences do so as well.
            if found is not None and not self._is_elsewhere(found) and not (
                self.look_alikes is not None and uses_odometry(self._p) and self.look_alikes.exist
            ):
                sequence.found = found
        if is_old:
            sequence.unrecognised = 0
        if single is None and sequence.found is not None and sequence.found in self._memory:
            return search.match(sequence.found)
        return single

    def _first_recent(self, search: Search) -> int:
        """Return the number of templates older than the stretch the robot is just learning.

        Automatically, these are the newest templates back to the first one that is unrelated to
        the view: since then, the scene has been changing gradually.
        """
        count, newest = len(self._memory), self._p.vt_recent_templates
        if newest != AUTOMATIC:
            return max(count - newest, 0)
        limit = self._threshold.related_limit
        while count > 0 and search.sad(self._memory.nth_id(count - 1)) <= limit:
            count -= 1
        return count
