# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Node of the experience map: odom, pose_cells/action -> map, pose, TF; goals -> route."""

from __future__ import annotations

import math
from collections import deque
from typing import Any

from geometry_msgs.msg import PoseStamped, PoseWithCovarianceStamped
from nav_msgs.msg import Odometry as OdometryMessage
from std_msgs.msg import String
from tf2_msgs.msg import TFMessage
from visualization_msgs.msg import MarkerArray

from ratslam_ros.core.common.angles import wrap
from ratslam_ros.core.common.odometry import Odometry
from ratslam_ros.core.common.pose import Pose, composed, inverse
from ratslam_ros.core.mapping.experience_map import ExperienceMap
from ratslam_ros.core.mapping.pose_hint import PoseHint
from ratslam_ros.core.vision.local_view import NO_TEMPLATE
from ratslam_ros.core.warm_up import warm_up
from ratslam_ros.errors import UnreachableGoal, UnusableInput, UnusableParameter
from ratslam_ros.messages.goals import BehaviourReport
from ratslam_ros.messages.mapping import Correction, RelocationPayload
from ratslam_ros.pipeline.commands import NOW, Command, Hint, ReportBehaviour, SearchPlace
from ratslam_ros.pipeline.items import Answer, MapStep, OdometryStep
from ratslam_ros.pipeline.live_stages import LiveExperienceMap
from ratslam_ros.pipeline.pipeline import COMMAND, Pipeline
from ratslam_ros.ros.convert import (
    covariance_of,
    header_of,
    planar_pose,
    pose_message,
    stamp_ns,
    transform,
)
from ratslam_ros.ros.inputs import Input
from ratslam_ros.ros.mapping.grid_publisher import GridPublisher
from ratslam_ros.ros.mapping.map_changes import MapChangePublisher
from ratslam_ros.ros.mapping.map_operations import MapCoordinator
from ratslam_ros.ros.mapping.map_sender import MapSender
from ratslam_ros.ros.mapping.markers import serialised_markers
from ratslam_ros.ros.mapping.odometry_frames import OdometryFrames
from ratslam_ros.ros.navigation.goal_navigation import GoalNavigation
from ratslam_ros.ros.node import LASERS, RatslamNode
from ratslam_ros.ros.payloads import refusing
from ratslam_ros.ros.qos import GOAL, LATCHED, RESULT, STATE, history

MAX_AHEAD = 200
"""Odometry messages by which the published pose may be ahead of the followed stream."""

MAX_ANSWERS = 10
"""Answers that are kept for pose_cells that are restarted: more than those that it waits for."""

HINT_AHEAD_NS = 2_000_000_000
"""A pose with a stamp this far ahead of the inputs is of another clock, and holds from now on."""

LEAST_CORRECTION_M = LEAST_CORRECTION_RAD = 1e-3
"""Smaller changes of the pose are not reported: they are part of the next pose."""


class ExperienceMapNode(RatslamNode):
    """Builds the map; publishes it, the robot's pose on it, and routes to goals."""

    SECTION = 'experience_map'
    PARTS = ('goal_recall',)
    MAPS = True
    TAKES = ('odometry', *LASERS, 'action')
    _grid: GridPublisher | None = None
    _stage: LiveExperienceMap

    def connect(self, pipeline: Pipeline) -> None:
        """Publish what the map answers, and what it changes."""
        self._sender = MapSender(self, self._stage)
        self._markers = self.create_publisher(MarkerArray, 'experience_map/markers', LATCHED)
        self._pose_out = self.create_publisher(PoseStamped, 'experience_map/pose', STATE)
        self._covariance_out = self.create_publisher(
            PoseWithCovarianceStamped, 'experience_map/pose_with_covariance', STATE
        )
        self._corrections = self.create_payload_publisher(Correction, RESULT)
        self._tf = self.create_publisher(TFMessage, '/tf', STATE)
        self._changes = MapChangePublisher(self, self._stage)
        self.frames = OdometryFrames(
            self.diagnostics.note, self.section.odom_frame, self.section.base_frame
        )
        self._goals = GoalNavigation(self, self._stage)
        self._unlearned = 0
        self.create_payload_subscription(
            BehaviourReport, self._on_behaviour, RESULT, 'behaviour'
        )
        receive = refusing(self._on_hint, self._refuse, 'initialpose')
        self.create_subscription(PoseWithCovarianceStamped, 'initialpose', receive, GOAL)
        self.offer('experience_map/relocate', self._on_relocate, is_logged=True)
        self._coordinator = MapCoordinator(self.operations)
        self._viewers = self._pose_ns = 0
        self._markers_due = False
        self._pose: Pose | None = None
        self._odom_pose = Pose(0.0, 0.0, 0.0)
        self._ahead: deque[Odometry] = deque(maxlen=MAX_AHEAD)
        """Odometry that was received, and has not come with the followed stream."""
        if self.section.exp_align_scans:
            warm_up('scan_alignment')  # loads LAPACK, for a seventh of the time of a start
            if self.section.exp_relocate != 'views':
                warm_up('relocation')  # takes long if nothing is cached, so only if it is used
            self._grid = GridPublisher(self, self._stage)
        pipeline.observe(COMMAND, self._obey)
        pipeline.observe('odometry', self._before_odometry)
        pipeline.observe('pose', self._moved)
        pipeline.observe('update', self._acted)
        if self.host.live.answers_all:
            pipeline.observe('relocation', self._answer_action)
            qos = history(MAX_ANSWERS)
            self._answers = self.create_publisher(String, RelocationPayload.TOPIC, qos)
        if self.host.chain.follows:
            # Before it has come with the stream, for the latest pose and its frames.
            topics = {'odom': OdometryMessage}
            self.inputs.append(Input(self, 'odometry', topics, self._on_odometry))

    @property
    def scan_topics(self) -> Any:
        """Topics of the scans by laser."""
        return self.section.lasers

    @property
    def _core(self) -> ExperienceMap:
        return self._stage.core

    def started_over(self) -> None:
        """Continue after the memory was emptied."""
        super().started_over()
        self.restored()
        # Subscribers that have the old map get the empty one.
        self._sender.has_changed = self._sender.has_sent
        self._pose, self._odom_pose = None, Pose(0.0, 0.0, 0.0)
        self._pose_ns = 0

    def drop_tasks(self) -> None:
        """Drop the goals of an earlier session."""
        self._goals.drop_goals()

    def restored(self) -> None:
        """Continue after the stage was restored from a state."""
        self._goals.use_other_map()
        self._sender.reset()
        self._sender.has_changed = True
        if self._grid is not None:
            self._grid.reset()

    def send_again(self) -> None:
        """Send the last answers again."""
        for payload in self.host.live.answers:
            self._answers.publish(String(data=payload))

    def close(self) -> None:
        """Process the messages that are still held, and publish the last map."""
        super().close()
        self._coordinator.close()
        self._sender.finish()
        if self._grid is not None:
            self._grid.close()
        if self._viewers > 0:
            self._send_markers()

    # Inputs

    def _on_behaviour(self, report: BehaviourReport) -> None:
        """Use a report from its stamp on; the map does not wait for them, as they are optional."""
        if not self._is_halted:
            since_ns = report.stamp.ns
            failed = report.failed and self._stage.navigator.report_blocked()
            self.host.command(
                ReportBehaviour(since_ns, report.behaviour, failed, report.ahead_rad), since_ns
            )

    def _on_hint(self, message: PoseWithCovarianceStamped) -> None:
        """Take the pose that an operator gives."""
        frame, expected = message.header.frame_id.lstrip('/'), self.section.map_frame
        if frame not in ('', expected):
            raise UnusableInput(f'its frame is {frame!r:.100}; expected {expected}')
        xx, xy, yy, yaw = (float(message.pose.covariance[at]) for at in (0, 1, 7, 35))
        hint = PoseHint(planar_pose(message.pose.pose), xx, xy, yy, yaw).checked()
        given_ns, newest_ns = stamp_ns(message.header), self.host.pipeline.order.newest_ns
        is_other_clock = given_ns > (newest_ns or 0) + HINT_AHEAD_NS
        self.host.command(Hint(hint), NOW if is_other_clock else given_ns)

    def _push(self, stream: str, stamp_ns: int, item: Any) -> None:
        if stream != 'odometry' or not self.host.chain.follows:
            super()._push(stream, stamp_ns, item)
            return
        if self._ahead and stamp_ns <= self._ahead[-1].stamp_ns:
            self._ahead.clear()  # the stamps have jumped back
        newest_ns = self.host.pipeline.order.newest_of(stream)
        if not self._is_halted and (newest_ns is None or stamp_ns > newest_ns):
            self._ahead.append(item)
            self._locate(item)

    def processed(self, stream: str) -> None:
        """Publish what a message other than odometry, which is located itself, has changed."""
        if stream != 'odometry':
            self._report_correction()
            self._send()

    # The stream

    def _obey(self, stamp_ns: int, command: Command) -> None:
        match command:
            case Hint():
                self._report_hint(stamp_ns, command.hint)
                self._report_correction()
            case ReportBehaviour() if self._stage.unlearned > self._unlearned:
                count = self._stage.unlearned - self._unlearned
                self._unlearned, self._sender.has_changed = self._stage.unlearned, True
                self.get_logger().info(f'{count} links were unlearned: {command.name} was blocked')

    def _report_hint(self, stamp_ns: int, hint: PoseHint) -> None:
        """Log what a given pose means for the map, which has got it."""
        adopted = self._core.hint
        effect = (
            'the robot is there until recognised places confirm or refute it'
            if adopted is not None and adopted.hint == hint
            else 'it has no effect: the map is empty, or the pose on it agrees already'
        )
        self.get_logger().info(f'a pose was given at {stamp_ns * 1e-9:.3f} s; {effect}')

    def _before_odometry(self, stamp_ns: int, odometry: Odometry) -> None:
        self._odometry = odometry

    def _moved(self, stamp_ns: int, step: OdometryStep) -> None:
        if step.gap_s > 0.0:
            self._sender.has_changed = True
            self.diagnostics.warn(
                f'odometry has a gap of {step.gap_s:.1f} s: the map continues in a separate '
                'component until a known place is recognised (max_odom_gap_s)'
            )
        while self._ahead and self._ahead[0].stamp_ns <= stamp_ns:
            self._ahead.popleft()
        if 'odometry' not in self.host.pipeline.inputs:  # it is not received, but computed here
            self._locate(self._odometry)

    def _acted(self, stamp_ns: int, step: MapStep) -> None:
        self._changes.publish_closures(stamp_ns, step.number, step.update.events)
        if step.action.template_id != NO_TEMPLATE:
            self._sender.has_changed = True

    def _answer_action(self, stamp_ns: int, answer: Answer) -> None:
        self._answers.publish(String(data=self.host.live.answers[-1]))

    def _on_relocate(self) -> str:
        """Search for the robot's place by what the laser has seen in the last metres."""
        if self._stage.relocator is None:
            raise UnusableParameter(
                'landmarks are off: set exp_align_scans, and exp_relocate to both'
            )
        self.host.command(SearchPlace())
        result = self._stage.searched
        assert result is not None  # nothing that this host takes waits for an answer
        x_m, y_m, heading_rad = self._core.pose
        if result.outcome not in ('found', 'here'):
            raise UnreachableGoal(f'{result.outcome}: {result.reason}')
        self._report_correction()
        return (
            f'{result.reason}; the robot is at ({x_m:.2f}, {y_m:.2f}), heading '
            f'{math.degrees(heading_rad):.0f} degrees'
        )

    # The robot's pose

    def _locate(self, odometry: Odometry) -> None:
        """Publish the pose at an odometry message.

        The pose includes the motion of the held messages, which enter the map later, in order.
        """
        self._pose_ns, self._odom_pose = odometry.stamp_ns, odometry.pose
        pose = self._current_pose()
        self._use_pose(pose)
        header = header_of(self._pose_ns, self.section.map_frame)
        message = pose_message(pose)
        self._pose_out.publish(PoseStamped(header=header, pose=message))
        if self._covariance_out.get_subscription_count() > 0:
            both = PoseWithCovarianceStamped(header=header)
            both.pose.pose = message
            both.pose.covariance = covariance_of(self._core.covariance.on_map(pose.heading_rad))
            self._covariance_out.publish(both)
        self._publish_tf()

    def _report_correction(self) -> None:
        """Publish a correction if an action has changed the pose at the last odometry."""
        before = self._pose
        if before is None or before == (pose := self._current_pose()):
            return
        self._use_pose(pose)
        if (
            math.dist(before[:2], pose[:2]) >= LEAST_CORRECTION_M
            or abs(wrap(pose.heading_rad - before.heading_rad)) >= LEAST_CORRECTION_RAD
        ):
            current_id = self._core.current_id
            self._corrections.publish(Correction.of(self._pose_ns, current_id, before, pose))

    def _current_pose(self) -> Pose:
        """Return the robot's pose on the map, including the motion of the held messages."""
        waiting = self.host.pipeline.waiting('odometry')
        return self._stage.pose_after([*waiting, *self._ahead])

    def _use_pose(self, pose: Pose) -> None:
        self._pose = pose
        self._goals.locate(self._pose_ns, pose, self._odom_pose)

    def _publish_tf(self) -> None:
        p = self.section
        assert self._pose is not None
        is_known = self._core.localisation != 'unknown' and all(
            math.isfinite(value) for value in self._odom_pose
        )
        if p.publish_tf and is_known and not self.host.map.is_replaying:
            odom_on_map = composed(self._pose, inverse(self._odom_pose))
            self._tf.publish(TFMessage(transforms=[
                transform(self._pose_ns, p.map_frame, self.frames.odom, odom_on_map)
            ]))

    # The map

    def _on_timer(self) -> None:
        with self._lock:
            super()._on_timer()
            self._send()
            viewers = self._markers.get_subscription_count()
            if viewers > self._viewers and self._sender.has_sent:
                self._markers_due = True
            self._viewers = viewers
            self._goals.update()

    def _send(self) -> None:
        """Send the changes of the map, or its markers, or the next part of the whole map.

        One of them in each call, so that none of the messages that follow has to wait for all.
        """
        if self._changes.update() or (self._grid is not None and self._grid.advance()):
            return
        if self._markers_due:
            self._send_markers()
            return
        if self._sender.advance(self.section.map_period_s):
            self._markers_due = self._viewers > 0

    def _send_markers(self) -> None:
        self._markers_due = False
        self._markers.publish(serialised_markers(self._core, self._stage.action_ns))

    def _diagnostic_values(self) -> dict[str, Any]:
        localisation, reason = self._core.localisation, self._core.covariance.reason
        self.diagnostics.missing.pop('pose', None)
        if localisation == 'unknown':
            self.diagnostics.missing['pose'] = f'the pose on the map is unknown: {reason}'
        return {
            'localisation': localisation,
            'experiences': len(self._core),
            'links': self._core.link_count,
            'components': self._core.component_count,
            'experience': self._core.current_id,
            'jumps_refused': self._core.gate.rejected_count,
            'carried': self._core.gate.relocation_count,
            'rotation_gain': round(self._core.optimiser.turns.gain, 4),
            'turn_per_m_rad': round(self._core.optimiser.turns.per_m_rad, 5),
            **({} if self._stage.relocator is None else {
                f'relocations_{name}': count
                for name, count in self._stage.relocator.counts.items()
            }),
            **self._goals.diagnostic_values(),
        }
