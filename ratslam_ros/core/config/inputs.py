# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Parameters that all parts share: their inputs, and the odometry."""

from __future__ import annotations

from dataclasses import dataclass

from ratslam_ros.core.common.turn_correction import TurnCorrection
from ratslam_ros.core.config.parameter import Section, parameter


@dataclass(frozen=True)
class InputParameters(Section):
    """Inputs of all parts: order and silence of messages, and the odometry."""

    odom_source: str = parameter(
        'twist',
        'Part of the odometry messages that motion is computed from: the twist, or differences '
        'of the pose.',
        choices=('twist', 'pose'),
        raise_if='set to pose if the driver leaves the twist empty',
        lower_if='set to twist if the pose jumps because another filter corrects it',
    )
    odom_rotation_gain: float = parameter(
        1.0, 'Factor for the turns that odometry measures.', low=0.05, high=20.0,
        raise_if='the robot turns further than the odometry measures',
        lower_if='the robot turns less far than the odometry measures',
    )
    odom_turn_per_m: float = parameter(
        0.0,
        'Turn that is added to every metre of odometry, counter-clockwise, as for wheels of '
        'unequal diameter.',
        unit='rad/m', low=-1.0, high=1.0,
        raise_if='by odometry, a straight path bends to the right',
        lower_if='by odometry, a straight path bends to the left',
    )
    max_odom_gap_s: float = parameter(
        2.0,
        'Longest interval between two odometry messages over which the motion is computed, from '
        'the later message. After a longer one the motion is unknown: the map continues in a '
        'separate component until a known place is recognised. 60: no motion is unknown; in '
        'longer intervals the robot counts as stationary. It does not apply to landmark_map.',
        unit='s; 60: off', low=0.01, high=60.0,
        raise_if='odometry messages are normally further apart, or the driver sends none while '
        'the robot stands still',
        lower_if='odometry has gaps in which the robot moves, and they leave long false links',
    )
    max_lateness_s: float = parameter(
        2.0,
        'Longest time that a message waits for other streams, measured by the newest stamp '
        'received.',
        unit='s', low=0.0, high=600.0,
        raise_if='messages are counted as late',
        lower_if='the map lags too long behind a camera that has stopped',
    )
    watchdog_after_s: float = parameter(
        5.0, 'Live only: warn if an input has been silent for this long, and name its publishers.',
        unit='s', low=0.1, high=3600.0,
        raise_if='inputs are slower than this', lower_if='a lost input should be reported sooner',
        runtime='at once',
    )
    flush_after_s: float = parameter(
        2.0, 'Live only: process all held messages if no input has arrived for this long.',
        unit='s', low=0.0, high=600.0,
        raise_if='inputs pause for longer than this, and messages are counted as late after the '
        'pause',
        lower_if='the last messages of a recording should reach the map sooner', runtime='at once',
    )
    on_jump_back: str = parameter(
        'start_over',
        'Live only: what to do when stamps jump back, as when a recording is played in a loop. '
        'start_over clears the map; go_on keeps it and assumes that the robot was carried.',
        choices=('start_over', 'go_on'),
        raise_if='set to go_on to recognise known places in the next round of a loop',
        lower_if='set to start_over to build the same map in each round', runtime='at once',
    )
    image_grey: str = parameter(
        'luma',
        'Grey value of a colour: luma, 0.299 R + 0.587 G + 0.114 B; or the mean of the channels, '
        'as in the Python port of OpenRatSLAM.',
        choices=('luma', 'mean'),
        raise_if='leave at luma', lower_if='set to mean to compare with OpenRatSLAM',
    )
    image_transport: str = parameter(
        'auto',
        'Live only: subscribe to image (raw) or image/compressed; auto uses compressed images if '
        'no raw ones are published.',
        choices=('auto', 'raw', 'compressed'),
        raise_if='set to compressed to save network bandwidth',
        lower_if='set to raw if compression artefacts impair recognition', runtime='at once',
    )

    @property
    def turn_correction(self) -> TurnCorrection:
        """Correction of the turns that odometry measures."""
        return TurnCorrection(self.odom_rotation_gain, self.odom_turn_per_m)
