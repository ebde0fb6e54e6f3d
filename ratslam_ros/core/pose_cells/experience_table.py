# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Table of experiences, with their places in the pose cells, and transitions between them."""

from __future__ import annotations

import math
from collections.abc import Callable, Collection
from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from ratslam_ros.core.common.rows import Rows, listed
from ratslam_ros.core.common.saved import MAX_COUNT, MAX_ID, Field, Saved
from ratslam_ros.core.common.state import State
from ratslam_ros.core.pose_cells.torus import Located, Place, Torus


@dataclass(slots=True)
class Experience:
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

    def label(self, experience_id: int) -> Place:
        """Return the place at which an experience was created, which identifies it."""
        return self._all[experience_id].label

    def located(self, experience_id: int) -> Located:
        """Return the place of an experience; it moves if its component joins another one."""
        return self._all[experience_id].located

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
            one.located = self._torus.rescaled(one.located, factor)
            self._store(number)

    def merge(self, component: int, into: int, moved: Callable[[Located], Located]) -> None:
        """Move the experiences of one component into another one, by ``moved``."""
        for number, one in enumerate(self._all):
            if one.component == component:
                one.located, one.component = moved(one.located), into
                self._store(number)

    def members(self, component: int) -> set[int]:
        """Return the experiences of a component."""
        return {number for number, one in enumerate(self._all) if one.component == component}

    def has(self, experience_id: int, template_id: int, component: int) -> bool:
        """Return whether there is an experience of this id, template and component."""
        return (
            experience_id < len(self)
            and self._all[experience_id].template_id == template_id
            and self._all[experience_id].component == component
        )

    def _in(self, component: int, template_id: int) -> list[int]:
        """Return the experiences of a template in a component, in the order of creation."""
        return [
            i for i in self._of_template.get(template_id, ())
            if self._all[i].component == component
        ]

    def _unwrapped_cells(self, a: int, b: int) -> float:
        """Return the distance of the unwrapped positions of two experiences."""
        return math.dist(self._all[a].located.unwrapped, self._all[b].located.unwrapped)

    def _put(self, number: int, template_id: int, located: Located, component: int) -> None:
        """Add an experience under the next id, or under that of a removed one."""
        one = Experience(template_id, located.place, located, component, self._creation_count)
        self._creation_count += 1
        if number < len(self):
            self._all[number] = one
        else:
            self._all.append(one)
        self._store(number)
        self._of_template.setdefault(template_id, []).append(number)

    def _remove(self, experience_id: int) -> None:
        """Remove an experience so that its id can be reused; its template stays associated."""
        template_id = self._all[experience_id].template_id
        others = self._of_template.pop(template_id, [experience_id])  # none if it is forgotten
        others.remove(experience_id)
        if others:
            self._of_template[template_id] = others

    def _store(self, number: int) -> None:
        """Store an experience in the table that is saved."""
        one = self._all[number]
        (place, unwrapped) = one.located
        row = one.template_id, *one.label, *place, *unwrapped, one.component, one.rank
        if number == len(self._rows):
            self._rows.append(row)
        else:
            self._rows[number] = row

    def _restored(self, state: State) -> None:
        components = state['components']
        created = np.asarray(state.get('created', np.arange(len(state['experiences']))), np.int64)
        for (template_id, *label), (x, y), component, place, rank in zip(
            listed(state['experiences']), listed(state['unrolled']['experiences']),
            listed(components['experiences']), listed(components['places']), created.tolist(),
            strict=True,
        ):
            located = Located(Place(*place), (x, y))
            self._all.append(
                Experience(int(template_id), Place(*label), located, int(component), rank)
            )
            self._store(len(self) - 1)
        self._creation_count = 1 + max(created.tolist(), default=-1)
        for number in np.argsort(created).tolist():
            self._of_template.setdefault(self._all[number].template_id, []).append(number)


class Transitions:
    """The transitions, and a table of them that is saved."""

    def __init__(self) -> None:
        self._known: set[tuple[int, int]] = set()
        self._rows = Rows(2, np.int64)

    def add(self, source: int, target: int) -> bool:
        """Add a transition; return whether it is new."""
        if (source, target) in self._known:
            return False
        self._known.add((source, target))
        self._rows.append((source, target))
        return True

    def remove(self, experience_id: int) -> None:
        """Remove all transitions from and to an experience."""
        is_gone = (self._rows.values == experience_id).any(axis=1)
        self._known.difference_update(map(tuple, self._rows.values[is_gone].tolist()))
        self._rows.keep(~is_gone)

    def pairs(self) -> NDArray[np.int64]:
        """Return all transitions, (n, 2) source and target, sorted."""
        # The source before the first experience is -1.
        numbers = np.sort(((self._rows.values[:, 0] + 1) << 32) + self._rows.values[:, 1])
        return np.stack([(numbers >> 32) - 1, numbers & 0xFFFFFFFF], axis=1)
