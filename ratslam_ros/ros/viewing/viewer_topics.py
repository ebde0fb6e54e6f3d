# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Subscriptions of the live view: messages of all nodes -> records of the run."""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from typing import Any

import numpy as np
from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import PoseStamped, PoseWithCovarianceStamped
from msgspec.structs import replace
from nav_msgs.msg import Odometry as OdometryMessage
from nav_msgs.msg import Path
from numpy.typing import NDArray
from rclpy.node import Node
from rclpy.serialization import deserialize_message
from sensor_msgs.msg import CompressedImage, Image, LaserScan, PointCloud2
from std_msgs.msg import String

from ratslam_ros.core.common.pose import Pose, composed, inverse
from ratslam_ros.core.mapping.pose_covariance import UNKNOWN_M2
from ratslam_ros.core.pose_cells.active_cells import ActiveCells
from ratslam_ros.core.vision.local_view import UNDECODABLE, ViewMatch
from ratslam_ros.errors import UnusableInput
from ratslam_ros.history.recorder import cells_record, image_record, scan_record, view_record
from ratslam_ros.history.records import (
    CommandRecord,
    MatchRecord,
    PoseRecord,
    Record,
    RouteRecord,
    StatusRecord,
    ViewRecord,
)
from ratslam_ros.images import image_of
from ratslam_ros.messages.commands import CommandPayload
from ratslam_ros.messages.goals import GoalStatus
from ratslam_ros.messages.json_schema import Payload, encode
from ratslam_ros.messages.map_changes import ClosurePayload
from ratslam_ros.messages.mapping import ActionPayload, TemplatePayload
from ratslam_ros.messages.pose_cells import PacketsPayload
from ratslam_ros.ros.convert import planar_pose, route_points, stamp_ns
from ratslam_ros.ros.inputs import publisher_count
from ratslam_ros.ros.mapping.followed_map import FollowedMap
from ratslam_ros.ros.mapping.match_pictures import separated
from ratslam_ros.ros.mapping.odometry_frames import OdometryFrames
from ratslam_ros.ros.mapping.scans import ScanInput
from ratslam_ros.ros.payloads import decoded, refusing
from ratslam_ros.ros.qos import LATCHED, RESULT, STATE, STATIC, VIEW, WATCH
from ratslam_ros.ros.viewing.viewer_controls import RosControls
from ratslam_ros.viewer.live_run import LiveRun

POSE_PERIOD_S = 0.1
"""Shortest time between two poses that are used: that of the loop that draws."""

IMAGE_PERIOD_S = 0.25
"""Shortest time between two camera images, and two pictures of a match, that are used."""

ALL = 0.0
"""Period of a stream of which all messages are used."""

SCAN_PERIOD_S = 0.5
"""Shortest time between two scans that are used."""

MAX_PENDING = 50
"""Number of the last views that further messages may complete: 5 s of images at 10 Hz."""

POINT_BYTES = 16
"""Size of a cell in `pose_cells/cells`: x, y, theta and activity as float32."""

POSE = 'experience_map/pose_with_covariance'

EXPECTED = POSE, 'local_view/template', 'pose_cells/action'
"""Topics without which a run cannot be shown."""


class ViewerTopics:
    """Turns messages into records; all methods run in the thread that spins the node.

    Of a stream that is faster than it is drawn, messages are dropped before they are decoded.
    """

    def __init__(
        self, node: Node, run: LiveRun, controls: RosControls, frames: dict[str, Pose]
    ) -> None:
        """Subscribe to all topics.

        Args:
            node: the node of the viewer.
            run: receives the records.
            controls: receives what the nodes report about themselves.
            frames: origin on the map of other frames, which coincide with it at the first pose of
                the run, added here.
        """
        self._node, self._run, self._controls, self._frames = node, run, controls, frames
        self._used_s: dict[str, float] = {}
        self._heard_s: dict[str, float] = {}
        self._since_s = time.monotonic()
        self._dead_reckoning: Pose | None = None
        self._truth: Pose | None = None
        self._templates: dict[int, ViewMatch] = {}
        self._pictures: dict[int, NDArray[np.uint8]] = {}
        self._views: dict[int, ViewRecord] = {}
        self._cells: PointCloud2 | None = None
        self._odometry_frames = OdometryFrames(lambda _: None)
        self._laser = ScanInput(
            self._node, lambda _: None, lambda: self._odometry_frames.known_base, self._refuse,
            lambda scan: self._add(scan_record(scan)),
        )
        self.map = FollowedMap(self._node, self._refuse, lambda one: self._add(one.change))
        """The changes of the map."""
        payloads: tuple[tuple[type[Payload], Any, Callable[[Any], None]], ...] = (
            (TemplatePayload, RESULT, self._on_template),
            (ActionPayload, RESULT, self._on_action),
            (PacketsPayload, VIEW, self._on_packets),
            (ClosurePayload, STATE, self._on_closure),
            (GoalStatus, LATCHED, self._on_status),
            (CommandPayload, STATIC, self._on_command),
        )
        topics: tuple[tuple[type, str, Any, float, Callable[[Any], None]], ...] = (
            (OdometryMessage, 'odom', WATCH, POSE_PERIOD_S / 2, self._on_odometry),
            (PoseStamped, 'ground_truth/pose', WATCH, POSE_PERIOD_S / 2, self._on_truth),
            (PoseWithCovarianceStamped, POSE, WATCH, POSE_PERIOD_S, self._on_pose),
            (LaserScan, 'scan', WATCH, SCAN_PERIOD_S, self._laser.receive),
            (CompressedImage, 'image/compressed', WATCH, IMAGE_PERIOD_S, self._on_compressed),
            (Image, 'image', WATCH, IMAGE_PERIOD_S, self._on_image),
            (Image, 'local_view/matched', VIEW, IMAGE_PERIOD_S, self._on_matched),
            (PointCloud2, 'pose_cells/cells', VIEW, ALL, self._on_cells),
            (Path, 'experience_map/route', LATCHED, ALL, self._on_route),
            (DiagnosticArray, '/diagnostics', STATE, ALL, self._controls.on_diagnostics),
            *(
                (String, payload.TOPIC, qos, ALL, decoded(payload, take, self._refuse))
                for payload, qos, take in payloads
            ),
        )
        self._subscriptions = [
            self._node.create_subscription(
                kind, topic, self._receiver(kind, topic, period_s, callback), qos,
                raw=period_s != ALL,
            )
            for kind, topic, qos, period_s, callback in topics
        ]

    def close(self) -> None:
        """Receive no more messages."""
        for subscription in self._subscriptions:
            self._node.destroy_subscription(subscription)
        self._laser.close()
        self.map.close()

    def missing(self, silence_s: float) -> str:
        """Return which expected topics are silent and what may be the cause, '' if none is."""
        now_s = time.monotonic()
        silent: list[str] = []
        lonely: list[str] = []
        for topic in EXPECTED:
            if now_s - self._heard_s.get(topic, self._since_s) >= silence_s:
                name = self._node.resolve_topic_name(topic)
                (silent if publisher_count(self._node, topic) else lonely).append(name)
        causes = []
        if lonely:
            causes.append(f'no node publishes {", ".join(lonely)}: are the nodes running?')
        if silent:
            causes.append(
                f'no messages on {", ".join(silent)}: do the nodes receive images and odometry? '
                'The tab Drive shows what each of them waits for.'
            )
        return '; '.join(causes)

    # Receiving

    def _receiver(
        self, kind: type, topic: str, period_s: float, callback: Callable[[Any], None]
    ) -> Callable[[Any], None]:
        """Return what takes messages, and with a period decodes at most one in each."""
        take = refusing(callback, self._refuse, topic)

        def receive(message: Any) -> None:
            now_s = time.monotonic()
            self._heard_s[topic] = now_s
            if now_s - self._used_s.get(topic, -math.inf) >= period_s:
                self._used_s[topic] = now_s
                take(message if period_s == ALL else deserialize_message(message, kind))

        return receive

    def _add(self, record: Record) -> None:
        if record.stamp_ns > 0 and self._run.add(record):
            self._node.get_logger().warning('the stamps have jumped back: a new run begins')
            for waiting in self._templates, self._pictures, self._views, self._frames:
                waiting.clear()
            self.map.restart()

    # Poses

    def _on_odometry(self, message: OdometryMessage) -> None:
        self._odometry_frames.update(message)
        pose = planar_pose(message.pose.pose)
        # A driver may leave the pose empty.
        is_given = all(map(math.isfinite, pose)) and pose != (0.0, 0.0, 0.0)
        self._dead_reckoning = pose if is_given else None

    def _on_truth(self, message: PoseStamped) -> None:
        self._truth = planar_pose(message.pose)

    def _on_pose(self, message: PoseWithCovarianceStamped) -> None:
        pose, rows = planar_pose(message.pose.pose), message.pose.covariance
        covariance = float(rows[0]), float(rows[1]), float(rows[7])
        is_known = all(map(math.isfinite, covariance)) and max(covariance) < UNKNOWN_M2
        if all(map(math.isfinite, pose)):
            dead_reckoning = self._on_map('odom', pose, self._dead_reckoning)
            truth = self._on_map('world', pose, self._truth)
            self._add(PoseRecord(
                stamp_ns(message.header), pose, dead_reckoning, truth,
                covariance if is_known else None,
            ))

    def _on_map(self, frame: str, pose: Pose, other: Pose | None) -> Pose | None:
        """Return a pose in another frame on the map, aligned at the first pose of the run."""
        if other is None:
            return None
        if frame not in self._frames:
            self._frames[frame] = composed(pose, inverse(other))
        return composed(self._frames[frame], other)

    # Images

    def _on_image(self, message: Image) -> None:
        # Compressed ones need less time, if there are both.
        if 'image/compressed' not in self._heard_s:
            self._on_compressed(message)

    def _on_compressed(self, message: Image | CompressedImage) -> None:
        self._add(image_record(stamp_ns(message.header), image_of(message)))

    def _on_matched(self, message: Image) -> None:
        self._pictures[stamp_ns(message.header)] = image_of(message).grey()
        self._pair(stamp_ns(message.header))

    def _pair(self, stamp_ns: int) -> None:
        """Add the pictures of a view once its template is known."""
        if stamp_ns not in self._pictures or stamp_ns not in self._templates:
            return
        match, both = self._templates[stamp_ns], self._pictures.pop(stamp_ns)
        views = separated(both)
        if views is not None:
            shift_px = self._shift_px(match.relative_rad)
            self._add(MatchRecord(stamp_ns, match.template_id, *views, shift_px))

    def _shift_px(self, relative_rad: float) -> int:
        """Return the columns by which a view is shifted, as ``LocalView.shift_of`` does."""
        values = self._controls.values
        field_rad = math.radians(float(values['local_view.vt_shift_fov_deg']))
        if values['local_view.vt_panoramic']:
            field_rad = math.tau
        width = float(values['local_view.template_x_size'])
        return round(relative_rad / field_rad * width) if field_rad > 0.0 else 0

    # Views

    def _on_template(self, template: TemplatePayload) -> None:
        self._templates[template.stamp.ns] = template.match
        _forget(self._templates)
        _forget(self._pictures)
        self._pair(template.stamp.ns)

    def _on_action(self, received: ActionPayload) -> None:
        stamp_ns, action = received.stamp.ns, received.change
        match = self._templates.get(stamp_ns, UNDECODABLE)
        threshold = float(self._controls.values['local_view.vt_match_threshold'])
        view = self._views[stamp_ns] = view_record(stamp_ns, match, action, threshold)
        _forget(self._views)
        self._add(view)

    def _on_closure(self, event: ClosurePayload) -> None:
        stamp_ns = event.stamp.ns
        view = self._views.get(stamp_ns)
        if view is None:
            return
        if event.outcome == 'relocated':
            new = replace(view, relocated_to=event.target_id)
        elif event.outcome == 'rejected':
            new = replace(
                view, source_id=event.source_id, target_id=event.target_id, reason=event.reason
            )
        else:
            return  # the action says the same
        self._views[stamp_ns] = new
        if not self._run.replace_view(view, new):
            self._add(new)

    # The pose cells

    def _on_cells(self, message: PointCloud2) -> None:
        self._cells = message

    def _on_packets(self, received: PacketsPayload) -> None:
        """Add the activity; the cells of the same stamp are published before the packets."""
        stamp = received.stamp.ns
        if self._cells is None or stamp_ns(self._cells.header) != stamp:
            return
        data = self._cells.data
        if len(data) % POINT_BYTES:
            raise UnusableInput(f'its cells have {len(data)} bytes, not {POINT_BYTES} each')
        points = np.frombuffer(data, '<f4').reshape(-1, 4).astype(np.float64)
        if not ((points[:, :3] >= 0.0) & (points[:, :3] < received.dims)).all():  # NaN is not
            raise UnusableInput(f'one of its cells is outside of {received.dims}')
        active = ActiveCells(points[:, :3].astype(np.int64), points[:, 3], *received.arrays)
        self._add(cells_record(stamp, received.dims, active))

    # The map and the goals

    def _on_route(self, message: Path) -> None:
        self._add(RouteRecord(stamp_ns(message.header), route_points(message)))

    def _on_status(self, status: GoalStatus) -> None:
        self._controls.on_status(status)
        self._add(StatusRecord(status.stamp.ns, encode(status)))

    def _on_command(self, command: CommandPayload) -> None:
        # 0: before the first input
        self._add(CommandRecord(max(command.stamp.ns, 1), encode(command)))

    def _refuse(self, stream: str, reason: str) -> None:
        self._run.problems['refused'] = f'a message of {stream} was refused: {reason}'


def _forget(waiting: dict[int, Any]) -> None:
    """Remove the oldest items above the limit."""
    while len(waiting) > MAX_PENDING:
        del waiting[next(iter(waiting))]
