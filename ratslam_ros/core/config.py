# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Every parameter, once: name, unit, range, default and effect.

YAML files, ``--set``, the ROS parameter descriptors and docs/parameters.md are made from these
dataclasses. Names follow OpenRatSLAM's (Ball et al. 2013), so that its configurations carry over.
"""

from __future__ import annotations

import difflib
from collections.abc import Mapping
from dataclasses import dataclass, field, fields, replace
from typing import Any, Self

from ratslam_ros.core.goal_config import GoalRecallParameters
from ratslam_ros.core.goal_memory_config import GoalMemoryParameters
from ratslam_ros.core.live_config import LiveInput
from ratslam_ros.core.movement_config import GoalFollowerParameters
from ratslam_ros.core.section import ParameterInfo, Section, Value, parameter
from ratslam_ros.errors import UnusableParameter

__all__ = ['GoalRecallParameters', 'ParameterInfo', 'Section', 'Value', 'parameter']

WHOLE = -1  # an upper image bound of -1 means: to the edge of the image


_CROP_MAX = 'px; -1: to the edge of the image'


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


@dataclass(frozen=True)
class VisualOdometryParameters(ImageInput):
    """Speed and turn rate from the camera alone."""

    vtrans_image_x_min: int = parameter(
        0, 'px', 0, 65535, 'Left edge of the window that speed is measured in.',
        'the robot itself is seen at the left', 'more of the scene should count')  # fmt: skip
    vtrans_image_x_max: int = parameter(
        WHOLE, _CROP_MAX, WHOLE, 65535, 'Right edge (exclusive) of the speed window.',
        'more of the scene should count', 'the robot itself is seen at the right')  # fmt: skip
    vtrans_image_y_min: int = parameter(
        0, 'px', 0, 65535, 'Upper edge of the speed window.',
        'sky or far walls, which hardly move, dilute the speed',
        'the ground close by is blurred')  # fmt: skip
    vtrans_image_y_max: int = parameter(
        WHOLE, _CROP_MAX, WHOLE, 65535, 'Lower edge (exclusive) of the speed window.',
        'the ground is not seen enough', 'the robot itself is seen below')  # fmt: skip
    vrot_image_x_min: int = parameter(
        0, 'px', 0, 65535, 'Left edge of the window that the turn rate is measured in.',
        'the robot itself is seen at the left', 'fast turns exceed the window')  # fmt: skip
    vrot_image_x_max: int = parameter(
        WHOLE, _CROP_MAX, WHOLE, 65535, 'Right edge (exclusive) of the turn window.',
        'fast turns exceed the window', 'the robot itself is seen at the right')  # fmt: skip
    vrot_image_y_min: int = parameter(
        0, 'px', 0, 65535, 'Upper edge of the turn window.',
        'an empty ceiling or sky dilutes the profile',
        'far things, which turn without moving, are cut off')  # fmt: skip
    vrot_image_y_max: int = parameter(
        WHOLE, _CROP_MAX, WHOLE, 65535, 'Lower edge (exclusive) of the turn window.',
        'far things, which turn without moving, are cut off',
        'the ground, which moves with speed, disturbs the turn rate')  # fmt: skip
    camera_fov_deg: float = parameter(
        50.0, 'deg', 1.0, 360.0, 'Horizontal field of view of the whole image.',
        'measured turns are too small', 'measured turns are too large')  # fmt: skip
    camera_hz: float = parameter(
        10.0, 'Hz', 0.01, 1000.0,
        'The frame rate that vtrans_scaling was chosen at; time itself comes from the stamps.',
        'the speed is too high', 'the speed is too low')  # fmt: skip
    vtrans_scaling: float = parameter(
        100.0, 'm/s per unit of profile difference', 0.0, 1e6,
        'Speed for a given change of the image.', 'the map is too small',
        'the map is too large')  # fmt: skip
    vtrans_max: float = parameter(
        20.0, 'm/s', 0.0, 1000.0, 'Largest speed believed.', 'fast driving is cut off',
        'changes of light give bursts of speed')  # fmt: skip
    fov_from_camera_info: bool = parameter(
        True, '', 0, 1,
        'Take the field of view from camera_info, where it is recorded or published. Live, images '
        'wait for the first one.',
        'the camera is calibrated', 'camera_info is wrong',
    )  # fmt: skip
    publish_tf: bool = parameter(
        False, '', 0, 1, 'Live only: publish odom_frame -> base_frame on /tf.',
        'nothing else publishes it', 'the robot publishes it')  # fmt: skip
    odom_frame: str = parameter(
        'odom', '', 0, 0, 'Live only: frame of the integrated pose.',
        'set to the name that the robot uses', 'leave as it is where nothing else names it',
    )  # fmt: skip
    base_frame: str = parameter(
        'base_link', '', 0, 0, 'Live only: frame of the robot.',
        'set to the name that the robot uses', 'leave as it is where nothing else names it',
    )  # fmt: skip


@dataclass(frozen=True)
class LocalViewParameters(ImageInput, Memory):
    """What a view is reduced to, and when it counts as seen before."""

    image_crop_x_min: int = parameter(
        0, 'px', 0, 65535, 'Left edge of the part of the image that is compared.',
        'the robot itself is seen at the left', 'more of the scene should count')  # fmt: skip
    image_crop_x_max: int = parameter(
        WHOLE, _CROP_MAX, WHOLE, 65535, 'Right edge (exclusive) of that part.',
        'more of the scene should count', 'the robot itself is seen at the right')  # fmt: skip
    image_crop_y_min: int = parameter(
        0, 'px', 0, 65535, 'Upper edge of that part.',
        'sky or ceiling carry no information', 'landmarks are cut off')  # fmt: skip
    image_crop_y_max: int = parameter(
        WHOLE, _CROP_MAX, WHOLE, 65535, 'Lower edge (exclusive) of that part.',
        'landmarks are cut off', 'the robot itself or plain floor is seen below')  # fmt: skip
    template_x_size: int = parameter(
        60, 'px', 1, 1024, 'Width of a template.', 'different places look alike',
        'small differences of the path spoil recognition')  # fmt: skip
    template_y_size: int = parameter(
        10, 'px', 1, 1024, 'Height of a template.', 'different places look alike',
        'pitching of the camera spoils recognition')  # fmt: skip
    vt_match_threshold: float = parameter(
        0.03, 'mean difference', 0.0, 1.0,
        'A view at most this different from a template is recognised as that template.',
        'known places are not recognised (ratslam tune proposes a value)',
        'different places are confused')  # fmt: skip
    vt_shift_match: int = parameter(
        5, 'template px', 0, 511, 'Horizontal shifts tried to either side (forward camera).',
        'the robot passes places at other headings or lanes', 'different places look alike',
    )  # fmt: skip
    vt_shift_fov_deg: float = parameter(
        0.0, 'deg; 0: no', 0.0, 180.0,
        'Angle that the template shows, after cropping: the shift at which a view fits then tells '
        'how the robot is turned against when the template was learned (forward camera).',
        'set to the angle where shifts are turns: a camera on the axis of a robot among walls',
        'set to 0 where shifts are lanes, as on a road; 0 is as OpenRatSLAM',
    )  # fmt: skip
    vt_step_match: int = parameter(
        1, 'template px', 1, 511, 'Step between the shifts tried.', 'matching is too slow',
        'recognition misses views between the steps')  # fmt: skip
    vt_shift_match_y: int = parameter(
        0, 'template px', 0, 511, 'Vertical shifts tried to either side.',
        'the camera pitches, or passes places nearer or further', 'different places look alike',
    )  # fmt: skip
    vt_recent_templates: int = parameter(
        0, 'templates; 0: off', 0, 100_000,
        'This many of the newest templates are recognised only by vt_recent_threshold.',
        'standing or slow driving names old templates in place of learning new ones',
        'a loop is shorter than this many templates')  # fmt: skip
    vt_recent_threshold: float = parameter(
        0.5, 'share of vt_match_threshold', 0.0, 1.0,
        'The threshold of the newest templates: how finely a new stretch is learned.',
        'too many templates are learned', 'a template covers too long a stretch')  # fmt: skip
    vt_normalisation: float = parameter(
        0.0, 'mean brightness; 0: off', 0.0, 1.0, 'Scale every view to this mean brightness.',
        'the brightness of the whole image varies', 'bright parts are cut off at white',
    )  # fmt: skip
    vt_patch_normalise: int = parameter(
        0, 'template px; 0: off', 0, 128,
        'Normalise each pixel by mean and deviation of the patch this far around it.',
        'shadows or local light vary', 'noise in plain areas is blown up')  # fmt: skip
    vt_min_patch_normalisation_std: float = parameter(
        0.0, 'of brightness 0 to 1', 0.0, 1.0,
        'Patches with a deviation below this count as plain (0.5).',
        'noise in plain areas is blown up', 'faint texture should count')  # fmt: skip
    vt_panoramic: bool = parameter(
        False, '', 0, 1, 'The camera sees the full circle: compare at every turn of the view.',
        'the camera is panoramic', 'the camera looks forward')  # fmt: skip
    vt_exact_error: bool = parameter(
        True, '', 0, 1, 'Find the least error of an unknown view too; else it is told as -1.',
        'you look at how near unknown views came to the threshold',
        'there are hundreds of thousands of templates: only the error of unknown views is lost'
    )  # fmt: skip

    def __post_init__(self) -> None:
        super().__post_init__()
        if not self.vt_panoramic and 2 * self.vt_shift_match >= self.template_x_size:
            raise UnusableParameter(
                f'vt_shift_match is {self.vt_shift_match}; expected less than half of '
                f'template_x_size ({self.template_x_size}), so that something is left to compare'
            )
        if 2 * self.vt_shift_match_y >= self.template_y_size:
            raise UnusableParameter(
                f'vt_shift_match_y is {self.vt_shift_match_y}; expected less than half of '
                f'template_y_size ({self.template_y_size}), so that something is left to compare'
            )


LEAST_EXP_MAX = 20


@dataclass(frozen=True)
class PoseCellsParameters(OdometryInput):
    """The continuous attractor network that filters place, and what the views do to it."""

    pc_dim_x: int = parameter(
        21, 'cells', 1, 100_000, 'Extent along x; the cells wrap round. pc_dim_xy sets x and y.',
        'distant places are confused', 'the activity picture is too large')  # fmt: skip
    pc_dim_y: int = parameter(
        21, 'cells', 1, 100_000, 'Extent along y; the cells wrap round.',
        'distant places are confused', 'the activity picture is too large')  # fmt: skip
    pc_dim_th: int = parameter(
        36, 'cells', 1, 3600, 'Number of headings; 36 gives 10 degrees each.',
        'headings must be told apart more finely', 'headings are too finely divided',
    )  # fmt: skip
    pc_w_e_dim: int = parameter(
        7, 'cells, odd', 1, 99, 'Width of the excitatory kernel.',
        'packets fall apart', 'steps cost too much')  # fmt: skip
    pc_w_e_var: float = parameter(
        1.0, 'cells', 0.01, 50.0, 'Deviation of the excitatory kernel.',
        'packets are too sharp', 'packets are too wide')  # fmt: skip
    pc_w_i_dim: int = parameter(
        5, 'cells, odd', 1, 99, 'Width of the inhibitory kernel.',
        'neighbouring packets live side by side', 'steps cost too much')  # fmt: skip
    pc_w_i_var: float = parameter(
        2.0, 'cells', 0.01, 50.0, 'Deviation of the inhibitory kernel.',
        'inhibition should reach further', 'inhibition should stay near')  # fmt: skip
    pc_global_inhib: float = parameter(
        0.00002, 'activity', 0.0, 1.0, 'Taken from every cell at each step.',
        'weak packets live too long', 'a new place wins too quickly')  # fmt: skip
    pc_cell_x_size: float = parameter(
        1.0, 'm', 1e-4, 1e4, 'Side of a pose cell on the ground.',
        'the robot is fast or the odometry poor: places are not linked',
        'close places must be told apart')  # fmt: skip
    vt_active_decay: float = parameter(
        1.0, '', 0.0, 100.0, 'How much a template tires each time that it is seen on end.',
        'a robot at rest is pulled to wrong places', 'recognition acts too weakly')  # fmt: skip
    pc_vt_inject_energy: float = parameter(
        0.15, 'activity', 0.0, 100.0, 'Energy that a recognised view injects.',
        'known places are recognised but loops do not close',
        'single wrong recognitions move the packet')  # fmt: skip
    pc_vt_restore: float = parameter(
        0.05, 'per template message', 0.0, 100.0, 'How fast a tired template recovers.',
        'places seen again soon have no effect', 'a robot at rest is pulled to wrong places',
    )  # fmt: skip
    pc_vt_agree_views: float = parameter(
        3.0, 'views; 0: off', 0.0, 100.0,
        'A recognised view injects its energy times the 4th power of (recent views that agree '
        'with its place, less those that agree with the present one) / this. 0: always its '
        'energy, as in OpenRatSLAM.',
        'wrong recognitions bend the map', 'short revisits are not linked')  # fmt: skip
    pc_vt_agree_cells: float = parameter(
        3.0, 'cells', 0.0, 1000.0, 'Places that views claim agree within this distance.',
        'odometry or views are imprecise against the cells', 'neighbouring places are confused',
    )  # fmt: skip
    pc_vt_agree_spacing: float = parameter(
        2.0, 'cells', 0.0, 1000.0,
        'Way (and a quarter of the turn, in planes) between views that count as two that agree.',
        'places that look alike for a stretch bend the map', 'short revisits are not linked',
    )  # fmt: skip
    pc_vt_agree_recent: int = parameter(
        8, 'views', 1, 1000,
        'How many recognised views, a spacing apart, are remembered for this.',
        'right recognitions are rare among wrong ones', 'repetitive places agree by chance',
    )  # fmt: skip
    pc_vt_agree_near: float = parameter(
        0.0, 'cells; 0: off', 0.0, 1e6,
        'A view that claims a place nearer than this to the present one, by the odometry since a '
        'known place, needs fewer others that agree, in proportion, at least 2.',
        'ways are mapped a second time beside themselves', 'neighbouring places are confused',
    )  # fmt: skip
    exp_delta_pc_threshold: float = parameter(
        2.0, 'cells', 0.01, 1000.0,
        'A place further than this from the current experience, in pose cells, is another one.',
        'loops are seen but not linked; there are too many experiences',
        'the map is too coarse or wrong places are linked')  # fmt: skip
    exp_current_by: str = parameter(
        'delta', '', 0, 0,
        'Which experience of the view becomes current: delta, the nearest within '
        'exp_delta_pc_threshold once the view or the place has changed; activity, always the most '
        'active one (docs/algorithm.md).',
        'leave at delta', 'set to activity to compare with the papers',
        choices=('delta', 'activity'),
    )  # fmt: skip
    exp_activity_xy: float = parameter(
        2.0, 'cells', 0.01, 1000.0,
        'Distance along x and y at which an experience is active no more, r_a in the paper.',
        'few experiences are active', 'experiences far from the peak are active')  # fmt: skip
    exp_activity_th: float = parameter(
        2.0, 'cells', 0.01, 1000.0,
        'Difference of heading at which an experience is active no more, theta_a in the paper.',
        'few experiences are active', 'experiences of other headings are active')  # fmt: skip
    exp_activity_threshold: float = parameter(
        0.0, 'activity', 0.0, 2.0,
        'If exp_current_by is activity: a new experience is made where none is more active.',
        'the map is too coarse', 'there are too many experiences')  # fmt: skip
    exp_max: int = parameter(
        0, 'experiences; 0: any number', 0, 100_000_000,
        'With so many, each new experience takes the number of an old one that is forgotten: of '
        'those visited once, or else least often, the one that was visited longest ago.',
        'places are forgotten that are still needed', 'the map outgrows memory or time',
    )  # fmt: skip

    def __post_init__(self) -> None:
        super().__post_init__()
        if 0 < self.exp_max < LEAST_EXP_MAX:
            raise UnusableParameter(
                f'exp_max is {self.exp_max}; expected 0 (any number) or at least {LEAST_EXP_MAX}, '
                'so that what the robot has just come by is kept'
            )
        for name in ('pc_w_e_dim', 'pc_w_i_dim'):
            if getattr(self, name) % 2 == 0:
                raise UnusableParameter(
                    f'{name} is {getattr(self, name)}; expected an odd number of cells, '
                    'so that the kernel has a middle'
                )


@dataclass(frozen=True)
class ExperienceMapParameters(OdometryInput):
    """The graph of experiences, and how it is relaxed."""

    exp_relaxation: str = parameter(
        'solve', '', 0, 0,
        'Solve for the poses at which all links are in balance, or go towards them by sweeps from '
        'link to link, exp_loops after each action, as OpenRatSLAM does.',
        'leave at solve', 'set to sweep to compare with OpenRatSLAM',
        choices=('solve', 'sweep'),
    )  # fmt: skip
    exp_correction: float = parameter(
        0.5, 'share of the error', 0.0, 0.5,
        "Share of a link's error that each end takes in a sweep; 0: the map is not relaxed.",
        'loops close too slowly', 'the map is restless')  # fmt: skip
    exp_loops: int = parameter(
        10, 'sweeps', 0, 10_000,
        'Sweeps over all links after each action, if exp_relaxation is sweep; 0: the map is not '
        'relaxed.',
        'loops close too slowly', 'large maps cost too much')  # fmt: skip
    exp_align_scans: bool = parameter(
        False, '', 0, 1,
        'Where there is a laser: places that the camera recognises are brought onto each other by '
        'their scans. Not in the papers.',
        'goals are reached half a metre beside where they are, and the robot has a laser',
        'the map shall hang on camera and odometry alone')  # fmt: skip
    exp_jump_drift: float = parameter(
        0.0, 'm per m; 0: all are believed', 0.0, 100.0,
        'A recognition that would move the robot on the map by more than 1 m and this share of '
        'the way, or turn it by more than 34 degrees and twice this in rad, is believed only '
        'after two metres, and makes no link. Not in the papers.',
        'loops are seen but not closed', 'places that look alike are taken for each other',
    )  # fmt: skip
    exp_confidence_threshold: float = parameter(
        0.25, 'share of the tries', 0.0, 1.0,
        'A link is unlearned when its confidence, the share of tries in which its transition was '
        'made, falls below this; 0: never. Only behaviours that have names are tries.',
        'the robot tries blocked ways for too long', 'ways are given up for people who pass',
    )  # fmt: skip
    exp_min_tries: int = parameter(
        8, 'tries', 1, 1_000_000,
        'A link is not unlearned before its behaviour has led elsewhere so many times since the '
        'link was last made; time-outs count at once.',
        'links between places that take turns are unlearned', 'wrong links stay for too long',
    )  # fmt: skip
    exp_recent_tries: int = parameter(
        3, 'times', 1, 1_000_000,
        'Times that a link was made that count against time-outs, at most: what was long ago is '
        'forgotten. With a threshold of 0.25 a link made once is unlearned by 4 time-outs, one '
        'made 3 times or more by 10.',
        'ways are given up for people who pass', 'the robot tries blocked ways for too long',
    )  # fmt: skip
    exp_try_radius_m: float = parameter(
        1.0, 'm', 0.01, 1000.0,
        'A time-out counts for the links that lead ahead within this distance of the robot.',
        'links beside an obstacle survive it', 'ways past an obstacle are unlearned with it',
    )  # fmt: skip
    exp_initial_em_deg: float = parameter(
        90.0, 'deg', -360.0, 360.0, 'Heading of the robot on the map at the start.',
        'the map should be turned counter-clockwise',
        'the map should be turned clockwise')  # fmt: skip
    map_frame: str = parameter(
        'map', '', 0, 0, 'Frame of the map, its poses and its routes.',
        'set to a name of its own for each robot that shares a TF tree',
        'leave as it is for a single robot',
    )  # fmt: skip
    odom_frame: str = parameter(
        'odom', '', 0, 0, 'Live only: frame of the odometry; map_frame -> odom_frame is on /tf.',
        'set to the name that the robot uses', 'leave as it is where nothing else names it',
    )  # fmt: skip
    base_frame: str = parameter(
        'base_link', '', 0, 0, 'Live only: frame of the robot, in which a goal may be given.',
        'set to the name that the robot uses', 'leave as it is where nothing else names it',
    )  # fmt: skip
    publish_tf: bool = parameter(
        True, '', 0, 1, 'Live only: publish map_frame -> odom_frame on /tf.',
        'RViz should show the robot on the map', 'something else locates the robot on the map',
    )  # fmt: skip
    map_period_s: float = parameter(
        1.0, 's', 0.0, 3600.0,
        'Live only: least time between two messages with the whole map; the last is always sent.',
        'large maps take too much of the network', 'the map should be shown sooner',
    )  # fmt: skip


@dataclass(frozen=True)
class Config:
    """All parameters, a section for each of the five core modules."""

    visual_odometry: VisualOdometryParameters = field(default_factory=VisualOdometryParameters)
    local_view: LocalViewParameters = field(default_factory=LocalViewParameters)
    pose_cells: PoseCellsParameters = field(default_factory=PoseCellsParameters)
    goal_memory: GoalMemoryParameters = field(default_factory=GoalMemoryParameters)
    experience_map: ExperienceMapParameters = field(default_factory=ExperienceMapParameters)
    goal_recall: GoalRecallParameters = field(default_factory=GoalRecallParameters)
    goal_follower: GoalFollowerParameters = field(default_factory=GoalFollowerParameters)

    def __post_init__(self) -> None:
        sources = self.pose_cells.odom_source, self.experience_map.odom_source
        if sources[0] != sources[1]:
            raise UnusableParameter(
                'pose_cells.odom_source and experience_map.odom_source are '
                f'{sources[0]} and {sources[1]}; expected the same, or the map would not be that '
                'of the pose cells: set both'
            )

    def with_values(self, values: Mapping[str, Value]) -> Self:
        """Return a copy with ``section.name`` keys set; all or nothing.

        Raises:
            UnusableParameter: an unknown section or name (the nearest known ones are told), or a
                value of the wrong type or out of range.
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

    def values(self) -> dict[str, dict[str, Value]]:
        """Return every value as ``{section: {name: value}}`` in declared order."""
        return {
            item.name: {
                name: getattr(getattr(self, item.name), name)
                for name, _, _ in getattr(self, item.name).parameters()
            }
            for item in fields(self)
        }


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
}

SETTABLE = frozenset(
    {
        'watchdog_after_s', 'on_jump_back', 'flush_after_s', 'publish_tf', 'map_period_s',
        'goal_tolerance_m', 'memory_folder', 'goal_radius_m', 'goal_timeout_s',
        'goal_timeout_factor', 'goal_timeout_least_s', 'goal_explore_s', 'route_keep_s',
        'route_switch_s', 'route_width_m', 'waypoint_ahead_m', 'explore',
    }
)  # fmt: skip
"""What a node lets be set while it runs. All else decides what the map becomes: one map is made
with one set of values."""


def section_of(name: str) -> str | None:
    """Return the first section that has a parameter of this name, None if there is none."""
    if name == 'pc_dim_xy':
        return 'pose_cells'
    for section, cls in SECTIONS.items():
        if name in {known for known, _, _ in cls.parameters()}:
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
    if name not in known:
        elsewhere = section_of(name)
        close = difflib.get_close_matches(name, known, 3, 0.5) or known
        hint = f'did you mean {elsewhere}.{name}?' if elsewhere else (
            f'the nearest known: {", ".join(close)}'
        )
        raise UnusableParameter(f'{section} has no parameter {name!r}; {hint}')
    return [(section, name)]
