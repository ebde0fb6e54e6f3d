# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Parameters of the experience map."""

from __future__ import annotations

from dataclasses import dataclass

from ratslam_ros.core.config.parameter import Section, parameter
from ratslam_ros.errors import UnusableParameter

MAX_LASERS = 8
"""Largest number of lasers; every action waits for the scans of all of them."""


@dataclass(frozen=True)
class ExperienceMapParameters(Section):
    """The pose graph of experiences and its optimisation."""

    exp_relaxation: str = parameter(
        'solve',
        'Optimisation of the pose graph: solve computes the most likely poses; sweep '
        'applies exp_loops iterations of local corrections after each action, link after link, '
        'as OpenRatSLAM does; batch corrects all experiences at once, as in equation (7) of '
        'Milford et al. (2006).',
        choices=('solve', 'sweep', 'batch'),
        raise_if='leave at solve',
        lower_if='set to sweep to compare with OpenRatSLAM, to batch for the paper',
    )
    exp_correction: float = parameter(
        0.5,
        "Share of a link's error that each of its ends corrects in one sweep, unless "
        'exp_relaxation is solve; 0: the map is not relaxed.',
        unit='share of the error', low=0.0, high=0.5,
        raise_if='loops close too slowly', lower_if='the map oscillates',
    )
    exp_loops: int = parameter(
        10,
        'Sweeps over all links after each action, unless exp_relaxation is solve; 0: the map is '
        'not relaxed.',
        unit='sweeps', low=0, high=10_000,
        raise_if='loops close too slowly', lower_if='large maps take too much computing time',
    )
    exp_align_scans: bool = parameter(
        False,
        'If there is a laser, compute the poses of links to recognised places by matching their '
        'scans. Not in the papers.',
        raise_if='goals are missed by half a metre, and the robot has a laser',
        lower_if='the map should depend on camera and odometry alone',
    )
    scan_topics: str = parameter(
        'scan',
        'Topics of the lasers that exp_align_scans uses, separated by commas without spaces, '
        'such as scan,scan_rear. Their newest scans are used together, as one scan.',
        raise_if='list all lasers if each sees a part of the surroundings',
        lower_if='leave as it is for a single laser',
    )
    exp_gate_closures: bool = parameter(
        False,
        'Loop-closure gate: a closure beyond the 99 % bound of the covariance of the relative '
        'pose of both places makes no link. It is accepted as a relocalisation after two metres '
        'of consistent evidence. Not in the papers.',
        raise_if='places that look alike are confused',
        lower_if='places are recognised but loops are not closed', runtime='at next message',
    )
    exp_relocate: str = parameter(
        'views',
        'What relocates a robot that was carried: views, consistent closures along two metres; '
        'landmarks, the corners that the laser sees, proven by the scans; or both. landmarks and '
        'both need a laser and exp_align_scans. Not in the papers.',
        choices=('views', 'landmarks', 'both'),
        raise_if='set to both if the robot has a laser and is moved by hand',
        lower_if='set to views if the surroundings are crowded or change a lot',
    )
    exp_confidence_threshold: float = parameter(
        0.25,
        'A link is removed when its confidence, the share of tries that made its transition, '
        'falls below this; 0: never. Only the tries of named behaviours count.',
        unit='share of the tries', low=0.0, high=1.0,
        raise_if='the robot keeps trying blocked routes for too long',
        lower_if='routes are removed because people pass by', runtime='at next message',
    )
    exp_unlearning: str = parameter(
        'cautious',
        'What counts against a link. equation: its behaviour led elsewhere, and nothing else, as '
        'in equation (9) of Milford et al. (2006). cautious: this counts only after eight times '
        'in a row and if there is a detour; time-outs in front of the link count as well.',
        choices=('cautious', 'equation'),
        raise_if='leave at cautious', lower_if='set to equation to compare with the paper',
    )
    exp_recent_tries: int = parameter(
        3,
        'Upper limit of the number of successful transitions that count against timeouts, so '
        'that old successes are forgotten. With a threshold of 0.25, a link made once is removed '
        'after 4 timeouts, and a link made 3 times or more after 10.',
        unit='times', low=1, high=1_000_000,
        raise_if='routes are removed because people pass by',
        lower_if='the robot keeps trying blocked routes for too long', runtime='at next message',
    )
    exp_try_radius_m: float = parameter(
        1.0,
        'A timeout counts for all links ahead of the robot that pass within this distance of it.',
        unit='m', low=0.01, high=1000.0,
        raise_if='links that pass beside an obstacle are not removed',
        lower_if='links past an obstacle are removed with the blocked ones',
        runtime='at next message',
    )
    exp_initial_em_deg: float = parameter(
        90.0, 'Initial heading of the robot in the map.', unit='deg', low=-360.0, high=360.0,
        raise_if='the map should be turned counter-clockwise',
        lower_if='the map should be turned clockwise',
    )
    map_frame: str = parameter(
        'map', 'Frame of the map, its poses and its routes.',
        raise_if='set to a unique name for each robot that shares a TF tree',
        lower_if='leave as it is for a single robot',
    )
    odom_frame: str = parameter(
        'auto',
        'Live only: frame of the odometry; map_frame -> odom_frame is on /tf. auto: the frame_id '
        'of its messages.',
        raise_if='set if the messages name another frame than the TF tree',
        lower_if='leave as it is for most robots',
    )
    base_frame: str = parameter(
        'auto',
        'Live only: frame of the robot; goals may be given in it, and the place of the laser is '
        'looked up in it. auto: the child_frame_id of the odometry.',
        raise_if='set if the messages name another frame than the TF tree',
        lower_if='leave as it is for most robots',
    )
    publish_tf: bool = parameter(
        True, 'Live only: publish map_frame -> odom_frame on /tf.',
        raise_if='RViz should show the robot in the map',
        lower_if='another node localises the robot in the map', runtime='at once',
    )
    map_period_s: float = parameter(
        1.0,
        'Live only: minimum time between two messages with the whole map; the latest map is '
        'always sent.',
        unit='s', low=0.0, high=3600.0,
        raise_if='large maps take too much network bandwidth',
        lower_if='the map should be shown sooner', runtime='at once',
    )

    def __post_init__(self) -> None:
        super().__post_init__()
        names = self.lasers
        if not all(names) or len(set(names)) < len(names) or len(names) > MAX_LASERS:
            raise UnusableParameter(
                f'scan_topics is {self.scan_topics!r}; expected 1 to {MAX_LASERS} different '
                'topics separated by commas, such as scan,scan_rear'
            )

    @property
    def lasers(self) -> tuple[str, ...]:
        """Topic of each laser, in the order of their numbers."""
        return tuple(self.scan_topics.split(','))
