# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Joining: actions of pose cells that may know more or less than the map -> actions it can do."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

from ratslam_ros.core.common.pose import Pose
from ratslam_ros.core.common.state import State
from ratslam_ros.core.mapping.experience_map import ExperienceMap
from ratslam_ros.core.mapping.id_map import DenseIdMap
from ratslam_ros.core.mapping.scan_matching import ScanMatch
from ratslam_ros.core.pose_cells.map_action import MapAction


class LateJoin:
    """Applies actions to an experience map, whichever of the two was started first.

    With both there from the start, and no action lost, every action is applied as it came.
    """

    def __init__(self, experience_map: ExperienceMap) -> None:
        self._map = experience_map
        self._numbering = DenseIdMap()
        self.missed = 0
        """Actions that were sent and never came, by their sequence, those before it began too."""
        self.forgotten = 0
        """How often the pose cells came back with an empty memory."""
        self._next = 0
        self.first_sequence: int | None = None
        """The sequence of the first action that came; above 0 the map began late."""

    def state(self) -> State:
        """Return which actions came so far, for ``restore``."""
        return {
            'missed': self.missed, 'forgotten': self.forgotten, 'next': self._next,
            'first_sequence': self.first_sequence, 'numbering': self._numbering.state(),
        }  # fmt: skip

    def restore(self, state: State) -> None:
        """Take what ``state`` gave."""
        self.missed, self.forgotten = state['missed'], state['forgotten']
        self._next, self.first_sequence = state['next'], state['first_sequence']
        self._numbering.restore(state['numbering'])

    def apply(
        self, action: MapAction, sequence: int, memory_ns: int, behaviour: str = '',
        look: Callable[[MapAction, int, Pose, Pose | None], ScanMatch] | None = None,
    ) -> None:  # fmt: skip
        """Do what the pose cells decided, as far as the map knows what they mean.

        An experience that the map does not know is made where the robot is; one that it knows
        with another view or place is forgotten first, as the pose cells have forgotten it. A link
        leads from the experience that the map has as its current one: the motion was counted
        from there. ``look``: tells what scans say of an action, as the map numbers it, of the
        current experience and the offset, and of where the map has the robot at the target.
        """
        if self.first_sequence is None:
            self.first_sequence = self.missed = sequence
        elif sequence < self._next:  # restarted, or with a memory from before the map's own
            self.forgotten += 1
            self._numbering.forget()
        else:
            self.missed += sequence - self._next
        self._next = sequence + 1
        self._numbering.remember(memory_ns)
        kind = action.action
        if kind == 'none':
            self._map.apply(action, behaviour)
            return
        known = self._numbering.knows(action.target_id) and (
            self._map.labels[self._numbering.number(action.target_id)]
            == (action.template_id, action.place)
        )
        if not known:
            if not self._map.mapping:
                return
            kind = 'create'
        elif kind == 'create':
            kind = 'link'
        target = self._numbering.number(action.target_id)
        source = self._map.current_id
        action = replace(action, action=kind, source_id=source, target_id=target)
        sight = None
        if look is not None:
            sight = look(action, source, self._map.offset, self._map.seen_from(target))
        self._map.apply(action, behaviour, sight)
