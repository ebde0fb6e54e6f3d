# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from ratslam_ros.errors import UnusableInput, UnusableParameter
from ratslam_ros.simulator.camera import CameraOptions
from ratslam_ros.simulator.floor_plan import load_floor_plan, office
from ratslam_ros.simulator.laser import LaserOptions
from ratslam_ros.simulator.light import LightDrift
from ratslam_ros.simulator.robot import Pose, RobotOptions
from ratslam_ros.simulator.simulation import (
    START_STAMP_NS,
    STEP_NS,
    Happening,
    ImageSample,
    OdometrySample,
    ScanSample,
    SimulationOptions,
    Simulator,
)
from ratslam_ros.simulator.world import PERSON_RADIUS_M, WorldOptions, build_world

RADIUS_M = RobotOptions().body_radius_m
BLIND = SimulationOptions(camera=None, laser=None)
SMALL = SimulationOptions(camera=CameraOptions(width=16, height=12))
LOOP = load_floor_plan('obstacle_loop')
START = Pose(*LOOP.places['S'], 0.0)
BOX = (*LOOP.places['X'], 0.8, 2.0)


def run(simulator, duration_s):
    samples = []
    for _ in range(round(duration_s * 40)):
        samples += simulator.step()
    return samples


def same(first, second):
    for a, b in zip(first, second, strict=True):
        if (a.stamp_ns, a.truth) != (b.stamp_ns, b.truth):
            return False
        if isinstance(a, ImageSample) and not np.array_equal(a.image, b.image):
            return False
        if isinstance(a, ScanSample) and not np.array_equal(a.ranges_m, b.ranges_m):
            return False
    return True


def test_samples_come_when_due_odometry_before_scan_before_image():
    simulator = Simulator(LOOP, START, 0, SMALL)
    assert simulator.stamp_ns == START_STAMP_NS
    assert [type(sample) for sample in simulator.step()] == [
        OdometrySample, ScanSample, ImageSample,
    ]  # fmt: skip
    assert simulator.stamp_ns == START_STAMP_NS + STEP_NS
    samples = run(simulator, 10.0)
    counts = [sum(isinstance(s, t) for s in samples) for t in (OdometrySample, ScanSample)]
    assert counts == [200, 100]
    assert sum(isinstance(s, ImageSample) for s in samples) == 80


def test_sensors_that_are_not_there_give_nothing_and_disturb_nothing():
    with_all, without = Simulator(LOOP, START, 3, SMALL), Simulator(LOOP, START, 3, BLIND)
    for simulator in (with_all, without):
        simulator.command(0.4, 0.1)
    assert {type(sample) for sample in run(without, 3.0)} == {OdometrySample}
    run(with_all, 3.0)
    assert with_all.truth == without.truth


def test_command_holds_and_the_way_is_measured():
    simulator = Simulator(LOOP, START, 1, BLIND)
    simulator.command(0.4, 0.0)
    run(simulator, 12.0)
    assert simulator.odometer_m == pytest.approx(4.6, abs=0.15)
    assert simulator.truth.x_m - START.x_m == pytest.approx(simulator.odometer_m, abs=0.15)
    assert simulator.collisions == 0
    simulator.command(0.0, 0.0)
    run(simulator, 2.0)
    at = simulator.truth
    run(simulator, 5.0)
    assert simulator.truth == at


def test_robot_in_front_of_a_wall_stops_while_its_wheels_turn_on():
    simulator = Simulator(LOOP, Pose(START.x_m, START.y_m, math.pi), 1, BLIND)
    simulator.command(0.3, 0.0)
    samples = run(simulator, 20.0)
    # Some slip turns it a little, and along the wall it slides; but not through.
    assert LOOP.clearance_m(simulator.truth.x_m, simulator.truth.y_m) >= RADIUS_M - 1e-6
    assert simulator.odometer_m < 3.0
    assert samples[-1].odometry.pose.x_m == pytest.approx(5.8, abs=0.2)
    assert simulator.collisions >= 1


def test_each_touch_counts_once():
    simulator = Simulator(LOOP, Pose(START.x_m, START.y_m, math.pi), 1, BLIND)
    for touches in (1, 2, 3):
        simulator.command(0.3, 0.0)
        run(simulator, 6.0)
        assert simulator.collisions == touches
        simulator.command(-0.3, 0.0)
        run(simulator, 3.0)
        assert simulator.collisions == touches


@settings(max_examples=8, deadline=None)
@given(
    st.lists(st.tuples(st.floats(-2.0, 2.0), st.floats(-3.0, 3.0)), min_size=5, max_size=12),
    st.sampled_from('Secg'),
    st.integers(0, 2**32),
)
def test_body_never_enters_walls_obstacles_or_people(commands, place, seed):
    plan = load_floor_plan('university_floor')
    start = Pose(*plan.places[place], 0.3)
    simulator = Simulator(plan, start, seed, BLIND, people=10)
    simulator.put_obstacle('box', start.x_m + 1.2, start.y_m, 0.6, 0.6)
    solid = load_floor_plan('university_floor')
    solid.solid[:] = simulator.world.solid
    for speed_mps, turn_rate_radps in commands:
        simulator.command(speed_mps, turn_rate_radps)
        for _ in range(20):
            simulator.step()
        at, people = simulator.truth, simulator.world.people
        assert solid.clearance_m(at.x_m, at.y_m) >= RADIUS_M - 1e-6
        apart_m = np.hypot(people[:, 0] - at.x_m, people[:, 1] - at.y_m)
        assert apart_m.min() >= RADIUS_M + PERSON_RADIUS_M - 1e-6


def test_same_seed_same_samples_and_another_seed_others():
    def drive(seed):
        options = SimulationOptions(
            camera=CameraOptions(width=16, height=12), world=WorldOptions(light_change=0.15)
        )
        happenings = [Happening(2.0, 'put', 'box', *BOX), Happening(5.0, 'take', 'box')]
        simulator = Simulator(LOOP, START, seed, options, happenings, people=3)
        simulator.command(0.5, 0.02)
        return run(simulator, 8.0)

    first = drive(1)
    assert same(first, drive(1))
    assert not same(first, drive(2))


def test_being_carried_is_noticed_by_no_wheel():
    relocated, left = Simulator(LOOP, START, 1, BLIND), Simulator(LOOP, START, 1, BLIND)
    for simulator in (relocated, left):
        simulator.command(0.3, 0.0)
        run(simulator, 2.0)
    relocated.carry(Pose(*LOOP.places['b'], math.pi / 2))
    assert relocated.truth == Pose(*LOOP.places['b'], math.pi / 2)
    odometer_m = relocated.odometer_m
    for a, b in zip(run(relocated, 3.0), run(left, 3.0), strict=True):
        assert a.odometry == b.odometry
    assert relocated.odometer_m == pytest.approx(odometer_m + 0.9, abs=0.05)
    with pytest.raises(UnusableInput, match='does not fit'):
        relocated.carry(Pose(0.1, 0.1, 0.0))
    with pytest.raises(UnusableInput, match='does not fit'):
        relocated.carry(Pose(-5.0, 1.0, 0.0))


def test_obstacle_blocks_the_corridor_and_is_gone_again():
    happenings = [Happening(30.0, 'take', 'box'), Happening(0.0, 'put', 'box', *BOX)]
    simulator = Simulator(LOOP, START, 1, SMALL, happenings)
    simulator.command(0.6, 0.0)
    before = run(simulator, 0.1)
    first_cut = next(s for s in before if isinstance(s, ScanSample))
    assert first_cut.ranges_m[90] == pytest.approx(BOX[0] - 0.4 - START.x_m, abs=0.2)
    for _ in range(29 * 40):
        # Steered along the middle by somebody who knows where it is.
        aside_m = simulator.truth.y_m - START.y_m
        simulator.command(0.6, -0.8 * aside_m - 1.5 * simulator.truth.heading_rad)
        simulator.step()
    assert BOX[0] - 0.9 < simulator.truth.x_m < BOX[0]
    for _ in range(20 * 40):
        aside_m = simulator.truth.y_m - START.y_m
        simulator.command(0.6, -0.8 * aside_m - 1.5 * simulator.truth.heading_rad)
        simulator.step()
    assert simulator.truth.x_m > BOX[0] + 1.0


def test_obstacle_is_seen_by_the_camera_and_leaves_no_trace():
    options = SimulationOptions(
        camera=CameraOptions(width=32, height=24, noise_grey=0.0, exposure_spread=0.0)
    )
    happenings = [Happening(1.0, 'put', 'box', *BOX), Happening(2.0, 'take', 'box')]
    samples = run(Simulator(LOOP, START, 1, options, happenings), 3.0)
    images = [s.image for s in samples if isinstance(s, ImageSample)]
    assert not np.array_equal(images[0], images[10])
    assert np.array_equal(images[0], images[20])


def test_obstacles_that_cannot_be_are_refused_and_change_nothing():
    simulator = Simulator(LOOP, START, 1, BLIND)
    solid = simulator.world.solid.copy()
    with pytest.raises(UnusableInput, match='on the robot'):
        simulator.put_obstacle('box', START.x_m + 0.4, START.y_m, 0.6, 0.6)
    with pytest.raises(UnusableInput, match='no free'):
        simulator.put_obstacle('box', 5.0, 14.0, 0.6, 0.6)
    with pytest.raises(UnusableInput, match="no obstacle 'box'"):
        simulator.take_obstacle('box')
    assert np.array_equal(simulator.world.solid, solid)
    simulator.put_obstacle('box', *BOX)
    with pytest.raises(UnusableInput, match='already'):
        simulator.put_obstacle('box', *LOOP.places['b'], 0.6, 0.6)
    simulator.take_obstacle('box')
    assert np.array_equal(simulator.world.solid, solid)
    assert np.array_equal(simulator.plan.solid, solid)
    with pytest.raises(UnusableInput, match='burn'):
        Happening(1.0, 'burn', 'box')


def test_bad_starts_rates_and_commands_are_refused():
    with pytest.raises(UnusableInput, match='does not fit'):
        Simulator(LOOP, Pose(0.2, 0.2, 0.0), 0, BLIND)
    with pytest.raises(UnusableParameter, match='laser cannot take 7'):
        Simulator(LOOP, START, 0, SimulationOptions(laser=LaserOptions(rate_hz=7)))
    with pytest.raises(UnusableInput, match='finite'):
        Simulator(LOOP, START, 0, BLIND).command(math.nan, 0.0)
    fast = Simulator(LOOP, START, 0, BLIND)
    fast.command(1e9, 0.0)
    assert max(s.odometry.speed_mps for s in run(fast, 6.0)) < 1.7


def test_light_drifts_over_minutes_by_the_share_asked_for():
    rng = np.random.Generator(np.random.PCG64(5))
    world = build_world(office(), rng)
    drift = LightDrift(world, rng, 0.12)
    lights = []
    for elapsed_s in range(0, 1800, 10):
        drift.update(elapsed_s)
        lights.append(world.light.copy())
    lights = np.array(lights)
    assert 0.06 < lights.std(axis=0).mean() < 0.2
    # Smoothly, and not everywhere alike.
    assert np.abs(np.diff(lights, axis=0)).max() < 0.05
    assert np.ptp(lights[-1] - lights[0]) > 0.05
    assert lights.min() > 0.1


def test_light_changes_only_where_it_is_asked_for():
    for change, changes in ((0.0, False), (0.12, True)):
        options = SimulationOptions(
            camera=None, laser=None, world=WorldOptions(light_change=change)
        )
        simulator = Simulator(LOOP, START, 5, options)
        run(simulator, 0.1)
        before = simulator.world.light.copy()
        run(simulator, 20.0)
        assert (not np.array_equal(simulator.world.light, before)) == changes
