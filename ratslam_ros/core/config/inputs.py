# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The parameters that several sections share: inputs of live nodes, and saved memories."""

from __future__ import annotations

from dataclasses import dataclass

from ratslam_ros.core.config.parameter import Section, parameter

WHOLE = -1
"""Upper image bound that stands for the edge of the image."""

CROP_MAX = 'px; -1: to the edge of the image'
"""Unit of upper image bounds."""


@dataclass(frozen=True)
class LiveInput(Section):
    """What a node does about inputs that fall silent or begin again."""

    watchdog_after_s: float = parameter(
        5.0, 's', 0.1, 3600.0,
        'Live only: after this long without an input, warn and tell who publishes it.',
        'inputs are slower than this', 'a lost input should be told sooner')  # fmt: skip
    flush_after_s: float = parameter(
        2.0, 's', 0.0, 600.0,
        'Live only: with no input for this long, all held messages are processed.',
        'inputs pause for longer than this and late messages are counted after the pause',
        'the last messages of a recording should reach the map sooner',
    )  # fmt: skip
    on_jump_back: str = parameter(
        'start_over', '', 0, 0,
        'Live only: when stamps jump back (a recording played in a loop), forget everything, or '
        'keep the map and go on as if the robot had been carried.',
        'set to go_on to see known places again at the next turn of a loop',
        'set to start_over to get the same map at each turn',
        choices=('start_over', 'go_on'),
    )  # fmt: skip


@dataclass(frozen=True)
class ImageInput(LiveInput):
    """Which images a node takes."""

    image_transport: str = parameter(
        'auto', '', 0, 0,
        'Live only: subscribe to image (raw) or image/compressed; auto takes compressed where '
        'nobody publishes raw images.',
        'set to compressed to save the network', 'set to raw where the compression spoils views',
        choices=('auto', 'raw', 'compressed'),
    )  # fmt: skip


@dataclass(frozen=True)
class Memory(LiveInput):
    """Where a node keeps what it has learned."""

    memory_folder: str = parameter(
        '~/.ros/ratslam', '', 0, 0,
        'Live only: where the services save and load keep the memory, a file a node.',
        'set to a folder for each place that the robot works in',
        'leave as it is for a single robot in a single place',
    )  # fmt: skip


@dataclass(frozen=True)
class OdometryInput(Memory):
    """How a section that takes odometry reads it, and how long it waits for slower streams."""

    odom_source: str = parameter(
        'twist', '', 0, 0,
        "Read motion from the odometry message's twist, or from differences of its pose.",
        'set to pose if the driver leaves the twist empty',
        'set to twist if the pose jumps (it is corrected by another filter)',
        choices=('twist', 'pose'),
    )  # fmt: skip
    max_lateness_s: float = parameter(
        2.0, 's', 0.0, 600.0,
        'A message waits for the other streams at most until a stamp this much newer is seen.',
        'messages are counted as late', 'the map lags too long behind a camera that fell silent',
    )  # fmt: skip
