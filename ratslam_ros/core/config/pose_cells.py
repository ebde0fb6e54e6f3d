# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The parameters of the pose cells."""

from __future__ import annotations

from dataclasses import dataclass

from ratslam_ros.core.config.inputs import OdometryInput
from ratslam_ros.core.config.parameter import parameter
from ratslam_ros.errors import UnusableParameter

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
