# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Calibration of odometry while driving: a robot drives laps of an oval with false turns."""

import math
from collections.abc import Iterator
from dataclasses import replace
from itertools import pairwise

import pytest

from ratslam_ros.core.common.odometry import Motion, MotionFromOdometry, Odometry, Twist
from ratslam_ros.core.common.pose import Pose
from ratslam_ros.core.common.turn_correction import TurnCorrection
from ratslam_ros.core.config import Config
from ratslam_ros.core.pose_cells.odometry_calibration import OdometryCalibration
from ratslam_ros.core.pose_cells.pose_cells import PoseCells
from ratslam_ros.core.vision.local_view import ViewMatch
from ratslam_ros.pipeline.ratslam import RatSLAM

PER_LAP, STEP_M, PERIOD_NS = 60, 0.5, 100_000_000
CALIBRATING = Config().with_values({
    'pose_cells.odom_calibration': True, 'pose_cells.exp_delta_pc_threshold': 1.0,
    'pose_cells.pc_dim_x': 60, 'pose_cells.pc_dim_y': 60,
})


def oval(
    laps: int, gain: float, per_m_rad: float = 0.0, scale_known: bool = True
) -> Iterator[tuple[Odometry, ViewMatch]]:
    """Yield odometry that has to be corrected, and views that are right."""
    for n in range(laps * PER_LAP):
        place = n % PER_LAP
        turn = 4.0 * math.pi / PER_LAP if place % (PER_LAP // 2) >= PER_LAP // 4 else 0.0
        measured = TurnCorrection(gain, per_m_rad).measured(turn, STEP_M)
        dt_s = PERIOD_NS * 1e-9
        twist = Twist(STEP_M / dt_s, measured / dt_s)
        odometry = Odometry((n + 1) * PERIOD_NS, twist, Pose(0.0, 0.0, 0.0), scale_known)
        yield odometry, ViewMatch(place, n < PER_LAP, 0.0, 0.0)


def driven(
    laps: int, gain: float, per_m_rad: float = 0.0, config: Config = CALIBRATING,
    scale_known: bool = True,
) -> RatSLAM:
    slam = RatSLAM(config, 'pose_cells')
    for odometry, match in oval(laps, gain, per_m_rad, scale_known):
        slam.odometry(odometry)
        slam.template(odometry.stamp_ns, match)
    slam.finish()
    return slam


def lap_turn_rad(slam: RatSLAM) -> float:
    """Return the turn of the map along a lap, in rad."""
    places = {one.template_id: one.pose.heading_rad for one in slam.experience_map.experiences()}
    headings = [heading for _, heading in sorted(places.items())]
    return sum(math.remainder(b - a, 2.0 * math.pi) for a, b in pairwise(headings))


@pytest.mark.parametrize('count', [5, 128, 129])
def test_kept_loops_are_of_the_whole_run(count: int) -> None:
    """Loop n has the turn n + 1: every experience is visited again after one more step."""
    calibration = OdometryCalibration(TurnCorrection())
    for n in range(count):
        for place in range(PER_LAP):
            calibration.visit(1000 * n + place, 0.0, created=True)
        for _ in range(n + 1):
            calibration.integrate(Motion(0.1, 0.0, 1.0, scale_known=False))
        calibration.visit(1000 * n, 0.0, created=False)
    kept = [round(turn_rad) - 1 for turn_rad in calibration._loop_turns_rad]
    stride = kept[1]
    assert kept == list(range(0, count, stride))
    assert min(count, 64) <= len(kept) <= 128


@pytest.mark.parametrize(
    ('gain', 'per_m_rad'), [(1.04, 0.0), (0.97, -0.004)]
)
def test_small_errors_of_wheels_are_found_by_the_map(gain: float, per_m_rad: float) -> None:
    slam = driven(4, gain, per_m_rad)
    measured = TurnCorrection(gain, per_m_rad).measured(2.0 * math.pi, PER_LAP * STEP_M)
    turns = slam.experience_map.optimiser.turns
    corrected = turns.corrected(measured, PER_LAP * STEP_M)
    assert abs(corrected - 2.0 * math.pi) < 0.7 * abs(measured - 2.0 * math.pi)
    before = slam.experience_map.pose.heading_rad
    slam.experience_map.integrate(Motion(1.0, 1.0, 1.0))
    turn_rad = slam.experience_map.pose.heading_rad - before
    assert math.remainder(turn_rad, math.tau) == pytest.approx(turns.corrected(1.0, 1.0))


@pytest.mark.parametrize('gain', [0.7, 2.5])
def test_wrong_scale_is_corrected_in_the_map_of_the_first_lap(gain: float) -> None:
    slam = driven(3, gain, scale_known=False)
    calibration = slam.pose_cells.calibration
    assert calibration is not None
    assert calibration.correction.gain == pytest.approx(gain, rel=0.02)
    slam.experience_map.settle()
    assert lap_turn_rad(slam) == pytest.approx(2.0 * math.pi, abs=0.3)


def test_unit_of_turns_is_found_as_soon_as_the_loops_suffice() -> None:
    """A robot that drives one lap and a half has few of them."""
    calibration = circle(26, 2.4)
    assert 0 < calibration.loops < 8
    assert calibration.correction.gain == pytest.approx(2.4, rel=0.02)


def test_false_recognitions_hardly_delay_the_unit_of_turns() -> None:
    """Every third view of the second lap is taken for one of another place."""
    gain = 2.5
    slam = RatSLAM(CALIBRATING, 'pose_cells')
    for n, (odometry, match) in enumerate(oval(2, gain, scale_known=False)):
        if n == PER_LAP + PER_LAP // 3:
            break
        is_false = n >= PER_LAP and n % 3 == 0
        slam.odometry(odometry)
        slam.template(odometry.stamp_ns, replace(match, template_id=n * 7 % PER_LAP)
                      if is_false else match)
    calibration = slam.pose_cells.calibration
    assert calibration is not None
    assert calibration.correction.gain == pytest.approx(gain, rel=0.02)


def test_loops_that_end_facing_another_way_tell_nothing_about_the_unit() -> None:
    """A robot with a panoramic camera drives there and back."""
    assert circle(60, 2.0, half_turn=True).loops == 0


def circle(steps: int, gain: float, half_turn: bool = False) -> OdometryCalibration:
    """Return the calibration after circles of 20 steps, of which each is seen the other way."""
    calibration = OdometryCalibration(TurnCorrection())
    turn_rad = (0.5 if half_turn else 1.0) * 2.0 * math.pi / 20 / gain
    for n in range(steps):
        turn = calibration.correction.corrected(turn_rad, 0.5)
        calibration.integrate(Motion(0.1, 0.5, turn, scale_known=False))
        relative_rad = math.pi * (n // 20 % 2) if half_turn else 0.0
        calibration.visit(n % 20, relative_rad, created=n < 20)
    return calibration


def test_unit_of_wheels_is_known() -> None:
    calibration = driven(4, 2.5).pose_cells.calibration
    assert calibration is not None
    assert calibration.correction == TurnCorrection()


def test_precise_odometry_is_not_changed() -> None:
    turns = driven(5, 1.0).experience_map.optimiser.turns
    assert tuple(turns) == pytest.approx((1.0, 0.0), abs=1e-6)


def test_calibration_can_be_switched_off() -> None:
    config = CALIBRATING.with_values({'pose_cells.odom_calibration': False})
    slam = driven(3, 2.5, config=config, scale_known=False)
    assert slam.pose_cells.calibration is None
    assert 'calibration' not in slam.pose_cells.state()
    assert slam.pipeline.stages['pose_cells'].motion.correction == TurnCorrection()


def test_estimate_starts_from_configured_correction() -> None:
    config = CALIBRATING.with_values({
        'inputs.odom_rotation_gain': 2.5, 'inputs.odom_turn_per_m': 0.004,
    })
    slam = driven(1, 2.5, 0.004, config)
    calibration = slam.pose_cells.calibration
    assert calibration is not None
    assert calibration.correction == TurnCorrection(2.5, 0.004)
    assert calibration.loops == 0
    once = 2.0 * math.pi * (PER_LAP - 1) / PER_LAP
    assert lap_turn_rad(slam) == pytest.approx(once, abs=0.15)


def test_restored_calibration_continues_identically() -> None:
    config = CALIBRATING.pose_cells
    messages = list(oval(3, 2.5, scale_known=False))
    one, split = PoseCells(config), PoseCells(config)
    actions: list[list[object]] = [[], []]
    turns: list[list[float]] = []
    for which, core in enumerate((one, split)):
        motion_of = MotionFromOdometry('twist', correction=CALIBRATING.inputs.turn_correction)
        for n, (odometry, match) in enumerate(messages):
            motion = motion_of.update(odometry)
            if motion is not None:
                core.integrate(motion)
            if core is not one and n >= len(messages) // 2:  # between odometry and view
                restored = PoseCells(config)
                restored.restore(core.state())
                core = restored
            action = core.view(match)
            assert action.correction is not None
            motion_of.correction = action.correction
            actions[which].append(action)
        assert core.calibration is not None
        assert core.calibration.loops > 0
        turns.append(core.calibration.state()['loop_turns_rad'])
    assert actions[0] == actions[1]
    assert turns[0] == turns[1]


def test_robot_that_was_carried_closes_no_loop() -> None:
    slam = driven(2, 2.5, scale_known=False)
    calibration = slam.pose_cells.calibration
    assert calibration is not None
    calibration.restart()
    before = len(calibration.state()['loop_turns_rad'])
    calibration.visit(0, 0.0, created=False)
    assert len(calibration.state()['loop_turns_rad']) == before


def test_loop_through_an_odometry_gap_does_not_count() -> None:
    config = CALIBRATING.with_values(
        {'inputs.max_odom_gap_s': 2.0}
    )
    slam = RatSLAM(config, 'pose_cells')
    gap_ns = 10 * 10**9
    for n, (odometry, match) in enumerate(oval(2, 2.5, scale_known=False)):
        if n >= PER_LAP:
            odometry = replace(odometry, stamp_ns=odometry.stamp_ns + gap_ns)
        slam.odometry(odometry)
        slam.template(odometry.stamp_ns, match)
    slam.finish()
    calibration = slam.pose_cells.calibration
    assert calibration is not None
    assert slam.pose_cells.gap_count == 1
    assert not calibration.state()['loop_turns_rad']
