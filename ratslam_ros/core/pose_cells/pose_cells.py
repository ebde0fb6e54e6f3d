# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Pose cells: estimate the pose from odometry and views, and derive actions for the map.

The published algorithm, with its choices: Milford et al. (2004) and (2005), section II, Milford et
al. (2006), section II, and OpenRatSLAM (Ball et al. 2013). Parts: the network (attractor.py), what
a view injects (visual_evidence.py, hebbian_links.py), the current experience (experiences.py).

Additions take the place of ``Lengths``, ``EqualWeights`` and ``Experiences``, or extend the
actions (``_extensions``); core/config/additions.py lists them.
"""

from __future__ import annotations

from collections.abc import Collection
from functools import partial
from typing import Any

from ratslam_ros.core.common.odometry import Motion
from ratslam_ros.core.common.saved import Field, count
from ratslam_ros.core.common.state import State
from ratslam_ros.core.config import (
    InputParameters,
    MemoryParameters,
    PoseCellsParameters,
    additions,
)
from ratslam_ros.core.pose_cells.experiences import Experiences
from ratslam_ros.core.pose_cells.hebbian_links import HebbianLinks, links_fit
from ratslam_ros.core.pose_cells.lengths import lengths_of
from ratslam_ros.core.pose_cells.map_action import (
    NO_EXPERIENCE,
    Action,
    Extension,
    MapAction,
    Viewed,
)
from ratslam_ros.core.pose_cells.map_relocation import MapRelocation, RecentOdometry
from ratslam_ros.core.pose_cells.pose_estimate import PoseEstimate
from ratslam_ros.core.pose_cells.torus import Located, Place
from ratslam_ros.core.pose_cells.visual_evidence import Injection, Observation, VisualEvidence
from ratslam_ros.core.vision.local_view import NO_TEMPLATE, ViewMatch

_STATE_KEYS = (
    'dims', 'packets', 'memories', 'unrolled', 'messages', 'last_template', 'experiences',
    'transitions', 'visits', 'gaps', 'current', 'since_current', 'stepped', 'agreement',
    'calibration', 'freshness', 'superseded', 'created', 'links', 'lengths', 'components',
    'present',
)
"""Order of the keys in saved states."""


class PoseCells(PoseEstimate):
    """Pose filter: an attractor network with visual evidence and experiences.

    Odometry moves the network's activity, recognised views inject activity, and each template
    message results in one action for the experience map.
    """

    SAVED = (
        *PoseEstimate.SAVED,
        Field('stepped', '_stepped', bool),
        Field('calibration', 'calibration', additions.CALIBRATION, optional=True),
        Field('links', '_links', HebbianLinks, when=lambda cells: cells._links.is_used,
              fits=('links to cells', links_fit)),
        Field('lengths', 'lengths', additions.AUTOMATIC_LENGTHS,
              when=lambda cells: cells.lengths.is_automatic),
        count('components/current', '_component'), count('components/gaps', 'gap_count'),
        Field('present/view', '_last_view', float, (2,), make=lambda *view: view),
        Field('', '_recent', RecentOdometry),
        Field('', '_evidence', VisualEvidence), Field('', '_experiences', Experiences),
    )

    def __init__(
        self, parameters: PoseCellsParameters, inputs: InputParameters = InputParameters(),
        memory: MemoryParameters = MemoryParameters(),
    ) -> None:
        """Create pose cells without experiences.

        Args:
            parameters: all parameters of the pose cells.
            inputs: the correction of the odometry with which ``odom_calibration`` starts.
            memory: what is forgotten at the limit ``exp_max``.
        """
        p = self._p = self._created_with = parameters
        self.mapping = True
        """Whether templates are associated and experiences created; False only localises."""
        super().__init__(p)
        self._links = HebbianLinks((p.pc_dim_th, p.pc_dim_y, p.pc_dim_x), p.pc_vt_learning_rate)
        lengths = self.lengths = lengths_of(p)
        """Cell size and thresholds in force."""
        self._evidence = VisualEvidence(p, self._torus, lengths)
        experiences = additions.EXPERIENCE_CHAINS.instead_of(Experiences, p)
        self._experiences = experiences(p, self._torus, lengths, memory)
        self.calibration: Any = additions.CALIBRATION.of(p, inputs.turn_correction)
        """Calibration of the odometry, if ``odom_calibration`` is set."""
        recognitions = additions.RECOGNITIONS.of(p, self._evidence, self._experiences, lengths)
        self._extensions: list[Extension] = [
            one for one in (recognitions, self.calibration) if one is not None
        ]
        self._last_view = NO_TEMPLATE, 0.0
        self._stepped = False
        self._component = 0
        self.gap_count = 0
        """Number of unknown motions."""
        self._recent = RecentOdometry()
        self.injections: tuple[Injection, ...] = ()
        """Activity that the last view has injected: place, in cells, and energy."""

    def __len__(self) -> int:
        """Return the number of experiences."""
        return len(self._experiences)

    def reconfigure(self, parameters: PoseCellsParameters) -> None:
        """Continue with other values, from the next message on.

        Raises:
            UnusableParameter: a parameter differs that cannot change; nothing is changed.
        """
        self._created_with.check_change(parameters)
        self._p = parameters
        self.lengths.reconfigure(parameters)
        self._evidence.reconfigure(parameters)
        self._experiences.reconfigure(parameters)

    @property
    def current_experience(self) -> int:
        """Id of the current experience, -1 before the first one."""
        return self._experiences.current_id

    def active_experiences(self) -> list[tuple[int, float]]:
        """Return active experiences and their activity; Milford et al. (2006), (1) to (4)."""
        return self._experiences.active(self._observation())

    def state(self) -> State:
        """Return the activity and everything learned, for ``restore``."""
        state = super().state()
        return {key: state[key] for key in _STATE_KEYS if key in state}

    @property
    def next_template_id(self) -> int:
        """Id above those of the templates of all experiences."""
        return self._experiences.next_template_id

    def integrate(self, motion: Motion) -> None:
        """Advance the network by one step: competition, then path integration of the motion.

        After an unknown motion, the network starts again in a new component.
        """
        if not motion.is_known:
            self._separate()
            return
        lengths, planes_per_rad = self.lengths, self._torus.planes_per_rad
        self._recent.integrate(motion)
        lengths.is_learning = self.mapping
        lengths.integrate(motion.distance_m)
        chord = motion.chord_m / lengths.cell_m
        turn, course = motion.turn_rad * planes_per_rad, motion.course_rad * planes_per_rad
        self._evidence.integrate(chord, turn, course)
        step = self._step if lengths.is_cell_known else self._turn
        step(chord, turn, course)
        self._experiences.integrate(motion)
        self._stepped = True
        for extension in self._extensions:
            extension.integrate(motion)

    def view(self, match: ViewMatch, is_located: bool = True, stamp_ns: int = 0) -> MapAction:
        """Process one template message: learn it or inject its activity, then choose the action.

        The associations of templates that local view has removed are removed first. At most one
        action other than ``none`` is returned per odometry message.

        Args:
            match: the template.
            is_located: False if the odometry has been missing for so long that the robot may be
                anywhere. Such a view has no effect.
            stamp_ns: stamp of the message; used if ``exp_forget`` is freshness.
        """
        if match.removed:
            self.forget(match.removed)
        self.lengths.is_learning = self.mapping
        if self.mapping:
            self._experiences.advance(stamp_ns)
        is_again = match.template_id == self._last_view[0]
        self._recent.view()
        self._last_view = match.template_id, match.relative_rad * self._torus.planes_per_rad
        source_id = self._experiences.current_id
        self.injections = ()
        is_seen = match.template_id != NO_TEMPLATE and is_located
        action: Action = self._observe(match.related_count) if is_seen else 'none'
        target_id = self._experiences.current_id
        place = self.peak
        if target_id != NO_EXPERIENCE:
            place = self._experiences[target_id].label
        chosen = MapAction(
            action, source_id, target_id, match.template_id, match.relative_rad, place
        )
        view = Viewed(is_seen, is_again, self._component, self.mapping)
        for extension in self._extensions:
            chosen = extension.extended(chosen, view)
        return chosen

    def _observe(self, related_count: int) -> Action:
        template_id, _ = self._last_view
        factor = self.lengths.observe(
            self.mapping and not self._evidence.is_known(template_id),
            self._evidence.is_recent(template_id, self._component),
            related_count,
        )
        if factor != 1.0:  # the size of the cells has just been determined
            self._rescale(factor)
            self._evidence.rescale(factor)
            self._experiences.rescale(factor)
            self._links.forget()
        recognised_id: int | None = None
        seen, nearest = self._observation(), self._experiences.nearest
        effect = self._evidence.observe(seen, self.mapping, self._stepped, nearest)
        if isinstance(effect, Injection):
            self.injections = (effect,)
            self._inject(*effect)
        elif effect is not None:
            recognised_id = nearest(seen.at(*effect))
            self._join(*effect)
        if self._links.is_used and self.mapping:
            self._links.learn(*self._last_view, *self.active())
        if not self._stepped:
            return 'none'
        self._stepped = False
        action = self._experiences.decide(self._observation(), self.mapping, recognised_id)
        if action in ('link', 'set'):  # the robot is at a known place: correct its position
            self._correct(self._experiences[self._experiences.current_id].located)
        return action

    def _inject(self, place: Place, energy: float) -> None:
        if self._last_view[0] in self._links:
            cells, weights = self._links.recalled(*self._last_view)
            self._packets = self._network.add(self._packets, cells, energy * weights)
        else:
            self._inject_at(place, energy, self._p.pc_vt_interpolate)

    def _observation(self) -> Observation:
        return Observation(*self._last_view, *self._located, self._component)

    def forget(self, template_ids: Collection[int] | None = None) -> None:
        """Remove the associations of templates that will not be seen again; None: of all."""
        gone = self._evidence.template_ids if template_ids is None else template_ids
        self._evidence.forget(gone, self._component)
        self._experiences.forget_templates(gone)
        self._links.forget(gone)

    def relocate(self, relocation: MapRelocation) -> bool:
        """Adopt a relocation by the map, ``ADOPTION_DELAY`` views after it.

        The activity moves to the robot's pose in the frame of the experience, carried along by the
        odometry since then, and the experience becomes the current one.

        Returns:
            False if the experience was pruned since, or if the odometry had a gap.
        """
        number, template_id, _ = relocation
        offset = self._recent.carried(relocation)
        if offset is None or not self.lengths.is_cell_known or (
            not self._experiences.has(number, template_id, self._component)
        ):
            return False
        self._move_to(self._experiences[number].located, offset, self.lengths.cell_m)
        self._experiences.relocate(number, offset)
        for extension in self._extensions:
            extension.restart()
        return True

    def _separate(self) -> None:
        """Begin a new component: the pose relative to all known places is unknown."""
        self.gap_count += 1
        self._component = self.gap_count
        self._recent.interrupt()
        self.lengths.interrupt()
        self._evidence.separate(self._component)
        for extension in self._extensions:
            extension.restart()
        self._experiences.separate()
        self._links.forget()
        self._start()
        self._stepped = True

    def _join(self, recognised: Located, component: int) -> None:
        """Merge the component of the robot and another one, in which its pose is known as well.

        The places of the later component move. While ``mapping`` is False, only the robot does.
        """
        own, estimate = self._component, self._located
        ends = recognised, estimate
        if component < own or not self.mapping:
            self._move_to(recognised)
            self._component, ends = component, (estimate, recognised)
        if self.mapping:
            later, earlier = max(own, component), min(own, component)
            moved = partial(additions.JOINING.load(), self._torus, *ends)
            self._evidence.merge(later, earlier, moved)
            self._experiences.merge(later, earlier, moved)
