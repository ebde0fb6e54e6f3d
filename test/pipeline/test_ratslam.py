# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The whole system in one process, in small worlds with a known true map."""

from __future__ import annotations

import itertools
import math
from collections import Counter
from collections.abc import Iterator
from contextlib import nullcontext
from typing import Any

import numpy as np
import pytest
from helpers import START_NS, extended, panorama, picture, twist

from ratslam_ros.core.common.angles import wrap
from ratslam_ros.core.common.odometry import Odometry, Twist
from ratslam_ros.core.common.pose import Pose
from ratslam_ros.core.config import Config
from ratslam_ros.core.vision.prepared_image import PreparedImage
from ratslam_ros.core.warm_up import warm_up
from ratslam_ros.errors import UnusableInput
from ratslam_ros.pipeline.commands import NOW, Relocated
from ratslam_ros.pipeline.items import OdometryStep, Step, ViewStep
from ratslam_ros.pipeline.local_view import LocalViewStage
from ratslam_ros.pipeline.pipeline import COMMAND, Pipeline
from ratslam_ros.pipeline.ratslam import RatSLAM

COLUMNS = 60
COLUMN_RAD = 2.0 * math.pi / COLUMNS
SIDE_CELLS, CELL_M = 20, 0.25  # a square of 5 m, with an image every 0.25 m
PERIOD_NS = 500_000_000

PANORAMIC = extended().with_values({
    'local_view.vt_panoramic': True, 'local_view.template_x_size': COLUMNS,
    'local_view.template_y_size': 8, 'local_view.vt_match_threshold': 0.05,
    'pose_cells.pc_dim_xy': 41, 'pose_cells.pc_cell_x_size': 0.5,
    'pose_cells.exp_delta_pc_threshold': 1.0, 'experience_map.exp_initial_em_deg': 0.0,
})

Route = Iterator[tuple[int, int, tuple[int, int]]]
"""Cells driven ahead, columns turned counter-clockwise, and position in cells, of each step."""


def square(laps: int, sense: int, first: int) -> Route:
    """Yield the steps along a square; the robot turns in place at corners, 3 columns per step.

    Args:
        laps: number of laps.
        sense: 1 counter-clockwise, -1 clockwise.
        first: heading of the first side in quarter turns.
    """
    x = y = 0
    for side in range(4 * laps):
        heading = first + side * sense
        d_x, d_y = [(1, 0), (0, 1), (-1, 0), (0, -1)][heading % 4]
        for _ in range(SIDE_CELLS):
            x, y = x + d_x, y + d_y
            yield 1, 0, (x, y)
        for _ in range(5):
            yield 0, 3 * sense, (x, y)


def turn_in_place(place: tuple[int, int], columns: int) -> Route:
    """Yield the steps of a turn, 3 columns each."""
    for _ in range(abs(columns) // 3):
        yield 0, 3 if columns > 0 else -3, place


def drive_square(mirrored: bool = False) -> tuple[RatSLAM, list[tuple[Step, Pose]]]:
    """Drive two laps counter-clockwise and one clockwise; return each step with the true pose.

    ``mirrored``: reverse the order of the camera's columns, as OpenRatSLAM interprets them.
    """
    route = itertools.chain(
        square(2, 1, 0), turn_in_place((0, 0), 15), square(1, -1, 1),
        turn_in_place((0, 0), -30),
    )
    slam = RatSLAM(PANORAMIC)
    column = 0
    stamp = START_NS
    truths: dict[int, Pose] = {stamp: Pose(0.0, 0.0, 0.0)}
    steps = slam.odometry(twist(stamp)) + slam.image(stamp, panorama((0, 0), 0))
    for cells, columns, place in route:
        stamp += PERIOD_NS
        column += columns
        dt = PERIOD_NS * 1e-9
        steps += slam.odometry(twist(stamp, cells * CELL_M / dt, columns * COLUMN_RAD / dt))
        steps += slam.image(stamp, panorama(place, -column if mirrored else column))
        heading = wrap(column * COLUMN_RAD)
        truths[stamp] = Pose(place[0] * CELL_M, place[1] * CELL_M, heading)
    steps += slam.finish()
    return slam, [(step, truths[step.stamp_ns]) for step in steps]


Driven = tuple[RatSLAM, list[tuple[Step, Pose]]]


@pytest.fixture(scope='module')
def driven() -> Driven:
    return drive_square()


def distance_m(a: Pose, b: Pose) -> float:
    return math.hypot(a.x_m - b.x_m, a.y_m - b.y_m)


def test_square_closes_with_views_at_other_headings(driven: Driven) -> None:
    """OpenRatSLAM displaces the map by up to 8.8 m.

    Its relative heading has the opposite sign of its odometry, and is added instead of subtracted.
    """
    slam, steps = driven
    views = [step for step, _ in steps if isinstance(step, ViewStep)]
    turned = [v for v in views if abs(v.match.relative_rad) > 0.5]
    assert len(turned) > 100
    closures = [v for v in views if v.action.action in ('link', 'set')]
    assert len(closures) > 50
    assert any(abs(v.action.relative_rad) > 1.0 for v in closures)
    for step, truth in steps:
        if isinstance(step, OdometryStep):
            assert distance_m(step.pose, truth) < 0.01
            assert abs(wrap(step.pose.heading_rad - truth.heading_rad)) < 0.01
    assert distance_m(slam.experience_map.pose, Pose(0.0, 0.0, 0.0)) < 0.01


def test_experiences_lie_where_their_views_were_learned(driven: Driven) -> None:
    slam, steps = driven
    created = {
        step.action.target_id: (truth, step.action.relative_rad)
        for step, truth in steps
        if isinstance(step, ViewStep) and step.action.action == 'create'
    }
    assert len(created) == len(slam.experience_map) > 30
    for experience in slam.experience_map.experiences():
        truth, relative = created[experience.id]
        assert distance_m(experience.pose, truth) < 0.01
        assert abs(wrap(experience.pose.heading_rad + relative - truth.heading_rad)) < 0.01


def test_relative_heading_is_heading_minus_learned_heading(driven: Driven) -> None:
    """Counter-clockwise is positive: wrap(-2 pi o / W), because columns run clockwise."""
    learned: dict[int, float] = {}
    checked = 0
    for step, truth in driven[1]:
        if not isinstance(step, ViewStep):
            continue
        if step.match.is_new:
            learned[step.match.template_id] = truth.heading_rad
        expected = wrap(truth.heading_rad - learned[step.match.template_id])
        assert abs(wrap(step.match.relative_rad - expected)) < 1e-9
        checked += abs(expected) > 0.1
    assert checked > 100


def test_mirrored_columns_displace_the_map() -> None:
    """The tests above are sensitive to the sign of the relative heading."""
    _, steps = drive_square(mirrored=True)
    max_error_m = max(
        distance_m(step.pose, truth) for step, truth in steps if isinstance(step, OdometryStep)
    )
    assert max_error_m > 0.1


def test_dead_reckoning_integrates_odometry_alone(driven: Driven) -> None:
    for step, truth in driven[1]:
        if isinstance(step, OdometryStep):
            assert distance_m(step.dead_reckoning, truth) < 1e-6


# Inputs


def small_config(**changes: float | str | bool) -> Config:
    """Return a configuration with small templates."""
    values = {'local_view.template_x_size': 8, 'local_view.template_y_size': 4,
              'local_view.vt_shift_match': 1}
    return extended().with_values({**values, **changes})


def feed(slam: RatSLAM, frames: int, first: int = 0) -> list[Step]:
    """Send odometry and an image every 0.1 s; the images repeat after 7."""
    steps: list[Step] = []
    for n in range(first, first + frames):
        steps += slam.odometry(twist(n * 100_000_000, 1.0, 0.2))
        steps += slam.image(n * 100_000_000, picture(n % 7))
    return steps


def test_each_message_gives_one_step_in_stamp_order() -> None:
    slam = RatSLAM(small_config())
    steps = feed(slam, 30) + slam.finish()
    assert sum(isinstance(step, ViewStep) for step in steps) == 30
    assert sum(isinstance(step, OdometryStep) for step in steps) == 30
    keys = [(step.stamp_ns, isinstance(step, ViewStep)) for step in steps]
    assert keys == sorted(keys)


@pytest.mark.parametrize('first', [5, 21, 40])
def test_head_is_decided_by_whether_odometry_comes(first: int) -> None:
    """Odometry may begin after the images; without any, it is estimated from them."""
    lateness = round(small_config().inputs.max_lateness_s * 10)
    expected = RatSLAM(small_config(), 'visual_odometry' if first > lateness else 'local_view')
    slam, again = RatSLAM(small_config()), RatSLAM(small_config())
    again.reconfigure(small_config(**{'pose_cells.pc_vt_inject_energy': 0.3}))
    expected.reconfigure(small_config(**{'pose_cells.pc_vt_inject_energy': 0.3}))
    slam.reconfigure(small_config(**{'pose_cells.pc_vt_inject_energy': 0.3}))
    steps: dict[RatSLAM, list[Step]] = {slam: [], expected: [], again: []}
    for n in range(first):
        for one in (slam, expected, again):
            steps[one] += one.image(n * 100_000_000, picture(n % 7))
        if n == 3:  # saved and restored before it is decided
            states = again.state()
            steps[other := RatSLAM(small_config())] = steps.pop(again)
            again = other
            assert again.restore(states)
    if first <= lateness:
        for one in (slam, expected, again):
            steps[one] += feed_odometry(one, first)
    for one in (slam, expected, again):
        steps[one] += one.finish()
    assert len(expected.experience_map) > 0
    assert repr(steps[slam]) == repr(steps[expected]) == repr(steps[again])
    assert repr(slam.state()) == repr(expected.state()) == repr(again.state())


def feed_odometry(slam: RatSLAM, count: int) -> list[Step]:
    return [step for n in range(count) for step in slam.odometry(twist(n * 100_000_000, 1.0, 0.2))]


def test_images_without_odometry_are_enough_at_the_end() -> None:
    slams = RatSLAM(small_config()), RatSLAM(small_config(), 'visual_odometry')
    for slam in slams:
        for n in range(4):
            slam.image(n * 100_000_000, picture(n))
        slam.finish()
    assert slams[0].visual_odometry is not None
    assert repr(slams[0].state()) == repr(slams[1].state())


def test_undecodable_image_gives_action_none() -> None:
    slam = RatSLAM(small_config())
    feed(slam, 3)
    slam.odometry(twist(10**9))
    (step,) = [s for s in slam.image(10**9, None) if isinstance(s, ViewStep)]
    assert step.match.template_id == -1
    assert step.action.action == 'none'
    assert not step.match.is_new


def test_undecodable_images_do_not_change_the_graph() -> None:
    graphs = []
    for broken in (False, True):
        slam = RatSLAM(small_config())
        for n in range(40):
            slam.odometry(twist(2 * n * 100_000_000, 4.0, 0.1))
            slam.image(2 * n * 100_000_000, picture(n % 15))
            if broken:
                slam.image((2 * n + 1) * 100_000_000, None)
        slam.finish()
        graph = slam.experience_map
        graphs.append((
            [e.template_id for e in graph.experiences()],
            [(link.source_id, link.target_id, link.count) for link in graph.links()],
        ))
    assert len(graphs[0][1]) > 10
    assert graphs[0] == graphs[1]


def test_refused_odometry_does_not_move_the_robot() -> None:
    slam = RatSLAM(small_config())
    slam.odometry(twist(0))
    slam.odometry(twist(10**9, 1.0))
    slam.odometry(twist(10**9, 5.0))
    slam.odometry(twist(5 * 10**8, 5.0))
    slam.finish()
    assert slam.counts.refused == 2
    assert slam.dead_reckoning.x_m == pytest.approx(0.0, abs=1e-9)
    assert slam.dead_reckoning.y_m == pytest.approx(1.0)


@pytest.mark.parametrize('descriptor', ['intensity', 'gradients'])
def test_prepared_images_give_the_same_results(descriptor: str) -> None:
    config = extended().with_values({
        'local_view.vt_descriptor': descriptor, 'local_view.template_x_size': 8,
        'local_view.template_y_size': 4, 'local_view.vt_shift_match': 1,
        'local_view.vt_min_structure': 0.01,
    })
    images = [picture(n % 9, 24, 32) for n in range(40)]
    images[20] = np.zeros_like(images[20])  # too little structure
    images[25] = images[25][:2]  # fits no window
    found = []
    for prepares in (False, True):
        slam = RatSLAM(config, head='visual_odometry')
        ready = [slam.prepare(image) for image in images] if prepares else images
        steps = [slam.image(n * 10**8, image) for n, image in enumerate(ready, 1)]
        found.append((steps, slam.finish(), slam.experience_map.poses.tobytes()))
    assert found[0] == found[1]


def test_visual_odometry_estimates_motion_from_images() -> None:
    slam = RatSLAM(small_config(), head='visual_odometry')
    columns = np.tile(np.random.default_rng(0).integers(0, 256, 200, dtype=np.uint8), (12, 1))
    steps: list[Step] = []
    for n in range(10):
        frame = np.ascontiguousarray(columns[:, 100 - 2 * n : 140 - 2 * n])
        steps += slam.image(n * 100_000_000, frame)
    steps += slam.finish()
    odometry = [step for step in steps if isinstance(step, OdometryStep)]
    assert len(odometry) == 9  # the first image gives none
    turned = odometry[-1].dead_reckoning.heading_rad - odometry[0].dead_reckoning.heading_rad
    assert turned == pytest.approx(math.radians(8 * 2 * 50.0 / 40))
    assert sum(isinstance(step, ViewStep) for step in steps) == 10


def test_stopwatch_is_entered_once_per_step() -> None:
    entered: Counter[str] = Counter()

    def watch(name: str) -> nullcontext[None]:
        entered[name] += 1
        return nullcontext()

    slam = RatSLAM(small_config(), stopwatch=watch)
    feed(slam, 10)
    slam.finish()
    assert entered == {
        'local_view.image': 10, 'pose_cells.odometry': 10, 'pose_cells.template': 10,
        'pose_cells.relocation': 10, 'experience_map.odometry': 10, 'experience_map.action': 10,
    }


def test_warm_up_does_not_change_results() -> None:
    first = RatSLAM(small_config())
    before = [repr(step) for step in feed(first, 10)]
    warm_up()
    assert [repr(step) for step in feed(RatSLAM(small_config()), 10)] == before


def test_local_view_follows_no_odometry_from_before_a_jump_back() -> None:
    config = Config().with_values({
        'local_view.vt_match_threshold': -1, 'local_view.vt_match_ratio': -1,
    })
    stage = LocalViewStage(config)
    pipeline = Pipeline([stage], 0)
    for first_ns in (START_NS, START_NS - 60 * 10**9):
        pipeline.begin_inputs()
        pipeline.feed(COMMAND, NOW, Relocated())
        for n in range(20):
            stamp_ns = first_ns + n * PERIOD_NS
            pipeline.feed('odometry', stamp_ns, twist(stamp_ns, 1.0))
            pipeline.feed('image', stamp_ns, PreparedImage(picture(n, 60, 80)))
        pipeline.finish()
        assert len(stage.state()['ahead']) <= 10**9 // PERIOD_NS


def test_pose_includes_odometry_that_is_held() -> None:
    slam = RatSLAM(PANORAMIC)
    slam.odometry(twist(START_NS))
    slam.image(START_NS, panorama((0, 0), 0))
    for n in range(1, 11):  # 1 m in 1 s, without another image
        stamp = START_NS + n * 100_000_000
        slam.odometry(twist(stamp, 1.0, 0.0))
        assert slam.pose.x_m == pytest.approx(0.1 * n)
    assert slam.experience_map.pose.x_m < 0.2
    slam.finish()
    assert slam.experience_map.pose.x_m == pytest.approx(1.0)
    assert slam.pose == slam.experience_map.pose


@pytest.mark.parametrize(('image', 'found'), [
    (np.zeros((48, 64, 3), np.uint8), r'ndarray of shape \(48, 64, 3\) and type uint8'),
    (np.zeros((48, 64)), r'ndarray of shape \(48, 64\) and type float64'),
    ([[0, 1], [2, 3]], 'list'),
])
def test_image_that_is_not_grey_is_refused(image: Any, found: str) -> None:
    slam = RatSLAM()
    for take in (lambda: slam.image(START_NS, image), lambda: slam.prepare(image)):
        with pytest.raises(UnusableInput, match=f'the image is a {found}: expected .* grey'):
            take()


def test_stamp_in_seconds_is_refused() -> None:
    slam = RatSLAM()
    with pytest.raises(UnusableInput, match=r'the stamp of the image is 1.5: expected .* in ns'):
        slam.image(1.5, None)  # type: ignore[arg-type]
    with pytest.raises(UnusableInput, match='the stamp of the odometry is'):
        slam.odometry(Odometry(np.float64(1e9), Twist(1.0, 0.0)))  # type: ignore[arg-type]
    assert slam.image(np.int64(START_NS), None) == []  # type: ignore[arg-type]
