# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Experience map: the pose graph, built from map actions (MapAction) and odometry (Motion)."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from ratslam_ros.core.common.angles import wrap
from ratslam_ros.core.common.pose import Pose, composed, inverse
from ratslam_ros.core.common.rotation_gain import is_small_error
from ratslam_ros.core.common.rows import listed
from ratslam_ros.core.common.saved import MAX_ID, Field, Saved
from ratslam_ros.core.common.state import State
from ratslam_ros.core.common.turn_correction import TurnCorrection
from ratslam_ros.core.config import ExperienceMapParameters
from ratslam_ros.core.mapping.components import Components
from ratslam_ros.core.mapping.graph import NotLinked
from ratslam_ros.core.mapping.link_learning import (
    count_other_transitions,
    count_time_out,
    least_confident,
)
from ratslam_ros.core.mapping.link_weights import reach_m
from ratslam_ros.core.mapping.links import Link, Links, outgoing_from
from ratslam_ros.core.mapping.loop_closure_gate import (
    LOST_COUNT,
    REQUIRED_COUNT,
    ClosureEvent,
    Excess,
    LoopClosureGate,
    Outcome,
    long_known_experience,
    path_covariance,
)
from ratslam_ros.core.mapping.optimiser import PoseGraphOptimiser
from ratslam_ros.core.mapping.pose_covariance import (
    PoseCovariance,
    compound,
    isotropic,
)
from ratslam_ros.core.mapping.pose_hint import GivenHint
from ratslam_ros.core.mapping.robot_on_graph import RobotOnGraph
from ratslam_ros.core.mapping.scan_matching import ScanMatch
from ratslam_ros.core.pose_cells.map_action import NO_EXPERIENCE, MapAction
from ratslam_ros.core.pose_cells.map_relocation import MapRelocation
from ratslam_ros.core.pose_cells.torus import Place
from ratslam_ros.core.vision.local_view import NO_TEMPLATE
from ratslam_ros.errors import UnusableInput

RELOCATED = isotropic(0.1, math.radians(2.0))
"""Covariance of a pose that scans have proven."""

SCAN_CHECK_SPACING_M = 1.0
"""Travelled distance between two checks of the scan against long-known experiences."""


class Direction(NamedTuple):
    """Distance, and bearing from straight ahead, of a point in the robot's frame."""

    distance_m: float
    direction_rad: float


class MapStatus(NamedTuple):
    """The current experience, -1 before the first one, and those one link away, ascending."""

    current_id: int
    neighbours: list[int]


class PrunedExperience(NamedTuple):
    """An experience that was removed, and the neighbour that represents it from now on.

    ``stand_in_id``: id of that neighbour, -1 if there is none. ``pose``: pose of the pruned
    experience in the frame of that neighbour, or of the start if there is none.
    """

    experience_id: int
    stand_in_id: int
    pose: Pose


@dataclass(frozen=True, slots=True)
class MapUpdate:
    """What one map action changed.

    ``pruned``: the experience that made room for a new one. ``events``: loop closures, rejections
    and relocations. ``relocation``: where scans have relocated the robot after the action, None if
    they have not.
    """

    pruned: PrunedExperience | None = None
    events: tuple[ClosureEvent, ...] = ()
    relocation: MapRelocation | None = None

    @property
    def rejected(self) -> bool:
        """Whether the gate rejected the transition; links and current experience are as before."""
        return self.reason != ''

    @property
    def reason(self) -> str:
        """Why the loop-closure gate rejected the transition; '' if it did not."""
        return next((one.reason for one in self.events if one.outcome == 'rejected'), '')


class ExperienceMap(RobotOnGraph, Saved):
    """The experience graph, and the robot on it, as map actions change them."""

    SAVED = (
        Field('poses', '_poses', 'f8', ('experiences', 3), spare=True),
        Field('labels', '_label_rows', 'f8', ('experiences', 4), -1, MAX_ID),
        Field('', '_links', Links), Field('', '_components', Components),
        Field('unlearned', '_unlearned', 'i8', ('', 2), 0, 'experiences',
              save=lambda ends: np.array(sorted(ends), np.int64).reshape(-1, 2),
              load=lambda ends: set(map(tuple, ends.tolist()))),
        Field('current', 'current_id', int, (), NO_EXPERIENCE, 'experiences'),
        Field('offset', 'offset', float, (3,), make=Pose),
        Field('duration_s', '_duration_s', low=0.0),
        Field('way_m', '_travelled_m', low=0.0),
        Field('made_m', '_created_at_m', 'f8', ('experiences',), spare=True),
        Field('odometer_m', '_odometer_m', low=0.0), Field('', '_optimiser', PoseGraphOptimiser),
        Field('jumps', 'gate', LoopClosureGate),
        Field('present/scan_checked_m', '_scan_checked_m'),
        Field('present/was_relocated', '_was_relocated', bool),
        Field('present/covariance', 'covariance', PoseCovariance),
        Field('present/hint', 'hint', list, save=GivenHint.state, load=GivenHint.from_state,
              when=lambda own: own.hint is not None),
        Field('view_spacing_m', '', save=lambda own: own._optimiser.view_spacing_m,
              when=lambda own: own._optimiser.view_spacing_m > 0.0),
        Field('recognised_at_m', '_recognised_at_m',
              when=lambda own: own._optimiser.view_spacing_m > 0.0),
    )

    def __init__(self, parameters: ExperienceMapParameters) -> None:
        heading_rad = wrap(math.radians(parameters.exp_initial_em_deg))
        super().__init__(Pose(0.0, 0.0, heading_rad), parameters)
        self._p = self._created_with = parameters
        self.on_pruned: list[Callable[[int, int, Pose], None]] = []
        """Called with the fields of ``PrunedExperience`` before its links are deleted."""
        self._scan_checked_m = self._recognised_at_m = 0.0
        self._was_relocated = False

    def reconfigure(self, parameters: ExperienceMapParameters) -> None:
        """Continue with other values, from the next message on.

        Raises:
            UnusableParameter: a parameter differs that cannot change; nothing is changed.
        """
        self._created_with.check_change(parameters)
        self._p = parameters

    @property
    def odometry_std(self) -> float:
        """Standard deviation of the odometry after one view spacing, in view spacings."""
        return self._noise.std

    def status(self) -> MapStatus:
        """Return the current experience, and those that links connect with it."""
        current = self.current_id
        return MapStatus(current, [] if current == NO_EXPERIENCE else self.neighbours(current))

    def distance_and_direction(self, target_id: int) -> Direction:
        """Return distance and bearing of a neighbour of the current experience from the robot.

        Computed from the shortest of the links between the two.

        Raises:
            NotLinked: the target is not a neighbour of the current experience.
        """
        source = self.current_id
        outgoing = [] if source == NO_EXPERIENCE else [
            link for link in map(outgoing_from(source), self._links.of(source))
            if link.target_id == target_id
        ]
        if not outgoing:
            known = self.status().neighbours
            raise NotLinked(
                f'no link connects experience {target_id} and the current one, {source}; its '
                f'neighbours are {", ".join(map(str, known)) or "none"}: choose one of them, or '
                'ask for a route'
            )
        shortest = min(outgoing, key=lambda link: link.distance_m)
        x, y, _ = composed(inverse(self.offset), shortest.relative_pose)
        return Direction(math.hypot(x, y), math.atan2(y, x))

    def _restored(self, state: State) -> None:
        self._labels = [(int(t), Place(x, y, theta)) for t, x, y, theta in listed(state['labels'])]
        if 'present' not in state:  # merged
            self._scan_checked_m = self._odometer_m
        if 'covariance' not in state.get('present', {}) and len(self):
            self.lose('it was not saved with the map')

    def correct_turns(self, before: TurnCorrection, now: TurnCorrection) -> None:
        """Correct everything that was measured with another correction of the odometry.

        After a large change, the poses are composed anew along driven links, as relaxation only
        adjusts a map whose headings are about right. Links that are measured by scans are not
        corrected.
        """
        if self._p.exp_align_scans:
            return
        self._links.correct_turns(before, now)
        x, y, turn = self.offset
        distance = math.hypot(x, y)
        half = 0.5 * (now.corrected(before.measured(turn, distance), distance) - turn)
        self.offset = composed(Pose(0.0, 0.0, half), Pose(x, y, turn + half))
        if not is_small_error(now.gain / before.gain):
            self._links.shares[:] = 1.0  # of recognitions, which had to agree with a wrong map
            self._compose()
        self._optimiser.measurement_changed()

    def _compose(self) -> None:
        """Compose the poses anew along the driven links, from one experience of each part."""
        reached: set[int] = set()
        for first in range(len(self)):
            waiting = [first] if first not in reached else []
            reached.update(waiting)
            for i in waiting:
                driven = [link for link in self._links.of(i) if not link.recognised]
                for link in driven:
                    to = link if link.source_id == i else link.reversed()
                    if to.target_id not in reached:
                        reached.add(to.target_id)
                        waiting.append(to.target_id)
                        pose = composed(self.pose_of(i), to.relative_pose)
                        self._poses[to.target_id] = pose

    def apply(
        self, action: MapAction, behaviour: str = '', scan_match: ScanMatch | None = None
    ) -> MapUpdate:
        """Execute one action of the pose cells, then relax the graph within its budget.

        An action without a template has no effect. While ``mapping`` is False, the same applies
        to an action that creates an experience or refers to an unknown one.

        Args:
            action: create, link, set or none. Creating an experience whose id is in use prunes
                the experience that has it.
            behaviour: name of the behaviour that was active, stored in the link; '' if unknown. A
                transition by a named behaviour counts as a failed attempt of the other links
                from the same experience by the same behaviour.
            scan_match: the robot's pose by scan matching. Its poses replace the estimates by
                odometry and by the view, unless they are None.
        """
        if action.template_id == NO_TEMPLATE:
            return MapUpdate()  # an undecodable image leaves the map as it is
        if not self.mapping and (action.action == 'create' or action.target_id >= len(self)):
            return MapUpdate()
        if action.view_spacing_m > 0.0:
            self._optimiser.view_spacing_m = action.view_spacing_m
        events: tuple[ClosureEvent, ...] = ()
        if action.action == 'none':
            events += self._recognise(action)
            self._relax()
            return MapUpdate(events=events)
        # After a rejected closure, or before they adopt a relocation, the current experience of
        # the pose cells differs from that of the map: the robot did not come from the action's
        # source.
        was_rejecting = self.gate.rejecting
        source = action.source_id
        if was_rejecting or self._was_relocated or self.current_id == NO_EXPERIENCE:
            source = self.current_id
        target_offset = action.relative_pose
        if scan_match is not None:
            self.offset = scan_match.from_current or self.offset
            target_offset = scan_match.from_target or target_offset
        pruned, relocated, target = None, False, action.target_id
        if action.action == 'create':
            pose = self.pose
            self.gate.record_new_place(pose)
            if action.target_id < len(self):
                pruned = self._prune(action.target_id)
                if source == action.target_id:  # possible if actions were lost
                    source = self.current_id
            self._place(action, composed(pose, inverse(target_offset)), self._odometer_m)
        elif self._is_apart(action.target_id):
            if not self._fits_hint(target, target_offset):
                reason = 'contradicts the pose that an operator has given'
                self._relax()
                return MapUpdate(events=(ClosureEvent('rejected', source, target, reason),))
            self._rejoin(target, target_offset)
            self.gate.record_agreement(self.pose)
            if source == NO_EXPERIENCE:
                reason = 'recognised after a gap of the odometry, or at a given pose'
                events = (ClosureEvent('relocated', source, target, reason),)
        elif (excess := self._excess(target, target_offset)) is not None:
            reason = str(excess)
            if self._scan_confirms_pose(scan_match):
                self.gate.reject_by_scan(self.pose)
                reason += '; the scan confirms the present pose'
            else:
                claimed = composed(self.pose_of(action.target_id), target_offset)
                has_scan = scan_match is not None and scan_match.fits is not None
                by_views = self._p.exp_relocate != 'landmarks' or not has_scan
                relocated = self.gate.record_closure(self.pose, claimed, by_views)
                agreeing = self.gate.agreeing_count
                reason += f'; {agreeing} of {REQUIRED_COUNT} closures agree'
                if by_views and not relocated and agreeing >= LOST_COUNT:
                    self.lose('recognised places contradict it')
            outcome: Outcome = 'relocated' if relocated else 'rejected'
            events = (ClosureEvent(outcome, self.current_id, target, reason),)
            if not relocated:
                self._relax()
                return MapUpdate(events=events)
        else:
            self.gate.record_agreement(self.pose)
        returned = was_rejecting and source == action.target_id
        if source != NO_EXPERIENCE and self.mapping and not relocated and not returned:
            is_leaf = action.action == 'create'
            recognised = action.view_spacing_m > 0.0 and not is_leaf
            is_added = self._connect(
                source, target, target_offset, behaviour, is_leaf, recognised
            )
            if is_added and not is_leaf:
                events += (ClosureEvent('closed', source, target),)
        self.current_id = target
        self.offset = target_offset
        self._duration_s = self._travelled_m = 0.0
        if action.action != 'create':
            # A return to a known place, unless `_recognise` measures it.
            if action.view_spacing_m > 0.0 and action.recognised_id < 0 and self.mapping:
                self._noise.recognise(
                    self.pose_of(target), action.relative_rad, action.view_spacing_m
                )
            self._locate(None if scan_match is None else scan_match.covariance)
        events += self._recognise(action)
        self._record_scan_confirmation(scan_match)
        self._relax()
        return MapUpdate(pruned, events)

    def relocate(self, target_id: int, target_offset: Pose, views: Sequence[Pose] = ()) -> bool:
        """Move the robot to another place that was proven by scans; return whether it is accepted.

        No link is made, because the robot did not drive there. If the place is in another
        component, the components are joined as by a recognised view.

        Args:
            target_id: experience that becomes the current one.
            target_offset: pose of the robot in its frame.
            views: poses of the robot on the map according to recognised views.
        """
        claimed = composed(self.pose_of(target_id), target_offset)
        if not self.gate.offer_proven(claimed, views):
            return False
        if self._is_apart(target_id):
            source = self.current_id
            self._rejoin(target_id, target_offset)
            if source != NO_EXPERIENCE and self.mapping:
                self._connect(source, target_id, target_offset, '', False)
        self._was_relocated = True
        self.current_id, self.offset = target_id, target_offset
        self._duration_s = self._travelled_m = 0.0
        self.hint = None
        self._locate(RELOCATED)
        return True

    # Loop-closure gating

    def _excess(self, target: int, target_offset: Pose) -> Excess | None:
        """Return by how much a transition displaces the robot, None if it is within the bound."""
        p, source = self._p, self.current_id
        if not p.exp_gate_closures or not self.mapping or source == NO_EXPERIENCE:
            return None
        if self._links.row(source, target) is not None and not self.gate.rejecting:
            return None
        excess = self._path_excess(target, target_offset)
        if excess is None:
            return None
        optimiser = self._optimiser
        if optimiser.is_settled or not optimiser.is_enabled or p.exp_relaxation != 'solve':
            return excess
        # The poses may still contain the error of a loop closure that has not been relaxed.
        self.settle()
        optimiser.discard_budget()
        return self._path_excess(target, target_offset)

    def _path_excess(self, target: int, target_offset: Pose) -> Excess | None:
        claimed, measured = composed(self.pose_of(target), target_offset), self._view_covariance
        excess = Excess.of(self.pose, claimed, measured)
        if excess is None:
            return None
        noise = self._noise.variance(self.view_spacing_m)
        path = path_covariance(
            self._poses[: len(self)], self.link_ends, self.link_shapes[:, 0], self.current_id,
            target, noise,
        )
        if path is None:
            return None
        compound(path, *self.offset, self._travelled_m, *noise)
        return Excess.of(self.pose, claimed, path + measured)

    def _record_scan_confirmation(self, scan_match: ScanMatch | None) -> None:
        """Check the scan against long-known experiences, once per ``SCAN_CHECK_SPACING_M``."""
        if scan_match is None or scan_match.fits is None:
            return
        if self._odometer_m - self._scan_checked_m >= SCAN_CHECK_SPACING_M:
            self._scan_checked_m = self._odometer_m
            if self._scan_confirms_pose(scan_match):
                self.confirm()

    def _scan_confirms_pose(self, scan_match: ScanMatch | None) -> bool:
        """Return whether the scan fits a long-known experience at the robot's present pose."""
        if scan_match is None or scan_match.fits is None or self.gate.accepts_next:
            return False
        n, here = len(self), self.pose
        known = long_known_experience(
            self._poses[:n], self._created_at_m[:n], self._odometer_m, here
        )
        return known is not None and scan_match.fits(
            known, composed(inverse(self.pose_of(known)), here)
        )

    # Links

    def unlearn_blocked(self, behaviour: str, ahead_rad: float, here: Pose | None = None) -> int:
        """Count a behaviour that timed out at the robot's pose, and unlearn blocked links.

        The time-out is a failed attempt of every link that passes within ``exp_try_radius_m`` of
        the robot and leads ahead, see ``link_learning.leading_ahead``. The direction and the
        behaviour of a link do not matter, because routes use links in both directions and by any
        behaviour. Nothing is counted before the first experience or while ``mapping`` is False.

        Args:
            behaviour: name of the behaviour; if it is '', nothing is counted.
            ahead_rad: direction in which the behaviour should have driven, in the map frame.
            here: pose of the robot on the map; None: the map's own estimate.

        Returns:
            Number of links that were unlearned.

        Raises:
            UnusableInput: ``ahead_rad`` is not finite.
        """
        if not math.isfinite(ahead_rad):
            raise UnusableInput(f'ahead_rad is {ahead_rad}; expected a finite angle')
        if not behaviour or not self.mapping or self.current_id == NO_EXPERIENCE:
            return 0
        blocked = count_time_out(self._links, self._poses, here or self.pose, ahead_rad, self._p)
        if blocked:
            self._unlearn(blocked)
        return len(blocked)

    def _recognise(self, action: MapAction) -> tuple[ClosureEvent, ...]:
        """Link the current experience to the one that the view was recognised as.

        Nothing happens if they are linked already, or are in different components, or if too few
        recognitions agree for the distance between the two.
        """
        current, target = self.current_id, action.recognised_id
        if (
            not 0 <= target < len(self) or current in (NO_EXPERIENCE, target) or not self.mapping
            or self._is_apart(target) or self._links.row(current, target) is not None
        ):
            return ()
        place, here = self.pose_of(target), self.pose
        distance_m = math.hypot(place.x_m - here.x_m, place.y_m - here.y_m)
        spacing_m = action.view_spacing_m
        driven_m = self._odometer_m - self._recognised_at_m
        if distance_m > reach_m(driven_m, action.agreement, spacing_m):
            return ()
        if distance_m < reach_m(0.0, 0.0, spacing_m):
            self._recognised_at_m = self._odometer_m
            if action.agreement == 1.0:  # few of these are false
                self._noise.recognise(place, action.relative_rad, spacing_m)
        offset = Pose(0.0, 0.0, action.relative_rad)
        # If relaxation accepts a recognition beyond the bound, the next ones are within it.
        measured = self._view_covariance
        if action.agreement == 1.0 and self._is_in_map and self.covariance.agrees(
            here, composed(place, offset), measured
        ):
            self.covariance.fuse(measured)
        self._connect(current, target, offset, '', is_leaf=False, recognised=True)
        return (ClosureEvent('closed', current, target),)

    def _connect(
        self, source: int, target: int, target_offset: Pose, behaviour: str, is_leaf: bool,
        recognised: bool = False,
    ) -> bool:
        """Add the link of a transition, or average it with the link that exists.

        Then unlearn links from the same source that the behaviour does not drive any more.

        Args:
            source, target: ids of the experiences.
            target_offset: pose of the robot in the frame of the target.
            behaviour: name of the behaviour that made the transition, '' if unknown.
            is_leaf: whether the target is new. Then this link alone determines its pose, and
                nothing has to be relaxed.
            recognised: whether the link is a recognition.

        Returns:
            Whether the link is new.
        """
        x_m, y_m, facing_rad = composed(self.offset, inverse(target_offset))
        link = Link(
            source, target, math.hypot(x_m, y_m), math.atan2(y_m, x_m), facing_rad,
            self._duration_s, behaviour, 1, recognised,
        )
        row = self._links.row(source, target)
        if row is None:
            self._links.append(link)
            if not is_leaf:
                self._optimiser.structure_changed()
        else:
            self._links.average(row, link)
            self._optimiser.measurement_changed()
        if behaviour:
            count_other_transitions(self._links, source, target, behaviour)
            while True:
                unlikely = least_confident(self._links, source, behaviour, self._p, len(self))
                if unlikely is None:
                    break
                self._unlearn([unlikely])
        return row is None

    def _unlearn(self, rows: list[int]) -> None:
        """Delete links that can no longer be driven, and record their ends."""
        self._unlearned.update((i, j) for i, j in self.link_ends[rows].tolist())
        self._delete(rows)

    def _delete(self, rows: list[int]) -> None:
        self._links.delete(rows)
        self._optimiser.structure_changed()

    def _prune(self, pruned_id: int) -> PrunedExperience:
        """Remove an experience from the graph, and link its neighbours past it.

        The neighbour at the shortest link becomes its stand-in: the other neighbours are linked
        to the stand-in. If the pruned experience is the current one, the stand-in becomes current.
        """
        links = self._links.of(pruned_id)
        stand_in, pose = NO_EXPERIENCE, composed(inverse(self.origin), self.pose_of(pruned_id))
        if links:
            shortest = min(links, key=lambda link: link.distance_m)
            to_stand_in = outgoing_from(pruned_id)(shortest)
            stand_in = to_stand_in.target_id
            pose = composed(inverse(self.pose_of(stand_in)), self.pose_of(pruned_id))
            others = {end for k in links for end in (k.source_id, k.target_id)}
            for other in sorted(others - {pruned_id, stand_in}):
                self._links.bridge(links, pruned_id, stand_in, other)
            if self.current_id == pruned_id:
                self.offset = composed(to_stand_in.reversed().relative_pose, self.offset)
                self._duration_s += to_stand_in.duration_s
        if self.current_id == pruned_id:
            self.current_id = stand_in
        for notify in self.on_pruned:
            notify(pruned_id, stand_in, pose)
        self._delete(self._links.rows_at(pruned_id))
        self._unlearned = {ends for ends in self._unlearned if pruned_id not in ends}
        return PrunedExperience(pruned_id, stand_in, pose)

    # Relaxation

    def _relax(self) -> None:
        if self.mapping:
            self._optimiser.step(self._poses, len(self), self._links)

    def settle(self) -> None:
        """Move all experiences to the fixed point of relaxation, whatever the budget."""
        self._optimiser.settle(self._poses, len(self), self._links)
