# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The parameters that every node has."""

from __future__ import annotations

from dataclasses import dataclass

from ratslam_ros.core.section import Section, parameter


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
