# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Nodes that find the unit of turns while driving: they build the map of an offline run."""

from __future__ import annotations

import math
from typing import Any

import pytest
from helpers import extended
from ros_messages import MakeWorld, odometry, string

from ratslam_ros.core.common.odometry import Odometry, Twist
from ratslam_ros.core.common.pose import Pose
from ratslam_ros.core.vision.local_view import ViewMatch
from ratslam_ros.messages.json_schema import encode
from ratslam_ros.messages.mapping import TemplatePayload, encode_map
from ratslam_ros.pipeline.ratslam import RatSLAM
from ratslam_ros.ros.experience_map_node import ExperienceMapNode
from ratslam_ros.ros.pose_cells_node import PoseCellsNode

PERIOD_NS, PER_LAP, STEP_M = 100_000_000, 30, 1.0
VALUES: dict[str, bool | float] = {
    'pose_cells.odom_calibration': True, 'pose_cells.exp_delta_pc_threshold': 1.0,
    'pose_cells.pc_dim_x': 40, 'pose_cells.pc_dim_y': 40,
    'inputs.max_lateness_s': 600.0,
}
GAIN = 2.4


def inputs(laps: int) -> list[tuple[int, Twist, ViewMatch]]:
    """Return odometry that turns too little, and views that are right, of laps on a circle."""
    twist = Twist(STEP_M * 10.0, 2.0 * math.pi / PER_LAP * 10.0 / GAIN)
    return [
        ((n + 1) * PERIOD_NS, twist, ViewMatch(n % PER_LAP, n < PER_LAP, 0.0, 0.0))
        for n in range(laps * PER_LAP)
    ]


class Nodes:
    """The nodes pose_cells and experience_map, and their inputs."""

    def __init__(self, world: MakeWorld, *arguments: str) -> None:
        given = [
            item for name, value in VALUES.items()
            for item in ('-p', f'{name.replace(".", ":")}:={str(value).lower()}')
        ]
        self.made = world(PoseCellsNode, ExperienceMapNode, arguments=(
            '-p', 'base:=extended', *given, *arguments,
        ))
        self.pose_cells, self.map = self.made.nodes

    def send(self, stamp_ns: int, twist: Twist, match: ViewMatch) -> None:
        message = odometry(stamp_ns, *twist[:2])
        message.twist.covariance[0] = 1e6  # the scale is unknown
        self.made.send('odom', message)
        text = encode(TemplatePayload.of(stamp_ns, match, 1))
        self.made.send('local_view/template', string(text))
        self.made.until(lambda: self.map.host.pipeline.order.newest_of('action') == stamp_ns)

    @property
    def corrections(self) -> list[Any]:
        return [node._stage.motion.correction for node in (self.pose_cells, self.map)]


def offline(laps: int) -> RatSLAM:
    slam = RatSLAM(extended().with_values(VALUES), 'pose_cells')
    for stamp_ns, twist, match in inputs(laps):
        slam.odometry(Odometry(stamp_ns, twist, Pose(0.0, 0.0, 0.0), scale_known=False))
        slam.template(stamp_ns, match)
    slam.finish()
    return slam


def test_nodes_build_the_map_of_an_offline_run(world: MakeWorld) -> None:
    slam, nodes = offline(4), Nodes(world)
    for one in inputs(4):
        nodes.send(*one)
    calibration = slam.pose_cells.calibration
    assert calibration is not None
    assert calibration.correction.gain == pytest.approx(GAIN, rel=0.02)
    assert nodes.corrections == [calibration.correction] * 2
    assert encode_map(0, nodes.map._core) == encode_map(0, slam.experience_map)
    found = nodes.made.diagnostics()['pose_cells']
    assert float(found['rotation_gain']) == round(calibration.correction.gain, 4)
    assert int(found['calibration_loops']) == calibration.loops
