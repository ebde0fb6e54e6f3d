# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Table of experiences, with their places in the pose cells, and transitions between them."""

from __future__ import annotations

import math
from collections.abc import Callable, Collection
from typing import ClassVar, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ratslam_ros.core.common.rows import KeyedRows, Rows, listed
from ratslam_ros.core.common.saved import MAX_COUNT, MAX_ID, Field, Saved
from ratslam_ros.core.common.state import State
from ratslam_ros.core.pose_cells.torus import Located, Place, Torus

_COMPONENT = 9
"""Column of the table of experiences."""


class Experience(NamedTuple):
    """An experience of the pose cells.

    Attributes:
        template_id: the template with which it was created.
        label: the place at which it was created, which identifies it.
        located: its place, which moves if its component joins another one.
        component: its component.
        rank: number of experiences that were created before it.
    """

    template_id: int
    label: Place
    located: Located
    component: int
    rank: int


class ExperienceTable(Saved):
    """All experiences, by id and by template."""

    SAVED: ClassVar[tuple[Field, ...]] = (
        Field('unrolled/experiences', '', 'f8', ('experiences', 2),
              save=lambda own: own._rows.values[:, 7:9]),
        Field('experiences', '', 'f8', ('experiences', 4), -1, MAX_ID,
              save=lambda own: own._rows.values[:, :4]),
        Field('components/experiences', '', 'i8', ('experiences',), 0, MAX_ID,
              save=lambda own: own._rows.values[:, 9]),
        Field('components/places', '', 'f8', ('experiences', 3),
              save=lambda own: own._rows.values[:, 4:7]),
        Field('created', '', 'i8', ('experiences',), 0, MAX_COUNT, optional=True,
              save=lambda own: own._rows.values[:, 10]),
    )

    def __init__(self, torus: Torus) -> None:
        self._torus = torus
        self._creation_count = 0
        # Template, label, place, unwrapped position, component and rank of each.
        self._rows = Rows(11)
        self._of_template: dict[int, list[int]] = {}

    def __len__(self) -> int:
        return len(self._rows)

    def __getitem__(self, experience_id: int) -> Experience:
        template_id, *places, component, rank = self._rows[experience_id]
        return Experience(
            int(template_id), Place(*places[:3]),
            Located(Place(*places[3:6]), (places[6], places[7])), int(component), int(rank),
        )

    @property
    def next_template_id(self) -> int:
        """Id above those of the templates of all experiences."""
        return int(self._rows.values[:, 0].max(initial=-1)) + 1

    def forget_templates(self, template_ids: Collection[int]) -> None:
        """Remove the associations of templates; their experiences stay, as places on the map."""
        for template_id in template_ids:
            self._of_template.pop(template_id, None)

    def rescale(self, factor: float) -> None:
        """Multiply all places by a factor; labels stay, because the map has received them."""
        for number in range(len(self)):
            located = self._torus.rescaled(self[number].located, factor)
            self._store(number, self[number]._replace(located=located))

    def merge(self, component: int, into: int, moved: Callable[[Located], Located]) -> None:
        """Move the experiences of one component into another one, by ``moved``."""
        for number in self.members(component):
            one = self[number]
            self._store(number, one._replace(located=moved(one.located), component=into))

    def members(self, component: int) -> set[int]:
        """Return the experiences of a component."""
        return set(np.flatnonzero(self._rows.values[:, _COMPONENT] == component).tolist())

    def has(self, experience_id: int, template_id: int, component: int) -> bool:
        """Return whether there is an experience of this id, template and component."""
        return experience_id < len(self) and (
            (self[experience_id].template_id, self[experience_id].component)
            == (template_id, component)
        )

    def _in(self, component: int, template_id: int) -> list[int]:
        """Return the experiences of a template in a component, in the order of creation."""
        return [
            i for i in self._of_template.get(template_id, ())
            if self._rows.values[i, _COMPONENT] == component
        ]

    def _unwrapped_cells(self, a: int, b: int) -> float:
        """Return the distance of the unwrapped positions of two experiences."""
        return math.dist(self[a].located.unwrapped, self[b].located.unwrapped)

    def _put(self, number: int, template_id: int, located: Located, component: int) -> None:
        """Add an experience under the next id, or under that of a removed one."""
        one = Experience(template_id, located.place, located, component, self._creation_count)
        self._creation_count += 1
        self._store(number, one)
        self._of_template.setdefault(template_id, []).append(number)

    def _remove(self, experience_id: int) -> None:
        """Remove an experience so that its id can be reused; its template stays associated."""
        template_id = self[experience_id].template_id
        others = self._of_template.pop(template_id, [experience_id])  # none if it is forgotten
        others.remove(experience_id)
        if others:
            self._of_template[template_id] = others

    def _store(self, number: int, one: Experience) -> None:
        """Add or change an experience."""
        self._rows[number] = (
            one.template_id, *one.label, *one.located.place, *one.located.unwrapped,
            one.component, one.rank,
        )

    def _restored(self, state: State) -> None:
        components, unrolled = state['components'], state['unrolled']['experiences']
        created = np.asarray(state.get('created', np.arange(len(unrolled))), np.int64)
        self._rows.replace([
            (*experience, *place, *unwrapped, component, rank)
            for experience, place, unwrapped, component, rank in zip(
                listed(state['experiences']), listed(components['places']), listed(unrolled),
                listed(components['experiences']), created.tolist(), strict=True,
            )
        ])
        self._creation_count = 1 + int(created.max(initial=-1))
        for number in np.argsort(created).tolist():
            self._of_template.setdefault(self[number].template_id, []).append(number)


class Transitions(KeyedRows):
    """The transitions: source and target of each."""

    def __init__(self) -> None:
        super().__init__(2, 2, np.int64)

    def add(self, source: int, target: int) -> bool:
        """Add a transition; return whether it is new."""
        count = len(self)
        self.put((source, target))
        return len(self) > count

    def forget(self, experience_id: int) -> None:
        """Remove all transitions from and to an experience."""
        for ends in self.values[(self.values == experience_id).any(axis=1)].tolist():
            self.drop(*ends)

    def pairs(self) -> NDArray[np.int64]:
        """Return all transitions, (n, 2) source and target, sorted."""
        # The source before the first experience is -1.
        numbers = np.sort(((self.values[:, 0] + 1) << 32) + self.values[:, 1])
        return np.stack([(numbers >> 32) - 1, numbers & 0xFFFFFFFF], axis=1)
