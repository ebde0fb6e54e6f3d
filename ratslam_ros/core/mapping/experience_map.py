# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Experience map: the pose graph, built from map actions (MapAction) and odometry (Motion).

Milford et al. (2006), section III, and OpenRatSLAM (Ball et al. 2013). linked_graph.py changes the
links, link_learning.py has equation (9), and relaxation.py optimises the poses.

Additions judge closures (``Closures``), link recognised places (recognised_links.py) and correct
turns (corrected_turns.py); core/config/additions.py lists them.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import astuple

import numpy as np

from ratslam_ros.core.common.angles import wrap
from ratslam_ros.core.common.pose import Pose, composed, inverse
from ratslam_ros.core.common.rows import listed
from ratslam_ros.core.common.saved import MAX_ID, MAX_NUMBER, Field, Saved
from ratslam_ros.core.common.state import State
from ratslam_ros.core.common.turn_correction import TurnCorrection
from ratslam_ros.core.config import ExperienceMapParameters, additions
from ratslam_ros.core.mapping.carried import Carried
from ratslam_ros.core.mapping.components import Components
from ratslam_ros.core.mapping.linked_graph import Closures, LinkedGraph
from ratslam_ros.core.mapping.links import Link, Links, is_link
from ratslam_ros.core.mapping.loop_closure_gate import ClosureEvent, LoopClosureGate
from ratslam_ros.core.mapping.map_update import MapUpdate
from ratslam_ros.core.mapping.optimiser import PoseGraphOptimiser
from ratslam_ros.core.mapping.pose_covariance import PoseCovariance, isotropic
from ratslam_ros.core.mapping.pose_hint import GivenHint
from ratslam_ros.core.mapping.robot_on_graph import Departure
from ratslam_ros.core.mapping.scan_match import ScanMatch
from ratslam_ros.core.pose_cells.map_action import NO_EXPERIENCE, MapAction
from ratslam_ros.core.pose_cells.torus import Place
from ratslam_ros.core.vision.local_view import NO_TEMPLATE

RELOCATED = isotropic(0.1, math.radians(2.0))
"""Covariance of a pose that scans have proven."""

DEPARTURE_SPACINGS = 5.0
"""Distance driven over known places, in view spacings, up to which a new experience is linked to
the one before them, too. Links are straight, and routes lead over them."""


class ExperienceMap(LinkedGraph, Saved):
    """The experience graph, and the robot on it, as map actions change them."""

    SAVED = (
        Field('poses', '_poses', 'f8', ('experiences', 3)),
        Field('labels', '_label_rows', 'f8', ('experiences', 4), -1, MAX_ID),
        Field('', 'link_table', Links), Field('', '_components', Components),
        Field('unlearned', '_unlearned', 'i8', ('', 2), 0, 'experiences',
              save=lambda ends: np.array(sorted(ends), np.int64).reshape(-1, 2),
              load=lambda ends: set(map(tuple, ends.tolist()))),
        Field('current', 'current_id', int, (), NO_EXPERIENCE, 'experiences'),
        Field('offset', 'offset', float, (3,), make=Pose),
        Field('duration_s', '_duration_s', low=0.0),
        Field('way_m', 'travelled_m', low=0.0),
        Field('made_m', '_created_at_m', 'f8', ('experiences',)),
        Field('odometer_m', '_odometer_m', low=0.0), Field('', 'optimiser', PoseGraphOptimiser),
        Field('jumps', 'gate', LoopClosureGate),
        Field('', '_closures', Closures),
        Field('present/was_relocated', '_was_relocated', bool),
        Field('present/carried', 'carried', Carried, when=lambda own: own.carried.has_spots),
        Field('present/blocked', '_blocked', list, when=lambda own: bool(own._blocked),
              save=lambda blocked: [[at_m, *astuple(link)] for at_m, link in blocked],
              load=lambda rows: [(at_m, Link(*link)) for at_m, *link in rows],
              fits=('links of known experiences', lambda rows, state: all(
                  abs(at_m) <= MAX_NUMBER and is_link(link, len(state['poses']))
                  for at_m, *link in rows
              ))),
        Field('present/departure', 'departure', float, (6,),
              save=Departure.state, load=Departure.from_state,
              when=lambda own: own.departure is not None,
              fits=('one from a known experience', lambda departure, state: (
                  0 <= departure[0] < len(state['poses'])
              ))),
        Field('present/covariance', 'covariance', PoseCovariance),
        Field('present/hint', 'hint', list, save=GivenHint.state, load=GivenHint.from_state,
              when=lambda own: own.hint is not None),
        Field('view_spacing_m', '', save=lambda own: own.optimiser.view_spacing_m,
              when=lambda own: own.optimiser.view_spacing_m > 0.0),
        Field('recognised_at_m', 'recognised_at_m',
              when=lambda own: own.optimiser.view_spacing_m > 0.0),
    )

    def __init__(self, parameters: ExperienceMapParameters) -> None:
        heading_rad = wrap(math.radians(parameters.exp_initial_em_deg))
        super().__init__(Pose(0.0, 0.0, heading_rad), parameters)
        self._created_with = parameters
        self._closures = self._closures_of(parameters)
        self.recognised_at_m = 0.0
        """Odometer reading at the last recognition near the robot."""
        self._was_relocated = False

    def reconfigure(self, parameters: ExperienceMapParameters) -> None:
        """Continue with other values, from the next message on.

        Raises:
            UnusableParameter: a parameter differs that cannot change; nothing is changed.
        """
        self._created_with.check_change(parameters)
        self.parameters, checked_m = parameters, self._closures.checked_m
        self._closures = self._closures_of(parameters)
        self._closures.checked_m = checked_m
        if not parameters.exp_gate_closures:
            self.carried.restart()

    def _closures_of(self, p: ExperienceMapParameters) -> Closures:
        return additions.GATED_CLOSURES.instead_of(Closures, p)(self, p)

    def _restored(self, state: State) -> None:
        self._labels = [(int(t), Place(x, y, theta)) for t, x, y, theta in listed(state['labels'])]
        if not self.parameters.exp_gate_closures:
            self.carried.restart()
        if 'present' not in state:  # merged
            self._closures.checked_m = self._odometer_m
        if 'covariance' not in state.get('present', {}) and len(self):
            self.lose('it was not saved with the map')

    def correct_turns(self, before: TurnCorrection, now: TurnCorrection) -> None:
        """Correct everything that was measured with another correction of the odometry."""
        additions.CORRECTED_TURNS.load()(self, before, now)

    def apply(
        self, action: MapAction, behaviour: str = '', scan_match: ScanMatch = ScanMatch()
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
        self._closures.check_view(action.template_id, scan_match)
        links, weighs = None, action.view_spacing_m > 0.0
        if weighs:
            self.optimiser.view_spacing_m = action.view_spacing_m
            links = additions.RECOGNISED_LINKS.load()(self, self._closures)
        events: tuple[ClosureEvent, ...] = ()
        if action.action == 'none':
            if links is not None:
                events = links.recognised(action)
            self._relax()
            return MapUpdate(events=events)
        # After a rejected closure, or before they adopt a relocation, the current experience of
        # the pose cells differs from that of the map: the robot did not come from the action's
        # source.
        was_rejecting = self.gate.rejecting
        source = action.source_id
        if was_rejecting or self._was_relocated or self.current_id == NO_EXPERIENCE:
            source = self.current_id
        self._align(scan_match)
        target_offset = scan_match.from_target or action.relative_pose
        pruned, event, target = None, None, action.target_id
        if action.action == 'create':
            pose = self.pose
            self.gate.record_new_place(pose)
            if target < len(self):
                pruned = self._prune(target)
                if source == target:  # possible if actions were lost
                    source = self.current_id
            self._place(action, composed(pose, inverse(target_offset)), self._odometer_m)
        elif self.is_apart(target):
            event = self._joined(source, target, target_offset)
        else:
            event = self._closures.judged(target, target_offset, scan_match)
            if event is None:
                self.gate.record_agreement(self.pose)
        if event is not None:
            events = (event,)
            if event.outcome == 'rejected':
                self._relax()
                return MapUpdate(events=events)
        returned = was_rejecting and source == target
        if source != NO_EXPERIENCE and self.mapping and event is None and not returned:
            is_leaf = action.action == 'create'
            departure = self._departure_beside(source) if is_leaf else None
            is_added = self.connect(
                source, target, target_offset, behaviour, is_leaf,
                recognised=weighs and (not is_leaf or departure is not None),
            )
            if departure is not None:
                self.connect_departure(departure, target, target_offset)
            if is_added and not is_leaf:
                events += (ClosureEvent('closed', source, target),)
        if action.action == 'create' or source == NO_EXPERIENCE or event is not None:
            self.departure = None
        elif self.departure is None and weighs:
            self.departure = Departure(source, self.offset, self._duration_s, self.travelled_m)
        self.current_id = target
        self.offset = target_offset
        self._duration_s = self.travelled_m = 0.0
        if action.action != 'create':
            if links is not None:
                links.returned(action)
            if not self.is_doubtful(target):
                self._locate(scan_match)
        elif scan_match.fits is not None:
            self.covariance.relative = self._noise_since(scan_match)
        else:
            self.covariance.relative = None
        if links is not None:
            events += links.recognised(action)
        self._closures.check_scan(scan_match)
        self._relax()
        return MapUpdate(pruned, events)

    def _departure_beside(self, source: int) -> Departure | None:
        """Return the departure if it is another experience than the source, and near enough."""
        departure = self.departure
        if (
            departure is None or departure.experience_id == source
            or self.is_apart(departure.experience_id)
            or departure.travelled_m > DEPARTURE_SPACINGS * self.view_spacing_m
        ):
            return None
        return departure

    def _joined(self, source: int, target: int, target_offset: Pose) -> ClosureEvent | None:
        """Join the component of the robot and that of a recognised place; return the event."""
        if not self._fits_hint(target, target_offset):
            reason = 'contradicts the pose that an operator has given'
            return ClosureEvent('rejected', source, target, reason)
        self.rejoin(target, target_offset)
        self.gate.record_agreement(self.pose)
        if source != NO_EXPERIENCE:
            return None
        reason = 'recognised after a gap of the odometry, or at a given pose'
        return ClosureEvent('relocated', source, target, reason)

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
        if self.is_apart(target_id):
            source = self.current_id
            self.rejoin(target_id, target_offset)
            if source != NO_EXPERIENCE and self.mapping:
                self.connect(source, target_id, target_offset, '', False)
        self._was_relocated = True
        self.carried.restart()
        self.current_id, self.offset, self.departure = target_id, target_offset, None
        self._duration_s = self.travelled_m = 0.0
        self.hint = None
        self._locate(ScanMatch(covariance=RELOCATED))
        return True
