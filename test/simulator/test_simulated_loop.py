# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Closed loop of simulator and RatSLAM on a small floor, for one or two simulated minutes."""

import dataclasses
import math

import numpy as np
import pytest

from ratslam_ros.core.common.pose import Pose
from ratslam_ros.core.driving.steering import Command
from ratslam_ros.errors import UnreachableGoal
from ratslam_ros.files.config import load_config
from ratslam_ros.messages.mapping import encode_map
from ratslam_simulator.closed_loop import ClosedLoop
from ratslam_simulator.config import SimulatorParameters, make_simulator
from ratslam_simulator.floor_plan import parse_floor_plan
from ratslam_simulator.laser import LaserOptions
from ratslam_simulator.robot import RobotOptions
from ratslam_simulator.simulation import SimulationOptions, Simulator
from ratslam_simulator.trials import attempt
from ratslam_simulator.world import WorldOptions

# A corridor around a block, one lap of which takes about a minute.
PLAN = parse_floor_plan("""
##################
#................#
#................#
#.S..............#
#................#
#....########....#
#....########....#
#....########....#
#....########....#
#................#
#................#
#................#
##################
""", 0.5)
CONFIG = load_config('navigation')[0]


# Without slip and aliasing, which a map of one minute cannot yet correct.
PLAIN = SimulationOptions(
    world=WorldOptions(aliasing=0.0),
    robot=RobotOptions(wheel_radius_error=0.0, wheel_base_error=0.0, slip_m=0.0),
)


def closed_loop(seed, options=None):
    simulator = Simulator(PLAN, Pose(*PLAN.places['S'], 0.0), seed, options)
    return ClosedLoop(simulator, CONFIG, exploring_seed=seed)


def explored(seed, duration_s, options=None):
    loop = closed_loop(seed, options)
    loop.explore(duration_s)
    return loop


def apart_m(a, b):
    return math.hypot(a.x_m - b.x_m, a.y_m - b.y_m)


def map_bytes(loop):
    return encode_map(0, loop.experience_map)


def test_explore_builds_map_and_log():
    loop = explored(1, 20.0)
    log, graph = loop.log, loop.experience_map
    first = len(graph)
    assert first > 20
    assert loop.now_s == pytest.approx(20.0, abs=0.15)
    loop.explore(60.0)
    assert len(graph) > 2 * first
    rows = len(log.stamp_ns)
    assert rows == pytest.approx(80 * 20, abs=3)
    assert {
        len(column) for column in (log.truth, log.estimated, log.dead_reckoning,
                                   log.experience_id, log.packet)
    } == {rows}
    assert set(np.diff(log.stamp_ns)) == {50_000_000}
    assert log.truths().shape == (rows, 3)
    assert np.diff(log.truths()[:, :2], axis=0).max() < 0.05
    assert max(log.experience_id) < len(graph)
    assert sorted(log.truth_of) == list(range(len(graph)))
    # After one lap, loop closures lead to the right places.
    assert len(log.closures_ns) == len(log.jump_m) > 0
    assert np.median(log.jump_m) < 0.5
    assert np.searchsorted(log.stamp_ns, log.closures_ns[0]) > rows / 4
    assert loop.simulator.collisions == 0


def test_run_in_parts_equals_single_run():
    def run(parts_s):
        loop = closed_loop(4)
        for end_s in parts_s:
            loop.run(lambda scan: Command(0.2, 0.02, 'straight'), lambda: loop.now_s >= end_s)  # noqa: B023
        return map_bytes(loop)

    assert run([5.0, 10.0, 10.5, 15.0]) == run([15.0])


def test_robot_with_backward_laser_returns_to_named_place():
    laser = LaserOptions(beams=360, fov_deg=359.0, mount=Pose(0.3, 0.0, math.pi))
    config = CONFIG.with_values({'experience_map.exp_align_scans': True})
    simulator = Simulator(
        PLAN, Pose(*PLAN.places['S'], 0.0), 1, dataclasses.replace(PLAIN, laser=laser)
    )
    loop = ClosedLoop(simulator, config, exploring_seed=1)
    loop.explore(20.0)
    loop.name_place('corner')
    corner = loop.simulator.truth
    loop.explore(60.0)
    begun_s, begun_m = loop.now_s, loop.simulator.odometer_m
    assert apart_m(loop.simulator.truth, corner) > 3.0
    (task,) = loop.go_to('corner', until=lambda: loop.now_s > begun_s + 90.0)
    assert (task.status, task.reason) == ('succeeded', '')
    # 0.5 m would need a longer exploration: views match slightly before their places.
    assert apart_m(loop.simulator.truth, corner) < 1.0
    assert loop.simulator.odometer_m - begun_m < 30.0
    assert loop.simulator.collisions == 0
    assert not loop.navigator.queue
    assert loop.guidance.status == 'succeeded'
    assert near_walls(loop) > 0.95


def near_walls(loop):
    """Return the share of all points stored on the map that are within 0.1 m of a wall."""
    matcher, cell_m = loop.ratslam.scan_matcher, PLAN.cell_m
    shares = []
    for number, true in loop.log.truth_of.items():
        points = matcher.reference(number)
        if points is not None:
            c, s = math.cos(true.heading_rad), math.sin(true.heading_rad)
            on_plan = points @ np.array([[c, s], [-s, c]]) + (true.x_m, true.y_m)
            steps = np.array([[0.0, 0.0], [0.1, 0.0], [-0.1, 0.0], [0.0, 0.1], [0.0, -0.1]])
            cells = np.floor((on_plan[:, None] + steps) / cell_m).astype(int)
            on_floor = ((cells >= 0) & (cells < PLAN.solid.shape[::-1])).all(axis=2)
            x, y = np.clip(cells, 0, np.array(PLAN.solid.shape[::-1]) - 1).transpose(2, 0, 1)
            shares.append((PLAN.solid[y, x] & on_floor).any(axis=1).mean())
    assert len(shares) > 20
    return np.mean(shares)


def test_go_to_unknown_raises_and_until_cancels():
    loop = explored(0, 20.0)
    stamp_ns = loop.simulator.stamp_ns
    with pytest.raises(UnreachableGoal, match='nowhere'):
        loop.go_to(0, 'nowhere')
    assert loop.simulator.stamp_ns == stamp_ns
    end_s = loop.now_s + 2.0
    near, far = loop.go_to(0, 1, until=lambda: loop.now_s >= end_s)
    assert (near.status, far.status) == ('cancelled', 'cancelled')
    assert not loop.navigator.queue
    assert loop.now_s == pytest.approx(end_s, abs=0.15)


def test_carried_robot_relocalises():
    loop = explored(1, 70.0, PLAIN)
    log, graph = loop.log, loop.experience_map
    mapped = dict(log.truth_of)
    closures = len(log.closures_ns)
    target = log.truth[len(log.truth) * 2 // 3]
    assert apart_m(target, loop.simulator.truth) > 2.0
    estimated = log.estimated[-1]
    loop.simulator.carry(target)
    loop.explore(0.2)  # too short for a relocalisation
    assert apart_m(log.estimated[-1], estimated) < 0.3

    def error_m():
        """Return by how much the distance to the nearest old experience is overestimated."""
        nearest = min(mapped, key=lambda number: apart_m(mapped[number], loop.simulator.truth))
        place = graph.poses[nearest, :2].tolist()
        estimated_m = math.dist(place, graph.pose[:2])
        return estimated_m - apart_m(mapped[nearest], loop.simulator.truth)

    assert error_m() > 1.5
    loop.explore(30.0)
    assert len(log.closures_ns) > closures
    assert error_m() < 0.75


def test_robot_does_not_oscillate_on_its_way_to_goals_of_the_university_floor():
    """A robot that turns between two headings hardly moves."""
    config = CONFIG.with_values({
        'experience_map.exp_align_scans': False, 'experience_map.exp_relocate': 'views',
    })
    simulator = make_simulator(SimulatorParameters(plan='university_floor', seed=2))
    loop, at_m = ClosedLoop(simulator, config, exploring_seed=2), {}
    for name in map(str, range(7)):
        loop.explore(20.0)
        loop.name_place(name)
        at_m[name] = simulator.truth[:2]
    trials = [attempt(loop, name, place_m) for name, place_m in list(at_m.items())[::2]]
    assert [one.outcome for one in trials] == ['succeeded'] * len(trials)
    assert max(one.reversals / max(one.driven_m, 3.0) for one in trials) < 2.5
    assert max(one.took_s / one.shortest_s for one in trials) < 2.0
