# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Pose cells: Motion, ViewMatch -> MapAction."""

from __future__ import annotations

import math
from collections import deque
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from ratslam_ros.core.common.odometry import Motion, moved
from ratslam_ros.core.common.pose import Pose
from ratslam_ros.core.common.state import State
from ratslam_ros.core.config import PoseCellsParameters
from ratslam_ros.core.pose_cells.agreement import Agreement
from ratslam_ros.core.pose_cells.attractor import Network, Packet, kernel
from ratslam_ros.core.pose_cells.experience_activity import activity
from ratslam_ros.core.pose_cells.pruning import Gaps, Visits
from ratslam_ros.core.pose_cells.torus import Place, Torus
from ratslam_ros.core.vision.local_view import NO_TEMPLATE, ViewMatch
from ratslam_ros.errors import UnusableInput

Action = Literal['create', 'link', 'set', 'none']

NO_EXPERIENCE = -1

CLAIMS, WITNESSES = 8, 6
"""Of so many views recognised lately, so many must have been seen where the robot may be."""

NEWEST_TEMPLATES = 10
"""Templates learned this recently inject nothing: the robot is still there."""

REST_CELLS = 0.02
"""Net motion since the current experience, in cells or planes, that still counts as rest."""


@dataclass(frozen=True, slots=True)
class MapAction:
    """What the experience map shall do; there is one for every template message.

    ``source_id`` is the experience that was current, ``target_id`` the one that is now; -1 where
    there is none. To create an experience that there is means to forget that one, and to make the
    new one under its number. ``relative_rad``: heading of the robot less that of the target's
    view. ``place``: where the target lies in the pose cells; the peak while there is none.
    """

    action: Action
    source_id: int
    target_id: int
    template_id: int
    relative_rad: float
    place: Place


@dataclass(slots=True)
class _Memory:
    """Where a template was first seen, and how tired it is since which template message."""

    place: Place
    unrolled: tuple[float, float]
    order: int
    decay: float
    message: int


class PoseCells:
    """The network, what views are tied to in it, and which experience that makes current."""

    def __init__(self, parameters: PoseCellsParameters) -> None:
        p = self._p = parameters
        self.mapping = True
        """Whether views are tied to places and experiences made; else the robot is located."""
        self._torus = Torus(p.pc_dim_x, p.pc_dim_y, p.pc_dim_th)
        self._agreement = Agreement(
            self._torus,
            p.pc_vt_agree_views,
            p.pc_vt_agree_cells,
            p.pc_vt_agree_spacing,
            p.pc_vt_agree_recent,
            p.pc_vt_agree_near,
        )
        self._network = Network(
            (p.pc_dim_th, p.pc_dim_y, p.pc_dim_x),
            kernel(p.pc_w_e_dim, p.pc_w_e_var),
            kernel(p.pc_w_i_dim, p.pc_w_i_var),
            p.pc_global_inhib,
        )
        self._packets = self._network.start()
        self.peak = self._decoded()
        self._memories: dict[int, _Memory] = {}
        self._messages = 0
        self._last_template = NO_TEMPLATE
        self._experiences: list[tuple[int, Place]] = []
        # The packet comes back to the same cells from other parts of the world. Where it would be
        # in cells that never end tells these apart, as far as odometry since a known place does.
        self._unrolled = self.peak.x, self.peak.y
        self._unrolled_of: list[tuple[float, float]] = []
        self._claimed: deque[tuple[float, float]] = deque(maxlen=CLAIMS)
        """Where views that were recognised lately were first seen, in cells that never end."""
        self._of_template: dict[int, list[int]] = {}
        self._transitions = _Transitions()
        self._visits = Visits()
        self._gaps = Gaps()
        self._seen = NO_TEMPLATE, 0.0
        self._current = NO_EXPERIENCE
        self._since_current = Pose(0.0, 0.0, 0.0)
        self._stepped = False

    def __len__(self) -> int:
        return len(self._experiences)

    @property
    def current_experience(self) -> int:
        """Id of the current experience, -1 before the first."""
        return self._current

    def activity(self) -> NDArray[np.float64]:
        """Return all activity, (n_theta, n_y, n_x), for viewers."""
        return self._network.dense(self._packets)

    def projected(self) -> tuple[NDArray[np.int64], NDArray[np.float64]]:
        """Return the cells (n,) of the (y, x) plane, y * n_x + x, and their activity over theta.

        Only those with activity, ascending; the goal memory learns from them.
        """
        return self._network.projected(self._packets)

    def state(self) -> State:
        """Return all activity and all that was learned, for ``restore``."""
        return {
            'dims': [self._p.pc_dim_x, self._p.pc_dim_y, self._p.pc_dim_th],
            'packets': [packet._asdict() for packet in self._packets],
            'memories': [
                [template, *m.place, m.order, m.decay, m.message]
                for template, m in self._memories.items()
            ],
            'unrolled': {
                'peak': list(self.peak),  # not where the packets are now, if a view injected
                'here': list(self._unrolled),
                'claimed': [list(place) for place in self._claimed],
                'memories': [list(m.unrolled) for m in self._memories.values()],
                'experiences': [list(place) for place in self._unrolled_of],
            },
            'messages': self._messages,
            'last_template': self._last_template,
            'experiences': [[template, *place] for template, place in self._experiences],
            'transitions': self._transitions.pairs(),
            'visits': self._visits.state(),
            'gaps': self._gaps.state(),
            'current': self._current,
            'since_current': list(self._since_current),
            'stepped': self._stepped,
            'agreement': self._agreement.state(),
        }

    def restore(self, state: State) -> None:
        """Take what ``state`` gave for the present memory, which must be empty.

        Raises:
            UnusableInput: it is of pose cells of other extents.
        """
        dims = [self._p.pc_dim_x, self._p.pc_dim_y, self._p.pc_dim_th]
        if state['dims'] != dims:
            raise UnusableInput(
                f'the pose cells are {state["dims"]}; expected {dims}: pc_dim_x, pc_dim_y and '
                'pc_dim_th must be those of the run that saved'
            )
        self._packets = [Packet(**packet) for packet in state['packets']]
        self.peak = self._decoded()
        for template, x, y, theta, order, decay, message in state['memories']:
            self._memories[template] = _Memory(Place(x, y, theta), (x, y), order, decay, message)
        self._messages = state['messages']
        self._last_template = state['last_template']
        for number, (template, x, y, theta) in enumerate(state['experiences']):
            self._experiences.append((template, Place(x, y, theta)))
            self._unrolled_of.append((x, y))
            self._of_template.setdefault(template, []).append(number)
        self._unrolled = self.peak.x, self.peak.y
        if 'unrolled' in state:
            unrolled = state['unrolled']
            self.peak = Place(*unrolled['peak'])
            self._unrolled = tuple(unrolled['here'])
            self._claimed.extend(tuple(place) for place in unrolled['claimed'])
            self._unrolled_of = [tuple(place) for place in unrolled['experiences']]
            for memory, place in zip(
                self._memories.values(), unrolled['memories'], strict=True
            ):
                memory.unrolled = tuple(place)
        for source, target in state['transitions']:
            self._transitions.add(source, target)
        self._current = state['current']
        if 'visits' in state:
            self._visits.restore(state['visits'])
        else:
            self._visits.assume(len(self), self._current)
        if 'gaps' in state:
            self._gaps.restore(state['gaps'])
        if self._p.exp_max > 0:  # what was driven while there was no limit
            for source, target in state['transitions']:
                if source != NO_EXPERIENCE and not self._gaps.knows(source, target):
                    way = math.dist(self._unrolled_of[source], self._unrolled_of[target])
                    self._gaps.join(source, target, way * self._p.pc_cell_x_size)
        self._since_current = Pose(*state['since_current'])
        self._stepped = state['stepped']
        self._agreement.restore(state['agreement'])

    def integrate(self, motion: Motion) -> None:
        """Let the network compete once and follow one motion."""
        chord = motion.chord_m / self._p.pc_cell_x_size
        turn = motion.turn_rad * self._torus.planes_per_rad
        self._agreement.integrate(chord, turn)
        self._packets = self._network.step(self._packets, chord, turn)
        before, self.peak = self.peak, self._decoded()
        self._unrolled = self._further(self._unrolled, before, self.peak)
        self._since_current = moved(self._since_current, motion)
        self._stepped = True

    def view(self, match: ViewMatch) -> MapAction:
        """Take one template message: associate or inject, and decide the map's action."""
        turned = match.relative_rad * self._torus.planes_per_rad
        self._seen = match.template_id, turned
        source = self._current
        action: Action = 'none'
        if match.template_id != NO_TEMPLATE:  # what nobody could see changes nothing
            self._recall(match.template_id, turned)
            self._messages += 1
            self._last_template = match.template_id
            if self._stepped:
                self._stepped = False
                action = self._decide(match.template_id, turned)
        place = self._experiences[self._current][1] if self._experiences else self.peak
        return MapAction(
            action, source, self._current, match.template_id, match.relative_rad, place
        )

    def active_experiences(self) -> list[tuple[int, float]]:
        """Return the experiences of the last view that are near the peak, the most active first.

        Seed 000, equations (1) to (4): (id, activity above 0 and up to 2).
        """
        template_id, turned = self._seen
        return self._active(template_id, self._here(turned))

    def _here(self, turned: float) -> Place:
        """Return the peak as the view would have it: with the heading of its template."""
        return Place(self.peak.x, self.peak.y, self.peak.theta - turned)

    def _active(self, template_id: int, here: Place) -> list[tuple[int, float]]:
        active = [
            (i, self._activity(i, here))
            for i in self._of_template.get(template_id, ())
            if self._is_believable(i)
        ]
        return sorted(
            (item for item in active if item[1] > 0.0), key=lambda item: (-item[1], item[0])
        )

    def _activity(self, experience_id: int, here: Place) -> float:
        p, (_, place) = self._p, self._experiences[experience_id]
        return activity(self._torus, here, place, p.exp_activity_xy, p.exp_activity_th)

    def _further(
        self, unrolled: tuple[float, float], start: Place, end: Place
    ) -> tuple[float, float]:
        """Return where in cells that never end one comes from a place there."""
        d_x, d_y = self._torus.step(start, end)
        return unrolled[0] + d_x, unrolled[1] + d_y

    def _is_believable(self, experience_id: int) -> bool:
        """Return whether the robot may be at an experience whose view and cells are its own.

        Two places that share their cells are told apart by odometry since a known place, or else
        by what was seen lately, and not by one view.
        """
        near = self._p.pc_vt_agree_near
        if near == 0.0 or experience_id == self._current:
            return True
        x, y = self._unrolled_of[experience_id]
        if math.hypot(self._unrolled[0] - x, self._unrolled[1] - y) < near:
            return True
        return sum(math.hypot(a - x, b - y) < near for a, b in self._claimed) >= WITNESSES

    def _off_cells(self, memory: _Memory, claimed: Place) -> float:
        """Return how far what a view claims is from the peak, in cells that never end."""
        same = Place(self.peak.x, self.peak.y, claimed.theta)
        x, y = self._unrolled
        return math.hypot(
            memory.unrolled[0] - x, memory.unrolled[1] - y,
            self._torus.distance(same, self.peak),
        )  # fmt: skip

    def _decoded(self) -> Place:
        theta, y, x = self._network.peak(self._packets)
        return Place(x, y, theta)

    def _recall(self, template_id: int, turned: float) -> None:
        """Tie an unknown template to the peak; let a known one inject where it is tied to."""
        p = self._p
        memory = self._memories.get(template_id)
        if memory is None and not self.mapping:
            return
        if memory is None:
            here = self._here(turned)
            self._memories[template_id] = _Memory(
                here, self._unrolled, len(self._memories), p.vt_active_decay, self._messages
            )
            return
        if memory.order >= len(self._memories) - NEWEST_TEMPLATES:
            return
        if template_id != self._last_template:
            self._claimed.append(memory.unrolled)
        # All decays relax after every message; each is brought up to date when it is needed.
        rested = memory.decay - p.pc_vt_restore * (self._messages - memory.message)
        memory.decay = max(p.vt_active_decay, rested)
        memory.message = self._messages
        if template_id == self._last_template:
            memory.decay += p.vt_active_decay
        claimed = Place(memory.place.x, memory.place.y, memory.place.theta + turned)
        tired = math.exp(min(1.2 * memory.decay, 10.0))  # above e^3.4 nothing is injected
        energy = p.pc_vt_inject_energy / 30.0 * (30.0 - tired)
        energy *= self._agreement.weigh(
            template_id, claimed, self.peak, self._off_cells(memory, claimed)
        )
        if energy > 0.0:
            self._packets = self._network.inject(
                self._packets, claimed.theta, claimed.y, claimed.x, energy
            )

    def _decide(self, template_id: int, turned: float) -> Action:
        if self._p.exp_current_by == 'activity':
            return self._decide_by_activity(template_id, turned)
        candidates = self._of_template.get(template_id)
        if candidates is None:
            return self._create(template_id, turned)
        here = self._here(turned)
        threshold = self._p.exp_delta_pc_threshold
        current_template, current_place = self._experiences[self._current]
        jumped = self._torus.distance(here, current_place) > threshold
        if not jumped and (template_id == current_template or self._at_rest()):
            return 'none'
        others = [i for i in candidates if i != self._current and self._is_believable(i)]
        if others:
            distance, nearest = min(
                (self._torus.distance(here, self._experiences[i][1]), i) for i in others
            )
            if distance < threshold:
                return self._arrive(nearest)
        return self._create(template_id, turned)

    def _decide_by_activity(self, template_id: int, turned: float) -> Action:
        here = self._here(turned)
        active = self._active(template_id, here)
        if not active or active[0][1] <= self._p.exp_activity_threshold:
            return self._create(template_id, turned)
        most_active = active[0][0]
        if most_active == self._current or (
            self._at_rest() and self._activity(self._current, here) > 0.0
        ):
            return 'none'
        return self._arrive(most_active)

    def _create(self, template_id: int, turned: float) -> Action:
        if self._current != NO_EXPERIENCE and self._at_rest():
            return 'none'  # never a second experience while the robot stands still
        if not self.mapping:
            return 'none'
        here = Place(self.peak.x, self.peak.y, (self.peak.theta - turned) % self._p.pc_dim_th)
        new = len(self._experiences)
        if 0 < self._p.exp_max <= new:
            new = self._visits.least(self._gaps)
            self._forget(new)
            self._experiences[new] = template_id, here
            self._unrolled_of[new] = self._unrolled
        else:
            self._experiences.append((template_id, here))
            self._unrolled_of.append(self._unrolled)
        self._of_template.setdefault(template_id, []).append(new)
        self._visits.create(new)
        self._change_to(new)
        return 'create'

    def _forget(self, experience_id: int) -> None:
        """Free the number of an experience; what its view is tied to stays."""
        template_id, _ = self._experiences[experience_id]
        self._of_template[template_id].remove(experience_id)
        if not self._of_template[template_id]:
            del self._of_template[template_id]
        self._transitions.forget(experience_id)
        self._gaps.forget(experience_id)

    def _arrive(self, target: int) -> Action:
        self._visits.arrive(target)
        place = self._experiences[target][1]
        self._unrolled = self._further(self._unrolled_of[target], place, self.peak)
        return 'link' if self._change_to(target) else 'set'

    def _change_to(self, target: int) -> bool:
        """Make an experience current; return whether it is a transition made the first time."""
        first = self._transitions.add(self._current, target)
        if self._p.exp_max > 0:
            self._gaps.join(self._current, target, math.hypot(*self._since_current[:2]))
        self._current = target
        self._since_current = Pose(0.0, 0.0, 0.0)
        return first

    def _at_rest(self) -> bool:
        x, y, turn = self._since_current
        planes = abs(turn) * self._torus.planes_per_rad
        return math.hypot(x, y) / self._p.pc_cell_x_size < REST_CELLS and planes < REST_CELLS


class _Transitions:
    """Which experience followed on which, found from either of the two."""

    def __init__(self) -> None:
        self._after: dict[int, set[int]] = {}
        self._before: dict[int, set[int]] = {}

    def add(self, source: int, target: int) -> bool:
        """Add a transition; return whether it is new."""
        after = self._after.setdefault(source, set())
        if target in after:
            return False
        after.add(target)
        self._before.setdefault(target, set()).add(source)
        return True

    def forget(self, experience_id: int) -> None:
        """Take out all from and to an experience."""
        for target in self._after.pop(experience_id, ()):
            self._before[target].discard(experience_id)
        for source in self._before.pop(experience_id, ()):
            self._after[source].discard(experience_id)

    def pairs(self) -> list[list[int]]:
        """Return all, sorted."""
        return sorted([i, j] for i, after in self._after.items() for j in after)
