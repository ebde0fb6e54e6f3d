# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Definition of every parameter: name, unit, range, default and effect; and the configuration.

YAML files, ``--set``, the ROS parameter descriptors and docs/parameters.md are derived from the
dataclasses of the sections. Names follow OpenRatSLAM (Ball et al. 2013), so that its
configurations can be used.
"""

from __future__ import annotations

import difflib
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field, fields, replace
from typing import Any, Self, cast

from ratslam_ros.core.config.experience_map import ExperienceMapParameters
from ratslam_ros.core.config.goal_follower import GoalFollowerParameters
from ratslam_ros.core.config.goal_memory import GoalMemoryParameters
from ratslam_ros.core.config.goal_recall import GoalRecallParameters
from ratslam_ros.core.config.inputs import InputParameters
from ratslam_ros.core.config.landmark_map import LandmarkMapParameters
from ratslam_ros.core.config.local_view import LocalViewParameters
from ratslam_ros.core.config.memory import MemoryParameters
from ratslam_ros.core.config.parameter import (
    AUTOMATIC,
    WHOLE,
    ParameterInfo,
    Section,
    Value,
    parameter,
)
from ratslam_ros.core.config.pose_cells import LEAST_EXP_MAX, PoseCellsParameters
from ratslam_ros.core.config.visual_odometry import VisualOdometryParameters
from ratslam_ros.errors import UnusableParameter

__all__ = [
    'AUTOMATIC', 'DECLARATIONS', 'LEAST_EXP_MAX', 'REMOVED', 'SECTIONS', 'SHARED', 'WHOLE',
    'Config', 'ExperienceMapParameters', 'GoalFollowerParameters', 'GoalMemoryParameters',
    'GoalRecallParameters', 'InputParameters', 'LandmarkMapParameters',
    'LocalViewParameters', 'MemoryParameters', 'ParameterInfo',
    'PoseCellsParameters', 'Section', 'Value', 'VisualOdometryParameters', 'declared',
    'parameter', 'removal', 'section_of', 'stored_values',
]

SHARED = 'inputs', 'memory'
"""Sections that all parts use. Nodes declare these parameters beside their own, by plain names,
and files may set them in any section."""

ALIASES = {
    'pose_cells.pc_dim_xy': ('pose_cells.pc_dim_x', 'pose_cells.pc_dim_y'),
    **{
        f'local_view.image_vt_{axis}_range_{end}': (f'local_view.image_crop_{axis}_{end}',)
        for axis in 'xy' for end in ('min', 'max')
    },
}
"""Further names, and the parameters that they set: ``pc_dim_xy`` of OpenRatSLAM, and the crop as
its Python port names it."""

_NO_EFFECT = 'had no effect on maps (docs/algorithm.md, "Ablation"); leave it out'
_CONSTANT = 'is a constant now; leave it out'
_COVARIANCE = 'follows from the covariance of the pose now; leave it out'
REMOVED = {
    **dict.fromkeys(('pc_vt_agree_mean', 'pc_vt_agree_near', 'exp_place_offset'), _NO_EFFECT),
    **dict.fromkeys((
        'goal_timeout_factor', 'goal_timeout_least_s', 'goal_explore_s', 'route_keep_s',
        'route_width_m', 'waypoint_ahead_m',
        'wall_distance_most_m', 'wall_look_ahead_m', 'route_ahead_m', 'try_timeout_s',
        'look_back_every_m', 'look_back_turn_deg', 'look_back_m', 'change_wall_every_s',
        'explore_seed',
        'goal_memory_step_cells', 'goal_memory_active_share', 'goal_memory_eta_tau',
        'goal_memory_eta_chi', 'goal_memory_eta_delta', 'goal_memory_search_cells',
        'goal_memory_reached_cells', 'exp_min_tries', 'grid_period_s', 'grid_cell_m',
        'pc_vt_agree_recent', 'forget_robust_visits',
        'lm_odom_position_sd_m', 'lm_odom_drift_sd_rad', 'lm_odom_turn_sd_rad', 'lm_range_sd_m',
        'lm_bearing_sd_rad', 'lm_direction_sd_rad', 'lm_length_sd_m', 'lm_outlier_probability',
        'lm_repeat_m', 'lm_local_m', 'landmark_map.map_period_s',
        'le_range_sd_m', 'le_wall_sd_m', 'le_min_length_m', 'le_max_range_m', 'le_interval_m',
    ), _CONSTANT),
    'landmark_map.max_odom_gap_s': 'is always off now; leave it out',
    'landmark_map.odom_frame': 'is always that of the odometry messages; leave it out',
    'landmark_map.publish_tf': 'is always on now; leave it out',
    'wall_distance_m': 'follows from robot_radius_m now; leave it out',
    'vt_exact_error': 'is always on now; leave it out',
    'goal_timeout_s': 'is given with a goal now (docs/topics.md); leave it out',
    'route_unknown_m': 'is always off now; leave it out',
    'exp_jump_drift': 'is exp_gate_closures now, whose bound follows from the covariance of the '
                      'pose; set that to true if it was above 0',
    **dict.fromkeys(('goal_sure_m', 'try_unknown_m'), _COVARIANCE),
    **dict.fromkeys(('image_width', 'image_height'), 'is always that of the images; leave it out'),
    'pc_cells_to_avg': 'is always 3; leave it out',
}
"""Parameters of earlier versions and of OpenRatSLAM that do not exist here, and what to do about
them. Files and nodes that set them are read, with a notice. A name that other sections have is
given with its section."""


@dataclass(frozen=True)
class Config:
    """All parameters: the shared sections, and one section for each part."""

    inputs: InputParameters = field(default_factory=InputParameters)
    memory: MemoryParameters = field(default_factory=MemoryParameters)
    visual_odometry: VisualOdometryParameters = field(default_factory=VisualOdometryParameters)
    local_view: LocalViewParameters = field(default_factory=LocalViewParameters)
    pose_cells: PoseCellsParameters = field(default_factory=PoseCellsParameters)
    goal_memory: GoalMemoryParameters = field(default_factory=GoalMemoryParameters)
    experience_map: ExperienceMapParameters = field(default_factory=ExperienceMapParameters)
    goal_recall: GoalRecallParameters = field(default_factory=GoalRecallParameters)
    goal_follower: GoalFollowerParameters = field(default_factory=GoalFollowerParameters)
    landmark_map: LandmarkMapParameters = field(default_factory=LandmarkMapParameters)

    def with_values(self, values: Mapping[str, Value]) -> Self:
        """Return a copy with new values, given by ``section.name``.

        All values are validated together, so that values that depend on each other can be changed
        at once.

        Raises:
            UnusableParameter: a section or name is unknown (the message lists the closest known
                ones), a value has the wrong type or is out of range, or two sections give
                different values for a shared parameter.
        """
        changes: dict[str, dict[str, Value]] = {}
        given: dict[str, str] = {}
        for key, value in values.items():
            for target in _targets(key):
                section, _, name = target.partition('.')
                other = given.setdefault(target, key)
                if section in SHARED and values[other] != value:
                    raise UnusableParameter(
                        f'{other} is {values[other]!r} and {key} is {value!r}; expected one value '
                        f'for all parts: set {target} only'
                    )
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
        return asdict(self)

    def flat(self) -> dict[str, Value]:
        """Return all values by ``section.name``, in declared order."""
        return {
            f'{section}.{name}': value
            for section, values in self.values().items() for name, value in values.items()
        }


def _replaced(section: str, old: Any, change: Mapping[str, Value]) -> Any:
    try:
        return replace(old, **change)
    except UnusableParameter as error:
        raise UnusableParameter(f'{section}.{error}') from None


SECTIONS = {
    item.name: cast(type[Section], item.default_factory) for item in fields(Config)
}
"""Class of each section, in the order of config.yaml."""

DECLARATIONS: dict[str, tuple[ParameterInfo, Value]] = {
    f'{section}.{name}': (info, default)
    for section, cls in SECTIONS.items() for name, info, default in cls.parameters()
}
"""Metadata and default of every parameter, by ``section.name``."""


def declared(key: str) -> tuple[str, ...]:
    """Return the parameters, as ``section.name``, that a key sets; () if it is unknown.

    A shared parameter may be given with any section, as in files of earlier versions. Names may
    be written as in the Python port of OpenRatSLAM, VT-MATCH-THRESHOLD or VT_MATCH_THRESHOLD.
    """
    key = _spelled(key)
    section, _, name = key.partition('.')
    if key in REMOVED:
        return ()
    if key in DECLARATIONS:
        return (key,)
    if key in ALIASES:
        return ALIASES[key]
    shared = [f'{one}.{name}' for one in SHARED if section in SECTIONS]
    return tuple(one for one in shared if one in DECLARATIONS)


def _spelled(key: str) -> str:
    """Return a key in the spelling of the declarations."""
    return key.lower().replace('-', '_')


def removal(key: str) -> str | None:
    """Return what to do about a parameter in ``REMOVED``, with or without its section.

    None if the key is no such parameter.
    """
    key = _spelled(key)
    return None if declared(key) else REMOVED.get(key, REMOVED.get(key.rpartition('.')[2]))


def stored_values(values: Mapping[str, Any]) -> tuple[dict[str, Any], list[str]]:
    """Return values that this or another version has stored, by the present names, and notices.

    Removed parameters are left out. Sections of earlier versions may contradict each other in what
    is shared now. Then the value of the pose cells is used, which build the map.
    """
    found: dict[str, Any] = {}
    notices = []
    unknown = sorted(key for key in values if not declared(key) and removal(key) is None)
    if unknown:
        notices.append(f'unknown parameters are ignored: {", ".join(unknown)}')
    for key in sorted(values, key=lambda key: not key.startswith('pose_cells.')):
        for target in declared(key):
            if found.setdefault(target, values[key]) != values[key]:
                notices.append(f'{key} was {values[key]}, {found[target]} is used')
    return found, notices


def section_of(name: str) -> str | None:
    """Return the first section that has a parameter of this name, or None."""
    name = _spelled(name)
    for section in SECTIONS:
        if f'{section}.{name}' in DECLARATIONS or f'{section}.{name}' in ALIASES:
            return section
    return None


def _targets(key: str) -> tuple[str, ...]:
    """Return the parameters that a key stands for; raise UnusableParameter if it is unknown."""
    found = declared(key)
    if found:
        return found
    section, _, name = key.partition('.')
    advice = removal(key)
    if advice is not None:
        raise UnusableParameter(f'{key} is no parameter: it {advice}')
    if section not in SECTIONS:
        guess = section_of(name or section)
        hint = f'did you mean {guess}.{name or section}?' if guess else (
            f'the sections are {", ".join(SECTIONS)}'
        )
        raise UnusableParameter(f'{key!r} names no parameter; expected section.name: {hint}')
    elsewhere = section_of(name)
    known = [item for item, _, _ in SECTIONS[section].parameters()]
    close = difflib.get_close_matches(_spelled(name), known, 3, 0.5) or known
    hint = f'did you mean {elsewhere}.{name}?' if elsewhere else (
        f'the nearest known: {", ".join(close)}'
    )
    raise UnusableParameter(f'{section} has no parameter {name!r}; {hint}')
