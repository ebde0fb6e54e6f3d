# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Node of the simulator: cmd_vel -> image, odom, scan, sonars, /clock and the true pose."""

from __future__ import annotations

import array
import math
import time
from typing import Any

from geometry_msgs.msg import PoseStamped, Twist
from nav_msgs.msg import Odometry as OdometryMessage
from rosgraph_msgs.msg import Clock as ClockMessage
from sensor_msgs.msg import CameraInfo, Image, LaserScan, Range
from tf2_msgs.msg import TFMessage

from ratslam_ros.core.common.pose import Pose
from ratslam_ros.ros.convert import header_of, image_message, pose_message, time_of, transform
from ratslam_ros.ros.plain_node import PlainNode
from ratslam_ros.ros.qos import CLOCK, RESULT, STATE, STATIC
from ratslam_simulator.config import SimulatorParameters, make_simulator
from ratslam_simulator.recording import (
    CAMERA_FRAME,
    LASER_FRAMES,
    ODOM_FRAME,
    ROBOT_FRAME,
    SCAN_TOPICS,
    WORLD_FRAME,
)
from ratslam_simulator.samples import (
    ImageSample,
    OdometrySample,
    Sample,
    ScanSample,
    SonarSample,
)
from ratslam_simulator.simulation import STEP_NS

STEP_CHECK_PERIOD_S = 0.01
"""Period of the timer that runs the steps that are due."""

MAX_LAG_S = 0.2
"""Largest lag behind wall time that is caught up; beyond it, simulated time slows down."""

SLOW_RATIO = 0.9
"""Fraction of the requested rate below which the node warns."""


class SimulatorNode(PlainNode):
    """Simulates a robot on the topics of a real one; publishes its time on /clock."""

    SECTION = 'simulator'
    PARAMETERS = SimulatorParameters

    def __init__(self) -> None:
        super().__init__()
        self._clock_out = self.create_publisher(ClockMessage, '/clock', CLOCK)
        self._image = self.create_publisher(Image, 'image', RESULT)
        self._camera_info = self.create_publisher(CameraInfo, 'camera_info', RESULT)
        self._odometry = self.create_publisher(OdometryMessage, 'odom', RESULT)
        lasers = self.simulator.options.lasers
        self._scans = [
            self.create_publisher(LaserScan, topic.lstrip('/'), RESULT)
            for topic in SCAN_TOPICS[: len(lasers)]
        ]
        sonars = self.simulator.options.sonars
        mounts = dict(zip(LASER_FRAMES, (laser.mount for laser in lasers), strict=False))
        mounts |= {f'sonar_{i}': mount for i, mount in enumerate(sonars.mounts if sonars else ())}
        self._sonars = {
            frame: self.create_publisher(Range, frame, RESULT)
            for frame in mounts if frame not in LASER_FRAMES
        }
        self._truth = self.create_publisher(PoseStamped, 'ground_truth/pose', STATE)
        self._tf = self.create_publisher(TFMessage, '/tf', STATE)
        self._tf_static = self.create_publisher(TFMessage, '/tf_static', STATIC)
        if mounts:
            self._tf_static.publish(TFMessage(transforms=[
                transform(self.simulator.stamp_ns, ROBOT_FRAME, frame, mount)
                for frame, mount in mounts.items()
            ]))
        self.create_subscription(Twist, 'cmd_vel', self._on_command, STATE)
        self._command_s = -math.inf
        self._due_s = self._reported_s = time.monotonic()
        self._reported_ns = self.simulator.stamp_ns
        self.create_timer(STEP_CHECK_PERIOD_S, self._step_due, clock=self.steady)

    def _begin(self) -> None:
        super()._begin()
        self.simulator = make_simulator(self._p)

    @classmethod
    def warm_up(cls) -> None:
        """Compile or load from the cache all functions that a step needs."""
        make_simulator(SimulatorParameters(plan='office')).step()

    def _on_command(self, message: Twist) -> None:
        speed_mps, turn_rate_radps = float(message.linear.x), float(message.angular.z)
        if not (math.isfinite(speed_mps) and math.isfinite(turn_rate_radps)):
            self.diagnostics.drop('refused', f'cmd_vel is {speed_mps}, {turn_rate_radps}')
            return
        self._command_s = time.monotonic()
        self.simulator.command(speed_mps, turn_rate_radps)

    def _step_due(self) -> None:
        """Run the steps that are due."""
        now_s = time.monotonic()
        if now_s - self._command_s > self._p.cmd_timeout_s:
            self.simulator.command(0.0, 0.0)
        self._due_s = max(self._due_s, now_s - MAX_LAG_S)
        while self._due_s <= now_s:
            self._due_s += STEP_NS * 1e-9 / self._p.rate
            for sample in self.simulator.step():
                self._publish(sample)
            if time.monotonic() - now_s > MAX_LAG_S:
                return  # let the executor serve the other callbacks

    def _publish(self, sample: Sample) -> None:
        stamp_ns = sample.stamp_ns
        if isinstance(sample, OdometrySample):
            self._clock_out.publish(ClockMessage(clock=time_of(stamp_ns)))
            self._publish_odometry(sample)
            self._publish_truth(stamp_ns, sample.truth)
        elif isinstance(sample, ImageSample):
            self._image.publish(image_message(stamp_ns, CAMERA_FRAME, sample.image))
            self._camera_info.publish(self._info(stamp_ns))
        elif isinstance(sample, SonarSample):
            self._publish_ranges(sample)
        else:
            self._scans[sample.laser].publish(self._laser_scan(sample))

    def _publish_truth(self, stamp_ns: int, truth: Pose) -> None:
        self._truth.publish(
            PoseStamped(header=header_of(stamp_ns, WORLD_FRAME), pose=pose_message(truth))
        )

    def _publish_odometry(self, sample: OdometrySample) -> None:
        stamp_ns, odometry = sample.stamp_ns, sample.odometry
        pose = odometry.pose
        message = OdometryMessage(
            header=header_of(stamp_ns, ODOM_FRAME), child_frame_id=ROBOT_FRAME
        )
        message.pose.pose = pose_message(pose)
        message.twist.twist.linear.x = float(odometry.speed_mps)
        message.twist.twist.angular.z = float(odometry.turn_rate_radps)
        self._odometry.publish(message)
        self._tf.publish(
            TFMessage(transforms=[transform(stamp_ns, ODOM_FRAME, ROBOT_FRAME, pose)])
        )

    def _publish_ranges(self, sample: SonarSample) -> None:
        sonars = self.simulator.options.sonars
        assert sonars is not None  # there is a sample
        for (frame, publisher), range_m in zip(self._sonars.items(), sample.ranges_m, strict=True):
            publisher.publish(Range(
                header=header_of(sample.stamp_ns, frame), radiation_type=Range.ULTRASOUND,
                field_of_view=math.radians(sonars.cone_deg), min_range=sonars.range_min_m,
                max_range=sonars.range_max_m, range=float(range_m),
            ))

    def _laser_scan(self, sample: ScanSample) -> LaserScan:
        laser = self.simulator.options.lasers[sample.laser]
        return LaserScan(
            header=header_of(sample.stamp_ns, LASER_FRAMES[sample.laser]),
            angle_min=laser.first_rad,
            angle_max=laser.first_rad + laser.step_rad * (laser.beams - 1),
            angle_increment=laser.step_rad,
            scan_time=1.0 / laser.rate_hz,
            range_min=0.0,
            range_max=laser.range_max_m,
            ranges=array.array('f', sample.ranges_m.tobytes()),
        )

    def _info(self, stamp_ns: int) -> CameraInfo:
        camera = self.simulator.options.camera
        assert camera is not None  # there is an image sample
        f, x, y = camera.focal_px, camera.width / 2, camera.height / 2
        return CameraInfo(
            header=header_of(stamp_ns, CAMERA_FRAME), height=camera.height, width=camera.width,
            distortion_model='plumb_bob', d=[0.0] * 5, k=[f, 0.0, x, 0.0, f, y, 0.0, 0.0, 1.0],
            r=[1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0],
            p=[f, 0.0, x, 0.0, 0.0, f, y, 0.0, 0.0, 0.0, 1.0, 0.0],
        )

    def _publish_diagnostics(self) -> None:
        now_s, simulator = time.monotonic(), self.simulator
        passed_s = (simulator.stamp_ns - self._reported_ns) * 1e-9
        rate = passed_s / max(now_s - self._reported_s, 1e-3)
        self._reported_s, self._reported_ns = now_s, simulator.stamp_ns
        if rate < SLOW_RATIO * self._p.rate:
            self.diagnostics.warn(
                f'this machine is too slow: the simulation runs at {rate:.2f} times real '
                f'time, not at {self._p.rate:g}',
            )
        self.diagnostics.publish(self._diagnostic_values(rate), 'running')

    def _diagnostic_values(self, rate: float) -> dict[str, Any]:
        simulator = self.simulator
        return {
            'rate': round(rate, 2),
            'simulated_s': simulator.elapsed_s,
            'driven_m': round(simulator.odometer_m, 2),
            'collisions': simulator.collisions,
        }
