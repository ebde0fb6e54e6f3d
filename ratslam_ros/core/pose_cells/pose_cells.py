# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Pose cells: estimate the pose from odometry and views, and derive actions for the map."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Collection
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from ratslam_ros.core.common.odometry import Motion, moved
from ratslam_ros.core.common.pose import Pose, composed, inverse
from ratslam_ros.core.common.saved import Field, Saved, count
from ratslam_ros.core.common.state import State
from ratslam_ros.core.config import InputParameters, MemoryParameters, PoseCellsParameters
from ratslam_ros.core.pose_cells.attractor import MAX_CELLS, Network, Packet, kernel, packets_fit
from ratslam_ros.core.pose_cells.experiences import Experiences
from ratslam_ros.core.pose_cells.hebbian_links import HebbianLinks, links_fit
from ratslam_ros.core.pose_cells.lengths import Lengths
from ratslam_ros.core.pose_cells.map_action import NO_EXPERIENCE, Action, MapAction
from ratslam_ros.core.pose_cells.map_relocation import ADOPTION_DELAY, MapRelocation
from ratslam_ros.core.pose_cells.odometry_calibration import OdometryCalibration
from ratslam_ros.core.pose_cells.registration import Located, Registration
from ratslam_ros.core.pose_cells.torus import Place, Torus
from ratslam_ros.core.pose_cells.visual_evidence import Injection, Observation, VisualEvidence
from ratslam_ros.core.vision.local_view import NO_TEMPLATE, ViewMatch

_STATE_KEYS = (
    'dims', 'packets', 'memories', 'unrolled', 'messages', 'last_template', 'experiences',
    'transitions', 'visits', 'gaps', 'current', 'since_current', 'stepped', 'agreement',
    'calibration', 'freshness', 'superseded', 'created', 'links', 'lengths', 'components',
    'present',
)
"""Order of the keys in saved states."""


class PoseCells(Saved):
    """Pose filter: an attractor network with visual evidence and experiences.

    Odometry moves the network's activity, recognised views inject activity, and each template
    message results in one action for the experience map.
    """

    SAVED = (
        Field('dims', 'dims', int, (3,), 1, MAX_CELLS,
              parameters='pc_dim_x, pc_dim_y and pc_dim_th'),
        Field('packets', '_packets', list, fits=('boxes on the torus', packets_fit),
              save=lambda packets: [packet._asdict() for packet in packets],
              load=lambda packets: [Packet(**packet) for packet in packets]),
        # The peak cannot be decoded from the packets if a view has injected since.
        Field('unrolled/peak', 'peak', float, (3,), make=Place),
        Field('unrolled/here', '_unwrapped', float, (2,), make=lambda *here: here),
        Field('stepped', '_stepped', bool),
        Field('calibration', 'calibration', OdometryCalibration, optional=True),
        Field('links', '_links', HebbianLinks, optional=True, fits=('links to cells', links_fit)),
        Field('lengths', 'lengths', Lengths, when=lambda cells: cells.lengths.is_automatic),
        count('components/current', '_component'), count('components/gaps', '_gap_count'),
        Field('present/view', '_last_view', float, (2,), make=lambda *view: view),
        Field('present/odometry', '_odometry', float, (3,), make=Pose),
        Field('present/at_views', '_at_views', float, ('', 3), make=Pose),
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
        self._torus = Torus(p.pc_dim_x, p.pc_dim_y, p.pc_dim_th)
        self._network = Network(
            (p.pc_dim_th, p.pc_dim_y, p.pc_dim_x),
            kernel(p.pc_w_e_dim, p.pc_w_e_var),
            kernel(p.pc_w_i_dim, p.pc_w_i_var),
            p.pc_global_inhib,
            p.pc_lattice == 'fixed',
        )
        self.lengths = Lengths(p)
        """Cell size and thresholds in force, see ``Lengths``."""
        self._evidence = VisualEvidence(p, self._torus, self.lengths)
        self._links: HebbianLinks | None = None
        if p.pc_vt_learning_rate > 0.0:
            dims = p.pc_dim_th, p.pc_dim_y, p.pc_dim_x
            self._links = HebbianLinks(dims, p.pc_vt_learning_rate)
        self._experiences = Experiences(p, self._torus, self.lengths, memory)
        self.calibration: OdometryCalibration | None = None
        """Calibration of the odometry, if ``odom_calibration`` is set."""
        if p.odom_calibration:
            self.calibration = OdometryCalibration(inputs.turn_correction)
        self._packets = self._network.start()
        self.peak = self._decoded()
        """Peak of activity after the last odometry message."""
        self._unwrapped = self.peak.x, self.peak.y
        self._last_view = NO_TEMPLATE, 0.0
        self._stepped = False
        self._component = self._gap_count = 0
        self._odometry = Pose(0.0, 0.0, 0.0)
        self._at_views: deque[Pose] = deque(maxlen=ADOPTION_DELAY)
        self._injections: tuple[Injection, ...] = ()

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

    @property
    def gap_count(self) -> int:
        """Number of unknown motions."""
        return self._gap_count

    def activity(self) -> NDArray[np.float64]:
        """Return the activity of all cells, (n_theta, n_y, n_x)."""
        return self._network.dense(self._packets)

    def projected(self) -> tuple[NDArray[np.int64], NDArray[np.float64]]:
        """Return the activity summed over theta, of the active cells of the (y, x) plane.

        Returns:
            (n,) cell numbers y * n_x + x, ascending, and (n,) their activity, above 0.
        """
        return self._network.projected(self._packets)

    @property
    def dims(self) -> tuple[int, int, int]:
        """Numbers of cells in x, y and theta."""
        return self._torus.n_x, self._torus.n_y, self._torus.n_theta

    @property
    def injections(self) -> tuple[Injection, ...]:
        """Activity that the last view has injected: place, in cells, and energy."""
        return self._injections

    def active(self) -> tuple[NDArray[np.int64], NDArray[np.float64]]:
        """Return the active cells and their activity.

        Returns:
            (n, 3) theta, y and x, ascending, and (n,) their activity, above 0.
        """
        return self._network.active(self._packets)

    def packets(self) -> NDArray[np.float64]:
        """Return theta, y and x of the peak of each packet, and its total activity, (m, 4)."""
        return self._network.places(self._packets)

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
        self._odometry = moved(self._odometry, motion)
        self.lengths.is_learning = self.mapping
        self.lengths.integrate(motion.distance_m)
        chord = motion.chord_m / self.lengths.cell_m
        turn = motion.turn_rad * self._torus.planes_per_rad
        course = motion.course_rad * self._torus.planes_per_rad
        self._evidence.integrate(chord, turn, course)
        if self.lengths.is_cell_known:
            self._packets = self._network.step(self._packets, chord, turn, course)
            before, self.peak = self.peak, self._decoded()
            self._unwrapped = self._torus.displaced(self._unwrapped, before, self.peak)
        else:
            direction = (self.peak.theta + 0.5 * turn + course) / self._torus.planes_per_rad
            x, y = self._unwrapped
            self._unwrapped = x + chord * math.cos(direction), y + chord * math.sin(direction)
            self._packets = self._network.step(self._packets, 0.0, turn)
            self.peak = self._torus.wrapped(self._unwrapped, self._decoded().theta)
        self._experiences.integrate(motion)
        self._stepped = True
        if self.calibration is not None:
            self.calibration.integrate(motion)

    def view(self, match: ViewMatch, is_located: bool = True, stamp_ns: int = 0) -> MapAction:
        """Process one template message: learn it or inject its activity, then choose the action.

        The associations of templates that local view has removed are removed first.

        At most one action other than ``none`` is returned per odometry message.

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
        self._at_views.append(self._odometry)
        self._last_view = match.template_id, match.relative_rad * self._torus.planes_per_rad
        source_id = self._experiences.current_id
        self._injections = ()
        is_seen = match.template_id != NO_TEMPLATE and is_located
        action: Action = self._observe(match.related_count) if is_seen else 'none'
        target_id = self._experiences.current_id
        place = self.peak
        if target_id != NO_EXPERIENCE:
            place = self._experiences.label(target_id)
        chosen = MapAction(
            action, source_id, target_id, match.template_id, match.relative_rad, place
        )
        return self._extended(chosen, is_seen, is_again)

    def _extended(self, action: MapAction, is_seen: bool, is_again: bool) -> MapAction:
        """Return an action with what is not in the papers: recognitions, weights, calibration.

        Args:
            action: the action of the pose cells.
            is_seen: whether the view had an effect.
            is_again: whether its template is that of the view before.
        """
        recognised_id, agreement = NO_EXPERIENCE, 0.0
        if is_seen and self._p.exp_view_links and self._evidence.agreement > 0.0:
            learned_at = self._evidence.located(action.template_id, self._component)
            recognised_id = self._experiences.first_at(
                action.template_id, self._component, learned_at
            )
            agreement = self._evidence.agreement
        has_weights = self._p.exp_view_links or self._p.exp_weigh_links
        action = replace(
            action, recognised_id=recognised_id, agreement=agreement,
            view_spacing_m=self.lengths.scale_m if has_weights else 0.0,
        )
        if self.calibration is None:
            return action
        if self.mapping:
            self.calibration.observe(action, is_again)
        return replace(action, correction=self.calibration.correction)

    def forget(self, template_ids: Collection[int] | None = None) -> None:
        """Remove the associations of templates that will not be seen again; None: of all."""
        gone = self._evidence.template_ids if template_ids is None else template_ids
        self._evidence.forget(gone, self._component)
        self._experiences.forget_templates(gone)
        if self._links is not None:
            self._links.forget(gone)

    def relocate(self, relocation: MapRelocation) -> bool:
        """Adopt a relocation by the map, ``ADOPTION_DELAY`` views after it.

        The activity moves to the robot's pose in the frame of the experience, carried along by the
        odometry since then, and the experience becomes the current one.

        Returns:
            False if the experience was pruned since, or if the odometry had a gap.
        """
        number, template_id, then = relocation
        if len(self._at_views) < ADOPTION_DELAY or not self.lengths.is_cell_known or (
            not self._experiences.has(number, template_id, self._component)
        ):
            return False
        offset = composed(then, composed(inverse(self._at_views[0]), self._odometry))
        torus, (place, unwrapped) = self._torus, self._experiences.located(number)
        heading_rad = place.theta / torus.planes_per_rad
        x, y, _ = composed(Pose(0.0, 0.0, heading_rad), offset)
        x, y = x / self.lengths.cell_m, y / self.lengths.cell_m
        self._packets = self._network.inject(
            [], (place.theta + offset.heading_rad * torus.planes_per_rad) % torus.n_theta,
            (place.y + y) % torus.n_y, (place.x + x) % torus.n_x, 1.0,
        )
        self.peak = self._decoded()
        self._unwrapped = unwrapped[0] + x, unwrapped[1] + y
        self._experiences.relocate(number, offset)
        if self.calibration is not None:
            self.calibration.restart()
        return True

    def active_experiences(self) -> list[tuple[int, float]]:
        """Return the experiences of the last view's template near the peak, most active first.

        Milford et al. (2006), equations (1) to (4).

        Returns:
            Pairs of experience id and activity, above 0 and at most 2.
        """
        return self._experiences.active(self._observation())

    def _rescale(self, factor: float) -> None:
        """Multiply all places by a factor after a change of the cell size.

        The activity keeps its shape. It is a single packet, because nothing was injected yet.
        """
        before, (x, y) = self._decoded(), self._unwrapped
        self._unwrapped = x * factor, y * factor
        place = self._torus.wrapped(self._unwrapped, before.theta)
        self._packets = [
            self._network.displaced(packet, place.y - before.y, place.x - before.x)
            for packet in self._packets
        ]
        self.peak = self._decoded()
        self._evidence.rescale(factor)
        self._experiences.rescale(factor)
        if self._links is not None:
            self._links.forget()

    def _observe(self, related_count: int) -> Action:
        template_id, _ = self._last_view
        factor = self.lengths.observe(
            self.mapping and not self._evidence.is_known(template_id),
            self._evidence.is_recent(template_id, self._component),
            related_count,
        )
        if factor != 1.0:
            self._rescale(factor)
        seen = self._observation()
        joined: set[int] = set()
        effect = self._evidence.observe(seen, self.mapping, is_first=self._stepped)
        if isinstance(effect, Injection):
            self._injections = (effect,)
            self._inject(*effect)
        elif effect is not None:
            joined = self._experiences.members(effect.component)
            self._join(*effect)
            seen = self._observation()
        if self._links is not None and self.mapping:
            self._links.learn(*self._last_view, *self.active())
        if not self._stepped:
            return 'none'
        self._stepped = False
        action = self._experiences.decide(seen, self.mapping, joined)
        if action in ('link', 'set'):  # the robot is at a known place: correct its position
            place, unwrapped = self._experiences.located(self._experiences.current_id)
            self._unwrapped = self._torus.displaced(unwrapped, place, self.peak)
        return action

    def _inject(self, place: Place, energy: float) -> None:
        if self._links is not None and self._last_view[0] in self._links:
            cells, weights = self._links.recalled(*self._last_view)
            self._packets = self._network.add(self._packets, cells, energy * weights)
        else:
            self._packets = self._network.inject(
                self._packets, place.theta, place.y, place.x, energy, self._p.pc_vt_interpolate
            )

    def _separate(self) -> None:
        """Begin a new component: the pose relative to all known places is unknown."""
        self._at_views.clear()
        self._gap_count += 1
        self._component = self._gap_count
        self.lengths.interrupt()
        self._evidence.separate(self._component)
        if self.calibration is not None:
            self.calibration.restart()
        self._experiences.separate()
        if self._links is not None:
            self._links.forget()
        self._packets = self._network.start()
        self.peak = self._decoded()
        self._unwrapped = self.peak.x, self.peak.y
        self._stepped = True

    def _join(self, recognised: Located, component: int) -> None:
        """Merge the component of the robot and another one, in which its pose is known as well.

        The places of the later component move. While ``mapping`` is False, only the robot does.
        """
        estimate, own = Located(self.peak, self._unwrapped), self._component
        if component < own or not self.mapping:
            (x, y, theta), self._unwrapped = recognised
            self._packets = self._network.inject([], theta, y, x, 1.0)
            self.peak, self._component = self._decoded(), component
            registration = Registration(self._torus, estimate, recognised)
        else:
            registration = Registration(self._torus, recognised, estimate)
        if self.mapping:
            moved, into = max(own, component), min(own, component)
            self._evidence.merge(moved, into, registration)
            self._experiences.merge(moved, into, registration)

    def _observation(self) -> Observation:
        return Observation(*self._last_view, self.peak, self._unwrapped, self._component)

    def _decoded(self) -> Place:
        theta, y, x = self._network.peak(self._packets)
        return Place(x, y, theta)
