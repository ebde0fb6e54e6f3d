# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Assignment of views to experiences: data association, creation and transitions.

By distance as in OpenRatSLAM, or by activity as in Milford et al. (2006).
"""

from __future__ import annotations

import math
from collections.abc import Collection

from ratslam_ros.core.common.odometry import Motion, moved
from ratslam_ros.core.common.pose import Pose
from ratslam_ros.core.common.saved import Field
from ratslam_ros.core.common.state import State
from ratslam_ros.core.config import MemoryParameters, PoseCellsParameters
from ratslam_ros.core.pose_cells.experience_activity import activity
from ratslam_ros.core.pose_cells.experience_table import ExperienceTable, Transitions
from ratslam_ros.core.pose_cells.lengths import Lengths
from ratslam_ros.core.pose_cells.map_action import NO_EXPERIENCE, Action
from ratslam_ros.core.pose_cells.pruning import Pruning
from ratslam_ros.core.pose_cells.torus import Located, Place, Torus
from ratslam_ros.core.pose_cells.visual_evidence import Observation

STATIONARY_CELLS = 0.02
"""Net motion since the current experience, in cells and in heading planes, below which the robot
counts as stationary."""


class Experiences(ExperienceTable):
    """The experiences, and the decision which one is current.

    Distant parts of the environment share cells. The unwrapped position of each experience
    distinguishes them, as precisely as the odometry since the last known place allows.
    """

    SAVED = (
        *ExperienceTable.SAVED,
        Field('transitions', '', 'i8', ('', 2), NO_EXPERIENCE, 'experiences',
              save=lambda own: own._transitions.pairs()),
        Field('', '_pruning', Pruning),
        Field('current', 'current_id', int, (), NO_EXPERIENCE, 'experiences'),
        Field('since_current', '_since_current', float, (3,), make=Pose),
    )

    def __init__(
        self, parameters: PoseCellsParameters, torus: Torus, lengths: Lengths,
        memory: MemoryParameters,
    ) -> None:
        super().__init__(torus)
        self._p = parameters
        self._lengths = lengths
        self.current_id = NO_EXPERIENCE
        """Id of the current experience, -1 before the first one."""
        self._transitions = Transitions()
        self._pruning = Pruning(parameters, memory)
        self._since_current = Pose(0.0, 0.0, 0.0)
        self._learns = True

    def reconfigure(self, parameters: PoseCellsParameters) -> None:
        """Continue with other values; ``lengths`` must have them already."""
        self._p = parameters

    def _restored(self, state: State) -> None:
        super()._restored(state)
        self._transitions.replace(state['transitions'])
        self._pruning.estimate_missing(
            (source, target, self._unwrapped_cells(source, target) * self._lengths.cell_m)
            for source, target in self._transitions if source != NO_EXPERIENCE
        )

    def advance(self, stamp_ns: int) -> None:
        """Set the time at which experiences are visited; it never goes back."""
        self._pruning.advance(stamp_ns)

    def integrate(self, motion: Motion) -> None:
        """Add a motion to the displacement since the current experience."""
        self._since_current = moved(self._since_current, motion)

    def relocate(self, experience_id: int, offset: Pose) -> None:
        """Make an experience current without a transition; ``offset``: the robot in its frame."""
        self.current_id = experience_id
        self._since_current = offset

    def separate(self) -> None:
        """Leave the current experience: the motion since then is unknown."""
        self.current_id = NO_EXPERIENCE
        self._since_current = Pose(0.0, 0.0, 0.0)

    def active(self, seen: Observation) -> list[tuple[int, float]]:
        """Return the active experiences of the observed template, the most active first.

        Milford et al. (2006), equations (1) to (4).

        Returns:
            Pairs of experience id and activity, above 0 and at most 2.
        """
        active = [
            (i, self._activity(i, seen.place)) for i in self._in(seen.component, seen.template_id)
        ]
        return sorted(
            (item for item in active if item[1] > 0.0), key=lambda item: (-item[1], item[0])
        )

    def nearest(self, seen: Observation) -> int | None:
        """Return the nearest experience at which the template was seen, if any."""
        return self._nearest(seen, self._in(seen.component, seen.template_id))

    def first_at(self, template_id: int, component: int, place: Located) -> int:
        """Return the first experience of a template at a place, -1 if there is none."""
        for i in self._in(component, template_id):
            if self.are_same(self[i].located, place):
                return i
        return NO_EXPERIENCE

    def are_same(self, a: Located, b: Located) -> bool:
        """Return whether two places are closer than ``exp_delta_pc_threshold``."""
        threshold, scale = self._lengths.delta
        theta = self._torus.distance(a.place, Place(a.place.x, a.place.y, b.place.theta))
        return math.hypot(scale * math.dist(a.unwrapped, b.unwrapped), theta) < threshold

    def decide(
        self, seen: Observation, learn: bool, recognised_id: int | None = None
    ) -> Action:
        """Associate an observation with an experience, and make that one current.

        Args:
            seen: the observation.
            learn: whether an experience may be created.
            recognised_id: experience of another component at which the robot has just been
                recognised. The transition to it joins the components of the map.

        Returns:
            The action for the experience map.
        """
        self._learns = learn
        if self.current_id != NO_EXPERIENCE and learn:
            self._pruning.stay(self.current_id)
        if recognised_id is not None:
            return self._visit(recognised_id)
        return self._decide(seen)

    def _decide(self, seen: Observation) -> Action:
        """Associate an observation with an experience of the robot's component."""
        if self._p.exp_current_by == 'activity':
            return self._decide_by_activity(seen)
        if seen.template_id not in self._of_template:
            return self._create(seen)
        if not self._lengths.are_known:
            return 'none'
        if self._is_at_current(seen) and (
            self[self.current_id].template_id == seen.template_id or self._is_stationary()
        ):
            return 'none'
        nearest = self._nearest(seen, [
            i for i in self._in(seen.component, seen.template_id) if i != self.current_id
        ])
        return self._create(seen) if nearest is None else self._visit(nearest)

    def _nearest(self, seen: Observation, candidates: Collection[int]) -> int | None:
        """Return the nearest candidate closer than ``exp_delta_pc_threshold``, if any."""
        if not candidates:
            return None
        threshold, scale = self._lengths.delta
        distance, nearest = min(
            (self._torus.distance(seen.place, self[i].located.place, scale), i)
            for i in candidates
        )
        return nearest if distance < threshold else None

    def _is_at_current(self, seen: Observation) -> bool:
        """Return whether the observation was made near the current experience."""
        current = self.current_id
        if current == NO_EXPERIENCE or self[current].component != seen.component:
            return False
        threshold, scale = self._lengths.delta
        return self._torus.distance(seen.place, self[current].located.place, scale) <= threshold

    def _decide_by_activity(self, seen: Observation) -> Action:
        active = self.active(seen)
        if not active or active[0][1] <= self._p.exp_activity_threshold:
            return self._create(seen)
        most_active = active[0][0]
        current = self.current_id
        if most_active == current or (
            current != NO_EXPERIENCE and self[current].component == seen.component
            and self._is_stationary() and self._activity(current, seen.place) > 0.0
        ):
            return 'none'
        return self._visit(most_active)

    def _activity(self, experience_id: int, peak: Place) -> float:
        p, place = self._p, self[experience_id].located.place
        return activity(self._torus, peak, place, p.exp_activity_xy, p.exp_activity_th)

    def _create(self, seen: Observation) -> Action:
        if not self._learns:
            return 'none'
        if self.current_id != NO_EXPERIENCE and self._is_stationary():
            return 'none'  # views that alternate must not create experiences at one place
        peak = seen.peak
        place = Place(peak.x, peak.y, (peak.theta - seen.turn_planes) % self._p.pc_dim_th)
        new_id = self._pruning.take()
        if new_id < len(self):
            self._remove(new_id)
            self._transitions.forget(new_id)
        self._put(new_id, seen.template_id, Located(place, seen.unwrapped), seen.component)
        self._pruning.create(new_id)
        self._change_to(new_id)
        return 'create'

    def _visit(self, target_id: int) -> Action:
        if self._learns:
            self._pruning.visit(target_id)
        return 'link' if self._change_to(target_id) else 'set'

    def _change_to(self, target_id: int) -> bool:
        """Make an experience current; return whether this transition is new."""
        is_new = self._learns and self._transitions.add(self.current_id, target_id)
        if self._learns:
            distance_m = math.hypot(*self._since_current[:2])
            self._pruning.connect(self.current_id, target_id, distance_m)
        self.current_id = target_id
        self._since_current = Pose(0.0, 0.0, 0.0)
        return is_new

    def _is_stationary(self) -> bool:
        x, y, turn = self._since_current
        if not self._lengths.is_cell_known:
            return x == y == turn == 0.0
        planes = abs(turn) * self._torus.planes_per_rad
        cells = math.hypot(x, y) / self._lengths.cell_m
        return cells < STATIONARY_CELLS and planes < STATIONARY_CELLS
