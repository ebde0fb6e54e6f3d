# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Parameters of the pose cells."""

from __future__ import annotations

from dataclasses import dataclass

from ratslam_ros.core.config.parameter import Section, parameter
from ratslam_ros.errors import UnusableParameter

LEAST_EXP_MAX = 20
"""Smallest limit of the number of experiences, so that recent ones are never forgotten."""


@dataclass(frozen=True)
class PoseCellsParameters(Section):
    """The continuous attractor network that estimates the pose, and its correction by views."""

    odom_calibration: bool = parameter(
        True, '', 0, 1,
        'Estimate systematic errors of the turns that odometry measures from closed loops, and '
        'correct the odometry that follows; starts at odom_rotation_gain and odom_turn_per_m.',
        'wheels or the field of view of visual odometry are not calibrated',
        'the odometry is precise, or results must be those of OpenRatSLAM',
    )  # fmt: skip
    pc_dim_x: int = parameter(
        300, 'cells', 1, 100_000, 'Extent along x; the cells wrap around. pc_dim_xy sets x and y.',
        'distant places are confused', 'the activity picture is too large')  # fmt: skip
    pc_dim_y: int = parameter(
        300, 'cells', 1, 100_000, 'Extent along y; the cells wrap around.',
        'distant places are confused', 'the activity picture is too large')  # fmt: skip
    pc_dim_th: int = parameter(
        36, 'cells', 1, 3600, 'Number of heading planes; 36 gives 10 degrees each.',
        'headings must be resolved more finely', 'steps take too much computing time',
    )  # fmt: skip
    pc_w_e_dim: int = parameter(
        7, 'cells, odd', 1, 99, 'Width of the excitatory kernel.',
        'packets fall apart', 'steps take too much computing time')  # fmt: skip
    pc_w_e_var: float = parameter(
        1.0, 'cells', 0.01, 50.0, 'Standard deviation of the excitatory kernel.',
        'packets are too sharp', 'packets are too wide')  # fmt: skip
    pc_w_i_dim: int = parameter(
        5, 'cells, odd', 1, 99, 'Width of the inhibitory kernel.',
        'neighbouring packets persist side by side',
        'steps take too much computing time')  # fmt: skip
    pc_w_i_var: float = parameter(
        2.0, 'cells', 0.01, 50.0, 'Standard deviation of the inhibitory kernel.',
        'inhibition should reach further', 'inhibition should act locally')  # fmt: skip
    pc_global_inhib: float = parameter(
        0.00002, 'activity', 0.0, 1.0,
        'Global inhibition: activity subtracted from every cell at each step.',
        'weak packets persist too long', 'a new place wins too quickly')  # fmt: skip
    pc_lattice: str = parameter(
        'moving', '', 0, 0,
        'Path integration. moving: the lattice of each activity packet moves with the robot, so '
        'that the packet follows the odometry exactly. fixed: activity is shifted from cell to '
        'cell, as in the papers.',
        'leave at moving', 'set to fixed to compare with the papers',
        choices=('moving', 'fixed'),
    )  # fmt: skip
    pc_cell_x_size: float = parameter(
        -1.0, 'm', 1e-4, 1e4, 'Side length of a pose cell on the ground.',
        'the robot is fast or its odometry is poor, and places are not linked',
        'nearby places must be distinguished', automatic=True)  # fmt: skip
    vt_active_decay: float = parameter(
        1.0, '', 0.0, 100.0,
        'Habituation added to a template each time that it is seen again in succession.',
        'the pose of a stationary robot is pulled to wrong places',
        'recognition has too little effect',
        runtime='at next message',
    )  # fmt: skip
    pc_vt_inject_energy: float = parameter(
        0.15, 'activity', 0.0, 100.0, 'Activity that a recognised view injects.',
        'places are recognised but loops do not close',
        'single wrong recognitions move the activity packet',
        runtime='at next message',
    )  # fmt: skip
    pc_vt_learning_rate: float = parameter(
        0.0, 'per view; 0: one place for each template', 0.0, 1.0,
        'Rate of the Hebbian links between a template and all cells that are active when it is '
        'seen, as in Milford et al. (2005), who use 0.15. 0: the template is associated with the '
        'place at which it was learned, as in OpenRatSLAM.',
        'ambiguous views should be recalled by few sightings', 'views are shared by many places',
    )  # fmt: skip
    pc_vt_interpolate: bool = parameter(
        True, '', 0, 1,
        'Distribute the injected activity over the eight cells around the place; otherwise the '
        'nearest cell receives all of it, as in the papers.',
        'the pose should be precise', 'set to compare with the papers',
    )  # fmt: skip
    pc_vt_spare_newest: bool = parameter(
        True, '', 0, 1,
        'The ten newest templates inject nothing, because the robot is still near them. Not in '
        'the papers.',
        'a slow robot is pulled back to the view it has just learned',
        'set to compare with the papers',
    )  # fmt: skip
    pc_vt_restore: float = parameter(
        0.05, 'per template message', 0.0, 100.0,
        'Rate at which the habituation of a template decays.',
        'places that are soon seen again have no effect',
        'the pose of a stationary robot is pulled to wrong places',
        runtime='at next message',
    )  # fmt: skip
    pc_vt_agree_views: float = parameter(
        7.0, 'views; 0: off', 0.0, 100.0,
        'Number of recent views that must agree on a place. The injected energy is multiplied by '
        '((n - m) / this)^4, where n recent views agree with the place and m with the present '
        'estimate. 0: the energy is not weighted, as in OpenRatSLAM.',
        'wrong recognitions distort the map', 'short revisits are not linked',
        runtime='at next message',
    )  # fmt: skip
    pc_vt_agree_cells: float = parameter(
        -1.0, 'cells', 0.0, 1000.0,
        'Largest distance between the places that two agreeing views indicate.',
        'odometry or views are imprecise compared to the cells',
        'neighbouring places are confused', automatic=True,
        runtime='at next message',
    )  # fmt: skip
    pc_vt_agree_spacing: float = parameter(
        -1.0, 'cells', 0.0, 1000.0,
        'Smallest motion between two views that count separately: the distance plus a quarter of '
        'the turn in heading planes.',
        'places that look alike along a stretch distort the map', 'short revisits are not linked',
        automatic=True,
        runtime='at next message',
    )  # fmt: skip
    exp_delta_pc_threshold: float = parameter(
        -1.0, 'cells', 0.01, 1000.0,
        'Distance in the pose cells from the current experience at which another experience is '
        'created or becomes current.',
        'places are recognised but not linked, or there are too many experiences',
        'the map is too coarse, or wrong places are linked', automatic=True,
        runtime='at next message',
    )  # fmt: skip
    exp_view_links: bool = parameter(
        True, '', 0, 1,
        'Each recognised view links the current experience to the one of its template, and the '
        'robot creates experiences on known paths as well, exp_delta_pc_threshold apart. Links '
        'are weighted by their precision, and recognitions that contradict the others have little '
        'weight. Not in the papers.',
        'the map should be as precise as possible',
        'the map must not grow on known paths, or a robot follows routes on it',
    )  # fmt: skip
    exp_weigh_links: bool = parameter(
        False, '', 0, 1,
        'As exp_view_links, but the robot creates no experiences on known paths: links are '
        'weighted by their precision, recognitions that contradict the others have little '
        'weight, and the noise of the odometry is measured. Not in the papers.',
        'a robot without a laser follows routes on the map',
        'the results should be those of the papers',
    )  # fmt: skip
    exp_current_by: str = parameter(
        'delta', '', 0, 0,
        'Selection of the current experience among those of the recognised template. delta: the '
        'nearest within exp_delta_pc_threshold, once the template or the place has changed. '
        'activity: always the most active one (docs/algorithm.md).',
        'leave at delta', 'set to activity to compare with the papers',
        choices=('delta', 'activity'),
    )  # fmt: skip
    exp_activity_xy: float = parameter(
        2.0, 'cells', 0.01, 1000.0,
        'Distance along x and y at which the activity of an experience reaches zero: r_a of '
        'Milford et al. (2006).',
        'too few experiences are active', 'experiences far from the peak are active',
        runtime='at next message',
    )  # fmt: skip
    exp_activity_th: float = parameter(
        2.0, 'cells', 0.01, 1000.0,
        'Heading difference at which the activity of an experience reaches zero: theta_a of '
        'Milford et al. (2006).',
        'too few experiences are active',
        'experiences with other headings are active',
        runtime='at next message',
    )  # fmt: skip
    exp_activity_threshold: float = parameter(
        0.0, 'activity', 0.0, 2.0,
        'If exp_current_by is activity: a new experience is created if none is more active than '
        'this.',
        'the map is too coarse', 'there are too many experiences',
        runtime='at next message',
    )  # fmt: skip
    exp_max: int = parameter(
        0, 'experiences; 0: any number', 0, 100_000_000,
        'Limit of the number of experiences. At the limit, each new experience replaces one that '
        'is selected by exp_forget. Experiences whose removal would leave a large gap are kept. '
        'Without a limit, only superseded ones are replaced, if exp_view_links is set.',
        'places are forgotten that are still needed',
        'the map takes too much memory or computing time',
    )  # fmt: skip
    exp_forget: str = parameter(
        'visits', '', 0, 0,
        'Selection of the experience to remove at the limit exp_max. visits: the least often '
        'visited one; of several, the one whose last visit is the oldest. freshness: a faded one '
        '(forget_share and forget_after_s), so that recent regions stay '
        'dense and old ones become sparse.',
        'set to freshness if the robot explores new regions with a small exp_max',
        'leave at visits if the robot stays in one environment',
        choices=('visits', 'freshness'),
    )  # fmt: skip

    def __post_init__(self) -> None:
        super().__post_init__()
        if 0 < self.exp_max < LEAST_EXP_MAX:
            raise UnusableParameter(
                f'exp_max is {self.exp_max}; expected 0 (any number) or at least {LEAST_EXP_MAX}, '
                'so that recently visited experiences are kept'
            )
        for name in ('pc_w_e_dim', 'pc_w_i_dim'):
            if getattr(self, name) % 2 == 0:
                raise UnusableParameter(
                    f'{name} is {getattr(self, name)}; expected an odd number of cells, '
                    'so that the kernel has a centre'
                )
