# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Experience map: MapAction, Motion -> graph of places in the plane."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ratslam_ros.core.angles import wrap
from ratslam_ros.core.compiled import compiled
from ratslam_ros.core.config import ExperienceMapParameters
from ratslam_ros.core.local_view import NO_TEMPLATE
from ratslam_ros.core.odometry import Motion, Pose, moved
from ratslam_ros.core.pose_cells import NO_EXPERIENCE, MapAction
from ratslam_ros.core.relaxation import Relaxation
from ratslam_ros.core.state import State
from ratslam_ros.core.torus import Place

STEPS_PER_ACTION = 2000
"""Links that an action may relax, on average; what a map does not need is saved up for the next
change. Larger maps are relaxed once in several actions, so that the cost of one stays the same."""

STEPS_PER_LINK = 12
"""Steps of planning a link, before it has been tried."""


@dataclass(frozen=True, slots=True)
class Link:
    """A transition that was made: where the target lies in the source's frame, and how it went."""

    source_id: int
    target_id: int
    distance_m: float
    heading_rad: float
    facing_rad: float
    duration_s: float
    behaviour: str
    count: int


@dataclass(frozen=True, slots=True)
class Experience:
    """A place: its view, where it lies in the pose cells and on the map."""

    id: int
    template_id: int
    pose: Pose
    place: Place


class ExperienceMap:
    """The graph, and the robot's motion since the experience it is at."""

    def __init__(self, parameters: ExperienceMapParameters) -> None:
        self._p = parameters
        self.mapping = True
        """Whether links are made and the map relaxed; else the robot is only located on it."""
        self.origin = Pose(0.0, 0.0, wrap(math.radians(parameters.exp_initial_em_deg)))
        self._poses = np.empty((64, 3), np.float64)
        self._labels: list[tuple[int, Place]] = []
        self._ends = np.empty((64, 2), np.int64)
        self._shapes = np.empty((64, 3), np.float64)
        self._durations_s = np.empty(64, np.float64)
        self._notes: list[tuple[str, int]] = []
        self.links_version = 0
        """Grows with every change of a link; what is computed from the links holds until then."""
        self._row: dict[tuple[int, int], int] = {}
        self._plan: Relaxation | None = None
        self._plan_holds = False
        self._is_settled = True
        self._saved_steps = 0
        self.current_id = NO_EXPERIENCE
        self.offset = Pose(0.0, 0.0, 0.0)
        """Motion since the current experience, in its frame; before the first, since the start."""
        self._duration_s = 0.0

    def __len__(self) -> int:
        return len(self._labels)

    @property
    def frame_id(self) -> str:
        """Name of the frame that the poses are in."""
        return self._p.map_frame

    @property
    def link_count(self) -> int:
        """Number of links."""
        return len(self._notes)

    @property
    def link_ends(self) -> NDArray[np.int64]:
        """(links, 2) source and target of every link; a view, not to be changed or kept."""
        return self._ends[: len(self._notes)]

    @property
    def link_durations_s(self) -> NDArray[np.float64]:
        """(links,) duration of every link; a view, not to be changed or kept."""
        return self._durations_s[: len(self._notes)]

    @property
    def link_shapes(self) -> NDArray[np.float64]:
        """(links, 3) distance, heading and facing of every link; a view, not to be changed."""
        return self._shapes[: len(self._notes)]

    @property
    def link_notes(self) -> Sequence[tuple[str, int]]:
        """Behaviour and count of every link; not to be changed or kept."""
        return self._notes

    @property
    def labels(self) -> Sequence[tuple[int, Place]]:
        """Template and place in the pose cells of every experience; not to be changed or kept."""
        return self._labels

    @property
    def poses(self) -> NDArray[np.float64]:
        """(n, 3) x, y in m and heading in rad of every experience; a copy."""
        return self._poses[: len(self)].copy()

    @property
    def pose(self) -> Pose:
        """Where the robot is on the map, the motion since the current experience included."""
        return composed(self.pose_of(self.current_id), self.offset)

    def pose_of(self, experience_id: int) -> Pose:
        """Return an experience's place on the map; for -1 the robot's place at the start."""
        if experience_id == NO_EXPERIENCE:
            return self.origin
        x, y, heading = self._poses[experience_id].tolist()
        return Pose(x, y, heading)

    def experiences(self) -> list[Experience]:
        """Return all experiences, by id."""
        return [
            Experience(i, template, self.pose_of(i), place)
            for i, (template, place) in enumerate(self._labels)
        ]

    def links(self) -> list[Link]:
        """Return all links, in the order in which they were made."""
        links = []
        for row, note in enumerate(self._notes):
            source, target = self._ends[row].tolist()
            distance, heading, facing = self._shapes[row].tolist()
            duration = float(self._durations_s[row])
            links.append(Link(source, target, distance, heading, facing, duration, *note))
        return links

    def state(self) -> State:
        """Return the whole map, and where the robot is on it, for ``restore``."""
        links = len(self._notes)
        return {
            'poses': self.poses,
            'labels': [[template, *place] for template, place in self._labels],
            'ends': self._ends[:links].copy(),
            'shapes': self._shapes[:links].copy(),
            'notes': [
                [duration, *note]
                for duration, note in zip(self.link_durations_s.tolist(), self._notes, strict=True)
            ],
            'current': self.current_id,
            'offset': list(self.offset),
            'duration_s': self._duration_s,
            'relaxation': [
                0 if self._plan is None else self._plan.links,
                self._plan_holds, self._is_settled, self._saved_steps,
            ],
        }

    def restore(self, state: State) -> None:
        """Take what ``state`` gave for the present map, which must be empty."""
        self._poses = _with_room(state['poses'])
        self._labels = [(t, Place(x, y, theta)) for t, x, y, theta in state['labels']]
        self._ends = _with_room(state['ends'])
        self._shapes = _with_room(state['shapes'])
        self._durations_s = _with_room(np.array([duration for duration, *_ in state['notes']]))
        self._notes = [(name, count) for _, name, count in state['notes']]
        self.links_version += 1
        self._row = {(i, j): row for row, (i, j) in enumerate(state['ends'].tolist())}
        self.current_id = state['current']
        self.offset = Pose(*state['offset'])
        self._duration_s = state['duration_s']
        planned, self._plan_holds, self._is_settled, self._saved_steps = state['relaxation']
        if planned > 0:
            self._plan = Relaxation(state['ends'][:planned], len(self))

    def integrate(self, motion: Motion) -> None:
        """Add one motion to the way since the current experience, in that experience's frame."""
        self.offset = moved(self.offset, motion)
        self._duration_s += motion.dt_s

    def apply(self, action: MapAction, behaviour: str = '') -> None:
        """Do what the pose cells decided, then relax the map.

        Args:
            action: create, link, set or none.
            behaviour: name of what the robot was doing, for the link.
        """
        if action.template_id == NO_TEMPLATE:
            return  # an image that nobody could see leaves the map as it is
        if not self.mapping and (action.action == 'create' or action.target_id >= len(self)):
            return
        if action.action == 'none':
            self._relax()
            return
        turned = action.relative_rad
        if action.action == 'create':
            here = self.pose
            self._append(action, Pose(here.x_m, here.y_m, wrap(here.heading_rad - turned)))
        if action.source_id != NO_EXPERIENCE and self.mapping:
            leaf = action.action == 'create'
            self._connect(action.source_id, action.target_id, turned, behaviour, leaf)
        self.current_id = action.target_id
        self.offset = Pose(0.0, 0.0, turned)
        self._duration_s = 0.0
        self._relax()

    def _append(self, action: MapAction, pose: Pose) -> None:
        n = len(self)
        if n == len(self._poses):
            self._poses = np.concatenate([self._poses, np.empty_like(self._poses)])
        self._poses[n] = pose
        self._labels.append((action.template_id, action.place))

    def _connect(
        self, source: int, target: int, turned: float, behaviour: str, leaf: bool
    ) -> None:
        """Make or average the link; seed 000 equation (6) in polar form."""
        distance = math.hypot(self.offset.x_m, self.offset.y_m)
        heading = math.atan2(self.offset.y_m, self.offset.x_m)
        facing = wrap(self.offset.heading_rad - turned)
        row = self._row.get((source, target))
        self.links_version += 1
        if row is None:
            row = len(self._notes)
            if row == len(self._ends):
                self._ends = np.concatenate([self._ends, np.empty_like(self._ends)])
                self._shapes = np.concatenate([self._shapes, np.empty_like(self._shapes)])
                self._durations_s = np.concatenate([self._durations_s, self._durations_s])
            self._row[source, target] = row
            self._ends[row] = source, target
            self._shapes[row] = distance, heading, facing
            self._durations_s[row] = self._duration_s
            self._notes.append((behaviour, 1))
            if not leaf:  # one that hangs by its only link is where that says
                self._is_settled = self._plan_holds = False
            return
        self._is_settled = False
        old_distance, old_heading, old_facing = self._shapes[row].tolist()
        self._shapes[row] = (
            0.5 * (old_distance + distance),
            wrap(old_heading + 0.5 * wrap(heading - old_heading)),
            wrap(old_facing + 0.5 * wrap(facing - old_facing)),
        )
        self._durations_s[row] = 0.5 * (self._durations_s[row] + self._duration_s)
        known, count = self._notes[row]
        self._notes[row] = (behaviour or known, count + 1)

    def _relax(self) -> None:
        p = self._p
        if not self._notes or not self.mapping or p.exp_loops == 0 or p.exp_correction == 0.0:
            return
        if p.exp_relaxation == 'sweep':
            _sweep(
                self._poses, self._ends, self._shapes, len(self._notes),
                p.exp_correction, p.exp_loops,
            )  # fmt: skip
            return
        cost = len(self._notes)
        if not self._plan_holds:
            work = STEPS_PER_LINK * cost if self._plan is None else self._plan.work
            cost += work // 3
        self._saved_steps = min(self._saved_steps + STEPS_PER_ACTION, cost)
        if self._is_settled or self._saved_steps < cost:
            return
        self._saved_steps = 0
        self.settle()

    def settle(self) -> None:
        """Move all experiences to the fixed point of relaxation, whatever it costs."""
        links = len(self._notes)
        if self._plan is None or not self._plan_holds:
            self._plan = Relaxation(self._ends[:links], len(self))
            self._plan_holds = True
        self._plan.relax(self._poses[: len(self)], self._ends[:links], self._shapes[:links])
        self._is_settled = True


def composed(base: Pose, offset: Pose) -> Pose:
    """Return the pose that lies at ``offset`` in the frame of ``base``."""
    c, s = math.cos(base.heading_rad), math.sin(base.heading_rad)
    return Pose(
        base.x_m + c * offset.x_m - s * offset.y_m,
        base.y_m + s * offset.x_m + c * offset.y_m,
        wrap(base.heading_rad + offset.heading_rad),
    )


def _with_room(rows: NDArray[Any]) -> NDArray[Any]:
    """Return an array of at least 64 rows that begins with the given ones."""
    room = np.empty((max(64, len(rows)), *rows.shape[1:]), rows.dtype)
    room[: len(rows)] = rows
    return room


@compiled
def _sweep(
    poses: NDArray[np.float64], ends: NDArray[np.int64], shapes: NDArray[np.float64],
    links: int, correction: float, sweeps: int,
) -> None:  # fmt: skip
    """Move both ends of each link towards what it says, in the order the links were made.

    Seed 000 equation (7), with p_k - p_i + dp_ki in its second sum; experience 0 is held fixed.
    """
    for _ in range(sweeps):
        for row in range(links):
            i = ends[row, 0]
            j = ends[row, 1]
            direction = poses[i, 2] + shapes[row, 1]
            e_x = correction * (poses[j, 0] - poses[i, 0] - shapes[row, 0] * math.cos(direction))
            e_y = correction * (poses[j, 1] - poses[i, 1] - shapes[row, 0] * math.sin(direction))
            e_t = correction * wrap(poses[j, 2] - poses[i, 2] - shapes[row, 2])
            if i > 0:
                poses[i, 0] += e_x
                poses[i, 1] += e_y
                poses[i, 2] = wrap(poses[i, 2] + e_t)
            if j > 0:
                poses[j, 0] -= e_x
                poses[j, 1] -= e_y
                poses[j, 2] = wrap(poses[j, 2] - e_t)
