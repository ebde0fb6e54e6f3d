# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Experience graph: the poses and labels of experiences, and the links between them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ratslam_ros.core.common.pose import Pose
from ratslam_ros.core.common.rows import Rows
from ratslam_ros.core.mapping.components import Components
from ratslam_ros.core.mapping.links import Link, Links
from ratslam_ros.core.pose_cells.map_action import NO_EXPERIENCE, MapAction
from ratslam_ros.core.pose_cells.torus import Place
from ratslam_ros.errors import RatslamError

MIRRORED = {'left_wall': 'right_wall', 'right_wall': 'left_wall'}
"""Behaviour that follows the same wall when a link is driven against its direction."""


class NotLinked(RatslamError):  # noqa: N818 - the errors' names say what they are
    """Error: no link connects two experiences, or an experience is not on the map."""


@dataclass(frozen=True, slots=True)
class Experience:
    """A node of the graph: its template, pose on the map, and place in the pose cells."""

    id: int
    template_id: int
    pose: Pose
    place: Place


class ExperienceGraph:
    """Nodes and edges of the map, without the robot's pose and without rules that change them."""

    def __init__(self, origin: Pose, frame_id: str) -> None:
        self.origin = origin
        """Pose of the robot on the map at the start."""
        self.frame_id = frame_id
        """Name of the frame of all poses."""
        self._poses = Rows(3)
        self._created_at_m = Rows(None)
        self._labels: list[tuple[int, Place]] = []
        self._label_rows = Rows(4)
        self.link_table = Links()
        """All links; do not modify."""
        self._components = Components()
        self._unlearned: set[tuple[int, int]] = set()
        self.replacement_count = 0
        """Counter that grows when an experience takes the id of a pruned one."""

    def __len__(self) -> int:
        return len(self._labels)

    # Experiences

    @property
    def labels(self) -> Sequence[tuple[int, Place]]:
        """Template and place in the pose cells of every experience; do not modify or keep."""
        return self._labels

    @property
    def template_ids(self) -> NDArray[np.int64]:
        """(n,) template of every experience; a copy."""
        return self._label_rows.values[:, 0].astype(np.int64)

    @property
    def poses(self) -> NDArray[np.float64]:
        """(n, 3) x, y in m and heading in rad of every experience; a copy."""
        return self._poses.values.copy()

    def pose_of(self, experience_id: int) -> Pose:
        """Return an experience's pose on the map; for -1 the robot's pose at the start.

        The id is not checked.
        """
        if experience_id == NO_EXPERIENCE:
            return self.origin
        return Pose(*self._poses[experience_id])

    def created_at_m(self, experience_id: int) -> float:
        """Return the odometer reading, in m, at which an experience was created."""
        at_m: float = self._created_at_m[experience_id]
        return at_m

    def experiences(self) -> list[Experience]:
        """Return all experiences, in the order of their ids."""
        return [
            Experience(i, template, self.pose_of(i), place)
            for i, (template, place) in enumerate(self._labels)
        ]

    def component_of(self, experience_id: int) -> int:
        """Return the component of an experience; for -1 that of the robot.

        The relative pose of two components is unknown.
        """
        return self._components.of(experience_id)

    @property
    def components(self) -> list[int]:
        """Component of every experience; all are 0 unless the odometry had gaps."""
        return self._components.numbers()

    @property
    def component_count(self) -> int:
        """Number of components that have experiences."""
        return self._components.count

    @property
    def merge_count(self) -> int:
        """Counter that grows when components are joined."""
        return self._components.merge_count

    def neighbours(self, experience_id: int) -> list[int]:
        """Return the ids of the experiences one link away, in either direction, ascending.

        Raises:
            NotLinked: there is no such experience.
        """
        if not 0 <= experience_id < len(self):
            raise NotLinked(
                f'there is no experience {experience_id}; expected 0 to {len(self) - 1}'
            )
        links = self.link_table.of(experience_id)
        ends = {end for link in links for end in (link.source_id, link.target_id)}
        return sorted(ends - {experience_id})

    # Links

    @property
    def link_count(self) -> int:
        """Number of links."""
        return len(self.link_table)

    @property
    def unlearned_ends(self) -> NDArray[np.int64]:
        """(n, 2) source and target of unlearned links, sorted.

        Routes and relaxation do not use them. They are evidence that two experiences are close
        together, for shortcuts of the route planner. Links that were learned again are included.
        """
        return np.array(sorted(self._unlearned), np.int64).reshape(-1, 2)

    @property
    def blocked_ends(self) -> NDArray[np.int64]:
        """(n, 2) those of the unlearned links that were not learned again."""
        ends = self.unlearned_ends
        return ends[[self.link_table.row(i, j) is None for i, j in ends.tolist()]]

    @property
    def link_ends(self) -> NDArray[np.int64]:
        """(links, 2) source and target of every link; a view; do not modify or keep."""
        return self.link_table.ends

    def links(self) -> list[Link]:
        """Return all links, in the order in which they were created."""
        return [self.link_table[row] for row in range(len(self.link_table))]

    def behaviour_between(self, source_id: int, target_id: int) -> str:
        """Return the behaviour that drives from one experience to a neighbour, '' if unknown.

        If only the opposite link exists, the wall to follow is on the other side.
        """
        row = self.link_table.row(source_id, target_id)
        if row is not None:
            return self.link_table.behaviour_of(row)
        row = self.link_table.row(target_id, source_id)
        return '' if row is None else MIRRORED.get(self.link_table.behaviour_of(row), '')

    # Changes

    def _place(self, action: MapAction, pose: Pose, odometer_m: float) -> None:
        """Store a new experience under the next id, or under the id of a pruned one."""
        row = action.target_id
        self._components.add(row)
        self.replacement_count += row < len(self)
        self._labels[row : row + 1] = [(action.template_id, action.place)]
        self._label_rows[row] = action.template_id, *action.place
        self._poses[row], self._created_at_m[row] = pose, odometer_m
