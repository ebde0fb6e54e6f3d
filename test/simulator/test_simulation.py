# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
import math
from dataclasses import replace

import numpy as np
import pytest
from floor_clearance import clearance_m
from hypothesis import given, settings
from hypothesis import strategies as st

from ratslam_ros.core.common.pose import Pose
from ratslam_ros.errors import UnusableInput, UnusableParameter
from ratslam_simulator.camera import CameraOptions
from ratslam_simulator.floor_plan import load_floor_plan, office
from ratslam_simulator.laser import LaserOptions
from ratslam_simulator.light import LightDrift
from ratslam_simulator.people import Walk
from ratslam_simulator.robot import RobotOptions
from ratslam_simulator.samples import ImageSample, OdometrySample, ScanSample
from ratslam_simulator.simulation import (
    START_STAMP_NS,
    STEP_NS,
    ObstacleEvent,
    SimulationOptions,
    Simulator,
)
from ratslam_simulator.world import PERSON_RADIUS_M, WorldOptions, build_world

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


def test_step_returns_due_samples_in_order():
    simulator = Simulator(LOOP, START, 0, SMALL)
    assert simulator.stamp_ns == START_STAMP_NS
    assert [type(sample) for sample in simulator.step()] == [
        OdometrySample, ScanSample, ImageSample,
    ]
    assert simulator.stamp_ns == START_STAMP_NS + STEP_NS
    samples = run(simulator, 10.0)
    counts = [sum(isinstance(s, t) for s in samples) for t in (OdometrySample, ScanSample)]
    assert counts == [200, 100]
    assert sum(isinstance(s, ImageSample) for s in samples) == 80


def test_absent_sensors_do_not_change_motion():
    with_all, without = Simulator(LOOP, START, 3, SMALL), Simulator(LOOP, START, 3, BLIND)
    for simulator in (with_all, without):
        simulator.command(0.4, 0.1)
    assert {type(sample) for sample in run(without, 3.0)} == {OdometrySample}
    run(with_all, 3.0)
    assert with_all.truth == without.truth


def test_command_holds_until_next_and_odometer_counts():
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


def test_robot_at_wall_stops_while_wheels_turn():
    simulator = Simulator(LOOP, Pose(START.x_m, START.y_m, math.pi), 1, BLIND)
    simulator.command(0.3, 0.0)
    samples = run(simulator, 20.0)
    # Slip turns the robot slightly, so that it slides along the wall.
    assert clearance_m(LOOP, simulator.truth.x_m, simulator.truth.y_m) >= RADIUS_M - 1e-6
    assert simulator.odometer_m < 3.0
    assert samples[-1].odometry.pose.x_m == pytest.approx(5.8, abs=0.2)
    assert simulator.collisions >= 1


def test_each_contact_counts_as_one_collision():
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
def test_robot_never_overlaps_walls_obstacles_people(commands, place, seed):
    plan = load_floor_plan('university_floor')
    start = Pose(*plan.places[place], 0.3)
    simulator = Simulator(plan, start, seed, BLIND, people=10)
    simulator.add_obstacle('box', start.x_m + 1.2, start.y_m, 0.6, 0.6)
    with_box = replace(plan, solid=simulator.world.solid)
    for speed_mps, turn_rate_radps in commands:
        simulator.command(speed_mps, turn_rate_radps)
        for _ in range(20):
            simulator.step()
        at, people = simulator.truth, simulator.world.people
        assert clearance_m(with_box, at.x_m, at.y_m) >= RADIUS_M - 1e-6
        apart_m = np.hypot(people[:, 0] - at.x_m, people[:, 1] - at.y_m)
        assert apart_m.min() >= RADIUS_M + PERSON_RADIUS_M - 1e-6


def test_equal_seeds_give_equal_samples():
    def drive(seed):
        options = SimulationOptions(
            camera=CameraOptions(width=16, height=12), world=WorldOptions(light_change=0.15)
        )
        events = [ObstacleEvent(2.0, 'add', 'box', *BOX), ObstacleEvent(5.0, 'remove', 'box')]
        simulator = Simulator(LOOP, START, seed, options, events, people=3)
        simulator.command(0.5, 0.02)
        return run(simulator, 8.0)

    first = drive(1)
    assert same(first, drive(1))
    assert not same(first, drive(2))


def test_carry_changes_pose_but_not_odometry():
    relocated, undisturbed = Simulator(LOOP, START, 1, BLIND), Simulator(LOOP, START, 1, BLIND)
    for simulator in (relocated, undisturbed):
        simulator.command(0.3, 0.0)
        run(simulator, 2.0)
    relocated.carry(Pose(*LOOP.places['b'], math.pi / 2))
    assert relocated.truth == Pose(*LOOP.places['b'], math.pi / 2)
    odometer_m = relocated.odometer_m
    for a, b in zip(run(relocated, 3.0), run(undisturbed, 3.0), strict=True):
        assert a.odometry == b.odometry
    assert relocated.odometer_m == pytest.approx(odometer_m + 0.9, abs=0.05)
    with pytest.raises(UnusableInput, match='does not fit'):
        relocated.carry(Pose(0.1, 0.1, 0.0))
    with pytest.raises(UnusableInput, match='does not fit'):
        relocated.carry(Pose(-5.0, 1.0, 0.0))


def test_robot_is_carried_at_given_times():
    first, second = Pose(*LOOP.places['b'], 1.0), Pose(*LOOP.places['X'], 2.0)
    simulator = Simulator(LOOP, START, 1, SMALL, carries=[(0.4, second), (0.2, first)])
    run(simulator, 0.2)
    assert simulator.truth == START
    run(simulator, 0.1)
    assert simulator.truth == first
    run(simulator, 0.2)
    assert simulator.truth == second and simulator.odometer_m == 0.0


def test_obstacle_event_blocks_corridor_until_removed():
    events = [ObstacleEvent(30.0, 'remove', 'box'), ObstacleEvent(0.0, 'add', 'box', *BOX)]
    simulator = Simulator(LOOP, START, 1, SMALL, events)
    simulator.command(0.6, 0.0)
    before = run(simulator, 0.1)
    first_scan = next(s for s in before if isinstance(s, ScanSample))
    assert first_scan.ranges_m[90] == pytest.approx(BOX[0] - 0.4 - START.x_m, abs=0.2)
    for _ in range(29 * 40):
        # Steer along the middle of the corridor by the true pose.
        aside_m = simulator.truth.y_m - START.y_m
        simulator.command(0.6, -0.8 * aside_m - 1.5 * simulator.truth.heading_rad)
        simulator.step()
    assert BOX[0] - 0.9 < simulator.truth.x_m < BOX[0]
    for _ in range(20 * 40):
        aside_m = simulator.truth.y_m - START.y_m
        simulator.command(0.6, -0.8 * aside_m - 1.5 * simulator.truth.heading_rad)
        simulator.step()
    assert simulator.truth.x_m > BOX[0] + 1.0


def test_obstacle_changes_image_until_removed():
    options = SimulationOptions(
        camera=CameraOptions(width=32, height=24, noise_grey=0.0, exposure_spread=0.0)
    )
    events = [ObstacleEvent(1.0, 'add', 'box', *BOX), ObstacleEvent(2.0, 'remove', 'box')]
    samples = run(Simulator(LOOP, START, 1, options, events), 3.0)
    images = [s.image for s in samples if isinstance(s, ImageSample)]
    assert not np.array_equal(images[0], images[10])
    assert np.array_equal(images[0], images[20])


def test_unusable_obstacles_are_refused_without_changes():
    simulator = Simulator(LOOP, START, 1, BLIND)
    solid = simulator.world.solid.copy()
    with pytest.raises(UnusableInput, match='on the robot'):
        simulator.add_obstacle('box', START.x_m + 0.4, START.y_m, 0.6, 0.6)
    with pytest.raises(UnusableInput, match='no free'):
        simulator.add_obstacle('box', 5.0, 14.0, 0.6, 0.6)
    with pytest.raises(UnusableInput, match="no obstacle 'box'"):
        simulator.remove_obstacle('box')
    assert np.array_equal(simulator.world.solid, solid)
    simulator.add_obstacle('box', *BOX)
    with pytest.raises(UnusableInput, match='already'):
        simulator.add_obstacle('box', *LOOP.places['b'], 0.6, 0.6)
    simulator.remove_obstacle('box')
    assert np.array_equal(simulator.world.solid, solid)
    assert np.array_equal(simulator.plan.solid, solid)
    with pytest.raises(UnusableInput, match='burn'):
        ObstacleEvent(1.0, 'burn', 'box')


def test_unusable_starts_rates_and_commands_are_refused():
    with pytest.raises(UnusableInput, match='does not fit'):
        Simulator(LOOP, Pose(0.2, 0.2, 0.0), 0, BLIND)
    with pytest.raises(UnusableInput, match='a robot of radius'):
        Simulator(LOOP, START, 0, BLIND, carries=[(900.0, Pose(0.2, 0.2, 0.0))])
    with pytest.raises(UnusableInput, match='a person of radius'):
        Simulator(LOOP, START, 0, BLIND, walks=[Walk([(0.2, 0.2)], 900.0)])
    with pytest.raises(UnusableParameter, match='laser cannot take 41'):
        Simulator(LOOP, START, 0, SimulationOptions(laser=LaserOptions(rate_hz=41)))
    with pytest.raises(UnusableInput, match='finite'):
        Simulator(LOOP, START, 0, BLIND).command(math.nan, 0.0)
    fast = Simulator(LOOP, START, 0, BLIND)
    fast.command(1e9, 0.0)
    assert max(s.odometry.speed_mps for s in run(fast, 6.0)) < 1.7


@pytest.mark.parametrize('rate_hz', [1, 7, 40])
def test_camera_rate_gives_evenly_spread_images(rate_hz: int):
    camera = CameraOptions(width=4, height=2, rate_hz=rate_hz)
    images = [s for s in run(Simulator(LOOP, START, 0, SimulationOptions(camera=camera)), 3.0)
              if isinstance(s, ImageSample)]
    assert len(images) == 3 * rate_hz
    gaps_ns = np.diff([s.stamp_ns for s in images])
    assert np.all(np.abs(gaps_ns - 1e9 / rate_hz) < STEP_NS)


def test_light_drift_has_requested_size_and_is_smooth():
    rng = np.random.Generator(np.random.PCG64(5))
    world = build_world(office(), rng)
    drift = LightDrift(world, rng, 0.12)
    lights = []
    for elapsed_s in range(0, 1800, 10):
        drift.update(elapsed_s)
        lights.append(world.light.copy())
    lights = np.array(lights)
    assert 0.06 < lights.std(axis=0).mean() < 0.2
    # Smooth in time, and different from place to place.
    assert np.abs(np.diff(lights, axis=0)).max() < 0.05
    assert np.ptp(lights[-1] - lights[0]) > 0.05
    assert lights.min() > 0.1


def test_light_change_zero_keeps_light_constant():
    for change, changes in ((0.0, False), (0.12, True)):
        options = SimulationOptions(
            camera=None, laser=None, world=WorldOptions(light_change=change)
        )
        simulator = Simulator(LOOP, START, 5, options)
        run(simulator, 0.1)
        before = simulator.world.light.copy()
        run(simulator, 20.0)
        assert (not np.array_equal(simulator.world.light, before)) == changes
