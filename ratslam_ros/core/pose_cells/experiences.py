# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Assignment of views to experiences: data association, creation, transitions and pruning."""

from __future__ import annotations

import math
from collections.abc import Collection, Set

import numpy as np
from numpy.typing import NDArray

from ratslam_ros.core.common.freshness import Freshness
from ratslam_ros.core.common.odometry import Motion, moved
from ratslam_ros.core.common.pose import Pose
from ratslam_ros.core.common.rows import Rows, listed
from ratslam_ros.core.common.saved import MAX_COUNT, MAX_ID, Field, Saved
from ratslam_ros.core.common.state import State
from ratslam_ros.core.config import MemoryParameters, PoseCellsParameters
from ratslam_ros.core.pose_cells.experience_activity import activity
from ratslam_ros.core.pose_cells.lengths import Lengths
from ratslam_ros.core.pose_cells.map_action import NO_EXPERIENCE, Action
from ratslam_ros.core.pose_cells.pruning import DistanceGraph, VisitHistory
from ratslam_ros.core.pose_cells.registration import Located, Registration
from ratslam_ros.core.pose_cells.torus import Place, Torus
from ratslam_ros.core.pose_cells.visual_evidence import Observation

SUPERSEDED_SHARE = 0.25
"""Share of the experiences that may have a younger one at their place. They make the map more
precise, but with all of them it would grow on known ground without limit."""

STATIONARY_CELLS = 0.02
"""Net motion since the current experience, in cells and in heading planes, below which the robot
counts as stationary."""


class Experiences(Saved):
    """The experiences, and the decision which one is current.

    Distant parts of the environment share cells. The unwrapped position of each experience
    distinguishes them, as precisely as the odometry since the last known place allows.
    """

    SAVED = (
        Field('unrolled/experiences', '', 'f8', ('experiences', 2),
              save=lambda own: own._located_rows.values[:, 3:5]),
        Field('experiences', '_label_rows', 'f8', ('experiences', 4), -1, MAX_ID),
        Field('transitions', '', 'i8', ('', 2), NO_EXPERIENCE, 'experiences',
              save=lambda own: own._transitions.pairs()),
        Field('visits', '_visits', VisitHistory), Field('gaps', '_distances', DistanceGraph),
        Field('current', 'current_id', int, (), NO_EXPERIENCE, 'experiences'),
        Field('since_current', '_since_current', float, (3,), make=Pose),
        Field('components/experiences', '', 'i8', ('experiences',), 0, MAX_ID,
              save=lambda own: own._located_rows.values[:, 5]),
        Field('components/places', '', 'f8', ('experiences', 3),
              save=lambda own: own._located_rows.values[:, :3]),
        Field('freshness', '_freshness', Freshness, optional=True),
        Field('created', '', 'i8', ('experiences',), 0, MAX_COUNT, optional=True,
              save=lambda own: own._located_rows.values[:, 6]),
        Field('superseded', '', 'i8', ('',), 0, 'experiences',
              save=lambda own: np.flatnonzero(own._superseded[: len(own)]),
              when=lambda own: own._superseded[: len(own)].any()),
    )

    def __init__(
        self, parameters: PoseCellsParameters, torus: Torus, lengths: Lengths,
        memory: MemoryParameters,
    ) -> None:
        self._p = parameters
        self._torus = torus
        self._lengths = lengths
        self.current_id = NO_EXPERIENCE
        """Id of the current experience, -1 before the first one."""
        self._experiences: list[tuple[int, Place]] = []
        self._located: list[Located] = []
        self._components: list[int] = []
        self._creation_count = 0
        self._created: list[int] = []
        # Template and place of each; place, unwrapped position, component and rank of creation.
        self._label_rows, self._located_rows = Rows(4), Rows(7)
        self._of_template: dict[int, list[int]] = {}
        self._superseded = np.zeros(64, np.bool_)
        """Experiences with a younger one at their place, by id; spare ones at the end."""
        self._transitions = _Transitions()
        self._visits = VisitHistory()
        self._distances = DistanceGraph()
        has_freshness = parameters.exp_max > 0 and parameters.exp_forget == 'freshness'
        self._freshness = Freshness.of(memory) if has_freshness else None
        self._since_current = Pose(0.0, 0.0, 0.0)
        self._learns = True

    def __len__(self) -> int:
        return len(self._experiences)

    def reconfigure(self, parameters: PoseCellsParameters) -> None:
        """Continue with other values; ``lengths`` must have them already."""
        self._p = parameters

    def label(self, experience_id: int) -> Place:
        """Return the place at which an experience was created, which identifies it."""
        return self._experiences[experience_id][1]

    def located(self, experience_id: int) -> Located:
        """Return the place of an experience; it moves if its component joins another one."""
        return self._located[experience_id]

    @property
    def next_template_id(self) -> int:
        """Id above those of the templates of all experiences."""
        return max((template_id for template_id, _ in self._experiences), default=-1) + 1

    def _restored(self, state: State) -> None:
        self._experiences = [
            (int(label), Place(*place)) for label, *place in listed(state['experiences'])
        ]
        created = np.asarray(state.get('created', np.arange(len(self))), np.int64)
        self._created = created.tolist()
        self._creation_count = max(self._created, default=-1) + 1
        # The experiences of a template are in the order in which they were created.
        self._superseded = np.zeros(max(64, len(self)), np.bool_)
        self._superseded[state.get('superseded', [])] = True
        for number in np.argsort(created).tolist():
            template_id = self._experiences[number][0]
            self._of_template.setdefault(template_id, []).append(number)
        components = state['components']
        self._components = [int(c) for c in listed(components['experiences'])]
        self._located = [
            Located(Place(*place), (position[0], position[1]))
            for place, position in zip(
                listed(components['places']), listed(state['unrolled']['experiences']), strict=True
            )
        ]
        for number in range(len(self._located)):
            self._store(number)
        transitions = [(int(i), int(j)) for i, j in listed(state['transitions'])]
        for source, target in transitions:
            self._transitions.add(source, target)
        if self._prunes:  # distances that were not recorded are estimated
            for source, target in transitions:
                if source != NO_EXPERIENCE and not self._distances.are_neighbours(source, target):
                    cells = math.dist(
                        self._located[source].unwrapped, self._located[target].unwrapped
                    )
                    self._distances.connect(source, target, cells * self._lengths.cell_m)
        if self._freshness is not None and 'freshness' not in state:  # saved without a limit
            for number in range(len(self)):
                self._freshness.add(number)

    def advance(self, stamp_ns: int) -> None:
        """Set the time at which experiences are visited; it never goes back."""
        if self._freshness is not None:
            self._freshness.advance(stamp_ns)

    def forget_templates(self, template_ids: Collection[int]) -> None:
        """Remove the associations of templates; their experiences stay, as places on the map."""
        for template_id in template_ids:
            self._of_template.pop(template_id, None)

    def rescale(self, factor: float) -> None:
        """Multiply all places by a factor; labels stay, because the map has received them."""
        for i, (place, (x, y)) in enumerate(self._located):
            unwrapped = x * factor, y * factor
            self._located[i] = Located(self._torus.wrapped(unwrapped, place.theta), unwrapped)
            self._store(i)

    def integrate(self, motion: Motion) -> None:
        """Add a motion to the displacement since the current experience."""
        self._since_current = moved(self._since_current, motion)

    def has(self, experience_id: int, template_id: int, component: int) -> bool:
        """Return whether there is an experience of this id, template and component."""
        return (
            experience_id < len(self)
            and self._experiences[experience_id][0] == template_id
            and self._components[experience_id] == component
        )

    def relocate(self, experience_id: int, offset: Pose) -> None:
        """Make an experience current without a transition; ``offset``: the robot in its frame."""
        self.current_id = experience_id
        self._since_current = offset

    def separate(self) -> None:
        """Leave the current experience: the motion since then is unknown."""
        self.current_id = NO_EXPERIENCE
        self._since_current = Pose(0.0, 0.0, 0.0)

    def merge(self, component: int, into: int, registration: Registration) -> None:
        """Move the experiences of one component into another one."""
        moved: list[int] = []
        for i, number in enumerate(self._components):
            if number == component:
                self._located[i] = registration.moved(self._located[i])
                self._components[i] = into
                self._store(i)
                moved.append(i)
        if self._p.exp_view_links:
            kept = set(moved)
            for i in moved:
                self._supersede(i, kept)

    def active(self, seen: Observation) -> list[tuple[int, float]]:
        """Return the active experiences of the observed template, the most active first.

        Milford et al. (2006), equations (1) to (4).

        Returns:
            Pairs of experience id and activity, above 0 and at most 2.
        """
        active = [
            (i, self._activity(i, seen.place))
            for i in self._of_template.get(seen.template_id, ())
            if self._components[i] == seen.component
        ]
        return sorted(
            (item for item in active if item[1] > 0.0), key=lambda item: (-item[1], item[0])
        )

    def members(self, component: int) -> set[int]:
        """Return the experiences of a component."""
        return {i for i, number in enumerate(self._components) if number == component}

    def decide(
        self, seen: Observation, learn: bool, joined: Set[int] = frozenset()
    ) -> Action:
        """Associate an observation with an experience, and make that one current.

        Args:
            seen: the observation.
            learn: whether an experience may be created.
            joined: experiences of the component in which the robot has just been recognised. A
                transition to one of them joins the components of the map.

        Returns:
            The action for the experience map.
        """
        self._learns = learn
        if self._freshness is not None and self.current_id != NO_EXPERIENCE and learn:
            self._freshness.observe(self.current_id)  # the robot is still there
        if joined:
            there = self._nearest(seen, joined & set(self._of_template.get(seen.template_id, ())))
            if there is not None:
                return self._visit(there)
        if self._p.exp_view_links and learn:
            return self._decide_by_motion(seen)
        if self._p.exp_current_by == 'activity':
            return self._decide_by_activity(seen, learn)
        candidates = self._of_template.get(seen.template_id)
        if candidates is None:
            return self._create(seen, learn)
        if not self._lengths.are_known:
            return 'none'
        if self._is_at_current(seen) and (
            self._experiences[self.current_id][0] == seen.template_id or self._is_stationary()
        ):
            return 'none'
        nearest = self._nearest(seen, [
            i for i in candidates
            if i != self.current_id and self._components[i] == seen.component
        ])
        return self._create(seen, learn) if nearest is None else self._visit(nearest)

    def first_of(self, template_id: int, component: int) -> int:
        """Return the first experience of a template in a component, -1 if there is none."""
        for i in self._of_template.get(template_id, ()):
            if self._components[i] == component:
                return i
        return NO_EXPERIENCE

    def first_at(self, template_id: int, component: int, place: Located) -> int:
        """Return the first experience of a template at the place of the template, -1 if none.

        The experience that was created with the template may have been pruned. Others may be at
        places that only look alike.
        """
        for i in self._of_template.get(template_id, ()):
            if self._components[i] == component and self._are_same(self._located[i], place):
                return i
        return NO_EXPERIENCE

    def _are_same(self, a: Located, b: Located) -> bool:
        """Return whether two places are closer than ``exp_delta_pc_threshold``."""
        threshold, scale = self._lengths.delta
        theta = self._torus.distance(a.place, Place(a.place.x, a.place.y, b.place.theta))
        return math.hypot(scale * math.dist(a.unwrapped, b.unwrapped), theta) < threshold

    def _decide_by_motion(self, seen: Observation) -> Action:
        """Create an experience for a new template, and where the robot has moved on."""
        is_new = self.first_of(seen.template_id, seen.component) == NO_EXPERIENCE
        if not is_new and self.current_id != NO_EXPERIENCE:
            threshold, scale = self._lengths.delta
            cells = math.hypot(*self._since_current[:2]) / self._lengths.cell_m
            if cells * scale < threshold:
                return 'none'
        return self._create(seen, learn=True)

    def _nearest(self, seen: Observation, candidates: Collection[int]) -> int | None:
        """Return the nearest candidate closer than ``exp_delta_pc_threshold``, if any."""
        if not candidates:
            return None
        threshold, scale = self._lengths.delta
        distance, nearest = min(
            (self._torus.distance(seen.place, self._located[i].place, scale), i)
            for i in candidates
        )
        return nearest if distance < threshold else None

    def _is_at_current(self, seen: Observation) -> bool:
        """Return whether the observation was made near the current experience."""
        current = self.current_id
        if current == NO_EXPERIENCE or self._components[current] != seen.component:
            return False
        threshold, scale = self._lengths.delta
        return (
            self._torus.distance(seen.place, self._located[current].place, scale) <= threshold
        )

    def _decide_by_activity(self, seen: Observation, learn: bool) -> Action:
        active = self.active(seen)
        if not active or active[0][1] <= self._p.exp_activity_threshold:
            return self._create(seen, learn)
        most_active = active[0][0]
        current = self.current_id
        if most_active == current or (
            current != NO_EXPERIENCE and self._components[current] == seen.component
            and self._is_stationary() and self._activity(current, seen.place) > 0.0
        ):
            return 'none'
        return self._visit(most_active)

    def _activity(self, experience_id: int, peak: Place) -> float:
        p, place = self._p, self._located[experience_id].place
        return activity(self._torus, peak, place, p.exp_activity_xy, p.exp_activity_th)

    def _create(self, seen: Observation, learn: bool) -> Action:
        if self.current_id != NO_EXPERIENCE and self._is_stationary():
            return 'none'  # views that alternate must not create experiences at one place
        if not learn:
            return 'none'
        peak = seen.peak
        place = Place(peak.x, peak.y, (peak.theta - seen.turn_planes) % self._p.pc_dim_th)
        new_id = self._prune_candidate()
        if new_id < len(self):
            self._prune(new_id)
            self._experiences[new_id] = seen.template_id, place
            self._located[new_id] = Located(place, seen.unwrapped)
            self._components[new_id] = seen.component
            self._created[new_id] = self._creation_count
            self._label_rows[new_id] = seen.template_id, *place
        else:
            self._experiences.append((seen.template_id, place))
            self._located.append(Located(place, seen.unwrapped))
            self._components.append(seen.component)
            self._created.append(self._creation_count)
            self._label_rows.append((seen.template_id, *place))
        self._creation_count += 1
        self._store(new_id)
        self._of_template.setdefault(seen.template_id, []).append(new_id)
        self._visits.create(new_id)
        if new_id == len(self._superseded):
            self._superseded = np.concatenate([self._superseded, np.zeros(new_id, np.bool_)])
        self._superseded[new_id] = False
        if self._freshness is not None:
            self._freshness.add(new_id)
        self._change_to(new_id)
        if self._p.exp_view_links:
            self._supersede(new_id)
        return 'create'

    def _supersede(self, experience_id: int, kept: Collection[int] = ()) -> None:
        """Mark the older experiences of its template at its place: an experience replaces them.

        Args:
            experience_id: the experience.
            kept: experiences that are not marked.
        """
        here, component = self._located[experience_id], self._components[experience_id]
        for other in self._of_template.get(self._experiences[experience_id][0], ()):
            there = self._located[other]
            if (
                self._created[other] < self._created[experience_id] and other not in kept
                and self._components[other] == component and self._are_same(here, there)
            ):
                self._superseded[other] = True
                cells = math.dist(here.unwrapped, there.unwrapped)
                self._distances.connect(experience_id, other, cells * self._lengths.cell_m)

    def _store(self, number: int) -> None:
        """Store where an experience is in the table that is saved."""
        place, unwrapped = self._located[number]
        row = *place, *unwrapped, self._components[number], self._created[number]
        if number == len(self._located_rows):
            self._located_rows.append(row)
        else:
            self._located_rows[number] = row

    @property
    def _prunes(self) -> bool:
        """Whether experiences are pruned, for which the distances between them are needed."""
        return self._p.exp_max > 0 or self._p.exp_view_links

    def _prune_candidate(self) -> int:
        """Return the experience whose id a new one gets; the next id if none is pruned."""
        is_full = 0 < self._p.exp_max <= len(self)
        may_go = self._visits.old() & self._superseded[: len(self)]
        if not is_full and may_go.sum() <= SUPERSEDED_SHARE * len(self):
            return len(self)
        if not may_go.any():
            may_go = self._visits.may_go(self._distances)
        if self._freshness is None:
            return self._visits.prune_candidate(may_go)
        if is_full:
            candidate = self._freshness.candidate(may_go[self._freshness.items])
            assert candidate is not None  # at least one may go
        else:
            candidate = self._visits.prune_candidate(may_go)
        self._freshness.remove(candidate)
        return candidate

    def _prune(self, experience_id: int) -> None:
        """Remove an experience so that its id can be reused; its template stays associated."""
        template_id, _ = self._experiences[experience_id]
        others = self._of_template.pop(template_id, [experience_id])  # none if it is forgotten
        others.remove(experience_id)
        if others:
            self._of_template[template_id] = others
        self._transitions.remove(experience_id)
        self._distances.remove(experience_id)

    def _visit(self, target_id: int) -> Action:
        if self._learns:
            self._visits.visit(target_id)
            if self._freshness is not None:
                self._freshness.observe(target_id)
        return 'link' if self._change_to(target_id) else 'set'

    def _change_to(self, target_id: int) -> bool:
        """Make an experience current; return whether this transition is new."""
        is_new = self._learns and self._transitions.add(self.current_id, target_id)
        if self._learns and self._prunes:
            distance_m = math.hypot(*self._since_current[:2])
            self._distances.connect(self.current_id, target_id, distance_m)
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


class _Transitions:
    """Transitions between experiences, indexed by both of their ends."""

    def __init__(self) -> None:
        self._targets: dict[int, set[int]] = {}
        self._sources: dict[int, set[int]] = {}
        self._rows = Rows(2, np.int64)

    def add(self, source: int, target: int) -> bool:
        """Add a transition; return whether it is new."""
        targets = self._targets.setdefault(source, set())
        if target in targets:
            return False
        targets.add(target)
        self._sources.setdefault(target, set()).add(source)
        self._rows.append((source, target))
        return True

    def remove(self, experience_id: int) -> None:
        """Remove all transitions from and to an experience."""
        for target in self._targets.pop(experience_id, ()):
            self._sources[target].discard(experience_id)
        for source in self._sources.pop(experience_id, ()):
            self._targets[source].discard(experience_id)
        self._rows.keep((self._rows.values != experience_id).all(axis=1))

    def pairs(self) -> NDArray[np.int64]:
        """Return all transitions, (n, 2) source and target, sorted."""
        # The source before the first experience is -1.
        numbers = np.sort(((self._rows.values[:, 0] + 1) << 32) + self._rows.values[:, 1])
        return np.stack([(numbers >> 32) - 1, numbers & 0xFFFFFFFF], axis=1)
