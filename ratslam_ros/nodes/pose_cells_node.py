# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Node of the pose cells: odom, local_view/template -> pose_cells/action."""

from __future__ import annotations

import time
from collections import deque
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from nav_msgs.msg import Odometry as OdometryMessage
from sensor_msgs.msg import Image, PointCloud2
from std_msgs.msg import String

from ratslam_ros.core.common.odometry import Motion, MotionFromOdometry, Odometry
from ratslam_ros.core.common.state import State
from ratslam_ros.core.common.turn_correction import TurnCorrection
from ratslam_ros.core.config import Config
from ratslam_ros.core.mapping.id_map import MIN_MEMORY_NS, NO_MEMORY_NS, IdMap
from ratslam_ros.core.pose_cells.active_cells import active_cells
from ratslam_ros.core.pose_cells.map_relocation import ADOPTION_DELAY, MapRelocations
from ratslam_ros.core.pose_cells.pose_cells import PoseCells
from ratslam_ros.core.vision.local_view import NO_TEMPLATE, ViewMatch
from ratslam_ros.messages.json_schema import MalformedMessage
from ratslam_ros.messages.logged import decode_odometry, encode_odometry
from ratslam_ros.messages.mapping import (
    decode_relocation,
    decode_template,
    encode_action,
    encode_active,
)
from ratslam_ros.messages.pose_cells import encode_packets
from ratslam_ros.nodes.convert import accepted_odometry, grey_image, point_cloud
from ratslam_ros.nodes.goal_seeking import GoalSeeking
from ratslam_ros.nodes.node import FLUSH_CHECK_PERIOD_S, RatslamNode
from ratslam_ros.nodes.qos import INPUT, RESULT, VIEW
from ratslam_ros.nodes.run import run
from ratslam_ros.nodes.single_sender import SingleSender

LOGGED_GAIN_CHANGE = 0.02
"""Relative change of the rotation gain that is logged."""

ACTIVITY_PERIOD_S = 0.1
"""Shortest time between two messages with the activity."""


@dataclass(frozen=True, slots=True)
class Template:
    """A template message: the match, and the memory that its id belongs to."""

    match: ViewMatch
    memory_ns: int


class PoseCellsNode(RatslamNode[Odometry | Template]):
    """Tracks the robot in the pose cells; publishes one action for each template message."""

    SECTION = 'pose_cells'
    PARTS = ('goal_memory',)
    MAPS = True
    REGULAR = 'odometry'
    REPEATS = ('action',)

    def __init__(self, initial: Config = Config()) -> None:
        super().__init__(('odometry', 'template'), initial)
        self._publisher = self.create_publisher(String, 'pose_cells/action', RESULT)
        self._active = self.create_publisher(String, 'pose_cells/active_experiences', VIEW)
        self._activity = self.create_publisher(Image, 'pose_cells/activity', VIEW)
        self._cells = self.create_publisher(PointCloud2, 'pose_cells/cells', VIEW)
        self._packets = self.create_publisher(String, 'pose_cells/packets', VIEW)
        self._shown_s = 0.0
        self._goals: GoalSeeking | None = None
        if self.parts:
            self._goals = GoalSeeking(self, self._diagnostics, self.config)
        self._reset_state()
        self._add_input(
            'odometry', {'odom': OdometryMessage}, self._on_odometry,
            lambda data: self._take_odometry(decode_odometry(data)),
        )  # fmt: skip
        self.create_subscription(
            String, 'experience_map/relocation', self._when_resumed(
                'relocation', self._on_relocation, self._on_relocation
            ), INPUT,
        )  # fmt: skip
        self._senders['template'] = SingleSender(
            self, 'local_view/template', self._on_template,
            lambda reason: self._refuse('template', reason),
        )
        self._add_input(
            'template', {'local_view/template': String}, self._senders['template'].take,
            lambda data: self._on_template(String(data=data.decode())),
        )  # fmt: skip
        self.create_timer(FLUSH_CHECK_PERIOD_S, self._flush, clock=self._steady)

    @property
    def parts(self) -> tuple[str, ...]:
        """The section of the goal memory if it is switched on."""
        return self.PARTS if self.config.goal_memory.goal_memory else ()

    def _reset_state(self) -> None:
        self._core = self._new_core()
        self._core.mapping = self._mapping
        if self._goals is not None:
            self._goals.use_pose_cells(self._core)
        self._motion = MotionFromOdometry(
            self._section.odom_source, self._section.max_odom_gap_s,
            self._section.turn_correction,
        )
        self._logged_gain = self._motion.correction.gain
        self._numbering = IdMap()
        self._memory_ns = NO_MEMORY_NS
        self._sequence = 0
        self._relocations = MapRelocations()
        self._waiting: deque[tuple[int, Odometry | Template]] = deque()

    def _on_relocated(self) -> None:
        self._motion.restart()
        if self._core.calibration is not None:
            self._core.calibration.restart()
        if self._goals is not None:
            self._goals.relocated()

    def _begin_session(self) -> None:
        self._motion.restart()
        # The map may not answer in this session.
        self._relocations.restore({**self._relocations.state(), 'last': None})
        if len(self._core):
            unknown = Motion(0.0, 0.0, 0.0, False)
            self._core.integrate(unknown)
            if self._goals is not None:
                self._goals.integrate(0, unknown)

    def _new_core(self) -> PoseCells:
        core = PoseCells(self._first_section)
        core.reconfigure(self._section)
        return core

    def _reconfigure(self, section: Any) -> None:
        self._core.reconfigure(section)

    def _set_mapping(self, mapping: bool) -> None:
        self._core.mapping = mapping

    def _memory_state(self) -> State:
        state: State = {
            'memory_ns': self._memory_ns,
            'sequence': self._sequence,
            'numbering': self._numbering.state(),
            'core': self._core.state(),
            'motion': self._motion.state(),
            'relocations': self._relocations.state(),
        }
        if self._goals is not None:
            state['goal_memory'] = self._goals.memory_state()
        return state

    def _restore(self, state: State) -> None:
        core, numbering = self._new_core(), IdMap()
        core.restore(state['core'])
        if 'numbering' in state:
            numbering.restore(state['numbering'])
        elif len(core):
            numbering.assume(core.next_template_id)  # a replay has no other memory
        assumed_ns = MIN_MEMORY_NS if len(core) else NO_MEMORY_NS
        memory_ns, sequence = int(state.get('memory_ns', assumed_ns)), int(state['sequence'])
        relocations = MapRelocations()
        if 'relocations' in state:
            relocations.restore(state['relocations'])
        if self._goals is not None:
            self._goals.use_pose_cells(core, state.get('goal_memory'))
        self._memory_ns, self._sequence = memory_ns, sequence
        self._relocations = relocations
        self._waiting.clear()
        self._core, self._numbering = core, numbering
        if core.calibration is not None:
            self._motion.correction = core.calibration.correction
        self._core.mapping = self._mapping
        if 'motion' in state:
            self._motion.restore(state['motion'])
        else:
            self._motion.restart()

    def _on_odometry(self, message: OdometryMessage) -> None:
        odometry = accepted_odometry(message, self._motion, self._refuse)
        if odometry is not None:
            self._take_odometry(odometry)

    def _take_odometry(self, odometry: Odometry) -> None:
        self._push('odometry', odometry.stamp_ns, odometry)
        self._log('odometry', odometry.stamp_ns, lambda: encode_odometry(odometry))

    def _on_template(self, message: String) -> None:
        try:
            stamp_ns, match, memory_ns = decode_template(message.data)
        except MalformedMessage as error:
            self._refuse('template', str(error))
            return
        self._push('template', stamp_ns, Template(match, memory_ns))
        # local_view must know the ids that it has given, even if it was killed at once.
        self._log('template', stamp_ns, message.data.encode)

    def _on_relocation(self, message: String) -> None:
        """Receive the answer of the map to an action, which may relocate the robot."""
        try:
            sequence, relocation, memory_ns = decode_relocation(message.data)
        except MalformedMessage as error:
            self._refuse('relocation', str(error))
            return
        if sequence + ADOPTION_DELAY < self._sequence:
            return  # repeated by a restarted map, and adopted before
        if memory_ns in (NO_MEMORY_NS, self._memory_ns):
            self._relocations.answer(sequence, relocation)
            self._process_waiting()

    def _on_caught_up(self, are_images_lost: bool) -> None:
        assert self._keeper is not None
        for _, data in self._keeper.logged('relocation'):
            self._on_relocation(String(data=data.decode()))

    def _process_held(self) -> None:
        super()._process_held()
        while self._waiting:
            self._process_next(*self._waiting.popleft())

    def _take(self, stamp_ns: int, stream: str, item: Odometry | Template) -> None:
        self._waiting.append((stamp_ns, item))
        self._process_waiting()

    def _process_waiting(self) -> None:
        """Process messages up to the next template for which the map has to answer first.

        As for the inputs, it is not waited for longer than ``max_lateness_s``.
        """
        while self._waiting:
            stamp_ns, item = self._waiting[0]
            waited_ns = self._waiting[-1][0] - stamp_ns
            if isinstance(item, Template) and self._relocations.is_awaited(self._sequence):
                if waited_ns <= round(self._section.max_lateness_s * 1e9):
                    return
                self._diagnostics.drop(
                    'missed', 'experience_map does not answer: its relocations may be adopted '
                    'later than in a replay',
                )  # fmt: skip
            self._waiting.popleft()
            self._process_next(stamp_ns, item)

    def _process_next(self, stamp_ns: int, item: Odometry | Template) -> None:
        self._save_before(stamp_ns)
        if isinstance(item, Odometry):
            motion = self._motion.update(item)
            if motion is not None:
                with self._diagnostics.times('pose_cells'):
                    self._core.integrate(motion)
                if self._goals is not None:
                    self._goals.integrate(stamp_ns, motion)
        else:
            self._process_template(stamp_ns, item)
        self._publish_activity(stamp_ns)

    def _process_template(self, stamp_ns: int, template: Template) -> None:
        self._check_memory(stamp_ns, template)
        relocation = self._relocations.due(self._sequence)
        if relocation is not None and self._core.relocate(relocation) and (
            self._goals is not None
        ):
            self._goals.relocated()
        number = self._numbering.own_id(template.match.template_id)
        with self._diagnostics.times('pose_cells_view'):
            removed = tuple(self._numbering.own_id(i) for i in template.match.removed)
            match = replace(template.match, template_id=number, removed=removed)
            action = self._core.view(match, self._motion.reaches(stamp_ns), stamp_ns)
        if action.correction is not None and action.correction != self._motion.correction:
            self._motion.correction = action.correction
            self._report_correction(action.correction)
        if action.action == 'create' and self._memory_ns == NO_MEMORY_NS:
            self._memory_ns = max(stamp_ns, MIN_MEMORY_NS)
        payload = encode_action(
            stamp_ns, self._sequence, action, self._memory_ns, self._sender_id
        )
        self._sequence += 1
        self._publisher.publish(String(data=payload))
        self._log('action', stamp_ns, payload.encode)
        if self._active.get_subscription_count() > 0:
            active = self._core.active_experiences()
            self._active.publish(String(data=encode_active(stamp_ns, number, active)))

    def _report_correction(self, correction: TurnCorrection) -> None:
        """Log a correction of the odometry whose gain differs from the last one logged."""
        if abs(correction.gain / self._logged_gain - 1.0) >= LOGGED_GAIN_CHANGE:
            self._logged_gain = correction.gain
            self.get_logger().info(
                f'closed loops: turns of the odometry are multiplied by {correction.gain:.3f}, '
                f'plus {correction.per_m_rad:.4f} rad/m'
            )

    def _check_memory(self, stamp_ns: int, template: Template) -> None:
        """Detect that local_view has another memory than before, and renumber its templates."""
        first = self._numbering.memory_ns == NO_MEMORY_NS
        match = template.match
        if match.is_new and not first and template.memory_ns == self._numbering.memory_ns and (
            self._numbering.was_used(match.template_id)
        ):
            self._numbering.restart()
            self._core.forget()
            self._diagnostics.note(
                'local_view has gone back to an earlier memory: its ids mean other views now, so '
                'places seen before will not be recognised; load or reset all nodes together'
            )
        if self._numbering.set_memory(template.memory_ns):
            self._core.forget()
            self._diagnostics.note(
                'local_view has started with an empty memory: places seen before will not be '
                'recognised; to start over, call pose_cells/reset and experience_map/reset too'
            )
        elif first and template.match.template_id > NO_TEMPLATE and (
            template.memory_ns < stamp_ns
        ):
            self._diagnostics.counts['missed'] += match.template_id + 1
            self._diagnostics.note(
                'this node started late: local_view had learned before; views learned then are '
                'associated with pose cells when they are seen again. To start over, call reset '
                'on all nodes'
            )

    def _publish_activity(self, stamp_ns: int) -> None:
        """Publish the activity to subscribers, at a limited rate.

        The image is the largest activity over all headings, with x to the right and y up.
        """
        now_s = time.monotonic()
        if now_s - self._shown_s < ACTIVITY_PERIOD_S:
            return
        self._shown_s = now_s
        has_cells = self._cells.get_subscription_count() > 0
        has_packets = self._packets.get_subscription_count() > 0
        if has_cells or has_packets:
            active = active_cells(self._core)
            if has_cells:
                points = np.column_stack([active.cells, active.activity])
                self._cells.publish(point_cloud(stamp_ns, 'pose_cells', points, 'activity'))
            if has_packets:
                self._packets.publish(
                    String(data=encode_packets(stamp_ns, self._core.dims, active))
                )
        if self._activity.get_subscription_count() == 0:
            return
        plane = self._core.activity().max(axis=0)[::-1]
        largest = plane.max()
        shown = np.sqrt(plane / largest) if largest > 0.0 else plane
        self._activity.publish(
            grey_image(stamp_ns, 'pose_cells', np.rint(255.0 * shown).astype(np.uint8))
        )

    def _diagnostic_values(self) -> dict[str, Any]:
        peak = self._core.peak
        return {
            'experiences': len(self._core),
            'experience': self._core.current_experience,
            'peak': f'x {peak.x:.2f}, y {peak.y:.2f}, theta {peak.theta:.2f}',
            'actions': self._sequence,
            **(self._core.calibration.summary() if self._core.calibration is not None else {}),
            'odometry_gaps': self._core.gap_count,
            **self._core.lengths.report(),
            **(self._goals.diagnostic_values() if self._goals is not None else {}),
        }


def main(args: list[str] | None = None) -> int:
    """Run the node until it is interrupted."""
    return run(PoseCellsNode, args=args)
