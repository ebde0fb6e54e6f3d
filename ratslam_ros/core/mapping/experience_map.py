# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Experience map: MapAction, Motion -> graph of places in the plane."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ratslam_ros.core.common.angles import wrap
from ratslam_ros.core.common.odometry import Motion, moved
from ratslam_ros.core.common.pose import Pose, composed, inverse
from ratslam_ros.core.common.state import State
from ratslam_ros.core.config import ExperienceMapParameters
from ratslam_ros.core.mapping.link_learning import (
    ELSEWHERE,
    TIMED_OUT,
    confidences,
    has_detour,
    in_question,
    is_blocked,
    leading_ahead,
)
from ratslam_ros.core.mapping.links import Link, Links, leading_from, length_m, with_room
from ratslam_ros.core.mapping.loop_closure_gate import LoopClosureGate, is_jump, known_before
from ratslam_ros.core.mapping.relaxation import Relaxation, sweep
from ratslam_ros.core.mapping.scan_matching import ScanMatch
from ratslam_ros.core.pose_cells.map_action import NO_EXPERIENCE, MapAction
from ratslam_ros.core.pose_cells.torus import Place
from ratslam_ros.core.vision.local_view import NO_TEMPLATE
from ratslam_ros.errors import RatslamError, UnusableInput

STEPS_PER_ACTION = 2000
"""Links that an action may relax, on average; what a map does not need is saved up for the next
change. Larger maps are relaxed once in several actions, so that the cost of one stays the same."""

ASK_EVERY_M = 1.0
"""So often scans are asked whether the robot is where the map has it."""

MIRRORED = {'left_wall': 'right_wall', 'right_wall': 'left_wall'}

STEPS_PER_LINK = 12
"""Steps of planning a link, before it has been tried."""


class NotLinked(RatslamError):  # noqa: N818 - the errors' names say what they are
    """Two experiences that no link joins, or that are not on the map."""


class Direction(NamedTuple):
    """Where something lies as seen from the robot: how far, and at which angle from ahead."""

    distance_m: float
    direction_rad: float


class Forgotten(NamedTuple):
    """An experience whose number is free, the neighbour that stands in for it, and how.

    ``stand_in_id``: -1 where it had no neighbour; ``pose``: where the forgotten one lies in the
    frame of that neighbour, or of the map's start.
    """

    experience_id: int
    stand_in_id: int
    pose: Pose


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
        self._made_m = np.zeros(len(self._poses))
        """How far the robot had come when it made each experience."""
        self._labels: list[tuple[int, Place]] = []
        self._links = Links()
        self._unlearned: set[tuple[int, int]] = set()
        self.on_forgotten: list[Callable[[int, int, Pose], None]] = []
        """Called with what ``Forgotten`` says before a number comes to mean another experience."""
        self._plan: Relaxation | None = None
        self._planning_work = 0
        self._plan_holds = False
        self._is_settled = True
        self._saved_steps = 0
        self.current_id = NO_EXPERIENCE
        self.offset = Pose(0.0, 0.0, 0.0)
        """Motion since the current experience, in its frame; before the first, since the start."""
        self._duration_s = 0.0
        self._way_m = 0.0
        """Driven since the current experience."""
        self._odometer_m = self._asked_m = 0.0
        self.scans_fitted_m = 0.0
        """How far the robot had come when its scans last fitted what it knew there long before."""
        self.gate = LoopClosureGate()
        """What ``exp_jump_drift`` has refused and believed."""

    def __len__(self) -> int:
        return len(self._labels)

    @property
    def frame_id(self) -> str:
        """Name of the frame that the poses are in."""
        return self._p.map_frame

    @property
    def link_count(self) -> int:
        """Number of links."""
        return len(self._links)

    @property
    def link_ends(self) -> NDArray[np.int64]:
        """(links, 2) source and target of every link; a view, not to be changed or kept."""
        return self._links.ends

    @property
    def unlearned_ends(self) -> NDArray[np.int64]:
        """(n, 2) source and target of what was unlearned: no way, but it says how places lie.

        Sorted, with those that were learned again since.
        """
        return np.array(sorted(self._unlearned), np.int64).reshape(-1, 2)

    @property
    def link_durations_s(self) -> NDArray[np.float64]:
        """(links,) duration of every link; a view, not to be changed or kept."""
        return self._links.durations_s

    @property
    def link_shapes(self) -> NDArray[np.float64]:
        """(links, 3) distance, heading and facing of every link; a view, not to be changed."""
        return self._links.shapes

    @property
    def link_notes(self) -> Sequence[tuple[str, int]]:
        """Behaviour and count of every link; not to be changed or kept."""
        return self._links.notes

    @property
    def links_version(self) -> int:
        """Grows with every change of a link; what is computed from the links holds until then."""
        return self._links.version

    @property
    def rebuilt(self) -> int:
        """Grows where links vanish: then others have moved up to their rows."""
        return self._links.rebuilt

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

    def seen_from(self, experience_id: int) -> Pose | None:
        """Return where the robot is in the frame of an experience; None where there is none."""
        if not 0 <= experience_id < len(self):
            return None
        return composed(inverse(self.pose_of(experience_id)), self.pose)

    @property
    def odometer_m(self) -> float:
        """How far the robot has come."""
        return self._odometer_m

    def made_m(self, experience_id: int) -> float:
        """Return how far the robot had come when it made an experience."""
        return float(self._made_m[experience_id])

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
        return [self._links[row] for row in range(len(self._links))]

    def neighbours(self, experience_id: int) -> list[int]:
        """Return the experiences that are one link away, in either direction, by id.

        Raises:
            NotLinked: there is no such experience.
        """
        if not 0 <= experience_id < len(self):
            raise NotLinked(
                f'there is no experience {experience_id}; expected 0 to {len(self) - 1}'
            )
        ends = {end for k in self._links.of(experience_id) for end in (k.source_id, k.target_id)}
        return sorted(ends - {experience_id})

    def distance_and_direction(self, target_id: int) -> Direction:
        """Return where a neighbour of the current experience lies as seen from the robot.

        It is told by the shortest of the links that join the two.

        Raises:
            NotLinked: it is no neighbour.
        """
        here = self.current_id
        ways = [] if here == NO_EXPERIENCE else [
            way for way in map(leading_from(here), self._links.of(here))
            if way.target_id == target_id
        ]
        if not ways:
            known = [] if here == NO_EXPERIENCE else self.neighbours(here)
            raise NotLinked(
                f'no link joins experience {target_id} and the current one, {here}; its '
                f'neighbours are {", ".join(map(str, known)) or "none"}: choose one of them, or '
                'ask for a route'
            )
        way = min(ways, key=length_m).way
        x, y, _ = composed(inverse(self.offset), way)
        return Direction(math.hypot(x, y), math.atan2(y, x))

    def confidence(self, source_id: int, target_id: int) -> float:
        """Return the confidence of a link, by equation (9) of seed 000.

        1 for one whose behaviour has no name: it was never tried on purpose.

        Raises:
            NotLinked: there is no such link.
        """
        row = self._links.row(source_id, target_id)
        if row is None:
            raise NotLinked(f'no link leads from experience {source_id} to {target_id}')
        behaviour, _ = self._links.notes[row]
        if not behaviour:
            return 1.0
        rows = self._links.rows_by(source_id, behaviour)
        return confidences([self._links.notes[r][1] for r in rows], self._links.failures[rows])[
            rows.index(row)
        ]

    def state(self) -> State:
        """Return the whole map, and where the robot is on it, for ``restore``."""
        return {
            'poses': self.poses,
            'labels': [[template, *place] for template, place in self._labels],
            **self._links.state(),
            'unlearned': self.unlearned_ends,
            'current': self.current_id,
            'offset': list(self.offset),
            'duration_s': self._duration_s,
            'way_m': self._way_m,
            'made_m': self._made_m[: len(self)].copy(),
            'odometer_m': self._odometer_m,
            'relaxation': [
                0 if self._plan is None else self._plan.links,
                self._plan_holds, self._is_settled, self._saved_steps,
            ],
            'planning_work': self._planning_work,
            'jumps': self.gate.state(),
        }

    def restore(self, state: State) -> None:
        """Take what ``state`` gave for the present map, which must be empty."""
        self._poses = with_room(state['poses'])
        self._made_m = np.zeros(len(self._poses))
        self._made_m[: len(state['poses'])] = state.get('made_m', 0.0)
        self._odometer_m = self._asked_m = state.get('odometer_m', 0.0)
        self._labels = [(t, Place(x, y, theta)) for t, x, y, theta in state['labels']]
        self._links.restore(state)
        self._unlearned = {(i, j) for i, j in state.get('unlearned', np.empty((0, 2))).tolist()}
        self.current_id = state['current']
        self.offset = Pose(*state['offset'])
        self._duration_s = state['duration_s']
        self._way_m = state.get('way_m', 0.0)  # older memories have none
        planned, self._plan_holds, self._is_settled, self._saved_steps = state['relaxation']
        work = state.get('planning_work')
        if planned > 0 and (self._plan_holds or work is None):
            self._plan = Relaxation(state['ends'][:planned], len(self))
            work = self._plan.work if work is None else work
        self._planning_work = work or 0
        if 'jumps' in state:  # memories of before jumps were doubted have none
            self.gate.restore(state['jumps'])

    def integrate(self, motion: Motion) -> None:
        """Add one motion to the way since the current experience, in that experience's frame."""
        self.offset = moved(self.offset, motion)
        self._duration_s += motion.dt_s
        self._way_m += abs(motion.distance_m)
        self._odometer_m += abs(motion.distance_m)

    def apply(
        self, action: MapAction, behaviour: str = '', sight: ScanMatch | None = None
    ) -> Forgotten | None:
        """Do what the pose cells decided, then relax the map; see ``gate`` for what is not done.

        Args:
            action: create, link, set or none. To create an experience that there is means to
                forget that one and to make the new one in its place.
            behaviour: name of what the robot was doing, for the link; empty: nobody tells. A
                transition with a name is a failed try of the others by the same behaviour.
            sight: where the robot is, where scans tell that better than the motion and the view.

        Returns:
            What was forgotten, if anything was.
        """
        if action.template_id == NO_TEMPLATE:
            return None  # an image that nobody could see leaves the map as it is
        if not self.mapping and (action.action == 'create' or action.target_id >= len(self)):
            return None
        if action.action == 'none':
            self._relax()
            return None
        doubted = self.gate.doubting  # then the pose cells have left where the map still is
        source = self.current_id if doubted else action.source_id
        there = Pose(0.0, 0.0, action.relative_rad)
        if sight is not None:
            self.offset = sight.from_current or self.offset
            there = sight.from_target or there
        forgotten, relocated = None, False
        if action.action == 'create':
            here = self.pose
            self.gate.passed(here)
            if action.target_id < len(self):
                forgotten = self._forget(action.target_id)
                if source == action.target_id:  # where the map has missed some actions
                    source = self.current_id
            self._place(action, composed(here, inverse(there)))
        elif self._jumps_to(action.target_id, there):
            if self._is_still_here(sight):
                self.gate.deny(self.pose)
            else:
                claimed = composed(self.pose_of(action.target_id), there)
                relocated = self.gate.claim(self.pose, claimed)
            if not relocated:
                self._relax()
                return None
        else:
            self.gate.stayed(self.pose)
        returned = doubted and source == action.target_id
        if source != NO_EXPERIENCE and self.mapping and not relocated and not returned:
            leaf = action.action == 'create'
            self._connect(source, action.target_id, there, behaviour, leaf)
        self.current_id = action.target_id
        self.offset = there
        self._duration_s = self._way_m = 0.0
        self._ask_scans(sight)
        self._relax()
        return forgotten

    def _jumps_to(self, target: int, there: Pose) -> bool:
        """Return whether a transition to a known experience would carry the robot too far."""
        p, source = self._p, self.current_id
        if p.exp_jump_drift == 0.0 or not self.mapping or source == NO_EXPERIENCE:
            return False
        if self._links.row(source, target) is not None and not self.gate.doubting:
            return False
        if not self._is_jump(target, there):
            return False
        if self._is_settled or not self._relaxes or p.exp_relaxation != 'solve':
            return True
        self.settle()  # the map may be as far off as a loop that has just been closed
        self._saved_steps = 0
        return self._is_jump(target, there)

    def _ask_scans(self, sight: ScanMatch | None) -> None:
        """Note from time to time whether scans know the place, views of which may be new."""
        if sight is None or sight.fits is None:
            return
        if self._odometer_m - self._asked_m >= ASK_EVERY_M:
            self._asked_m = self._odometer_m
            if self._is_still_here(sight):
                self.scans_fitted_m = self._odometer_m

    def _is_still_here(self, sight: ScanMatch | None) -> bool:
        """Return whether scans say that the robot is where the map has it."""
        if sight is None or sight.fits is None or self.gate.lost:
            return False
        n, here = len(self), self.pose
        old = known_before(self._poses[:n], self._made_m[:n], self._odometer_m, here)
        return old is not None and sight.fits(old, composed(inverse(self.pose_of(old)), here))

    def _is_jump(self, target: int, there: Pose) -> bool:
        claimed = composed(self.pose_of(target), there)
        return is_jump(
            self.pose, claimed, self._p.exp_jump_drift, self.link_ends, self.link_shapes[:, 0],
            self.current_id, target, self._way_m,
        )  # fmt: skip

    def fail(self, behaviour: str, ahead_rad: float, here: Pose | None = None) -> int:
        """Count that a behaviour has timed out at the robot's place: its way is blocked.

        It is a failed try of every link that passes within ``exp_try_radius_m`` of the robot and
        leads ahead, in either direction and whatever its own behaviour, as routes use them so;
        see ``adaptation.leading_ahead``.

        Args:
            behaviour: its name; without one nothing is counted.
            ahead_rad: where it should have led, in the frame of the map.
            here: the robot on the map, None: as the map has it.

        Returns:
            How many links were unlearned.

        Raises:
            UnusableInput: the direction is not finite.
        """
        if not math.isfinite(ahead_rad):
            raise UnusableInput(f'ahead_rad is {ahead_rad}; expected a finite angle')
        if not behaviour or not self.mapping or self.current_id == NO_EXPERIENCE:
            return 0
        here = here or self.pose
        rows = leading_ahead(
            self._poses, self.link_ends, here.x_m, here.y_m, math.cos(ahead_rad),
            math.sin(ahead_rad), self._p.exp_try_radius_m,
        )  # fmt: skip
        links = self._links
        links.failures[rows, TIMED_OUT] += 1
        blocked = [
            row for row in rows.tolist()
            if is_blocked(links.notes[row][1], int(links.failures[row, TIMED_OUT]), self._p)
        ]  # fmt: skip
        if blocked:
            self._unlearn(blocked)
        return len(blocked)

    def behaviour_between(self, source_id: int, target_id: int) -> str:
        """Return the behaviour that leads from one experience to the next, '' where none does.

        Against a link's direction the wall that was followed is on the other side.
        """
        row = self._links.row(source_id, target_id)
        if row is not None:
            return self._links.notes[row][0]
        row = self._links.row(target_id, source_id)
        return '' if row is None else MIRRORED.get(self._links.notes[row][0], '')

    def _place(self, action: MapAction, pose: Pose) -> None:
        """Put a new experience on the map, under a number of its own or a free one."""
        n = len(self)
        label = action.template_id, action.place
        if action.target_id < n:
            self._poses[action.target_id] = pose
            self._made_m[action.target_id] = self._odometer_m
            self._labels[action.target_id] = label
            return
        if n == len(self._poses):
            self._poses = np.concatenate([self._poses, np.empty_like(self._poses)])
            self._made_m = np.concatenate([self._made_m, np.zeros_like(self._made_m)])
        self._poses[n] = pose
        self._made_m[n] = self._odometer_m
        self._labels.append(label)

    def _connect(
        self, source: int, target: int, there: Pose, behaviour: str, leaf: bool
    ) -> None:
        """Make or average the link; seed 000 equation (6) in polar form."""
        x_m, y_m, facing_rad = composed(self.offset, inverse(there))
        link = Link(
            source, target, math.hypot(x_m, y_m), math.atan2(y_m, x_m), facing_rad,
            self._duration_s, behaviour, 1,
        )  # fmt: skip
        row = self._links.row(source, target)
        if row is None:
            self._links.append(link)
            if not leaf:  # one that hangs by its only link is where that says
                self._is_settled = self._plan_holds = False
        else:
            self._links.average(row, link)
            self._is_settled = False
        if behaviour:
            self._expected_others(source, target, behaviour)

    def _expected_others(self, source: int, target: int, behaviour: str) -> None:
        """Count a failed try of each other link by a behaviour; unlearn those it never makes."""
        links = self._links
        rows = links.rows_by(source, behaviour)
        links.failures[[row for row in rows if links.ends[row, 1] != target], ELSEWHERE] += 1
        while (row := self._least_confident(source, behaviour)) is not None:
            self._unlearn([row])

    def _least_confident(self, source: int, behaviour: str) -> int | None:
        rows = self._links.rows_by(source, behaviour)
        counts = [self._links.notes[row][1] for row in rows]
        for link in in_question(counts, self._links.failures[rows], self._p):
            # A way of its own is not given up because another one is taken more often.
            if has_detour(self.link_ends, self.link_durations_s, rows[link], len(self)):
                return rows[link]
        return None

    def _unlearn(self, rows: list[int]) -> None:
        """Take links off the map that the robot can no longer go by."""
        self._unlearned.update((i, j) for i, j in self.link_ends[rows].tolist())
        self._delete(rows)

    def _delete(self, rows: list[int]) -> None:
        """Take links off the map."""
        self._links.delete(rows)
        self._is_settled = self._plan_holds = False

    def _forget(self, forgotten: int) -> Forgotten:
        """Take an experience out of the graph, and join its neighbours past it.

        The neighbour at the shortest link stands in for it: what was joined through the forgotten
        one is joined through that.
        """
        links = self._links.of(forgotten)
        stand_in, way = NO_EXPERIENCE, composed(inverse(self.origin), self.pose_of(forgotten))
        if links:
            near = leading_from(forgotten)(min(links, key=length_m))
            stand_in = near.target_id
            way = composed(inverse(self.pose_of(stand_in)), self.pose_of(forgotten))
            others = {end for k in links for end in (k.source_id, k.target_id)}
            for other in sorted(others - {forgotten, stand_in}):
                self._links.join_past(links, forgotten, stand_in, other)
            if self.current_id == forgotten:
                self.offset = composed(near.reversed().way, self.offset)
                self._duration_s += near.duration_s
        if self.current_id == forgotten:
            self.current_id = stand_in
        for tell in self.on_forgotten:
            tell(forgotten, stand_in, way)
        self._delete(self._links.rows_at(forgotten))
        self._unlearned = {ends for ends in self._unlearned if forgotten not in ends}
        return Forgotten(forgotten, stand_in, way)

    @property
    def _relaxes(self) -> bool:
        return self._p.exp_loops > 0 and self._p.exp_correction > 0.0

    def _relax(self) -> None:
        p = self._p
        if len(self._links) == 0 or not self.mapping or not self._relaxes:
            return
        if p.exp_relaxation == 'sweep':
            sweep(
                self._poses, self._links.ends, self._links.shapes, len(self._links),
                p.exp_correction, p.exp_loops,
            )  # fmt: skip
            return
        cost = len(self._links)
        if not self._plan_holds:
            cost += (self._planning_work or STEPS_PER_LINK * cost) // 3
        self._saved_steps = min(self._saved_steps + STEPS_PER_ACTION, cost)
        if self._is_settled or self._saved_steps < cost:
            return
        self._saved_steps = 0
        self.settle()

    def settle(self) -> None:
        """Move all experiences to the fixed point of relaxation, whatever it costs."""
        if self._plan is None or not self._plan_holds:
            self._plan = Relaxation(self._links.ends, len(self))
            self._planning_work = self._plan.work
            self._plan_holds = True
        self._plan.relax(self._poses[: len(self)], self._links.ends, self._links.shapes)
        self._is_settled = True
