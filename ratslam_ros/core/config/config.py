# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The complete configuration, and lookup of parameters by name."""

from __future__ import annotations

import difflib
from collections.abc import Mapping
from dataclasses import dataclass, field, fields, replace
from typing import Any, Self

from ratslam_ros.core.config.experience_map import ExperienceMapParameters
from ratslam_ros.core.config.goal_follower import GoalFollowerParameters
from ratslam_ros.core.config.goal_memory import GoalMemoryParameters
from ratslam_ros.core.config.goal_recall import GoalRecallParameters
from ratslam_ros.core.config.landmark_map import LandmarkMapParameters
from ratslam_ros.core.config.line_extraction import LineExtractionParameters
from ratslam_ros.core.config.local_view import LocalViewParameters
from ratslam_ros.core.config.parameter import Section, Value
from ratslam_ros.core.config.pose_cells import PoseCellsParameters
from ratslam_ros.core.config.visual_odometry import VisualOdometryParameters
from ratslam_ros.errors import UnusableParameter

SHARED = 'odom_source', 'max_odom_gap_s', 'odom_rotation_gain', 'odom_turn_per_m'
SHARING = 'pose_cells', 'experience_map'
"""Parameters that must have the same value in several sections, and these sections."""


REMOVED = {
    name: 'pose_cells' for name in ('pc_vt_agree_mean', 'pc_vt_agree_near', 'exp_place_offset')
}
"""Parameters of earlier versions, and their sections. Files that set them are read, with a notice;
docs/algorithm.md, "Ablation", has the reasons."""


@dataclass(frozen=True)
class Config:
    """All parameters, one section for each core module."""

    visual_odometry: VisualOdometryParameters = field(default_factory=VisualOdometryParameters)
    local_view: LocalViewParameters = field(default_factory=LocalViewParameters)
    pose_cells: PoseCellsParameters = field(default_factory=PoseCellsParameters)
    goal_memory: GoalMemoryParameters = field(default_factory=GoalMemoryParameters)
    experience_map: ExperienceMapParameters = field(default_factory=ExperienceMapParameters)
    goal_recall: GoalRecallParameters = field(default_factory=GoalRecallParameters)
    goal_follower: GoalFollowerParameters = field(default_factory=GoalFollowerParameters)
    landmark_map: LandmarkMapParameters = field(default_factory=LandmarkMapParameters)
    line_extraction: LineExtractionParameters = field(default_factory=LineExtractionParameters)

    def __post_init__(self) -> None:
        for name in SHARED:
            values = [getattr(getattr(self, section), name) for section in SHARING]
            if values[0] != values[1]:
                raise UnusableParameter(
                    f'pose_cells.{name} and experience_map.{name} are {values[0]} and '
                    f'{values[1]}; expected equal values, so that the map and the pose cells use '
                    'the same motion: set both'
                )

    def with_values(self, values: Mapping[str, Value]) -> Self:
        """Return a copy with new values, given by ``section.name``.

        All values are validated together, so that values that depend on each other can be changed
        at once.

        Raises:
            UnusableParameter: a section or name is unknown (the message lists the closest known
                ones), or a value has the wrong type or is out of range.
        """
        changes: dict[str, dict[str, Value]] = {}
        for key, value in values.items():
            for section, name in _targets(key):
                changes.setdefault(section, {})[name] = value
        sections = {
            section: _replaced(section, getattr(self, section), change)
            for section, change in changes.items()
        }
        return replace(self, **sections)

    def check_change(self, new: Config) -> None:
        """Check that a system that was created with these values can continue with others.

        Raises:
            UnusableParameter: as ``Section.check_change``.
        """
        for item in fields(self):
            try:
                getattr(self, item.name).check_change(getattr(new, item.name))
            except UnusableParameter as error:
                raise UnusableParameter(f'{item.name}.{error}') from None

    def values(self) -> dict[str, dict[str, Value]]:
        """Return all values as ``{section: {name: value}}``, in declared order."""
        return {
            item.name: {
                name: getattr(getattr(self, item.name), name)
                for name, _, _ in getattr(self, item.name).parameters()
            }
            for item in fields(self)
        }


def with_shared(values: Mapping[str, Value]) -> dict[str, Value]:
    """Return values, given by ``section.name``, where one section has the shared ones of another.

    Nodes, and the files that they write, have values of their own sections only.
    """
    result = dict(values)
    for name in SHARED:
        keys = [f'{section}.{name}' for section in SHARING]
        for key in keys:
            if key in values:
                result = {**dict.fromkeys(keys, values[key]), **result}
    return result


def _replaced(section: str, old: Any, change: Mapping[str, Value]) -> Any:
    try:
        return replace(old, **change)
    except UnusableParameter as error:
        raise UnusableParameter(f'{section}.{error}') from None


SECTIONS: dict[str, type[Section]] = {
    'visual_odometry': VisualOdometryParameters,
    'local_view': LocalViewParameters,
    'pose_cells': PoseCellsParameters,
    'goal_memory': GoalMemoryParameters,
    'experience_map': ExperienceMapParameters,
    'goal_recall': GoalRecallParameters,
    'goal_follower': GoalFollowerParameters,
    'landmark_map': LandmarkMapParameters,
    'line_extraction': LineExtractionParameters,
}
"""Class of each section, in the order of config.yaml."""


def section_of(name: str) -> str | None:
    """Return the first section that has a parameter of this name, or None."""
    if name == 'pc_dim_xy':
        return 'pose_cells'
    for section, cls in SECTIONS.items():
        if name in {parameter for parameter, _, _ in cls.parameters()}:
            return section
    return None


def _targets(key: str) -> list[tuple[str, str]]:
    """Return the (section, name) pairs that a ``section.name`` key stands for."""
    section, _, name = key.partition('.')
    if section not in SECTIONS:
        guess = section_of(name or section)
        hint = f'did you mean {guess}.{name or section}?' if guess else (
            f'the sections are {", ".join(SECTIONS)}'
        )
        raise UnusableParameter(f'{key!r} names no parameter; expected section.name: {hint}')
    if key == 'pose_cells.pc_dim_xy':
        return [('pose_cells', 'pc_dim_x'), ('pose_cells', 'pc_dim_y')]
    known = [item for item, _, _ in SECTIONS[section].parameters()]
    if REMOVED.get(name) == section:
        raise UnusableParameter(f'{key} was removed in this version: leave it out')
    if name not in known:
        elsewhere = section_of(name)
        close = difflib.get_close_matches(name, known, 3, 0.5) or known
        hint = f'did you mean {elsewhere}.{name}?' if elsewhere else (
            f'the nearest known: {", ".join(close)}'
        )
        raise UnusableParameter(f'{section} has no parameter {name!r}; {hint}')
    return [(section, name)]
