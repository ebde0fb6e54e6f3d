# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Visual evidence: places associated with templates, and the activity that recognitions inject."""

from __future__ import annotations

import math
from collections import deque
from dataclasses import dataclass
from typing import NamedTuple

from ratslam_ros.core.common.state import State
from ratslam_ros.core.config import PoseCellsParameters
from ratslam_ros.core.pose_cells.agreement import Agreement
from ratslam_ros.core.pose_cells.lengths import Lengths
from ratslam_ros.core.pose_cells.torus import Place, Torus, Unwrapped
from ratslam_ros.core.vision.local_view import NO_TEMPLATE

RECENT_RECOGNITIONS_COUNT = 8
"""Number of latest recognitions whose places are kept."""

NEWEST_TEMPLATES_COUNT = 10
"""Templates learned this recently inject nothing: the robot is still near them."""


class Observation(NamedTuple):
    """A view and the pose estimate at the time it was received.

    Attributes:
        template_id: the template of the view.
        turn_planes: heading of the robot minus heading of the template, in heading planes.
        peak: peak of activity.
        unwrapped: unwrapped position of the peak.
    """

    template_id: int
    turn_planes: float
    peak: Place
    unwrapped: Unwrapped

    @property
    def place(self) -> Place:
        """The peak with the heading of the template; theta is not wrapped."""
        return Place(self.peak.x, self.peak.y, self.peak.theta - self.turn_planes)


class Injection(NamedTuple):
    """Activity to add to the network."""

    place: Place
    energy: float


@dataclass(slots=True)
class _Association:
    """Place at which a template was first seen, and its decay.

    Attributes:
        place: peak of activity with the heading of the template.
        unwrapped: unwrapped position of the peak.
        order: number of templates associated before.
        decay: decay of the template when it was last updated.
        message: number of the template message of that update.
    """

    place: Place
    unwrapped: Unwrapped
    order: int
    decay: float
    message: int


class VisualEvidence:
    """Associations of templates with places, and the energies that recognised templates inject."""

    def __init__(
        self, parameters: PoseCellsParameters, torus: Torus, lengths: Lengths
    ) -> None:
        p = self._p = parameters
        self._torus = torus
        self._lengths = lengths
        self._agreement = Agreement(torus, lengths, p.pc_vt_agree_views, p.pc_vt_agree_recent)
        self._associations: dict[int, _Association] = {}
        self._messages = 0
        self._last_template = NO_TEMPLATE
        self.recent: deque[Unwrapped] = deque(maxlen=RECENT_RECOGNITIONS_COUNT)
        """Unwrapped positions at which the latest recognised templates were first seen."""

    def state(self) -> State:
        """Return everything learned, for ``restore``."""
        associations = self._associations
        return {
            'memories': [
                [template_id, *a.place, a.order, a.decay, a.message]
                for template_id, a in associations.items()
            ],
            'unrolled': {
                'claimed': [list(position) for position in self.recent],
                'memories': [list(a.unwrapped) for a in associations.values()],
            },
            'messages': self._messages,
            'last_template': self._last_template,
            'agreement': self._agreement.state(),
        }

    def restore(self, state: State) -> None:
        """Restore what ``state`` returned; nothing must have been learned before."""
        positions = state['unrolled']['memories']
        for (template_id, x, y, theta, order, decay, message), position in zip(
            state['memories'], positions, strict=True
        ):
            self._associations[template_id] = _Association(
                Place(x, y, theta), tuple(position), order, decay, message
            )
        self.recent.extend(tuple(position) for position in state['unrolled']['claimed'])
        self._messages = state['messages']
        self._last_template = state['last_template']
        self._agreement.restore(state['agreement'])

    def integrate(self, chord_cells: float, turn_planes: float) -> None:
        """Move the pose hypotheses by one motion of the robot."""
        self._agreement.integrate(chord_cells, turn_planes)

    def is_known(self, template_id: int) -> bool:
        """Return whether a template has a place."""
        return template_id in self._associations

    def is_recent(self, template_id: int) -> bool:
        """Return whether a template is one of the newest, or unknown."""
        known = self._associations.get(template_id)
        return known is None or known.order >= len(self._associations) - NEWEST_TEMPLATES_COUNT

    def rescale(self, factor: float) -> None:
        """Multiply all places by a factor; there must be no hypotheses yet."""
        for known in self._associations.values():
            known.unwrapped = known.unwrapped[0] * factor, known.unwrapped[1] * factor
            known.place = self._torus.wrapped(known.unwrapped, known.place.theta)

    def observe(self, seen: Observation, learn: bool) -> Injection | None:
        """Associate a new template with the peak, or compute the injection of a known one.

        Args:
            seen: the observation, with a template.
            learn: whether a new template is associated; otherwise it is ignored.

        Returns:
            The activity to inject, None if there is none.
        """
        injection = self._recall(seen, learn)
        self._messages += 1
        self._last_template = seen.template_id
        return injection

    def _recall(self, seen: Observation, learn: bool) -> Injection | None:
        p = self._p
        known = self._associations.get(seen.template_id)
        if known is None:
            if learn:
                self._associations[seen.template_id] = _Association(
                    seen.place, seen.unwrapped, len(self._associations), p.vt_active_decay,
                    self._messages,
                )  # fmt: skip
            return None
        if self.is_recent(seen.template_id) or not self._lengths.are_known:
            return None
        if seen.template_id != self._last_template:
            self.recent.append(known.unwrapped)
        # The decay recovers with each template message; it is computed when a template is seen.
        relaxed = known.decay - p.pc_vt_restore * (self._messages - known.message)
        known.decay = max(p.vt_active_decay, relaxed)
        known.message = self._messages
        if seen.template_id == self._last_template:
            known.decay += p.vt_active_decay
        place = Place(known.place.x, known.place.y, known.place.theta + seen.turn_planes)
        loss = math.exp(min(1.2 * known.decay, 10.0))  # above e^3.4 the energy is negative
        energy = p.pc_vt_inject_energy / 30.0 * (30.0 - loss)
        energy *= self._agreement.weigh(
            seen.template_id, place, seen.peak, self._distance(known, place, seen)
        )
        if p.pc_vt_agree_views > 0.0 and p.pc_vt_agree_mean > 0.0:
            place = self._agreement.mean(p.pc_vt_agree_mean)
        return Injection(place, energy) if energy > 0.0 else None

    def _distance(self, known: _Association, place: Place, seen: Observation) -> float:
        """Return the distance of a recognised place from the peak, x and y unwrapped.

        The unit is that of ``lengths.near``.
        """
        scale = self._lengths.near.planes_per_cell
        same = Place(seen.peak.x, seen.peak.y, place.theta)
        x, y = seen.unwrapped
        return math.hypot(
            (known.unwrapped[0] - x) * scale, (known.unwrapped[1] - y) * scale,
            self._torus.distance(same, seen.peak),
        )  # fmt: skip
