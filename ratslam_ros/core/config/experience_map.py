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
        'solve', '', 0, 0,
        'Optimisation of the pose graph: solve computes the least-squares solution; sweep applies '
        'exp_loops iterations of local corrections after each action, link after link, as '
        'OpenRatSLAM does; batch corrects all experiences at once, as in equation (7) of Milford '
        'et al. (2006).',
        'leave at solve', 'set to sweep to compare with OpenRatSLAM, to batch for the paper',
        choices=('solve', 'sweep', 'batch'),
    )  # fmt: skip
    exp_correction: float = parameter(
        0.5, 'share of the error', 0.0, 0.5,
        "Share of a link's error that each of its ends corrects in one sweep, unless "
        'exp_relaxation is solve; 0: the map is not relaxed.',
        'loops close too slowly', 'the map oscillates')  # fmt: skip
    exp_loops: int = parameter(
        10, 'sweeps', 0, 10_000,
        'Sweeps over all links after each action, unless exp_relaxation is solve; 0: the map is '
        'not relaxed.',
        'loops close too slowly', 'large maps take too much computing time')  # fmt: skip
    exp_align_scans: bool = parameter(
        False, '', 0, 1,
        'If there is a laser, compute the poses of links to recognised places by matching their '
        'scans. Not in the papers.',
        'goals are missed by half a metre, and the robot has a laser',
        'the map should depend on camera and odometry alone')  # fmt: skip
    scan_topics: str = parameter(
        'scan', '', 0, 0,
        'Topics of the lasers that exp_align_scans uses, separated by commas without spaces, such '
        'as scan,scan_rear. Their newest scans are used together, as one scan.',
        'list all lasers if each sees a part of the surroundings',
        'leave as it is for a single laser',
    )  # fmt: skip
    exp_gate_closures: bool = parameter(
        False, '', 0, 1,
        'Loop-closure gate: a closure beyond the 99 % bound of the covariance of the relative '
        'pose of both places makes no link. It is accepted as a relocalisation after two metres '
        'of consistent evidence. Not in the papers.',
        'places that look alike are confused',
        'places are recognised but loops are not closed',
        runtime='at next message',
    )  # fmt: skip
    exp_relocate: str = parameter(
        'views', '', 0, 0,
        'What relocates a robot that was carried: views, consistent closures along two metres; '
        'landmarks, the corners that the laser sees, proven by the scans; or both. landmarks and '
        'both need a laser and exp_align_scans. Not in the papers.',
        'set to both if the robot has a laser and is moved by hand',
        'set to views if the surroundings are crowded or change a lot',
        choices=('views', 'landmarks', 'both'),
    )  # fmt: skip
    exp_confidence_threshold: float = parameter(
        0.25, 'share of the tries', 0.0, 1.0,
        'A link is removed when its confidence, the share of tries that made its transition, '
        'falls below this; 0: never. Only the tries of named behaviours count.',
        'the robot keeps trying blocked routes for too long',
        'routes are removed because people pass by',
        runtime='at next message',
    )  # fmt: skip
    exp_unlearning: str = parameter(
        'cautious', '', 0, 0,
        'What counts against a link. equation: its behaviour led elsewhere, and nothing else, as '
        'in equation (9) of Milford et al. (2006). cautious: this counts only after eight times '
        'in a row and if there is a detour; time-outs in front of the link count as well.',
        'leave at cautious', 'set to equation to compare with the paper',
        choices=('cautious', 'equation'),
    )  # fmt: skip
    exp_recent_tries: int = parameter(
        3, 'times', 1, 1_000_000,
        'Upper limit of the number of successful transitions that count against timeouts, so that '
        'old successes are forgotten. With a threshold of 0.25, a link made once is removed after '
        '4 timeouts, and a link made 3 times or more after 10.',
        'routes are removed because people pass by',
        'the robot keeps trying blocked routes for too long',
        runtime='at next message',
    )  # fmt: skip
    exp_try_radius_m: float = parameter(
        1.0, 'm', 0.01, 1000.0,
        'A timeout counts for all links ahead of the robot that pass within this distance of it.',
        'links that pass beside an obstacle are not removed',
        'links past an obstacle are removed with the blocked ones',
        runtime='at next message',
    )  # fmt: skip
    exp_initial_em_deg: float = parameter(
        90.0, 'deg', -360.0, 360.0, 'Initial heading of the robot in the map.',
        'the map should be turned counter-clockwise',
        'the map should be turned clockwise')  # fmt: skip
    map_frame: str = parameter(
        'map', '', 0, 0, 'Frame of the map, its poses and its routes.',
        'set to a unique name for each robot that shares a TF tree',
        'leave as it is for a single robot',
    )  # fmt: skip
    odom_frame: str = parameter(
        'auto', '', 0, 0, 'Live only: frame of the odometry; map_frame -> odom_frame is on /tf. '
        'auto: the frame_id of its messages.',
        'set if the messages name another frame than the TF tree',
        'leave as it is for most robots',
    )  # fmt: skip
    base_frame: str = parameter(
        'auto', '', 0, 0, 'Live only: frame of the robot; goals may be given in it, and the place '
        'of the laser is looked up in it. auto: the child_frame_id of the odometry.',
        'set if the messages name another frame than the TF tree',
        'leave as it is for most robots',
    )  # fmt: skip
    publish_tf: bool = parameter(
        True, '', 0, 1, 'Live only: publish map_frame -> odom_frame on /tf.',
        'RViz should show the robot in the map', 'another node localises the robot in the map',
        runtime='at once',
    )  # fmt: skip
    map_period_s: float = parameter(
        1.0, 's', 0.0, 3600.0,
        'Live only: minimum time between two messages with the whole map; the latest map is '
        'always sent.',
        'large maps take too much network bandwidth', 'the map should be shown sooner',
        runtime='at once',
    )  # fmt: skip

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
