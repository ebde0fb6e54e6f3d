# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Node of the pose cells: odom, local_view/template -> pose_cells/action."""

from __future__ import annotations

import time
from typing import Any

import numpy as np
from sensor_msgs.msg import Image, PointCloud2

from ratslam_ros.core.common.turn_correction import TurnCorrection
from ratslam_ros.core.pose_cells.active_cells import active_cells
from ratslam_ros.core.pose_cells.pose_cells import PoseCells
from ratslam_ros.messages.mapping import ActionPayload, RelocationPayload
from ratslam_ros.messages.pose_cells import ActivePayload, PacketsPayload
from ratslam_ros.pipeline.items import Answer, NumberedAction
from ratslam_ros.pipeline.live_stages import LivePoseCells
from ratslam_ros.pipeline.pipeline import Pipeline
from ratslam_ros.ros.convert import image_message, point_cloud
from ratslam_ros.ros.mapping.sonar_plot import SonarPlot
from ratslam_ros.ros.navigation.goal_seeking import GoalSeeking
from ratslam_ros.ros.node import RatslamNode
from ratslam_ros.ros.qos import HISTORY_INPUT, INPUT, RESULT, VIEW

LOGGED_GAIN_CHANGE = 0.02
"""Relative change of the rotation gain that is logged."""

ACTIVITY_PERIOD_S = 0.1
"""Shortest time between two messages with the activity."""


class PoseCellsNode(RatslamNode):
    """Tracks the robot in the pose cells; publishes one action for each template message."""

    SECTION = 'pose_cells'
    PARTS = ('goal_memory',)
    MAPS = True
    TAKES = ('odometry', 'template', 'relocation')
    _stage: LivePoseCells

    def connect(self, pipeline: Pipeline) -> None:
        """Publish the actions, and directions to goals."""
        self._publisher = self.create_payload_publisher(ActionPayload, RESULT)
        self._active = self.create_payload_publisher(ActivePayload, VIEW)
        self._activity = self.create_publisher(Image, 'pose_cells/activity', VIEW)
        self._cells = self.create_publisher(PointCloud2, 'pose_cells/cells', VIEW)
        self._packets = self.create_payload_publisher(PacketsPayload, VIEW)
        self._sonars = SonarPlot(self, self._stage)
        self._shown_s = 0.0
        self._goals: GoalSeeking | None = None
        self._logged_gain = self.config.inputs.odom_rotation_gain
        pipeline.observe('action', self._publish)
        self._stage.on_moved = self._moved
        if self._stage.goal_memory is not None:
            self._goals = GoalSeeking(self, self._stage)

    @property
    def parts(self) -> tuple[str, ...]:
        """The section of the goal memory if it is switched on."""
        return self.PARTS if self.config.goal_memory.goal_memory else ()

    def subscribe(self, stream: str) -> None:
        """Subscribe to a stream that comes from outside."""
        if stream != 'relocation':
            super().subscribe(stream)
            return
        qos = HISTORY_INPUT if self.host.chain.is_followed else INPUT
        self.create_payload_subscription(
            RelocationPayload, self._on_relocation, qos, 'relocation'
        )

    @property
    def _core(self) -> PoseCells:
        return self._stage.core

    def started_over(self) -> None:
        """Continue after the memory was emptied."""
        super().started_over()
        self._logged_gain = self.config.inputs.odom_rotation_gain
        self.restored()

    def restored(self) -> None:
        """Continue after the stage was restored from a state."""
        self._sonars.reset()
        if self._goals is not None:
            self._goals.reset()

    def _on_relocation(self, received: RelocationPayload) -> None:
        """Receive the answer of the map to an action, which may relocate the robot."""
        answer = Answer(received.sequence, received.adopted, received.memory)
        with self.host.ready() as live:
            live.answer('relocation', answer)

    def _publish(self, stamp_ns: int, action: NumberedAction) -> None:
        correction = action.action.correction
        if correction is not None:
            self._report_correction(correction)
        payload = ActionPayload.of(stamp_ns, *action, self._sender_id)
        self.host.map.publish(self._publisher, payload)
        if self._active.get_subscription_count() > 0:
            active = self._core.active_experiences()
            self._active.publish(ActivePayload.of(stamp_ns, action.action.template_id, active))
        self._publish_activity(stamp_ns)

    def _moved(self, stamp_ns: int) -> None:
        if self._goals is not None:
            self._goals.update(stamp_ns)
        self._publish_activity(stamp_ns)

    def _on_timer(self) -> None:
        super()._on_timer()
        self._sonars.update()

    def _report_correction(self, correction: TurnCorrection) -> None:
        """Log a correction of the odometry whose gain differs from the last one logged."""
        if abs(correction.gain / self._logged_gain - 1.0) >= LOGGED_GAIN_CHANGE:
            self._logged_gain = correction.gain
            self.get_logger().info(
                f'closed loops: turns of the odometry are multiplied by {correction.gain:.3f}, '
                f'plus {correction.per_m_rad:.4f} rad/m'
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
        if has_cells or self._packets.get_subscription_count() > 0:
            active = active_cells(self._core)
            if has_cells:
                points = np.column_stack([active.cells, active.activity])
                self._cells.publish(point_cloud(stamp_ns, 'pose_cells', points, 'activity'))
            if self._packets.get_subscription_count() > 0:
                self._packets.publish(PacketsPayload.of(stamp_ns, self._core.dims, active))
        if self._activity.get_subscription_count() == 0:
            return
        plane = self._core.activity().max(axis=0)[::-1]
        largest = plane.max()
        shown = np.sqrt(plane / largest) if largest > 0.0 else plane
        self._activity.publish(
            image_message(stamp_ns, 'pose_cells', np.rint(255.0 * shown).astype(np.uint8))
        )

    def _diagnostic_values(self) -> dict[str, Any]:
        peak = self._core.peak
        return {
            'experiences': len(self._core),
            'experience': self._core.current_experience,
            'peak': f'x {peak.x:.2f}, y {peak.y:.2f}, theta {peak.theta:.2f}',
            'actions': self._stage.number,
            **(self._core.calibration.summary() if self._core.calibration is not None else {}),
            'odometry_gaps': self._core.gap_count,
            **self._core.lengths.report(),
            **(self._goals.diagnostic_values() if self._goals is not None else {}),
        }
