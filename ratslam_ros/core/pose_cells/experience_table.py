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
        self._all: list[Experience] = []
        self._creation_count = 0
        # Template, label, place, unwrapped position, component and rank of each.
        self._rows = Rows(11)
        self._of_template: dict[int, list[int]] = {}

    def __len__(self) -> int:
        return len(self._all)

    def __getitem__(self, experience_id: int) -> Experience:
        return self._all[experience_id]

    @property
    def next_template_id(self) -> int:
        """Id above those of the templates of all experiences."""
        return max((one.template_id for one in self._all), default=-1) + 1

    def forget_templates(self, template_ids: Collection[int]) -> None:
        """Remove the associations of templates; their experiences stay, as places on the map."""
        for template_id in template_ids:
            self._of_template.pop(template_id, None)

    def rescale(self, factor: float) -> None:
        """Multiply all places by a factor; labels stay, because the map has received them."""
        for number, one in enumerate(self._all):
            self._store(number, one._replace(located=self._torus.rescaled(one.located, factor)))

    def merge(self, component: int, into: int, moved: Callable[[Located], Located]) -> None:
        """Move the experiences of one component into another one, by ``moved``."""
        for number in self.members(component):
            one = self[number]
            self._store(number, one._replace(located=moved(one.located), component=into))

    def members(self, component: int) -> set[int]:
        """Return the experiences of a component."""
        return {number for number, one in enumerate(self._all) if one.component == component}

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
            if self._all[i].component == component
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
        """Add or change an experience, also in the table that is saved."""
        self._all[number : number + 1] = [one]
        self._rows[number] = (
            one.template_id, *one.label, *one.located.place, *one.located.unwrapped,
            one.component, one.rank,
        )

    def _restored(self, state: State) -> None:
        components, places, unrolled = map(listed, (
            state['components']['experiences'], state['components']['places'],
            state['unrolled']['experiences'],
        ))
        created = np.asarray(state.get('created', np.arange(len(unrolled))), np.int64)
        for number, (template_id, *label) in enumerate(listed(state['experiences'])):
            located = Located(Place(*places[number]), tuple(unrolled[number]))
            self._store(number, Experience(
                int(template_id), Place(*label), located, int(components[number]),
                int(created[number]),
            ))
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
