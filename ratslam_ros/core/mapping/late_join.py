# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Late join: map actions for an experience map that lacks earlier ones, or was reset alone."""

from __future__ import annotations

from dataclasses import replace

from ratslam_ros.core.common.saved import Field, Saved, count
from ratslam_ros.core.mapping.experience_map import ExperienceMap
from ratslam_ros.core.mapping.id_map import DenseIdMap
from ratslam_ros.core.pose_cells.map_action import NO_EXPERIENCE, MapAction
from ratslam_ros.core.pose_cells.map_relocation import MapRelocation


class LateJoin(Saved):
    """Translates actions of the pose cells for an experience map, whichever was started first.

    If both were started together, no action was lost and no closure was rejected, every action is
    returned unchanged.
    """

    SAVED = (
        count('missed', 'missed'), count('forgotten', 'restarts'),
        count('next', '_next', nullable=True),
        count('first_sequence', 'first_sequence', nullable=True),
        Field('numbering', '_ids', DenseIdMap),
    )

    def __init__(self, experience_map: ExperienceMap) -> None:
        self._map = experience_map
        self._ids = DenseIdMap()
        self.missed = 0
        """Number of actions that never arrived, including those before the map started."""
        self.restarts = 0
        """Number of times the pose cells restarted, or loaded an older memory."""
        self._next: int | None = 0
        """Number of the next action; None: that of whichever comes first."""
        self.first_sequence: int | None = None
        """Sequence number of the first action received; above 0 the map started late."""

    def assume(self) -> None:
        """Use the ids of the map unchanged: it was built together with its pose cells."""
        self._ids.assume(len(self._map))
        self._next = None

    def peer_relocation(self, relocation: MapRelocation | None) -> MapRelocation | None:
        """Return a relocation with the ids of the pose cells; None if they do not know its place.

        The template is that of the experience, whose id needs no translation.
        """
        if relocation is None:
            return None
        peer_id = self._ids.peer_id(relocation.experience_id)
        return None if peer_id is None else relocation._replace(experience_id=peer_id)

    def translate(self, action: MapAction, sequence: int, memory_ns: int) -> MapAction | None:
        """Return the action with the ids of the map; None if the map must not execute it.

        A link or set to an experience that the map does not have becomes a create, unless the map
        only localises. If the map's experience with that id has another template or place, the
        map missed its pruning: the action becomes a create, which prunes that experience now. A
        create of an experience that the map has becomes a link. The source is the map's current
        experience, because odometry was integrated from there.

        Args:
            action: with the ids of the pose cells.
            sequence: sequence number of the action; a gap counts as missed actions.
            memory_ns: stamp of the memory of the pose cells that the ids belong to.
        """
        if self._next is None:
            self.first_sequence = 0
        elif self.first_sequence is None:
            self.first_sequence = self.missed = sequence
        elif sequence < self._next:  # pose cells were restarted, or loaded an older memory
            self.restarts += 1
            self._ids.restart()
        else:
            self.missed += sequence - self._next
        self._next = sequence + 1
        self._ids.set_memory(memory_ns)
        recognised = self._ids.own_ids.get(action.recognised_id, NO_EXPERIENCE)
        action = replace(action, recognised_id=recognised)
        kind = action.action
        if kind == 'none':
            return action
        known = action.target_id in self._ids.own_ids and (
            self._map.labels[self._ids.own_id(action.target_id)]
            == (action.template_id, action.place)
        )
        if not known:
            if not self._map.mapping:
                return None
            kind = 'create'
        elif kind == 'create':
            kind = 'link'
        target = self._ids.own_id(action.target_id)
        return replace(
            action, action=kind, source_id=self._map.current_id, target_id=target
        )
