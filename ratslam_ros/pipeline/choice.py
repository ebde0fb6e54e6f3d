# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The choice of stages: those that a user runs, while other programs take the place of the rest.

It decides everything that depends on foreign stages: which stages share a process, and whether the
pose cells expect relocations. Only the odometry `auto` depends on who is found on the network.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from ratslam_ros.core.common.state import State
from ratslam_ros.errors import UnusableParameter

NAMES = 'visual_odometry', 'local_view', 'pose_cells', 'experience_map'
"""Names of all stages, in the direction of flow."""
DEFAULT = ','.join(NAMES[1:])
"""The stages of a robot that publishes its odometry, as users write them."""
TOPIC, CAMERA, AUTO = ODOMETRY = 'topic', 'camera', 'auto'
"""Where odometry comes from: the robot, visual_odometry, or what the process of local_view decides
when images have a publisher (ros/single_process.py)."""


def chosen_stages(text: str, odometry: str) -> tuple[str, ...]:
    """Return the chosen stages in the direction of flow.

    Args:
        text: their names, separated by commas.
        odometry: where it comes from, see ``ODOMETRY``; from the camera by visual_odometry.

    Raises:
        UnusableParameter: there is no such stage, or `auto` cannot add visual_odometry.
    """
    given = [*text.split(','), *(NAMES[:1] if odometry == CAMERA else ())]
    for name in given:
        if name not in NAMES:
            raise UnusableParameter(
                f'stages are {text!r}; expected some of {",".join(NAMES)}, separated by commas'
            )
    chosen = tuple(name for name in NAMES if name in given)
    if odometry == AUTO and chosen[0] != 'local_view':
        raise UnusableParameter(
            f'odometry auto adds visual_odometry before local_view; found the stages {text}: '
            'choose topic or camera'
        )
    return chosen


def decided_odometry(states: Mapping[str, State]) -> str:
    """Return what `auto` decided in the session that saved these states; '' if it did not."""
    settings = states.get('local_view', {}).get('settings', ())
    return next((one['UseOdometry'][0] for one in settings if 'UseOdometry' in one), '')


def neighbours(stages: Sequence[str]) -> list[tuple[str, ...]]:
    """Return the groups of stages between which none is missing: one pipeline can run a group."""
    groups: list[tuple[str, ...]] = []
    for name in stages:
        before = NAMES[NAMES.index(name) - 1]
        if groups and groups[-1][-1] == before:
            groups[-1] = (*groups[-1], name)
        else:
            groups.append((name,))
    return groups
