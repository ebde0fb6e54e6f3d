# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The inspection of a recording: what it chooses, and that it changes nothing else."""

from __future__ import annotations

import math
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from helpers import (
    IMAGE_TOPIC,
    ODOM_TOPIC,
    PERIOD_NS,
    START_NS,
    Recorded,
    extended,
    image_message,
    odometry_message,
    picture,
    undecodable_message,
    write_bag,
)
from numpy.typing import NDArray

from ratslam_ros.core.common.pose import Pose
from ratslam_ros.core.config import AUTOMATIC, Config
from ratslam_ros.errors import UnusableParameter
from ratslam_ros.offline import inspection as module
from ratslam_ros.offline.inspection import Inspection, inspect, static_borders
from ratslam_ros.offline.look_ahead import Look
from ratslam_ros.recordings import open_recording

COUNT = 60
HEIGHT, WIDTH = 48, 64


def drive(
    speed: float = 1.0, moves: bool = True, left_out: range = range(0), left: int = 0,
    right: int = 0, bottom: int = 0, flat: float = 0.0, brightness: float = 1.0,
) -> Iterator[Recorded]:
    """Yield a circle.

    Args:
        speed: speed in the twist, in m/s.
        moves: whether the pose moves.
        left_out: numbers of the odometry messages that are missing.
        left, right, bottom: width of the static borders in px.
        flat: share of images of a single grey level.
        brightness: factor of all grey levels.
    """
    for i in range(COUNT):
        stamp_ns = START_NS + i * PERIOD_NS
        angle = i / COUNT * 2.0 * math.pi
        pose = Pose(2.0 * math.sin(angle), 2.0 - 2.0 * math.cos(angle), angle)
        turn_rate = 0.5 if speed else 0.0
        if i not in left_out:
            still = Pose(0.0, 0.0, 0.0)
            message = odometry_message(stamp_ns, speed, turn_rate, pose if moves else still)
            yield stamp_ns, ODOM_TOPIC, 'odometry', message
        image = picture(i, HEIGHT, WIDTH)
        if i < flat * COUNT:
            image[:] = i
        image[HEIGHT - bottom :] = 60
        image[:, :left] = 10
        image[:, WIDTH - right :] = 20
        image = np.rint(brightness * image).astype(np.uint8)
        yield stamp_ns + 1_000_000, IMAGE_TOPIC, 'image', image_message(stamp_ns, image)


SMALL = extended().with_values(
    {'local_view.template_x_size': 16, 'local_view.vt_min_structure': 0.02}
)


def inspected(folder: Path, *fixed: str, config: Config = SMALL, **world: Any) -> Inspection:
    with open_recording(write_bag(folder / 'bag', drive(**world))) as recording:
        return inspect(recording, recording.select(), config, fixed)


def changes(config: Config) -> dict[str, Any]:
    """Return the parameters that differ from the defaults."""
    default = SMALL.values()
    return {
        f'{section}.{name}': value
        for section, values in config.values().items()
        for name, value in values.items() if value != default[section][name]
    }


def test_complete_recording_changes_nothing(tmp_path: Path) -> None:
    found = inspected(tmp_path)
    assert changes(found.config) == {}
    rotation, odometry, images = found.lines
    assert rotation == 'rotation: that of /odom'
    assert all(part in odometry for part in ('twist of /odom', '10.0 Hz', '6 m', 'no gaps'))
    assert all(part in images for part in ('64x48', '10.0 Hz', 'all are usable', 'no crop'))


def test_empty_twist_selects_the_pose(tmp_path: Path) -> None:
    found = inspected(tmp_path, speed=0.0)
    assert found.config.inputs.odom_source == 'pose'
    assert 'pose of /odom, because the twist is empty' in found.lines[1]


def test_empty_pose_selects_the_twist(tmp_path: Path) -> None:
    from_pose = extended().with_values(
        {'inputs.odom_source': 'pose'}
    )
    found = inspected(tmp_path, moves=False, config=from_pose)
    assert found.config.inputs.odom_source == 'twist'


def test_robot_at_rest_is_reported(tmp_path: Path) -> None:
    found = inspected(tmp_path, speed=0.0, moves=False)
    assert found.config.inputs.odom_source == 'twist'
    assert 'never moves' in found.lines[1]


def test_gaps_of_odometry_are_reported(tmp_path: Path) -> None:
    line = inspected(tmp_path, left_out=range(20, 45)).lines[1]
    assert '1 gap of more than 2 s, the longest 2.6 s at 2 s' in line


@pytest.mark.parametrize(('left_out', 'text'), [
    (range(25), '1 gap of more than 2 s, the longest 2.5 s at 0 s'),
    (range(30, COUNT), '1 gap of more than 2 s, the longest 3.0 s at 3 s'),
])
def test_odometry_of_a_part_of_the_images_has_a_gap(
    left_out: range, text: str, tmp_path: Path
) -> None:
    assert inspected(tmp_path, left_out=left_out).lines[1].endswith(text)


@pytest.mark.parametrize(('late_topic', 'early_topic'), [
    (IMAGE_TOPIC, ODOM_TOPIC), (ODOM_TOPIC, IMAGE_TOPIC),
])
def test_stamps_of_different_clocks_are_reported(
    late_topic: str, early_topic: str, tmp_path: Path
) -> None:
    late_ns = 2_500_000_000
    messages = sorted(
        (ns + late_ns if topic == late_topic else ns, topic, kind, message)
        for ns, topic, kind, message in drive()
    )
    with open_recording(write_bag(tmp_path / 'bag', messages)) as recording:
        inspect(recording, recording.select(), SMALL)
        [warning] = recording.warnings
    assert warning.startswith(
        f'the stamps of {late_topic} are 2.5 s behind those of {early_topic} '
    )


@pytest.mark.parametrize(('speed', 'spike', 'text'), [
    (1.0, (), ''), (99.0, (), ''),
    (1000.0, (), 'at 59 of 59 messages, first at 0.1 s, by up to 100 m '),
    (1.0, (30, 1e6), 'at 1 of 59 messages, first at 3.0 s, by up to 1e+05 m '),
])
def test_jumps_of_odometry_are_reported(
    speed: float, spike: tuple[int, float] | tuple[()], text: str, tmp_path: Path
) -> None:
    messages = list(drive(speed=speed))
    if spike:
        messages[2 * spike[0]][3].twist.twist.linear.x = spike[1]
    with open_recording(write_bag(tmp_path / 'bag', messages)) as recording:
        found = inspect(recording, recording.select(), SMALL)
    assert recording.warnings == []  # the replay has its own, of the whole recording
    assert found.jumps.startswith(f'the twist of /odom jumps {text}' if text else '')
    assert bool(found.jumps) == bool(text)


@pytest.mark.parametrize('off_s', [-100, 100])
@pytest.mark.parametrize('number', [60, 61])
def test_single_wrong_stamp_is_neither_a_jump_nor_a_gap(
    number: int, off_s: int, tmp_path: Path
) -> None:
    messages = list(drive(speed=1.0))
    messages[number][3].header.stamp.sec += off_s
    with open_recording(write_bag(tmp_path / 'bag', messages)) as recording:
        found = inspect(recording, recording.select(), SMALL)
        from_images = inspect(recording, recording.select(None, None, True), SMALL)
    for one in found, from_images:
        assert one.jumps == '' and 'no gaps' in one.lines[1]


def test_static_borders_are_cropped(tmp_path: Path) -> None:
    found = inspected(tmp_path, left=6, bottom=10)
    window = {'_x_min': 6, '_x_max': -1, '_y_min': 0, '_y_max': 38}
    values = found.config.values()
    for suffix, value in window.items():
        assert values['local_view'][f'image_crop{suffix}'] == value
    for name in ('vrot_image', 'vtrans_image'):
        assert values['visual_odometry'][f'{name}_x_min'] == 6
        assert values['visual_odometry'][f'{name}_y_max'] == -1
    assert 'crop x 6 to 64, y 0 to 38' in found.lines[2]


def test_crop_holds_a_template(tmp_path: Path) -> None:
    config = extended().with_values({'local_view.template_x_size': 60})
    assert config == inspected(tmp_path, left=6, config=config).config


def test_borders_of_large_images_are_in_their_pixels(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(module, 'SMALL_WIDTH_PX', 32)
    assert inspected(tmp_path, right=6).config.local_view.image_crop_x_max == 58


def test_set_values_are_kept(tmp_path: Path) -> None:
    name = 'local_view.image_crop_x_min'
    config = SMALL.with_values({name: 2})
    found = inspected(tmp_path, name, config=config, left=6)
    assert found.config.local_view.image_crop_x_min == 2
    assert found.config.visual_odometry.vrot_image_x_min == 6


@pytest.mark.parametrize(('calibrates', 'text'), [
    (True, 'field of view 50 deg assumed, corrected by closed loops while driving; set'),
    (False, 'field of view 50 deg assumed; set'),
])
def test_source_of_the_field_of_view_is_named(tmp_path: Path, calibrates: bool, text: str) -> None:
    config = SMALL.with_values({'pose_cells.odom_calibration': calibrates})
    with open_recording(write_bag(tmp_path / 'bag', drive())) as recording:
        found = inspect(recording, recording.select(visual_odometry=True), config)
    assert text in found.lines[0]


FOV, RATIO = 'visual_odometry.camera_fov_deg', 'local_view.vt_match_ratio'


@pytest.mark.parametrize(('ratio', 'fov_deg', 'fixed', 'expected'), [
    (0.3, None, (FOV,), 0.3), (0.3, None, (), AUTOMATIC), (0.3, 90.0, (), 0.3),
    (0.9, 90.0, (), AUTOMATIC), (0.3, 90.0, (FOV, RATIO), AUTOMATIC),
])
def test_look_alikes_count_for_a_camera_whose_field_of_view_is_known_or_seen(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, ratio: float, fov_deg: float | None,
    fixed: tuple[str, ...], expected: float,
) -> None:
    def found(looks: list[Look], config: Config, known_deg: float) -> float:
        assert len(looks) > 1 and all(look.view is not None for look in looks)
        assert known_deg == (fov_deg or config.visual_odometry.camera_fov_deg)
        return ratio

    monkeypatch.setattr(module, 'look_alike_ratio', found)
    monkeypatch.setattr(module, 'field_of_view_deg', lambda *arguments: fov_deg)
    automatic = SMALL.with_values(
        {'local_view.vt_match_threshold': AUTOMATIC, 'local_view.vt_match_ratio': AUTOMATIC}
    )
    with open_recording(write_bag(tmp_path / 'bag', drive())) as recording:
        for visual_odometry in (True, False):  # wheels show it while driving
            selection = recording.select(visual_odometry=visual_odometry)
            found = inspect(recording, selection, automatic, fixed)
            ratio_found = found.config.local_view.vt_match_ratio
            assert ratio_found == (expected if visual_odometry else AUTOMATIC)
            is_seen = visual_odometry and fov_deg is not None and FOV not in fixed
            used_deg = fov_deg if is_seen else automatic.visual_odometry.camera_fov_deg
            assert found.config.visual_odometry.camera_fov_deg == used_deg
            assert ('field of view 90 deg as returns to places show' in found.lines[0]) == is_seen


def test_views_without_structure_are_counted(tmp_path: Path) -> None:
    assert '25% of the views' in inspected(tmp_path, flat=0.25).lines[2]


def test_faint_images_have_enough_structure(tmp_path: Path) -> None:
    """All views in the dark had too little, and were neither recognised nor learned."""
    found = inspected(tmp_path / 'a', brightness=0.03)
    least = found.config.local_view.vt_min_structure
    assert 0.0 < least < SMALL.local_view.vt_min_structure
    assert 'all are usable' in found.lines[2]
    assert found.lines[2].endswith(f'faint: vt_min_structure {least:g}')
    found = inspected(tmp_path / 'b', 'local_view.vt_min_structure', brightness=0.03)
    assert changes(found.config) == {} and 'too little structure' in found.lines[2]


@pytest.mark.parametrize('brightness', [0.0, 0.02])
def test_dark_images_are_not_faint_ones(brightness: float, tmp_path: Path) -> None:
    """A map of a covered camera consisted of noise, and no line said why."""
    found = inspected(tmp_path, brightness=brightness)
    assert changes(found.config) == {}
    assert '100% of the views have too little structure' in found.lines[2]


def test_pixels_that_leave_the_upper_bits_unused_are_reported(tmp_path: Path) -> None:
    messages = list(drive())
    for _, _, _, image in messages[1::2]:
        pixels = image.data.astype('<u2') << 2  # 10 bits
        image.encoding, image.step, image.data = 'mono16', 2 * WIDTH, pixels.view(np.uint8)
    with open_recording(write_bag(tmp_path / 'bag', messages)) as recording:
        line = inspect(recording, recording.select(), SMALL).lines[2]
    assert 'too little structure' in line
    assert line.endswith('16-bit pixels must use the upper bits (docs/recordings.md)')


def test_reason_is_named_if_no_image_can_be_decoded(tmp_path: Path) -> None:
    messages = (
        (ns, topic, kind, undecodable_message(ns) if kind == 'image' else message)
        for ns, topic, kind, message in drive()
    )
    with open_recording(write_bag(tmp_path / 'bag', messages)) as recording:
        line = inspect(recording, recording.select(), SMALL).lines[2]
    assert line.startswith('images: none can be decoded: ') and len(line) > 40


@pytest.mark.parametrize('small', [0, 5])
def test_camera_may_send_an_image_that_no_window_fits(tmp_path: Path, small: int) -> None:
    tiny = np.zeros((1, 1), np.uint8)
    messages = (
        (ns, topic, kind, image_message(ns, tiny))
        if kind == 'image' and ns == START_NS + small * PERIOD_NS + 1_000_000
        else (ns, topic, kind, message)
        for ns, topic, kind, message in drive() if kind == 'image'
    )
    automatic = SMALL.with_values(
        {'local_view.vt_match_threshold': AUTOMATIC, 'local_view.vt_match_ratio': AUTOMATIC}
    )
    with open_recording(write_bag(tmp_path / 'bag', messages)) as recording:
        if small == 0:  # none is expected to fit
            with pytest.raises(UnusableParameter):
                inspect(recording, recording.select(), automatic)
        else:
            assert 'all are usable' in inspect(recording, recording.select(), automatic).lines[2]


def frames(deviation: NDArray[np.float64], count: int = 40) -> list[NDArray[np.uint8]]:
    """Return images whose columns have given deviations over time."""
    rng = np.random.default_rng(1)
    noise = rng.normal(size=(count, 20, len(deviation)))
    return list((128.0 + deviation * noise).clip(0, 255).astype(np.uint8))


def test_broad_static_part_is_kept() -> None:
    deviation = np.full(100, 30.0)
    deviation[:45] = 0.0
    assert static_borders(frames(deviation)) == (0, 100, 0, 20)
    deviation[5:] = 30.0
    assert static_borders(frames(deviation)) == (5, 100, 0, 20)


def test_few_images_or_a_robot_at_rest_give_no_crop() -> None:
    deviation = np.full(100, 30.0)
    deviation[:10] = 0.0
    assert static_borders(frames(deviation, 10)) == (0, 100, 0, 20)
    assert static_borders(frames(np.zeros(100))) == (0, 100, 0, 20)
