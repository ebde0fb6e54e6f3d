# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Pose cells: Motion, ViewMatch -> MapAction."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from ratslam_ros.core.agreement import Agreement
from ratslam_ros.core.attractor import Network, Packet, kernel
from ratslam_ros.core.config import PoseCellsParameters
from ratslam_ros.core.local_view import NO_TEMPLATE, ViewMatch
from ratslam_ros.core.odometry import Motion, Pose, moved
from ratslam_ros.core.state import State
from ratslam_ros.core.torus import Place, Torus
from ratslam_ros.errors import UnusableInput

Action = Literal['create', 'link', 'set', 'none']

NO_EXPERIENCE = -1

NEWEST_TEMPLATES = 10
"""Templates learned this recently inject nothing: the robot is still there."""

REST_CELLS = 0.02
"""Net motion since the current experience, in cells or planes, that still counts as rest."""


@dataclass(frozen=True, slots=True)
class MapAction:
    """What the experience map shall do; there is one for every template message.

    ``source_id`` is the experience that was current, ``target_id`` the one that is now; -1 where
    there is none. ``relative_rad``: heading of the robot less that of the target's view.
    ``place``: where the target lies in the pose cells; the peak while there is no experience.
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
        self._of_template: dict[int, list[int]] = {}
        self._transitions: set[tuple[int, int]] = set()
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
            'messages': self._messages,
            'last_template': self._last_template,
            'experiences': [[template, *place] for template, place in self._experiences],
            'transitions': sorted(map(list, self._transitions)),
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
            self._memories[template] = _Memory(Place(x, y, theta), order, decay, message)
        self._messages = state['messages']
        self._last_template = state['last_template']
        for number, (template, x, y, theta) in enumerate(state['experiences']):
            self._experiences.append((template, Place(x, y, theta)))
            self._of_template.setdefault(template, []).append(number)
        self._transitions = {(source, target) for source, target in state['transitions']}
        self._current = state['current']
        self._since_current = Pose(*state['since_current'])
        self._stepped = state['stepped']
        self._agreement.restore(state['agreement'])

    def integrate(self, motion: Motion) -> None:
        """Let the network compete once and follow one motion."""
        chord = motion.chord_m / self._p.pc_cell_x_size
        turn = motion.turn_rad * self._torus.planes_per_rad
        self._agreement.integrate(chord, turn)
        self._packets = self._network.step(self._packets, chord, turn)
        self.peak = self._decoded()
        self._since_current = moved(self._since_current, motion)
        self._stepped = True

    def view(self, match: ViewMatch) -> MapAction:
        """Take one template message: associate or inject, and decide the map's action."""
        turned = match.relative_rad * self._torus.planes_per_rad
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
            here = Place(self.peak.x, self.peak.y, self.peak.theta - turned)
            self._memories[template_id] = _Memory(
                here, len(self._memories), p.vt_active_decay, self._messages
            )
            return
        if memory.order >= len(self._memories) - NEWEST_TEMPLATES:
            return
        # All decays relax after every message; each is brought up to date when it is needed.
        rested = memory.decay - p.pc_vt_restore * (self._messages - memory.message)
        memory.decay = max(p.vt_active_decay, rested)
        memory.message = self._messages
        if template_id == self._last_template:
            memory.decay += p.vt_active_decay
        claimed = Place(memory.place.x, memory.place.y, memory.place.theta + turned)
        tired = math.exp(min(1.2 * memory.decay, 10.0))  # above e^3.4 nothing is injected
        energy = p.pc_vt_inject_energy / 30.0 * (30.0 - tired)
        energy *= self._agreement.weigh(template_id, claimed, self.peak)
        if energy > 0.0:
            self._packets = self._network.inject(
                self._packets, claimed.theta, claimed.y, claimed.x, energy
            )

    def _decide(self, template_id: int, turned: float) -> Action:
        candidates = self._of_template.get(template_id)
        if candidates is None:
            return self._create(template_id, turned)
        here = Place(self.peak.x, self.peak.y, self.peak.theta - turned)
        threshold = self._p.exp_delta_pc_threshold
        current_template, current_place = self._experiences[self._current]
        jumped = self._torus.distance(here, current_place) > threshold
        if not jumped and (template_id == current_template or self._at_rest()):
            return 'none'
        others = [i for i in candidates if i != self._current]
        if others:
            distance, nearest = min(
                (self._torus.distance(here, self._experiences[i][1]), i) for i in others
            )
            if distance < threshold:
                return self._arrive(nearest)
        return self._create(template_id, turned)

    def _create(self, template_id: int, turned: float) -> Action:
        if self._current != NO_EXPERIENCE and self._at_rest():
            return 'none'  # never a second experience while the robot stands still
        if not self.mapping:
            return 'none'
        new = len(self._experiences)
        here = Place(self.peak.x, self.peak.y, (self.peak.theta - turned) % self._p.pc_dim_th)
        self._experiences.append((template_id, here))
        self._of_template.setdefault(template_id, []).append(new)
        self._arrive(new)
        return 'create'

    def _arrive(self, target: int) -> Action:
        transition = (self._current, target)
        first = transition not in self._transitions
        self._transitions.add(transition)
        self._current = target
        self._since_current = Pose(0.0, 0.0, 0.0)
        return 'link' if first else 'set'

    def _at_rest(self) -> bool:
        x, y, turn = self._since_current
        planes = abs(turn) * self._torus.planes_per_rad
        return math.hypot(x, y) / self._p.pc_cell_x_size < REST_CELLS and planes < REST_CELLS
