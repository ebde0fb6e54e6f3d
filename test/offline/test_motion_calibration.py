# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Calibration of the motion of rendered and of real recordings before they are replayed."""

import csv
import math
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from helpers import (
    IMAGE_TOPIC,
    ODOM_TOPIC,
    PERIOD_NS,
    START_NS,
    camera_info_message,
    image_message,
    odometry_message,
    original,
    picture,
    real_recording,
    write_bag,
)

from ratslam_ros.core.common.pose import Pose
from ratslam_ros.core.config import Config
from ratslam_ros.core.vision.visual_odometry import VisualOdometry
from ratslam_ros.offline.motion_calibration import MotionCalibration, calibrate_motion
from ratslam_ros.recordings import ImageEvent, open_recording
from ratslam_simulator.camera import Camera, CameraOptions
from ratslam_simulator.floor_plan import parse_floor_plan
from ratslam_simulator.world import WorldOptions, build_world

ROOM = parse_floor_plan('\n'.join(['#' * 16, *['#..............#'] * 14, '#' * 16]), cell_m=1.0)
REFINED = original().with_values(
    {'visual_odometry.vrot_height_share': 0.5, 'visual_odometry.vrot_subpixel': True}
)
PER_LAP, STEP_M = 200, 0.08
FOV_DEG = 70.0
GAIN = 0.96
"""Gain that corrects the odometry of the rendered recordings."""


def stadium() -> Iterator[Pose]:
    """Yield the poses of one lap, counter-clockwise, of two straights and two half circles."""
    pose = Pose(5.0, 5.5, 0.0)
    for n in range(PER_LAP):
        turn = 4.0 * math.pi / PER_LAP if n % (PER_LAP // 2) >= PER_LAP // 4 else 0.0
        yield pose
        direction = pose.heading_rad + 0.5 * turn
        pose = Pose(
            pose.x_m + STEP_M * math.cos(direction), pose.y_m + STEP_M * math.sin(direction),
            pose.heading_rad + turn,
        )  # fmt: skip


def render(folder: Path, laps: float = 2.3) -> Path:
    """Write a recording of laps through a simulated room, with odometry."""
    rng = np.random.Generator(np.random.PCG64(3))
    world = build_world(ROOM, rng, WorldOptions(aliasing=0.0))
    camera = Camera(world, rng, CameraOptions(fov_deg=FOV_DEG, noise_grey=1.0))
    poses = list(stadium())

    def messages() -> Iterator[tuple[int, str, str, object]]:
        for n in range(round(laps * PER_LAP)):
            stamp_ns = START_NS + n * PERIOD_NS
            before, pose = poses[(n - 1) % PER_LAP], poses[n % PER_LAP]
            turn = math.remainder(pose.heading_rad - before.heading_rad, 2.0 * math.pi)
            dt_s = PERIOD_NS * 1e-9
            twist = STEP_M / dt_s, turn / GAIN / dt_s
            yield stamp_ns, ODOM_TOPIC, 'odometry', odometry_message(
                stamp_ns, *twist, Pose(0.0, 0.0, 0.0)
            )
            yield stamp_ns + 1, IMAGE_TOPIC, 'image', image_message(stamp_ns, camera.take(*pose))

    return write_bag(folder, messages())


def calibrated(
    path: Path, config: Config = REFINED, visual_odometry: bool = False,
    only_images: bool = False, duration_s: float | None = None,
) -> MotionCalibration:  # fmt: skip
    with open_recording(path) as recording:
        selection = recording.select(visual_odometry=visual_odometry)
        if only_images:
            recording.topics = tuple(t for t in recording.topics if t.name == IMAGE_TOPIC)
        return calibrate_motion(recording, selection, config, duration_s=duration_s)


def fov_of(calibration: MotionCalibration) -> float:
    return calibration.settings['visual_odometry.camera_fov_deg']


@pytest.fixture(scope='module')
def room(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return render(tmp_path_factory.mktemp('room') / 'recording')


def test_field_of_view_from_loops(room: Path) -> None:
    calibration = calibrated(room, visual_odometry=True, only_images=True)
    assert calibration.source == 'loops'
    assert calibration.loops >= 7
    assert '360' in calibration.reason
    assert fov_of(calibration) == pytest.approx(FOV_DEG, rel=0.05)


def test_field_of_view_does_not_depend_on_the_assumed_one(room: Path) -> None:
    narrow, wide = (
        fov_of(calibrated(
            room, REFINED.with_values({'visual_odometry.camera_fov_deg': assumed}),
            visual_odometry=True, only_images=True,
        )) for assumed in (30.0, 150.0)
    )  # fmt: skip
    assert narrow == pytest.approx(wide, rel=0.005)


def test_field_of_view_from_recorded_odometry(room: Path) -> None:
    calibration = calibrated(room, visual_odometry=True)
    assert calibration.source == 'odometry'
    assert ODOM_TOPIC in calibration.reason
    # The odometry turns by 1 / GAIN of the true turn.
    assert fov_of(calibration) == pytest.approx(FOV_DEG / GAIN, rel=0.05)


def test_correction_of_recorded_odometry(room: Path) -> None:
    calibration = calibrated(room)
    assert calibration.source == 'loops'
    gain, per_m = (
        calibration.settings[f'pose_cells.{name}']
        for name in ('odom_rotation_gain', 'odom_turn_per_m')
    )
    corrected = gain * 2.0 * math.pi / GAIN + per_m * PER_LAP * STEP_M
    assert corrected == pytest.approx(2.0 * math.pi, rel=0.015)
    config = REFINED.with_values(calibration.settings)
    assert config.pose_cells.turn_correction == config.experience_map.turn_correction


def test_path_without_loop_is_a_guess_with_advice(room: Path) -> None:
    half_lap_s = 0.5 * PER_LAP * PERIOD_NS * 1e-9
    calibration = calibrated(
        room, visual_odometry=True, only_images=True, duration_s=half_lap_s
    )
    assert calibration.source == 'guess'
    assert not calibration.settings
    assert 'camera_fov_deg' in calibration.reason
    assert calibrated(room, duration_s=half_lap_s).source == 'guess'


def test_camera_info_is_preferred(tmp_path: Path) -> None:
    def messages() -> Iterator[tuple[int, str, str, object]]:
        for n in range(5):
            stamp_ns = START_NS + n * PERIOD_NS
            yield stamp_ns, '/camera/camera_info', 'camera_info', camera_info_message(
                stamp_ns, 16.0
            )
            yield stamp_ns, IMAGE_TOPIC, 'image', image_message(stamp_ns, picture(n, 24, 32))

    path = write_bag(tmp_path / 'recording', messages())
    calibration = calibrated(path)
    assert calibration.source == 'camera_info'
    assert fov_of(calibration) == pytest.approx(90.0)
    off = REFINED.with_values({'visual_odometry.fov_from_camera_info': False})
    assert calibrated(path, off).source == 'guess'


def test_lab_car_turns_by_360_degrees_per_lap() -> None:
    folder = real_recording('lab_car')
    with open_recording(folder) as recording:
        selection = recording.select()
        calibration = calibrate_motion(recording, selection, REFINED)
        assert calibration.source == 'loops'
        visual_odometry = VisualOdometry(
            REFINED.with_values(calibration.settings).visual_odometry
        )
        headings, heading, last_ns = [], 0.0, 0
        for event in recording.events(selection):
            if isinstance(event, ImageEvent):
                measured = visual_odometry.estimate(event.stamp_ns, event.grey())
                if measured is not None:
                    heading += measured.twist.angular_z_radps * (event.stamp_ns - last_ns) * 1e-9
                last_ns = event.stamp_ns
                headings.append(math.degrees(heading))
    with open(folder / 'lap_phase.csv', encoding='ascii', newline='') as file:
        lap = [int(row['lap']) for row in csv.DictReader(file)]
    starts = [n for n in range(1, len(lap)) if lap[n] != lap[n - 1]]
    turns = np.diff(np.array(headings)[starts])
    assert len(turns) == 13
    assert turns.mean() == pytest.approx(360.0, abs=5.0)
    assert np.abs(turns - 360.0).max() < 30.0
