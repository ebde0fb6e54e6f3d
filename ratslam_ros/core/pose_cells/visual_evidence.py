# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Visual evidence: places associated with templates, and the activity that recognitions inject."""

from __future__ import annotations

import math
from collections.abc import Callable, Collection
from typing import NamedTuple

from ratslam_ros.core.common.rows import KeyedRows, listed
from ratslam_ros.core.common.saved import MAX_ID, Field, Saved, count
from ratslam_ros.core.common.state import State
from ratslam_ros.core.config import PoseCellsParameters
from ratslam_ros.core.config.additions import AGREEMENT
from ratslam_ros.core.pose_cells.injection_weights import EqualWeights
from ratslam_ros.core.pose_cells.lengths import Lengths
from ratslam_ros.core.pose_cells.torus import Located, Place, Torus, Unwrapped
from ratslam_ros.core.vision.local_view import NO_TEMPLATE

NEWEST_TEMPLATES_COUNT = 10
"""Templates learned this recently inject nothing (``pc_vt_spare_newest``)."""


class Observation(NamedTuple):
    """A view and the pose estimate at the time it was received.

    Attributes:
        template_id: the template of the view.
        turn_planes: heading of the robot minus heading of the template, in heading planes.
        peak: peak of activity.
        unwrapped: unwrapped position of the peak.
        component: component that the robot is in.
    """

    template_id: int
    turn_planes: float
    peak: Place
    unwrapped: Unwrapped
    component: int = 0

    @property
    def place(self) -> Place:
        """The peak with the heading of the template; theta is not wrapped."""
        return Place(self.peak.x, self.peak.y, self.peak.theta - self.turn_planes)

    def at(self, located: Located, component: int) -> Observation:
        """Return the same view with another estimate."""
        return self._replace(peak=located.place, unwrapped=located.unwrapped, component=component)


class Injection(NamedTuple):
    """Activity to add to the network."""

    place: Place
    energy: float


class Relocation(NamedTuple):
    """A pose of the robot in another component than its own, on which recent views agree."""

    located: Located
    component: int


class _Association(NamedTuple):
    """Place at which a template was first seen in a component, and its decay.

    Attributes:
        located: peak of activity, with the heading of the template.
        order: number of associations made before.
        decay: decay of the template when it was last updated.
        message: number of the template message of that update.
    """

    located: Located
    order: int
    decay: float
    message: int


class VisualEvidence(Saved):
    """Associations of templates with places, and the energies that recognised templates inject."""

    SAVED = (
        Field('memories', '', 'f8', ('memories', 7), -MAX_ID, MAX_ID,
              save=lambda evidence: evidence._rows.values[:, [0, 2, 3, 4, 7, 8, 9]]),
        Field('unrolled/memories', '', 'f8', ('memories', 2),
              save=lambda evidence: evidence._rows.values[:, 5:7]),
        count('messages', '_messages'),
        Field('last_template', '_last_template', int, (), NO_TEMPLATE, MAX_ID),
        Field('agreement', '_weights', EqualWeights),
        Field('components/memories', '', 'i8', ('memories',), 0, MAX_ID,
              save=lambda evidence: evidence._rows.values[:, 1]),
        Field('components/alive', '_components', int, ('',), 0, MAX_ID),
        count('components/made', '_made_count'),
        Field('present/unlocated', '_unlocated', int, ('', 2), 0, MAX_ID,
              make=lambda *key: key),
    )

    def __init__(
        self, parameters: PoseCellsParameters, torus: Torus, lengths: Lengths
    ) -> None:
        p = self._p = parameters
        self._torus = torus
        self._lengths = lengths
        self._weights = self._weights_of(p)
        # By template and component, in the order in which they were made; and the same as a table:
        # place, unwrapped position, order, decay and message.
        self._associations: dict[tuple[int, int], _Association] = {}
        self._rows = KeyedRows(2, 10)
        self._components = [0]
        self._made_count = 0
        # Made since the first view after the last motion; misplaced if odometry is missing.
        self._unlocated: list[tuple[int, int]] = []
        self._messages = 0
        self._last_template = NO_TEMPLATE
        self.agreement = 0.0
        """Share of the required recognitions that agree with the latest view, see
        ``Agreement.share``; 0 if it was not recognised."""

    def reconfigure(self, parameters: PoseCellsParameters) -> None:
        """Continue with other values; ``lengths`` must have them already."""
        self._p = parameters
        before, self._weights = self._weights, self._weights_of(parameters)
        self._weights.restore(before.state())

    def _weights_of(self, p: PoseCellsParameters) -> EqualWeights:
        weights = AGREEMENT.instead_of(EqualWeights, p)
        return weights(self._torus, self._lengths, p.pc_vt_agree_views)

    def _restored(self, state: State) -> None:
        for (template_id, *place, order, decay, message), (x, y), number in zip(
            listed(state['memories']), listed(state['unrolled']['memories']),
            listed(state['components']['memories']), strict=True,
        ):
            located = Located(Place(*place), (x, y))
            a = _Association(located, int(order), decay, int(message))
            self._store((int(template_id), int(number)), a)

    def integrate(self, chord_cells: float, turn_planes: float, course_planes: float) -> None:
        """Move the pose hypotheses by one motion of the robot."""
        self._weights.integrate(chord_cells, turn_planes, course_planes)
        self._unlocated.clear()

    def separate(self, component: int) -> None:
        """Begin a component, and discard what depends on the pose, which is unknown now.

        This includes the associations that were made while odometry was missing already.
        """
        for key in self._unlocated:
            self._remove(key)
        self._unlocated.clear()
        self._components.append(component)
        self._weights.discard()
        self._last_template = NO_TEMPLATE

    def merge(self, component: int, into: int, moved: Callable[[Located], Located]) -> None:
        """Move the places of one component into another one, by ``moved``.

        A template that has a place there already keeps it.
        """
        before = self._associations
        self._associations, self._rows = {}, KeyedRows(2, 10)
        for (template_id, number), a in before.items():
            if number != component:
                self._store((template_id, number), a)
            elif (template_id, into) not in before:
                self._store((template_id, into), a._replace(located=moved(a.located)))
        self._unlocated.clear()
        self._components.remove(component)
        self._weights.discard(component)

    @property
    def template_ids(self) -> list[int]:
        """Templates that have a place; one with several places is repeated."""
        return [template_id for template_id, _ in self._associations]

    def forget(self, template_ids: Collection[int], component: int) -> None:
        """Remove the places of templates, and components in which no template is left.

        Args:
            template_ids: the templates, which will not be seen again.
            component: component that the robot is in, which is kept.
        """
        removed = set(template_ids)
        for key in [(i, number) for i in removed for number in self._components]:
            if key in self._associations:
                self._remove(key)
        self._unlocated = [key for key in self._unlocated if key[0] not in removed]
        if len(self._components) > 1:
            used = {number for _, number in self._associations} | {component}
            self._components = [number for number in self._components if number in used]

    def located(self, template_id: int, component: int) -> Located:
        """Return the place of a template that has one in the component."""
        return self._associations[template_id, component].located

    def is_known(self, template_id: int) -> bool:
        """Return whether a template has a place."""
        return any((template_id, number) in self._associations for number in self._components)

    def is_recent(self, template_id: int, component: int) -> bool:
        """Return whether a template is unknown, or one of the newest of the component."""
        known = self._associations.get((template_id, component))
        if known is None:
            return not self.is_known(template_id)
        return known.order >= self._made_count - NEWEST_TEMPLATES_COUNT

    def rescale(self, factor: float) -> None:
        """Multiply all places by a factor; there must be no hypotheses yet."""
        for key, known in self._associations.items():
            located = self._torus.rescaled(known.located, factor)
            self._store(key, known._replace(located=located))

    def observe(
        self, seen: Observation, learn: bool, is_first: bool,
        nearest: Callable[[Observation], int | None],
    ) -> Injection | Relocation | None:
        """Associate a new template with the peak, or compute the effect of a known one.

        Args:
            seen: the observation, with a template.
            learn: whether a new template is associated; otherwise it is ignored.
            is_first: whether this is the first view after a motion.
            nearest: the experience of a view where it is recognised: the map joins by going there.

        Returns:
            The activity to inject; a relocation, if the template has a place in another component
            on which enough views agree; None if the view has no effect.
        """
        injection = self._recall(seen, learn)
        if is_first:
            self._unlocated.clear()
        self._messages += 1
        self._last_template = seen.template_id
        may_relocate = is_first and self._lengths.are_known
        return (self._relocation(seen, nearest) if may_relocate else None) or injection

    def _store(self, key: tuple[int, int], a: _Association) -> None:
        """Add or change an association, also in the table that is saved."""
        self._associations[key] = a
        self._rows.put(key, (*a.located.place, *a.located.unwrapped, *a[1:]))

    def _remove(self, key: tuple[int, int]) -> None:
        del self._associations[key]
        self._rows.drop(*key)

    def _recall(self, seen: Observation, learn: bool) -> Injection | None:
        p = self._p
        self.agreement = 0.0
        key = seen.template_id, seen.component
        known = self._associations.get(key)
        if known is None:
            if learn:
                self._store(key, _Association(
                    Located(seen.place, seen.unwrapped), self._made_count, p.vt_active_decay,
                    self._messages,
                ))
                self._made_count += 1
                self._unlocated.append(key)
            return None
        if p.pc_vt_spare_newest and known.order >= self._made_count - NEWEST_TEMPLATES_COUNT:
            return None
        if not self._lengths.are_known:
            return None
        # The decay recovers with each template message; it is computed when a template is seen.
        relaxed = known.decay - p.pc_vt_restore * (self._messages - known.message)
        decay = max(p.vt_active_decay, relaxed)
        if seen.template_id == self._last_template:
            decay += p.vt_active_decay
        self._store(key, known._replace(decay=decay, message=self._messages))
        place, _ = known.located
        place = place._replace(theta=place.theta + seen.turn_planes)
        loss = math.exp(min(1.2 * decay, 10.0))  # above e^3.4 the energy is negative
        energy = p.pc_vt_inject_energy / 30.0 * (30.0 - loss)
        energy *= self._weights.weigh(seen.template_id, place, seen.peak, seen.component)
        self.agreement = self._weights.share(seen.template_id, seen.component)
        return Injection(place, energy) if energy > 0.0 else None

    def _relocation(
        self, seen: Observation, nearest: Callable[[Observation], int | None]
    ) -> Relocation | None:
        """Return the place in another component that a view indicates, if enough views agree.

        The number is ``pc_vt_agree_views``, at which the energy of a recognition has its full
        value. Of several such components it is the first one.
        """
        for component in self._components:
            known = self._associations.get((seen.template_id, component))
            if known is None or component == seen.component:
                continue
            place, unwrapped = known.located
            place = place._replace(theta=(place.theta + seen.turn_planes) % self._torus.n_theta)
            found = Relocation(Located(place, unwrapped), component)
            weight = self._weights.weigh(seen.template_id, place, None, component=component)
            if weight >= 1.0 and nearest(seen.at(*found)) is not None:
                return found
        return None
