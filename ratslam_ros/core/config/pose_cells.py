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
        True,
        'Estimate the unit of turns of a camera without field of view from closed loops, and '
        'correct the odometry that follows; starts at odom_rotation_gain and odom_turn_per_m.',
        raise_if='the field of view of visual odometry is unknown',
        lower_if='it is known, or results must be those of OpenRatSLAM',
    )
    pc_dim_x: int = parameter(
        300, 'Extent along x; the cells wrap around. pc_dim_xy sets x and y.',
        unit='cells', low=1, high=100_000,
        raise_if='distant places are confused', lower_if='the activity picture is too large',
    )
    pc_dim_y: int = parameter(
        300, 'Extent along y; the cells wrap around.', unit='cells', low=1, high=100_000,
        raise_if='distant places are confused', lower_if='the activity picture is too large',
    )
    pc_dim_th: int = parameter(
        36, 'Number of heading planes; 36 gives 10 degrees each.', unit='cells', low=1, high=3600,
        raise_if='headings must be resolved more finely',
        lower_if='steps take too much computing time',
    )
    pc_w_e_dim: int = parameter(
        7, 'Width of the excitatory kernel.', unit='cells, odd', low=1, high=99,
        raise_if='packets fall apart', lower_if='steps take too much computing time',
    )
    pc_w_e_var: float = parameter(
        1.0, 'Standard deviation of the excitatory kernel.', unit='cells', low=0.01, high=50.0,
        raise_if='packets are too sharp', lower_if='packets are too wide',
    )
    pc_w_i_dim: int = parameter(
        5, 'Width of the inhibitory kernel.', unit='cells, odd', low=1, high=99,
        raise_if='neighbouring packets persist side by side',
        lower_if='steps take too much computing time',
    )
    pc_w_i_var: float = parameter(
        2.0, 'Standard deviation of the inhibitory kernel.', unit='cells', low=0.01, high=50.0,
        raise_if='inhibition should reach further', lower_if='inhibition should act locally',
    )
    pc_global_inhib: float = parameter(
        0.00002, 'Global inhibition: activity subtracted from every cell at each step.',
        unit='activity', low=0.0, high=1.0,
        raise_if='weak packets persist too long', lower_if='a new place wins too quickly',
    )
    pc_lattice: str = parameter(
        'moving',
        'Path integration. moving: the lattice of each activity packet moves with the robot, so '
        'that the packet follows the odometry exactly. fixed: activity is shifted from cell to '
        'cell, as in the papers.',
        choices=('moving', 'fixed'),
        raise_if='leave at moving', lower_if='set to fixed to compare with the papers',
    )
    pc_cell_x_size: float = parameter(
        -1.0, 'Side length of a pose cell on the ground.', unit='m', low=1e-4, high=1e4,
        automatic=True,
        raise_if='the robot is fast or its odometry is poor, and places are not linked',
        lower_if='nearby places must be distinguished',
    )
    vt_active_decay: float = parameter(
        1.0, 'Habituation added to a template each time that it is seen again in succession.',
        low=0.0, high=100.0,
        raise_if='the pose of a stationary robot is pulled to wrong places',
        lower_if='recognition has too little effect', runtime='at next message',
    )
    pc_vt_inject_energy: float = parameter(
        0.15, 'Activity that a recognised view injects.', unit='activity', low=0.0, high=100.0,
        raise_if='places are recognised but loops do not close',
        lower_if='single wrong recognitions move the activity packet', runtime='at next message',
    )
    pc_vt_learning_rate: float = parameter(
        0.0,
        'Rate of the Hebbian links between a template and all cells that are active when it is '
        'seen, as in Milford et al. (2005), who use 0.15. 0: the template is associated with the '
        'place at which it was learned, as in OpenRatSLAM.',
        unit='per view; 0: one place for each template', low=0.0, high=1.0,
        raise_if='ambiguous views should be recalled by few sightings',
        lower_if='views are shared by many places',
    )
    pc_vt_interpolate: bool = parameter(
        True,
        'Distribute the injected activity over the eight cells around the place; otherwise the '
        'nearest cell receives all of it, as in the papers.',
        raise_if='the pose should be precise', lower_if='set to compare with the papers',
    )
    pc_vt_spare_newest: bool = parameter(
        True,
        'The ten newest templates inject nothing, because the robot is still near them. Not in '
        'the papers.',
        raise_if='a slow robot is pulled back to the view it has just learned',
        lower_if='set to compare with the papers',
    )
    pc_vt_restore: float = parameter(
        0.05, 'Rate at which the habituation of a template decays.',
        unit='per template message', low=0.0, high=100.0,
        raise_if='places that are soon seen again have no effect',
        lower_if='the pose of a stationary robot is pulled to wrong places',
        runtime='at next message',
    )
    pc_vt_agree_views: float = parameter(
        7.0,
        'Number of recent views that must agree on a place. The injected energy is multiplied by '
        '((n - m) / this)^4, where n recent views agree with the place and m with the present '
        'estimate. 0: the energy is not weighted, as in OpenRatSLAM.',
        unit='views; 0: off', low=0.0, high=100.0,
        raise_if='wrong recognitions distort the map', lower_if='short revisits are not linked',
        runtime='at next message',
    )
    pc_vt_agree_cells: float = parameter(
        -1.0, 'Largest distance between the places that two agreeing views indicate.',
        unit='cells', low=0.0, high=1000.0, automatic=True,
        raise_if='odometry or views are imprecise compared to the cells',
        lower_if='neighbouring places are confused', runtime='at next message',
    )
    pc_vt_agree_spacing: float = parameter(
        -1.0,
        'Smallest motion between two views that count separately: the distance plus a quarter of '
        'the turn in heading planes.',
        unit='cells', low=0.0, high=1000.0, automatic=True,
        raise_if='places that look alike along a stretch distort the map',
        lower_if='short revisits are not linked', runtime='at next message',
    )
    exp_delta_pc_threshold: float = parameter(
        -1.0,
        'Distance in the pose cells from the current experience at which another experience is '
        'created or becomes current.',
        unit='cells', low=0.01, high=1000.0, automatic=True,
        raise_if='places are recognised but not linked, or there are too many experiences',
        lower_if='the map is too coarse, or wrong places are linked', runtime='at next message',
    )
    exp_view_links: bool = parameter(
        True,
        'Each recognised view links the current experience to the one of its template, and the '
        'robot creates experiences on known paths as well, exp_delta_pc_threshold apart. Links '
        'are weighted by their precision, and recognitions that contradict the others have '
        'little weight. Not in the papers.',
        raise_if='the map should be as precise as possible',
        lower_if='the map must not grow on known paths, or a robot follows routes on it',
    )
    exp_weigh_links: bool = parameter(
        False,
        'As exp_view_links, but the robot creates no experiences on known paths: links are '
        'weighted by their precision, recognitions that contradict the others have little '
        'weight, and the noise of the odometry is measured. Not in the papers.',
        raise_if='a robot without a laser follows routes on the map',
        lower_if='the results should be those of the papers',
    )
    exp_current_by: str = parameter(
        'delta',
        'Selection of the current experience among those of the recognised template. delta: the '
        'nearest within exp_delta_pc_threshold, once the template or the place has changed. '
        'activity: always the most active one (docs/algorithm.md).',
        choices=('delta', 'activity'),
        raise_if='leave at delta', lower_if='set to activity to compare with the papers',
    )
    exp_activity_xy: float = parameter(
        2.0,
        'Distance along x and y at which the activity of an experience reaches zero: r_a of '
        'Milford et al. (2006).',
        unit='cells', low=0.01, high=1000.0,
        raise_if='too few experiences are active',
        lower_if='experiences far from the peak are active', runtime='at next message',
    )
    exp_activity_th: float = parameter(
        2.0,
        'Heading difference at which the activity of an experience reaches zero: theta_a of '
        'Milford et al. (2006).',
        unit='cells', low=0.01, high=1000.0,
        raise_if='too few experiences are active',
        lower_if='experiences with other headings are active', runtime='at next message',
    )
    exp_activity_threshold: float = parameter(
        0.0,
        'If exp_current_by is activity: a new experience is created if none is more active than '
        'this.',
        unit='activity', low=0.0, high=2.0,
        raise_if='the map is too coarse', lower_if='there are too many experiences',
        runtime='at next message',
    )
    exp_max: int = parameter(
        0,
        'Limit of the number of experiences. At the limit, each new experience replaces one that '
        'is selected by exp_forget. Experiences whose removal would leave a large gap are kept. '
        'Without a limit, only superseded ones are replaced, if exp_view_links is set.',
        unit='experiences; 0: any number', low=0, high=100_000_000,
        raise_if='places are forgotten that are still needed',
        lower_if='the map takes too much memory or computing time',
    )
    exp_forget: str = parameter(
        'visits',
        'Selection of the experience to remove at the limit exp_max. visits: the least often '
        'visited one; of several, the one whose last visit is the oldest. visited_once: the same, '
        'whatever gap it leaves, as in Milford (2008). freshness: a faded one '
        '(forget_share and forget_after_s), so that recent regions stay dense and old ones '
        'become sparse.',
        choices=('visits', 'visited_once', 'freshness'),
        raise_if='set to freshness if the robot explores new regions with a small exp_max',
        lower_if='leave at visits if the robot stays in one environment',
    )

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
