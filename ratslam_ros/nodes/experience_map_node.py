# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Experience map as a node: odom, pose_cells/action -> map, pose, map -> odom; goal -> route."""

from __future__ import annotations

import math
import time
from dataclasses import dataclass
from typing import Any

from geometry_msgs.msg import PoseStamped
from nav_msgs.msg import Odometry as OdometryMessage
from sensor_msgs.msg import LaserScan
from std_msgs.msg import String
from tf2_msgs.msg import TFMessage
from visualization_msgs.msg import MarkerArray

from ratslam_ros.core.common.odometry import MotionFromOdometry, Odometry
from ratslam_ros.core.common.pose import Pose, composed, inverse
from ratslam_ros.core.common.state import State
from ratslam_ros.core.mapping.experience_map import ExperienceMap
from ratslam_ros.core.mapping.late_join import LateJoin
from ratslam_ros.core.mapping.mapping_step import apply_action
from ratslam_ros.core.mapping.scan_matching import ScanMatcher
from ratslam_ros.core.pose_cells.pose_cells import MapAction
from ratslam_ros.core.vision.local_view import NO_TEMPLATE
from ratslam_ros.core.warm_up import warm_up
from ratslam_ros.messages.json_schema import MalformedMessage
from ratslam_ros.messages.mapping import MapText, decode_action, encode_map
from ratslam_ros.nodes.behaviours import Behaviours
from ratslam_ros.nodes.convert import header_of, odometry_of, pose_message, transform
from ratslam_ros.nodes.goal_navigation import GoalNavigation
from ratslam_ros.nodes.markers import markers_of
from ratslam_ros.nodes.node import FLUSH_CHECK_S, RatslamNode
from ratslam_ros.nodes.qos import LATCHED, STATE
from ratslam_ros.nodes.run import run
from ratslam_ros.nodes.scans import accepted_scan

LARGEST_SHARE = 0.1
"""Of one core, for sending the map: a large map is sent less often than map_period_s."""


@dataclass(frozen=True, slots=True)
class Action:
    """An action message: what to do, its number, and the memory that its ids are of."""

    action: MapAction
    sequence: int
    memory_ns: int


class ExperienceMapNode(RatslamNode[Odometry | Action]):
    """Publishes the map, where the robot is on it, and the way to a goal."""

    SECTION = 'experience_map'
    PARTS = ('goal_recall',)
    MAPS = True

    def __init__(self) -> None:
        super().__init__(('odometry', 'action'))
        self._map_publisher = self.create_publisher(String, 'experience_map/map', LATCHED)
        self._markers = self.create_publisher(MarkerArray, 'experience_map/markers', LATCHED)
        self._pose_publisher = self.create_publisher(PoseStamped, 'experience_map/pose', STATE)
        self._tf = self.create_publisher(TFMessage, '/tf', STATE)
        self._goals = GoalNavigation(self, self._diagnostics, lambda: self.config, self._refuse)
        self._behaviours = Behaviours(self, self._refuse)
        self._next_map_s = 0.0
        self._sent = False
        self._viewers = self._pose_ns = 0
        self._forget()
        self._listen('odometry', {'odom': OdometryMessage}, self._on_odometry)
        if self._section.exp_align_scans:
            self._listen('scan', {'scan': LaserScan}, self._on_scan)
        self._listen('action', {'pose_cells/action': String}, self._on_action)
        self.create_timer(FLUSH_CHECK_S, self._tick, clock=self._steady)

    @classmethod
    def warm_up(cls) -> None:
        """Compile, or load from the cache, what a message needs."""
        warm_up(cls.SECTION, 'scan_alignment')

    def _forget(self) -> None:
        self._core = ExperienceMap(self._section)
        self._core.mapping = self._mapping
        self._map_text = MapText()
        self._late_join = LateJoin(self._core)
        self._scans = ScanMatcher()
        self._motion = MotionFromOdometry(self._section.odom_source)
        self._action_ns = 0
        self._changed = self._sent  # whoever has the old map is told that it is no more
        self._goals.begin(self._core)
        self._behaviours.forget()
        self._pose: Pose | None = None
        self._odom_pose = Pose(0.0, 0.0, 0.0)
        self._pose_ns = 0

    def _carried(self) -> None:
        self._motion.restart()
        self._scans.restart()
        self._core.gate.restart()
        self._behaviours.forget()

    def _set_mapping(self, mapping: bool) -> None:
        self._core.mapping = mapping

    def _learned(self) -> State:
        return {
            'action_ns': self._action_ns,
            'joining': self._late_join.state(),
            'core': self._core.state(),
            'goals': self._goals.learned(),
            'scans': self._scans.state(),
        }

    def _restore(self, state: State) -> None:
        core = ExperienceMap(self._section)
        core.restore(state['core'])
        core.gate.restart()
        late_join = LateJoin(core)
        late_join.restore(state['joining'])
        action_ns = int(state['action_ns'])
        scans = ScanMatcher()
        scans.restore(state['scans'])
        self._goals.begin(core, state['goals'])
        self._action_ns = action_ns
        self._core, self._late_join, self._scans = core, late_join, scans
        self._map_text = MapText()
        self._core.mapping = self._mapping
        self._motion.restart()
        self._changed = True

    def close(self) -> None:
        """Process what still waits, and send the last map."""
        super().close()
        self._send_map()

    # Inputs

    def _on_odometry(self, message: OdometryMessage) -> None:
        odometry = odometry_of(message)
        if not self._motion.accepts(odometry):
            self._refuse('odometry', f'{self._section.odom_source} is not finite: {odometry}')
            return
        self._push('odometry', odometry.stamp_ns, odometry)
        if not self._paused:
            self._locate(odometry)

    def _on_scan(self, message: LaserScan) -> None:
        scan = accepted_scan(message, self._refuse)
        if scan is not None and not self._paused:
            self._scans.scan(scan)

    def _on_action(self, message: String) -> None:
        try:
            stamp_ns, sequence, action, memory_ns = decode_action(message.data)
        except MalformedMessage as error:
            self._refuse('action', str(error))
            return
        self._push('action', stamp_ns, Action(action, sequence, memory_ns))
        self._correct()
        if self._changed and time.monotonic() >= self._next_map_s:
            self._send_map()

    def _use(self, stamp_ns: int, stream: str, item: Odometry | Action) -> None:
        if isinstance(item, Odometry):
            self._fail(stamp_ns - 1)
            motion = self._motion.update(item)
            if motion is not None:
                self._core.integrate(motion)
                self._scans.integrate(stamp_ns, motion)
            return
        self._fail(stamp_ns)
        joining, behaviour = self._late_join, self._behaviours.at(stamp_ns)
        missed, restarts = joining.missed, joining.restarts
        with self._diagnostics.times('experience_map'):
            action = joining.translate(item.action, item.sequence, item.memory_ns)
            if action is not None:
                apply_action(self._core, self._scans, stamp_ns, action, behaviour)
        if item.action.template_id != NO_TEMPLATE:
            self._action_ns = stamp_ns
            self._changed = True
        self._diagnostics.drop(
            'missed', f'{joining.missed - missed} actions of pose_cells never came: the map is '
            'not the one of a replay', joining.missed - missed,
        )  # fmt: skip
        if joining.restarts > restarts:
            self._miss('pose_cells has begun with an empty memory: the map goes on, but what was '
                       'mapped before will not be recognised. To start over call '
                       'experience_map/reset')  # fmt: skip
        elif item.sequence > 0 and item.sequence == joining.first_sequence and not missed:
            self._miss(f'this node came late: {item.sequence} actions of pose_cells were before '
                       'it, and what was mapped then is missing. To start over call reset on all '
                       'nodes')  # fmt: skip

    def _fail(self, stamp_ns: int) -> None:
        """Count the tries up to a stamp that have failed."""
        for note in self._behaviours.take(stamp_ns):
            if not self._goals.report_blocked():
                continue
            unlearned = self._core.report_blocked(note.behaviour, note.ahead_rad)
            if unlearned > 0:
                self._changed = True
                self.get_logger().info(
                    f'{unlearned} links are unlearned: {note.behaviour} led nowhere'
                )

    def _miss(self, text: str) -> None:
        if self._diagnostics.missing.get('action') != text:
            self._diagnostics.missing['action'] = text
            self.get_logger().warning(text)

    # Where the robot is

    def _locate(self, odometry: Odometry) -> None:
        """Publish the pose at an odometry message, with the motion that the map waits with.

        What is held is only added to what is published: it enters the map in its turn.
        """
        if odometry.stamp_ns != self._order.newest_of('odometry'):
            return  # refused, late, or not yet believed
        self._pose_ns, self._odom_pose = odometry.stamp_ns, odometry.pose
        self._publish_pose(self._pose_ahead())
        self._publish_tf()

    def _correct(self) -> None:
        """Publish the pose of the last odometry again where an action has changed it."""
        if self._pose is not None and self._pose != (pose := self._pose_ahead()):
            self._publish_pose(pose)

    def _pose_ahead(self) -> Pose:
        """Return where the robot is, the motion that is still held included."""
        waiting = (o for o in self._order.waiting('odometry') if isinstance(o, Odometry))
        offset = self._motion.ahead(waiting, self._core.offset)
        return composed(self._core.pose_of(self._core.current_id), offset)

    def _publish_pose(self, pose: Pose) -> None:
        self._pose = pose
        self._goals.locate(self._pose_ns, pose, self._odom_pose)
        header = header_of(self._pose_ns, self._section.map_frame)
        self._pose_publisher.publish(PoseStamped(header=header, pose=pose_message(pose)))

    def _publish_tf(self) -> None:
        p = self._section
        assert self._pose is not None
        if p.publish_tf and all(math.isfinite(value) for value in self._odom_pose):
            odom_on_map = composed(self._pose, inverse(self._odom_pose))
            self._tf.publish(TFMessage(transforms=[
                transform(self._pose_ns, p.map_frame, p.odom_frame, odom_on_map)
            ]))  # fmt: skip

    # The map

    def _tick(self) -> None:
        self._flush()
        if self._changed and time.monotonic() >= self._next_map_s:
            self._send_map()
        viewers = self._markers.get_subscription_count()
        if viewers > self._viewers and self._sent:
            self._send_markers()
        self._viewers = viewers
        self._goals.update()

    def _send_map(self) -> None:
        """Send the whole map, if it has changed since."""
        if not self._changed:
            return
        self._changed, self._sent = False, True
        start_s = time.monotonic()
        text = encode_map(self._action_ns, self._core, self._map_text)
        self._map_publisher.publish(String(data=text))
        if self._viewers > 0:
            self._send_markers()
        took_s = time.monotonic() - start_s
        self._next_map_s = start_s + max(self._section.map_period_s, took_s / LARGEST_SHARE)

    def _send_markers(self) -> None:
        self._markers.publish(markers_of(self._core, self._action_ns, self._section.map_frame))

    def _state(self) -> dict[str, Any]:
        return {
            'experiences': len(self._core),
            'links': self._core.link_count,
            'experience': self._core.current_id,
            'jumps_refused': self._core.gate.rejected_count,
            'carried': self._core.gate.relocation_count,
            **self._goals.state(),
        }


def main(args: list[str] | None = None) -> int:
    """Run the node until it is interrupted."""
    return run(ExperienceMapNode, args=args)
