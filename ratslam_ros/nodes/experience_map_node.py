# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Node of the experience map: odom, pose_cells/action -> map, pose, TF; goals -> route."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Any

from nav_msgs.msg import Odometry as OdometryMessage
from sensor_msgs.msg import LaserScan
from std_msgs.msg import String
from std_srvs.srv import Trigger
from tf2_msgs.msg import TFMessage
from visualization_msgs.msg import MarkerArray

from ratslam_ros.core.common.odometry import Motion, MotionFromOdometry, Odometry
from ratslam_ros.core.common.pose import Pose, composed, inverse
from ratslam_ros.core.common.scan import Scan, scan_stream
from ratslam_ros.core.common.state import State
from ratslam_ros.core.common.turn_correction import TurnCorrection
from ratslam_ros.core.config import Config
from ratslam_ros.core.mapping.experience_map import ExperienceMap, MapUpdate
from ratslam_ros.core.mapping.late_join import LateJoin
from ratslam_ros.core.mapping.mapping_step import adopt_correction, apply_action
from ratslam_ros.core.mapping.pose_uncertainty import PoseUncertainty
from ratslam_ros.core.mapping.relocator import Relocator
from ratslam_ros.core.mapping.scan_matching import ScanMatcher
from ratslam_ros.core.pose_cells.map_action import MapAction
from ratslam_ros.core.vision.local_view import NO_TEMPLATE
from ratslam_ros.core.warm_up import warm_up
from ratslam_ros.messages.corrections import Correction
from ratslam_ros.messages.json_schema import MalformedMessage
from ratslam_ros.messages.logged import decode_odometry, decode_scan, encode_odometry, encode_scan
from ratslam_ros.messages.mapping import decode_action, encode_relocation
from ratslam_ros.nodes.behaviours import Behaviours
from ratslam_ros.nodes.convert import accepted_odometry, transform
from ratslam_ros.nodes.goal_navigation import GoalNavigation
from ratslam_ros.nodes.grid_publisher import GridPublisher
from ratslam_ros.nodes.map_changes import MapChangePublisher
from ratslam_ros.nodes.map_operations import MapCoordinator
from ratslam_ros.nodes.map_sender import MapSender
from ratslam_ros.nodes.markers import serialised_markers
from ratslam_ros.nodes.node import FLUSH_CHECK_PERIOD_S, RatslamNode
from ratslam_ros.nodes.odometry_frames import OdometryFrames
from ratslam_ros.nodes.pose_hints import STREAM as HINTS
from ratslam_ros.nodes.pose_hints import PoseHints
from ratslam_ros.nodes.pose_publisher import PosePublisher
from ratslam_ros.nodes.qos import LATCHED, RESULT, STATE
from ratslam_ros.nodes.run import run
from ratslam_ros.nodes.scans import ScanInput
from ratslam_ros.nodes.single_sender import SingleSender


@dataclass(frozen=True, slots=True)
class Action:
    """An action message: the action, its number, and the memory that its ids belong to."""

    action: MapAction
    sequence: int
    memory_ns: int


class ExperienceMapNode(RatslamNode[Odometry | Scan | Action]):
    """Builds the map; publishes it, the robot's pose on it, and routes to goals."""

    SECTION = 'experience_map'
    PARTS = ('goal_recall',)
    MAPS = True
    REGULAR = 'odometry'
    REPEATS = ('relocation',)
    _grid: GridPublisher | None = None

    def __init__(self, initial: Config = Config()) -> None:
        super().__init__(('odometry', 'action'), initial)
        if self._section.exp_align_scans:
            warm_up('scan_alignment')  # loads LAPACK, for a seventh of the time of a start
            lasers = range(len(self._section.lasers))
            self._streams = 'odometry', *map(scan_stream, lasers), 'action'
            self._order = self._new_order()
        self._sender = MapSender(self)
        self._markers = self.create_publisher(MarkerArray, 'experience_map/markers', LATCHED)
        self._poses = PosePublisher(self)
        self._tf = self.create_publisher(TFMessage, '/tf', STATE)
        self._changes = MapChangePublisher(self, self._section.map_frame)
        self._frames = OdometryFrames(
            self._section.odom_frame, self._section.base_frame, self._diagnostics.note
        )
        self._goals = GoalNavigation(
            self, self._diagnostics, lambda: self.config, self._refuse, self._frames
        )
        self._behaviours = Behaviours(self, self._refuse, self._log)
        self._hints = PoseHints(
            self, self._section.map_frame, lambda: self._newest_ns('odometry'), self._refuse,
            self._log,
        )  # fmt: skip
        self._answers: Any = None
        if self._relocates:
            warm_up('relocation')  # takes long if nothing is cached, so only if it is used
            self._answers = self.create_publisher(String, 'experience_map/relocation', RESULT)
        self.create_service(Trigger, 'experience_map/relocate', self._on_relocate)
        assert self._operations is not None
        self._coordinator = MapCoordinator(
            self, lambda: str(self._section.memory_folder), self._operations.present_grid,
            self._diagnostics.warn,
        )  # fmt: skip
        self._viewers = self._pose_ns = 0
        self._markers_due = False
        self._reset_state()
        self._add_input(
            'odometry', {'odom': OdometryMessage}, self._on_odometry,
            lambda data: self._take_odometry(decode_odometry(data)),
        )  # fmt: skip
        self._lasers: list[ScanInput] = []
        if self._section.exp_align_scans:
            self._grid = GridPublisher(self, self._section.grid_cell_m)
            for laser, topic in enumerate(self._section.lasers):
                self._add_laser(laser, topic)
        self._senders['action'] = SingleSender(
            self, 'pose_cells/action', self._on_action,
            lambda reason: self._refuse('action', reason),
        )
        self._add_input(
            'action', {'pose_cells/action': String}, self._senders['action'].take,
            lambda data: self._on_action(String(data=data.decode())),
        )  # fmt: skip
        self.create_timer(FLUSH_CHECK_PERIOD_S, self._on_timer, clock=self._steady)

    @classmethod
    def warm_up(cls) -> None:
        """Compile or load from the cache all functions that processing a message needs."""
        warm_up(cls.SECTION)

    @property
    def _relocates(self) -> bool:
        """Whether scans relocate the robot."""
        section = self._section
        return bool(section.exp_align_scans and section.exp_relocate != 'views')

    def _reset_state(self) -> None:
        self._core = self._new_core()
        self._hints.reset()
        self._core.mapping = self._mapping
        self._sender.reset()
        if self._grid is not None:
            self._grid.reset()
        self._late_join = LateJoin(self._core)
        self._scans, self._uncertainty = ScanMatcher(), PoseUncertainty()
        self._relocator = Relocator(self._core, self._scans) if self._relocates else None
        self._motion = MotionFromOdometry(
            self._section.odom_source, self._section.max_odom_gap_s,
            self._section.turn_correction,
        )
        self._action_ns = 0
        # Subscribers that have the old map get the empty one.
        self._sender.has_changed = self._sender.has_sent
        self._goals.use_map(self._core)
        self._behaviours.reset()
        self._pose: Pose | None = None
        self._odom_pose = Pose(0.0, 0.0, 0.0)
        self._pose_ns = 0

    def _on_relocated(self) -> None:
        self._uncertainty = PoseUncertainty(is_known=False)
        self._motion.restart()
        self._scans.restart()
        self._core.gate.restart()
        self._behaviours.reset()

    def _on_caught_up(self, are_images_lost: bool) -> None:
        assert self._keeper is not None
        for _, data in self._keeper.logged('behaviour'):
            self._behaviours.replay(data.decode())
        if self._keeper.joins:
            for stamp_ns, data in self._keeper.logged(HINTS, self._keeper.since_ns):
                self._hints.repeat(stamp_ns, data)

    def _drop_tasks(self) -> None:
        self._goals.drop_goals()

    def _begin_session(self) -> None:
        self._motion.restart()
        self._behaviours.reset()
        if len(self._core):
            unknown = Motion(0.0, 0.0, 0.0, False)
            self._core.integrate(unknown)
            self._scans.integrate(0, unknown)

    def _new_core(self) -> ExperienceMap:
        core = ExperienceMap(self._first_section)
        core.reconfigure(self._section)
        return core

    def _reconfigure(self, section: Any) -> None:
        self._core.reconfigure(section)

    def _set_mapping(self, mapping: bool) -> None:
        self._core.mapping = mapping

    def _memory_state(self) -> State:
        return {
            'action_ns': self._action_ns,
            'joining': self._late_join.state(),
            'core': self._core.state(),
            'correction': list(self._motion.correction),
            'motion': self._motion.state(),
            'behaviours': self._behaviours.state(),
            'goals': self._goals.memory_state(),
            'scans': self._scans.state(),
            **({} if self._relocator is None else {'relocator': self._relocator.state()}),
        }

    def _restore(self, state: State) -> None:
        core = self._new_core()
        core.restore(state['core'])
        late_join = LateJoin(core)
        if 'joining' in state:
            late_join.restore(state['joining'])
        else:
            late_join.assume()  # saved by a replay
        action_ns = int(state.get('action_ns', 0))
        scans = ScanMatcher()
        if 'scans' in state or 'joining' in state:
            scans.restore(state['scans'])
        relocator = Relocator(core, scans) if self._relocates else None
        if relocator is not None and 'relocator' in state:
            relocator.restore(state['relocator'])
        self._goals.use_map(core, state['goals'])
        self._action_ns = action_ns
        self._core, self._late_join, self._scans = core, late_join, scans
        self._relocator, self._uncertainty = relocator, PoseUncertainty(is_known=False)
        self._motion.correction = TurnCorrection(
            *state.get('correction', self._section.turn_correction)
        )
        self._behaviours.reset()
        if 'behaviours' in state:
            self._behaviours.restore(state['behaviours'])
        self._sender.reset()
        if self._grid is not None:
            self._grid.reset()
        self._core.mapping = self._mapping
        if 'motion' in state:
            self._motion.restore(state['motion'])
        else:
            self._motion.restart()
        self._sender.has_changed = True

    def close(self) -> None:
        """Process the messages that are still held, and publish the last map."""
        super().close()
        self._sender.finish(self._core, self._action_ns)
        if self._viewers > 0:
            self._send_markers()

    # Inputs

    def _add_laser(self, laser: int, topic: str) -> None:
        stream = scan_stream(laser)
        scans = ScanInput(
            self, self._diagnostics.note, lambda: self._frames.known_base,
            lambda _, reason: self._refuse(stream, reason),
            lambda scan: self._use_scan(replace(scan, laser=laser)),
        )  # fmt: skip
        self._lasers.append(scans)
        self._add_input(
            stream, {topic: LaserScan}, scans.receive,
            lambda data: self._use_scan(replace(decode_scan(data), laser=laser)),
        )  # fmt: skip

    def _on_odometry(self, message: OdometryMessage) -> None:
        self._frames.update(message)
        odometry = accepted_odometry(message, self._motion, self._refuse)
        if odometry is not None:
            self._take_odometry(odometry)

    def _take_odometry(self, odometry: Odometry) -> None:
        self._push('odometry', odometry.stamp_ns, odometry)
        self._log('odometry', odometry.stamp_ns, lambda: encode_odometry(odometry))
        if not self._is_halted:
            self._locate(odometry)

    def _use_scan(self, scan: Scan) -> None:
        stream = scan_stream(scan.laser)
        self._push(stream, scan.stamp_ns, scan)
        self._log(stream, scan.stamp_ns, lambda: encode_scan(scan))
        self._report_correction()

    def _on_action(self, message: String) -> None:
        try:
            stamp_ns, sequence, action, memory_ns = decode_action(message.data)
        except MalformedMessage as error:
            self._refuse('action', str(error))
            return
        self._push('action', stamp_ns, Action(action, sequence, memory_ns))
        self._log('action', stamp_ns, message.data.encode)
        self._report_correction()
        self._send()

    def _process_item(self, stamp_ns: int, stream: str, item: Odometry | Scan | Action) -> None:
        self._hints.use(stamp_ns, self._core)
        if isinstance(item, Scan):
            self._scans.scan(item)
            return
        if isinstance(item, Odometry):
            self._unlearn_blocked(stamp_ns - 1)
            motion = self._motion.update(item)
            if motion is not None:
                self._core.integrate(motion)
                self._scans.integrate(stamp_ns, motion)
                self._uncertainty.integrate(motion)
                if not motion.is_known:
                    self._report_gap(motion.dt_s)
            return
        self._unlearn_blocked(stamp_ns)
        late_join, behaviour = self._late_join, self._behaviours.at(stamp_ns)
        missed, restarts = late_join.missed, late_join.restarts
        with self._diagnostics.times('experience_map'):
            adopt_correction(self._motion, self._core, item.action)
            action = late_join.translate(item.action, item.sequence, item.memory_ns)
            update = MapUpdate()
            if action is not None:
                update = apply_action(
                    self._core, self._scans, stamp_ns, action, behaviour, self._relocator
                )
                self._uncertainty.apply(action, update, self._scans.variance_m2)
        if self._answers is not None:
            relocation = late_join.peer_relocation(update.relocation)
            payload = encode_relocation(stamp_ns, item.sequence, relocation, item.memory_ns)
            self._answers.publish(String(data=payload))
            self._log('relocation', stamp_ns, payload.encode)
        self._changes.publish_closures(stamp_ns, item.sequence, update.events)
        if item.action.template_id != NO_TEMPLATE:
            self._action_ns = stamp_ns
            self._sender.has_changed = True
        self._diagnostics.drop(
            'missed', f'{late_join.missed - missed} actions of pose_cells were lost: the map '
            'differs from that of a replay', late_join.missed - missed,
        )  # fmt: skip
        if late_join.restarts > restarts:
            self._diagnostics.note(
                'pose_cells has started with an empty memory: the map is continued, but places '
                'mapped before will not be recognised. To start over, call experience_map/reset'
            )
        elif item.sequence > 0 and item.sequence == late_join.first_sequence and not missed:
            self._diagnostics.note(
                f'this node started late: {item.sequence} actions of pose_cells were sent before '
                'and are missing from the map. To start over, call reset on all nodes'
            )

    def _unlearn_blocked(self, stamp_ns: int) -> None:
        """Report the blocked attempts up to a stamp to the map, which may unlearn links."""
        for report in self._behaviours.take(stamp_ns):
            if not self._goals.report_blocked():
                continue
            unlearned = self._core.unlearn_blocked(report.behaviour, report.ahead_rad)
            if unlearned > 0:
                self._sender.has_changed = True
                self.get_logger().info(
                    f'{unlearned} links were unlearned: {report.behaviour} was blocked'
                )

    def _report_gap(self, gap_s: float) -> None:
        self._sender.has_changed = True
        self._diagnostics.warn(
            f'odometry has a gap of {gap_s:.1f} s: the map continues in a separate component '
            'until a known place is recognised (max_odom_gap_s)'
        )

    def _on_relocate(self, request: Any, response: Any) -> Any:
        """Search for the robot's place by what the laser has seen in the last metres."""
        if self._relocator is None:
            return self._answer(
                response, False, 'landmarks are off: set exp_align_scans, and exp_relocate to both'
            )
        with self._lock:
            result = self._relocator.search(is_lost=True)
            x_m, y_m, heading_rad = self._core.pose
        if result.outcome not in ('found', 'here'):
            return self._answer(response, False, f'{result.outcome}: {result.reason}')
        self._report_correction()
        return self._answer(
            response, True, f'{result.reason}; the robot is at ({x_m:.2f}, {y_m:.2f}), heading '
            f'{math.degrees(heading_rad):.0f} degrees',
        )  # fmt: skip

    # The robot's pose

    def _locate(self, odometry: Odometry) -> None:
        """Publish the pose at an odometry message.

        The pose includes the motion of the held messages, which enter the map later, in order.
        """
        if odometry.stamp_ns != self._order.newest_of('odometry'):
            return  # refused, late, or not confirmed by the stamp order
        self._pose_ns, self._odom_pose = odometry.stamp_ns, odometry.pose
        pose = self._current_pose()
        self._use_pose(pose)
        self._poses.publish(
            self._pose_ns, self._section.map_frame, pose, self._uncertainty.variances
        )
        self._publish_tf()

    def _report_correction(self) -> None:
        """Publish a correction if an action has changed the pose at the last odometry."""
        before = self._pose
        if before is not None and before != (pose := self._current_pose()):
            self._use_pose(pose)
            self._poses.publish_correction(
                Correction(self._pose_ns, self._core.current_id, before, pose)
            )

    def _current_pose(self) -> Pose:
        """Return the robot's pose on the map, including the motion of the held messages."""
        held = (o for o in self._order.waiting('odometry') if isinstance(o, Odometry))
        offset = self._motion.ahead(held, self._core.offset)
        return composed(self._core.pose_of(self._core.current_id), offset)

    def _use_pose(self, pose: Pose) -> None:
        self._pose = pose
        self._goals.locate(self._pose_ns, pose, self._odom_pose)

    def _publish_tf(self) -> None:
        p = self._section
        assert self._pose is not None
        if p.publish_tf and all(math.isfinite(value) for value in self._odom_pose):
            odom_on_map = composed(self._pose, inverse(self._odom_pose))
            self._tf.publish(TFMessage(transforms=[
                transform(self._pose_ns, p.map_frame, self._frames.odom, odom_on_map)
            ]))  # fmt: skip

    # The map

    def _on_timer(self) -> None:
        for laser in self._lasers:
            laser.update()
        self._flush()
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
        if self._changes.update(self._core, self._action_ns):
            return
        if self._grid is not None and self._grid.advance(
            self._core, self._scans, self._action_ns, self._section.grid_period_s
        ):
            return
        if self._markers_due:
            self._send_markers()
            return
        period_s = self._section.map_period_s
        if self._sender.advance(self._core, self._action_ns, period_s):
            self._markers_due = self._viewers > 0

    def _send_markers(self) -> None:
        self._markers_due = False
        self._markers.publish(
            serialised_markers(self._core, self._action_ns, self._section.map_frame)
        )

    def _diagnostic_values(self) -> dict[str, Any]:
        return {
            'experiences': len(self._core),
            'links': self._core.link_count,
            'components': self._core.component_count,
            'experience': self._core.current_id,
            'jumps_refused': self._core.gate.rejected_count,
            'carried': self._core.gate.relocation_count,
            **({} if self._relocator is None else {
                f'relocations_{name}': count for name, count in self._relocator.counts.items()
            }),
            **self._goals.diagnostic_values(),
        }


def main(args: list[str] | None = None) -> int:
    """Run the node until it is interrupted."""
    return run(ExperienceMapNode, args=args)
