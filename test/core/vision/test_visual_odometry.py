# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
import math

import numpy as np
import pytest
from helpers import extended, picture
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from ratslam_ros.core.common.odometry import Twist
from ratslam_ros.core.vision.visual_odometry import VisualOdometry
from ratslam_ros.errors import UnusableParameter

FRAME_NS = 100_000_000
Image = NDArray[np.uint8]


def scene(width: int = 400, height: int = 10, seed: int = 1) -> Image:
    """Return a wide image with varying columns, of which frames are crops."""
    columns = np.random.default_rng(seed).integers(20, 236, width, dtype=np.uint8)
    return np.tile(columns, (height, 1))


def frame(shift: int, width: int = 120) -> Image:
    """Return a frame whose content has moved right by ``shift`` columns."""
    return np.ascontiguousarray(scene()[:, 150 - shift : 150 - shift + width])


def twists(
    frames: list[tuple[int, Image]], **parameters: float
) -> list[Twist | None]:
    odometry = VisualOdometry(extended('visual_odometry', **parameters))
    return [found and found.twist for found in (odometry.estimate(*item) for item in frames)]


def plain_compare(now: NDArray[np.float64], before: NDArray[np.float64]) -> tuple[int, float]:
    """Return offset and smallest difference by the definition, shifts to the left first."""
    width = len(now)
    best: tuple[int, float] | None = None
    shifts = range(min(39, width // 2) + 1)
    left = [(-s, float(np.abs(now[: width - s] - before[s:]).mean())) for s in shifts]
    right = [(s, float(np.abs(now[s:] - before[: width - s]).mean())) for s in shifts]
    for offset, difference in left + right:
        if best is None or difference < best[1] - 1e-12:
            best = offset, difference
    assert best is not None
    return best


def test_first_frame_gives_no_odometry() -> None:
    assert twists([(0, frame(0))]) == [None]


@pytest.mark.parametrize('shift', [-39, -1, 0, 39])
def test_content_moving_left_is_a_right_turn(shift: int) -> None:
    _, motion = twists([(0, frame(0)), (FRAME_NS, frame(shift))], camera_fov_deg=60.0)
    assert motion is not None
    # 60 degrees over 120 px, in 0.1 s; counter-clockwise is positive.
    assert motion.angular_z_radps == pytest.approx(math.radians(shift * 0.5) / 0.1)
    assert math.copysign(1, motion.angular_z_radps) == math.copysign(1, shift) or shift == 0


def test_dropped_frame_does_not_change_the_speed() -> None:
    """Intervals come from the stamps; OpenRatSLAM assumes 1 / camera_hz."""
    half, full = frame(0).copy(), frame(0).copy()
    half[:, :] = 100
    full[:, :] = 100
    half, full = half + np.uint8(2), full + np.uint8(4)
    start = np.full_like(half, 100)
    _, at_rate = twists([(0, start), (FRAME_NS, half)])
    _, dropped = twists([(0, start), (2 * FRAME_NS, full)])
    assert at_rate is not None
    assert dropped is not None
    assert dropped.linear_x_mps == pytest.approx(at_rate.linear_x_mps)
    _, turn = twists([(0, frame(0)), (FRAME_NS, frame(3))])
    _, turn_dropped = twists([(0, frame(0)), (2 * FRAME_NS, frame(6))])
    assert turn is not None
    assert turn_dropped is not None
    assert turn_dropped.angular_z_radps == pytest.approx(turn.angular_z_radps)


def test_ties_go_to_left_and_smaller_shift() -> None:
    """Stripes with a period of 8 px moved by 4 px: both directions match equally."""
    columns = np.tile(np.repeat(np.array([10, 200], np.uint8), 4), 10)
    before, now = np.tile(columns, (3, 1)), np.tile(np.roll(columns, 4), (3, 1))
    _, motion = twists([(0, before), (FRAME_NS, now)], camera_fov_deg=80.0)
    assert motion is not None
    assert motion.angular_z_radps == pytest.approx(-math.radians(4.0) / 0.1)


@pytest.mark.parametrize('brighter', [0, 77])
def test_uniform_view_does_not_turn(brighter: int) -> None:
    """All shifts match equally: the smallest one wins, regardless of rounding."""
    flat = np.full((6, 90), 90, np.uint8)
    _, motion = twists([(0, flat), (FRAME_NS, flat + np.uint8(brighter))])
    assert motion is not None
    assert motion.angular_z_radps == 0.0
    assert motion.linear_x_mps == pytest.approx(min(brighter / 255 * 100, 20.0))


@settings(max_examples=60)
@given(st.integers(0, 10_000), st.integers(2, 100), st.integers(2, 12), st.integers(-20, 20))
def test_motion_equals_the_definition(seed: int, width: int, levels: int, shift: int) -> None:
    """With few grey levels, many shifts match nearly equally."""
    rng = np.random.default_rng(seed)
    wide = (rng.integers(0, levels, (5, width + 40)) * (255 // levels)).astype(np.uint8)
    before = np.ascontiguousarray(wide[:, 20 : 20 + width])
    now = np.ascontiguousarray(wide[:, 20 - shift : 20 - shift + width])
    _, motion = twists([(0, before), (FRAME_NS, now)], vtrans_max=1000.0, camera_fov_deg=50.0)
    assert motion is not None
    offset, difference = plain_compare(now.mean(0) / 255.0, before.mean(0) / 255.0)
    assert motion.angular_z_radps == pytest.approx(math.radians(offset * 50.0 / width) / 0.1)
    assert motion.linear_x_mps == pytest.approx(min(difference * 100.0, 1000.0))


def test_turn_and_speed_use_separate_windows() -> None:
    before, now = np.tile(scene(60)[:1], (20, 1)), np.tile(scene(60)[:1], (20, 1))
    now[:10] = np.roll(now[:10], 4, axis=1)  # above: a turn
    now[10:] += 10  # below: a change
    windows = {
        'vrot_image_y_max': 10, 'vrot_image_x_min': 8, 'vrot_image_x_max': 60,
        'vtrans_image_y_min': 10, 'camera_fov_deg': 60.0,
    }
    _, motion = twists([(0, before), (FRAME_NS, now)], **windows)
    assert motion is not None
    # The angle per pixel follows from the width of the whole image, 60 px.
    assert motion.angular_z_radps == pytest.approx(math.radians(4.0) / 0.1)
    assert motion.linear_x_mps == pytest.approx(10 / 255 * 100.0 / (0.1 * 10.0))


def test_changed_image_size_restarts_estimation() -> None:
    narrow, low = frame(0)[:, :80].copy(), frame(0)[:6, :80].copy()
    images = [frame(0), frame(0), narrow, narrow, low, low]
    motions = twists([(n * FRAME_NS, image) for n, image in enumerate(images)])
    assert [motion is None for motion in motions] == [True, False] * 3


@pytest.mark.parametrize('window', [
    {'vrot_image_x_max': 17}, {'vtrans_image_y_max': 13}, {'vrot_image_x_min': 16},
    {'vtrans_image_x_min': 8, 'vtrans_image_x_max': 8},
])
def test_window_outside_image_is_named_in_error(window: dict[str, int]) -> None:
    with pytest.raises(UnusableParameter, match=next(iter(window)).rsplit('_', 2)[0]):
        twists([(0, picture(1))], **window)


def smooth_frame(shift: float, brightness: float = 0.0, height: int = 12) -> Image:
    """Return a frame of smooth columns that have moved right by ``shift``, a fraction of a px."""
    x = np.arange(120.0) - shift
    columns = 120.0 + sum(
        size * np.sin(x / length + phase)
        for size, length, phase in ((40.0, 7.0, 0.3), (25.0, 3.1, 1.0), (20.0, 17.0, 2.0))
    )
    rows = columns + np.random.default_rng(0).uniform(-0.5, 0.5, (height, 120))
    return np.rint(rows + brightness).clip(0, 255).astype(np.uint8)


@pytest.mark.parametrize('shift', [-3.6, -0.3, 0.0, 8.8])
@pytest.mark.parametrize('brightness', [0.0, 25.0])
def test_subpixel_shifts_are_measured_at_any_exposure(shift: float, brightness: float) -> None:
    frames = [(0, smooth_frame(0.0)), (FRAME_NS, smooth_frame(shift, brightness))]
    _, motion = twists(frames, camera_fov_deg=60.0, vrot_subpixel=True)
    assert motion is not None
    assert motion.angular_z_radps == pytest.approx(math.radians(shift * 0.5) / 0.1, abs=0.007)


@pytest.mark.parametrize('width', [80, 400])
@pytest.mark.parametrize('share', [-0.2, 0.05, 0.35])
def test_turn_and_speed_do_not_depend_on_image_size(width: int, share: float) -> None:
    """The content moves by a share of the width, and fades by one grey level in ten."""
    def image(shift: float, contrast: float) -> Image:
        x = (np.arange(width) + 0.5) / width - shift
        columns = sum(np.sin(size * x + size) for size in (17.0, 31.0, 47.0)) / 3.0
        return np.tile(np.rint(128.0 + contrast * columns).astype(np.uint8), (width * 3 // 4, 1))

    frames = [(0, image(0.0, 100.0)), (FRAME_NS, image(share, 90.0))]
    _, motion = twists(frames, camera_fov_deg=60.0, vrot_subpixel=True, vrot_height_share=0.5)
    assert motion is not None
    assert motion.angular_z_radps == pytest.approx(math.radians(share * 60.0) / 0.1, abs=0.03)
    assert motion.linear_x_mps == pytest.approx(1.65, abs=0.3)


def test_height_share_excludes_the_lower_part_of_the_turn_window() -> None:
    """The lower half moves the other way, as the ground beside a car does."""
    def halves(up: int, down: int) -> Image:
        return np.concatenate((frame(up), frame(down), frame(down)))

    frames = [(0, halves(0, 0)), (FRAME_NS, halves(2, -3))]
    turns = []
    for share in (1.0, 1 / 3):
        _, motion = twists(frames, camera_fov_deg=60.0, vrot_height_share=share)
        assert motion is not None
        turns.append(round(math.degrees(motion.angular_z_radps * 0.1) / 0.5))
    assert turns == [-3, 2]
