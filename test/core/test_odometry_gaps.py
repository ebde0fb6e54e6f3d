# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Gaps of the odometry, in which the robot is moved, in a small world with a known true map."""

from __future__ import annotations

import math
import random
from collections.abc import Iterator

import numpy as np
import pytest
from helpers import START_NS, seen, twist

from ratslam_ros.core.common.angles import wrap
from ratslam_ros.core.common.pose import Pose, composed, inverse
from ratslam_ros.core.config import Config
from ratslam_ros.core.ratslam import OdometryStep, RatSLAM, Step, ViewStep
from ratslam_ros.messages.mapping import encode_map

PERIOD_NS = 500_000_000
STEP_M = 0.5
SIDE_STEPS, SIDES = 20, 4
LAP_STEPS = SIDE_STEPS * SIDES
GAP_NS = 10 * 10**9
"""Longer than the limit of 2 s."""

SECTIONS = 'pose_cells', 'experience_map'


def config(max_gap_s: float = 2.0, **changes: float | str | bool) -> Config:
    return Config().with_values({
        'pose_cells.pc_dim_xy': 41, 'pose_cells.exp_delta_pc_threshold': 0.4,
        'experience_map.exp_initial_em_deg': 0.0,
        **{f'{section}.max_odom_gap_s': max_gap_s for section in SECTIONS},
        **changes,
    })  # fmt: skip


def true_pose(step: int) -> Pose:
    """Return the pose on a square track after a number of steps; corners are turned sharply."""
    side, along = divmod(step % LAP_STEPS, SIDE_STEPS)
    x, y = [(0.0, 0.0), (10.0, 0.0), (10.0, 10.0), (0.0, 10.0)][side]
    heading = wrap(side * math.pi / 2.0)
    distance = along * STEP_M
    return Pose(x + distance * math.cos(heading), y + distance * math.sin(heading), heading)


class Drive:
    """A robot on the square track; each place has one template, of two steps."""

    def __init__(self, parameters: Config) -> None:
        self.slam = RatSLAM(parameters)
        self.stamp_ns = START_NS
        self.at = 0
        self.truths: dict[int, Pose] = {}
        self.steps: list[Step] = []
        self._observe()

    def forward(self, steps: int) -> None:
        """Drive along the track."""
        for _ in range(steps):
            self.stamp_ns += PERIOD_NS
            turn = wrap(
                true_pose(self.at + 1).heading_rad - true_pose(self.at).heading_rad
            )
            self.at += 1
            # The turn is made half before and half after the step, as the chord of an arc is.
            self._observe(STEP_M, turn)

    def stand(self, messages: int) -> None:
        for _ in range(messages):
            self.stamp_ns += PERIOD_NS
            self._observe()

    def carry(self, steps: int, gap_ns: int = GAP_NS) -> None:
        """Move the robot during a gap, after which its odometry shows the last velocity."""
        self.stamp_ns += gap_ns
        self.at += steps
        self._observe(STEP_M)

    def _observe(self, distance_m: float = 0.0, turn_rad: float = 0.0) -> None:
        dt_s = PERIOD_NS * 1e-9
        self.truths[self.stamp_ns] = true_pose(self.at)
        slam = self.slam
        self.steps += slam.odometry(twist(self.stamp_ns, distance_m / dt_s, turn_rad / dt_s))
        self.steps += slam.template(self.stamp_ns, seen(self.at % LAP_STEPS))

    def finish(self) -> RatSLAM:
        self.steps += self.slam.finish()
        return self.slam

    def error_m(self) -> float:
        """Return the largest error of an experience, after alignment at experience 0."""
        poses = [e.pose for e in self.slam.experience_map.experiences()]
        truths = [
            self.truths[step.stamp_ns] for step in self.steps
            if isinstance(step, ViewStep) and step.action.action == 'create'
        ]  # fmt: skip
        to_map = composed(poses[0], inverse(truths[0]))
        return max(
            math.dist(composed(to_map, truth)[:2], pose[:2])
            for pose, truth in zip(poses, truths, strict=True)
        )


def components_over_time(drive: Drive) -> Iterator[int]:
    for step in drive.steps:
        if isinstance(step, OdometryStep) and step.gap_s > 0.0:
            yield step.stamp_ns


@pytest.mark.parametrize('drift', [0.0, 0.1])
def test_component_joins_where_a_known_place_is_recognised(drift: float) -> None:
    """The second and third side are mapped in a component of their own, then joined."""
    drive = Drive(config(**{'experience_map.exp_jump_drift': drift}))
    drive.forward(15)
    drive.carry(15)
    drive.forward(40)
    graph = drive.slam.experience_map
    assert graph.component_count == 2
    drive.forward(40)
    drive.finish()
    assert graph.component_count == 1
    assert drive.error_m() < 1.0  # the views agree a few steps after the first known place
    assert max(link.distance_m for link in graph.links()) < 1.5


def test_gap_is_integrated_without_limit() -> None:
    """The same drive as above with the default leaves a link as long as the gap."""
    drive = Drive(config(60.0))
    drive.forward(15)
    drive.carry(15)
    drive.forward(80)
    graph = drive.finish().experience_map
    assert graph.component_count == 1
    assert max(link.distance_m for link in graph.links()) > 9.0
    assert drive.error_m() > 2.0


def test_component_without_recognition_stays_separate() -> None:
    drive = Drive(config())
    drive.forward(15)
    before = drive.slam.experience_map.pose
    drive.carry(15)
    drive.forward(30)
    graph = drive.finish().experience_map
    apart = graph.components.index(1)
    assert graph.components == [0] * apart + [1] * (len(graph) - apart)
    # It begins at the pose where the other one ended, and no link crosses the gap.
    assert math.dist(graph.pose_of(apart)[:2], before[:2]) < STEP_M + 1e-9
    assert not any(
        graph.component_of(k.source_id) != graph.component_of(k.target_id) for k in graph.links()
    )


def test_two_gaps_join_one_after_the_other() -> None:
    drive = Drive(config())
    graph = drive.slam.experience_map
    drive.forward(15)
    drive.carry(10)  # the second component begins at step 25
    drive.forward(15)
    drive.carry(10)  # the third at step 50
    drive.forward(20)
    assert graph.component_count == 3
    drive.forward(20)  # past the start, at step 80
    assert graph.component_count == 2
    drive.forward(5)
    drive.carry(-70)  # back to the second component, in a fourth one
    drive.forward(2)
    drive.forward(18)
    drive.finish()
    assert graph.component_count < 3
    drive.forward(LAP_STEPS)
    drive.finish()
    assert graph.component_count == 1
    assert drive.error_m() < 1.5


def test_gap_while_stationary_creates_no_second_experience() -> None:
    drive = Drive(config())
    drive.forward(10)
    drive.stand(5)
    drive.carry(0)
    count = len(drive.slam.experience_map)
    drive.stand(20)
    graph = drive.finish().experience_map
    assert len(graph) == count + 1  # where the robot stood before cannot be known
    assert graph.component_of(-1) == 1


def test_one_ambiguous_view_joins_nothing_unless_one_view_suffices() -> None:
    for views, expected in ((3.0, 2), (0.0, 1)):
        drive = Drive(config(**{'pose_cells.pc_vt_agree_views': views}))
        drive.forward(15)
        drive.carry(10)
        drive.forward(10)
        drive.stamp_ns += PERIOD_NS
        drive.slam.odometry(twist(drive.stamp_ns, 1.0))
        drive.slam.template(drive.stamp_ns, seen(3))  # a view of the first component
        drive.forward(5)
        assert drive.finish().experience_map.component_count == expected


def test_gap_as_long_as_the_limit_is_integrated() -> None:
    for gap_ns, expected in ((2 * 10**9, 1), (2 * 10**9 + 1, 2)):
        drive = Drive(config())
        drive.forward(10)
        drive.carry(4, gap_ns)
        drive.forward(5)
        assert drive.finish().experience_map.component_count == expected


def test_views_during_the_gap_have_no_effect() -> None:
    """The camera continues while odometry is missing: the robot may be anywhere."""
    maps = []
    for with_views in (False, True):
        drive = Drive(config())
        drive.forward(15)
        for n in range(1, 19):
            stamp_ns = drive.stamp_ns + n * PERIOD_NS
            if with_views and stamp_ns > drive.stamp_ns + 2 * 10**9:
                drive.steps += drive.slam.template(stamp_ns, seen((drive.at + n) % LAP_STEPS))
        drive.carry(20)
        drive.forward(80)
        drive.finish()
        maps.append(encode_map(0, drive.slam.experience_map))
    assert maps[0] == maps[1]


def test_place_seen_first_during_the_gap_is_learned_afterwards() -> None:
    """A view in the first two seconds of a gap is processed, as it may not be a gap yet."""
    drive = Drive(config())
    drive.forward(15)
    for n in (1, 2, 3):
        drive.steps += drive.slam.template(drive.stamp_ns + n * PERIOD_NS, seen(15 + 5 * n))
    drive.carry(-10)
    drive.forward(90)
    drive.finish()
    assert drive.slam.experience_map.component_count == 1
    assert drive.error_m() < 1.0


@pytest.mark.parametrize('seed', range(3))
def test_map_with_gaps_is_independent_of_arrival_times(seed: int) -> None:
    expected = None
    for shuffled in (False, True):
        rng = random.Random(seed)
        slam = RatSLAM(config())
        arrivals = []
        delays = {'odometry': 0, 'template': 0}
        stamp_ns = START_NS
        for n in range(160):
            stamp_ns += GAP_NS if n in (30, 75) else PERIOD_NS // 5
            for stream in delays:
                delay = rng.randrange(1_900_000_000) if shuffled else 0
                delays[stream] = max(delays[stream], stamp_ns + delay)
                arrivals.append((delays[stream], stream, stamp_ns, n))
        for _, stream, stamp, n in sorted(arrivals):
            if stream == 'odometry':
                slam.odometry(twist(stamp, 5.0, 0.3))
            else:
                slam.template(stamp, seen(n % 70))
        slam.finish()
        assert slam.counts.late == slam.counts.refused == 0
        result = encode_map(0, slam.experience_map)
        expected = expected or result
        assert result == expected


def test_localisation_only_returns_to_the_map_after_a_gap() -> None:
    drive = Drive(config())
    drive.forward(LAP_STEPS)
    slam = drive.slam
    count, links = len(slam.experience_map), slam.experience_map.link_count
    slam.pose_cells.mapping = slam.experience_map.mapping = False
    drive.carry(30)
    drive.forward(2)  # the jump of the stamps is confirmed by three messages
    assert slam.experience_map.current_id == -1
    drive.forward(18)
    drive.finish()
    graph = slam.experience_map
    assert (len(graph), graph.link_count, graph.component_count) == (count, links, 1)
    assert graph.component_of(-1) == 0
    assert math.dist(graph.pose[:2], true_pose(drive.at)[:2]) < 1.0


def test_random_gaps_never_link_across_and_join_correctly() -> None:
    """Each component is long enough for three views that count separately."""
    for seed in range(8):
        rng = np.random.default_rng(seed)
        drive = Drive(config())
        graph = drive.slam.experience_map
        for _ in range(int(rng.integers(1, 4))):
            drive.forward(int(rng.integers(12, 40)))
            drive.carry(int(rng.integers(-30, 30)))
            labels = graph.components
            assert all(labels[a] == labels[b] for a, b in graph.link_ends.tolist())
        drive.forward(2 * LAP_STEPS)
        drive.finish()
        assert graph.component_count == 1, seed
        assert drive.error_m() < 1.0, seed
