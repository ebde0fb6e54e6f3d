# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
import math
from dataclasses import replace

import numpy as np
import pytest
from floor_clearance import clearance_m

from ratslam_ros.core.common.pose import Pose
from ratslam_ros.errors import UnusableInput
from ratslam_simulator.camera import Camera, CameraOptions
from ratslam_simulator.floor_plan import load_floor_plan, parse_floor_plan
from ratslam_simulator.people import People, Walk
from ratslam_simulator.simulation import SimulationOptions, Simulator
from ratslam_simulator.world import PERSON_HEIGHT_M, PERSON_RADIUS_M, World, build_world

BLIND = SimulationOptions(camera=None, laser=None)
UNIVERSITY = load_floor_plan('university_floor')
LOOP = load_floor_plan('obstacle_loop')
CORRIDOR = parse_floor_plan('\n'.join(['#' * 40, *['#' + '.' * 38 + '#'] * 4, '#' * 40]), 0.5)
ROBOT_M = 0.22


def rng(seed=0):
    return np.random.Generator(np.random.PCG64(seed))


def walk(simulator, duration_s):
    """Run the simulator; return the positions of the people once per second, (n, people, 2)."""
    seen = []
    for step in range(round(duration_s * 40)):
        simulator.step()
        if step % 40 == 0:
            seen.append(simulator.world.people[:, :2].copy())
    return np.array(seen)


@pytest.mark.parametrize('plan', [UNIVERSITY, LOOP], ids=['university', 'loop'])
def test_people_keep_walking_without_overlap(plan):
    simulator = Simulator(plan, Pose(*plan.places['S'], 0.0), 2, BLIND, people=5)
    seen = walk(simulator, 120.0)
    for positions in seen:
        assert min(clearance_m(plan, x_m, y_m) for x_m, y_m in positions) > PERSON_RADIUS_M - 1e-6
        apart_m = np.hypot(*(positions[:, None] - positions[None]).transpose(2, 0, 1))
        assert apart_m[np.triu_indices(5, 1)].min() > 2 * PERSON_RADIUS_M
    steps_m = np.hypot(*np.diff(seen, axis=0).transpose(2, 0, 1))
    assert steps_m.max() < 1.6
    assert (steps_m.mean(axis=0) > 0.5).all()
    # Standing times are limited by the patience for two blockages in a row.
    for person in steps_m.T:
        still = ''.join('s' if step_m < 0.02 else '.' for step_m in person)
        assert 's' * 20 not in still


def test_people_in_corridor_keep_right():
    world = build_world(CORRIDOR, rng())
    robot = Pose(0.8, 1.5, 0.0)
    people = People(world, 4, rng(1), robot, ROBOT_M)
    sides = []
    for _ in range(40 * 120):
        people.walk(robot, 0.025)
        for x_m, y_m, facing_rad, _ in world.people:
            if 4.0 < x_m < 16.0:
                sides.append((y_m - 1.5) * -math.copysign(1.0, math.cos(facing_rad)))
    assert np.mean(np.array(sides) > 0.0) > 0.8
    assert np.quantile(sides, 0.75) > 0.35


def test_people_blocked_by_robot_stop_then_turn_away():
    world = build_world(CORRIDOR, rng())
    people = People(world, 1, rng(3), Pose(0.8, 1.5, 0.0), ROBOT_M)
    robot = Pose(0.8, 1.5, 0.0)
    for _ in range(400):  # until the person is in the middle of the corridor
        people.walk(robot, 0.025)
    x_m, y_m, facing_rad, _ = world.people[0]
    robot = Pose(x_m + math.copysign(1.3, math.cos(facing_rad)), y_m, 0.0)
    facing = []
    nearest_m = math.inf
    for _ in range(40 * 12):
        people.walk(robot, 0.025)
        nearest_m = min(nearest_m, math.dist(world.people[0, :2], (robot.x_m, robot.y_m)))
        facing.append(math.cos(world.people[0, 2]) * (robot.x_m - x_m) > 0)
    assert ROBOT_M + PERSON_RADIUS_M + 0.05 <= nearest_m < 1.25
    assert facing[0]
    assert not all(facing)


def test_people_avoid_added_obstacles():
    simulator = Simulator(LOOP, Pose(*LOOP.places['S'], 0.0), 2, BLIND, people=4)
    walk(simulator, 5.0)
    x_m, y_m, _, _ = simulator.world.people[0]
    simulator.add_obstacle('on a person', x_m, y_m, 1.0, 1.0)
    simulator.add_obstacle('box', *LOOP.places['X'], 0.8, 2.0)
    with_boxes = replace(LOOP, solid=simulator.world.solid)
    for positions in walk(simulator, 120.0):
        for x_m, y_m in positions:
            assert clearance_m(with_boxes, x_m, y_m) > PERSON_RADIUS_M - 1e-6


def test_carry_onto_person_moves_person_aside():
    simulator = Simulator(LOOP, Pose(*LOOP.places['S'], 0.0), 2, BLIND, people=2)
    walk(simulator, 3.0)
    x_m, y_m, _, _ = simulator.world.people[1]
    simulator.carry(Pose(x_m, y_m, 0.0))
    apart_m = np.hypot(*(simulator.world.people[:, :2] - (x_m, y_m)).T)
    assert apart_m.min() > ROBOT_M + PERSON_RADIUS_M


def test_people_do_not_change_other_random_draws():
    alone, among = (
        Simulator(UNIVERSITY, Pose(*UNIVERSITY.places['S'], 0.0), 6, BLIND, people=n)
        for n in (0, 3)
    )
    for simulator in (alone, among):
        simulator.command(0.3, 0.0)
        walk(simulator, 3.0)
    assert alone.truth == among.truth
    assert np.array_equal(alone.world.panel, among.world.panel)


def test_person_stands_for_the_time_of_the_walk():
    at = LOOP.places['X']
    simulator = Simulator(
        LOOP, Pose(*LOOP.places['S'], 0.0), 2, BLIND, people=1, walks=[Walk([at], 2.0, 6.0)]
    )
    counts = [len(positions) for positions in (walk(simulator, 1.0), simulator.world.people)]
    assert counts == [1, 1]
    assert len(walk(simulator, 1.0)[0]) == 1
    for positions in walk(simulator, 4.0):
        assert positions[1].tolist() == list(at)
    walk(simulator, 1.0)
    assert len(simulator.world.people) == 1


def test_person_walks_back_and_forth_and_turns_at_a_box():
    robot = Pose(0.8, 1.5, 0.0)
    points = [(4.2, 1.25), (9.2, 1.25), (14.2, 1.25)]
    simulator = Simulator(CORRIDOR, robot, 2, BLIND, walks=[Walk(points, 0.0)])
    free_m = walk(simulator, 60.0)[:, 0, 0]
    assert free_m.min() == pytest.approx(4.2, abs=0.4)
    assert free_m.max() == pytest.approx(14.2, abs=0.4)
    steps_m = np.diff(free_m)
    assert (steps_m > 0.3).sum() > 15 and (steps_m < -0.3).sum() > 15
    simulator.add_obstacle('wall', 10.2, 1.5, 0.6, 2.0)
    blocked_m = walk(simulator, 60.0)[:, 0, 0]
    assert np.ptp(blocked_m[30:]) > 3.0
    assert (blocked_m[30:] < 10.0).all() or (blocked_m[30:] > 10.0).all()


def test_walk_through_a_wall_or_onto_the_robot_is_resolved():
    at = LOOP.places['S']
    simulator = Simulator(LOOP, Pose(*at, 0.0), 2, BLIND)
    with pytest.raises(UnusableInput, match='does not fit at'):
        simulator.add_person(Walk([at, (0.1, 0.1)], 0.0))
    with pytest.raises(UnusableInput, match='does not fit at'):
        simulator.add_person(Walk([(-1.0, 3.0)], 0.0))
    simulator.add_person(Walk([at], 0.0))
    walk(simulator, 2.0)
    assert math.dist(simulator.world.people[0, :2], at) > ROBOT_M + PERSON_RADIUS_M


def test_too_many_people_are_refused():
    with pytest.raises(UnusableInput, match='room for'):
        Simulator(LOOP, Pose(*LOOP.places['S'], 0.0), 0, BLIND, people=500)


def test_people_appear_with_projected_size():
    room = parse_floor_plan('\n'.join(['#' * 14, *['#............#'] * 12, '#' * 14]), cell_m=1.0)
    world = build_world(room, rng())
    white = np.ones_like(world.library.textures)
    white[:, -1] = 0.0
    library = type(world.library)(white, (0,), clothes=(white.shape[1] - 1,))
    shape = (*room.solid.shape, 4)
    plain = World(
        room, library, np.zeros(shape, np.int16), np.zeros(shape, np.float32),
        np.ones(room.solid.shape, np.float32),
    )
    options = CameraOptions(width=200, height=200, noise_grey=0.0, exposure_spread=0.0)
    plain.people = np.array([(7.0, 7.0, 0.0, white.shape[1] - 1.0)])
    image = Camera(plain, rng(), options).take(3.0, 7.0, 0.0)
    dark = image == 0
    columns = np.flatnonzero(dark.any(axis=0))
    half_px = options.focal_px * math.tan(math.asin(PERSON_RADIUS_M / 4.0))
    assert columns[0] == pytest.approx(100 - half_px, abs=1)
    assert columns[-1] + 1 == pytest.approx(100 + half_px, abs=1)
    rows = np.flatnonzero(dark[:, 100])
    depth_m = 4.0 - PERSON_RADIUS_M
    top_px = 100 - options.focal_px * (PERSON_HEIGHT_M - options.height_m) / depth_m
    foot_px = 100 + options.focal_px * options.height_m / depth_m
    assert rows[0] == pytest.approx(top_px, abs=1)
    assert rows[-1] + 1 == pytest.approx(foot_px, abs=1)
    # A wall hides people.
    plain.solid[5:9, 5] = True
    assert (Camera(plain, rng(), options).take(3.0, 7.0, 0.0) > 0).all()
