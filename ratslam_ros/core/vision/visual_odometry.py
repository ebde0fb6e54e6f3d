# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Visual odometry from the shift and change of column intensity profiles.

See docs/algorithm.md, "From the camera alone".
"""

from __future__ import annotations

import math
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ratslam_ros.core.common.compiled import compiled, compiled_without_gil
from ratslam_ros.core.common.odometry import Motion, Odometry, Twist, moved
from ratslam_ros.core.common.pose import Pose
from ratslam_ros.core.common.saved import Field, Saved
from ratslam_ros.core.common.state import State
from ratslam_ros.core.config import VisualOdometryParameters
from ratslam_ros.core.vision.image_window import Window, contiguous, window_of

Profile = NDArray[np.int64]
"""(w,) sum of each column of a window; integers, so that equal differences compare as equal."""


class Profiles(NamedTuple):
    """Column sums of the two windows of an image."""

    shape: tuple[int, ...]
    """Shape of the image."""
    height: int
    """Number of rows of the window for translation."""
    rotation: Profile
    translation: Profile


CANONICAL_WIDTH_PX = 160
"""Width of an image, to which the profiles are scaled unless ``vrot_subpixel`` is off. The size of
the images has no influence then."""

MAX_SHIFT_SHARE = 0.375
"""Largest shift between successive images that is tried, relative to the width of the image. Turns
by more are measured wrongly; with less overlap, parts of the images match by chance."""

UNSCALED_MAX_SHIFT_PX = 39
"""The same in pixels of the image, with ``vrot_subpixel`` off."""

BAND_ROWS = 257
"""Rows summed in 16-bit integers: 257 * 255 = 65535. A SIMD register holds four times as many
columns of 16 bits as of 64 bits."""


def field_of_view_deg(focal_px: float, width_px: int) -> float:
    """Return the horizontal field of view of a pinhole camera, in degrees."""
    return math.degrees(2.0 * math.atan(0.5 * width_px / focal_px))


class _Last(NamedTuple):
    """Stamp and shape of the last image, and its profiles, which never change."""

    stamp_ns: int
    shape: list[int]
    rotation: Profile
    translation: Profile


class VisualOdometry(Saved):
    """Estimation of the turn rate from the image shift, and of the speed from the image change."""

    SAVED = (
        Field('pose', '_pose', float, (3,), make=Pose),
        Field('last', '_last', dict, nullable=True, save=_Last._asdict,
              load=lambda last: _Last(**last),
              fits=('stamp, shape and profiles', lambda last, _: last.keys() == {*_Last._fields}
                    and all(last[name].dtype == np.int64 and last[name].ndim == 1
                            for name in ('rotation', 'translation')))),
        Field('fov_deg', '', save=lambda own: own._p.camera_fov_deg),
    )

    def __init__(self, parameters: VisualOdometryParameters) -> None:
        self._p = self._created_with = parameters
        self._last: _Last | None = None
        self._pose = Pose(0.0, 0.0, 0.0)
        self._sized: tuple[tuple[int, ...], Window, Window] | None = None

    def profiles(self, image: NDArray[np.uint8]) -> Profiles:
        """Return the part of an image that is compared; another thread may call it.

        Args:
            image: (H, W) uint8, greyscale.

        Raises:
            UnusableParameter: a window exceeds the image.
        """
        sized = self._sized
        if sized is None or sized[0] != image.shape:
            sized = image.shape, self._rotation_window(image), self._translation_window(image)
            self._sized = sized
        pixels = contiguous(image)
        shape, rotation, translation = sized
        scale = self._width_px(shape) / shape[1]
        return Profiles(
            shape, translation.y_max - translation.y_min,
            _scaled(_profile_of(pixels, rotation), scale),
            _scaled(_profile_of(pixels, translation), scale),
        )

    def estimate(
        self, stamp_ns: int, image: NDArray[np.uint8], profiles: Profiles | None = None
    ) -> Odometry | None:
        """Estimate the motion since the previous image, and integrate the pose.

        Args:
            stamp_ns: stamp of the image; stamps must increase.
            image: (H, W) uint8, greyscale.
            profiles: what ``profiles`` returned for the image; None: compute it.

        Returns:
            The odometry, or None for the first image and after a change of the image size.

        Raises:
            UnusableParameter: a window exceeds the image.
        """
        p = self._p
        _, height, rotation, translation = self.profiles(image) if profiles is None else profiles
        shape = list(image.shape)
        last, self._last = self._last, _Last(stamp_ns, shape, rotation, translation)
        if last is None or last.shape != shape or len(last.rotation) != len(rotation):
            return None  # Profiles of different lengths cannot be compared.
        dt_s = (stamp_ns - last.stamp_ns) * 1e-9
        offset_px = self._rotation_px(rotation, last.rotation)
        max_shift_px = self._max_shift_px(translation)
        _, min_difference = _compare(translation, last.translation, max_shift_px)
        difference = min_difference / (255.0 * height)
        rad_per_px = p.camera_fov_deg / self._width_px(image.shape) * (math.pi / 180.0)
        speed_mps = difference * p.vtrans_scaling / (dt_s * p.camera_hz)
        twist = Twist(min(speed_mps, p.vtrans_max), offset_px * rad_per_px / dt_s)
        motion = Motion(dt_s, twist.linear_x_mps * dt_s, twist.angular_z_radps * dt_s)
        self._pose = moved(self._pose, motion)
        return Odometry(stamp_ns, twist, self._pose, scale_known=False)

    def reconfigure(self, parameters: VisualOdometryParameters) -> None:
        """Continue with other values, from the next image on; the field of view stays as it is.

        Raises:
            UnusableParameter: a parameter differs that cannot change; nothing is changed.
        """
        first = self._created_with
        first.check_change(replace(parameters, camera_fov_deg=first.camera_fov_deg))
        self._p = replace(parameters, camera_fov_deg=self._p.camera_fov_deg)

    def set_field_of_view(self, camera_fov_deg: float) -> None:
        """Set the field of view, in degrees, used from the next image on."""
        self._p = replace(self._p, camera_fov_deg=camera_fov_deg)

    def _restored(self, state: State) -> None:
        self.set_field_of_view(state['fov_deg'])

    def restart(self) -> None:
        """Treat the next image as the first one; the pose is kept."""
        self._last = None

    def _width_px(self, shape: tuple[int, ...]) -> int:
        """Return the width of the image in the pixels that shifts are measured in."""
        return CANONICAL_WIDTH_PX if self._p.vrot_subpixel else shape[1]

    def _rotation_px(self, now: Profile, before: Profile) -> float:
        """Return the shift between two profiles of the turn window, in pixels."""
        if not self._p.vrot_subpixel:
            return _compare(now, before, self._max_shift_px(now))[0]
        now, before = _without_mean(now), _without_mean(before)
        return _refined(now, before, _compare(now, before, self._max_shift_px(now))[0])

    def _max_shift_px(self, profile: Profile) -> int:
        """Return the largest shift of a profile that is tried, at most half its width."""
        scaled_px = round(MAX_SHIFT_SHARE * CANONICAL_WIDTH_PX)
        limit_px = scaled_px if self._p.vrot_subpixel else UNSCALED_MAX_SHIFT_PX
        return min(limit_px, len(profile) // 2)

    def _rotation_window(self, image: NDArray[np.uint8]) -> Window:
        p = self._p
        window = window_of(
            image, 'visual_odometry.vrot_image',
            (p.vrot_image_x_min, p.vrot_image_x_max), (p.vrot_image_y_min, p.vrot_image_y_max),
        )
        rows = math.ceil(p.vrot_height_share * (window.y_max - window.y_min))
        return window._replace(y_max=window.y_min + rows)

    def _translation_window(self, image: NDArray[np.uint8]) -> Window:
        p = self._p
        return window_of(
            image, 'visual_odometry.vtrans_image',
            (p.vtrans_image_x_min, p.vtrans_image_x_max),
            (p.vtrans_image_y_min, p.vtrans_image_y_max),
        )


def _profile_of(image: NDArray[np.uint8], window: Window) -> Profile:
    profile = np.zeros(window.x_max - window.x_min, np.int64)
    _profile(image, *window, profile)
    return profile


def _scaled(profile: Profile, scale: float) -> Profile:
    """Return the area means of a profile, with ``scale`` times as many columns."""
    count = len(profile)
    wanted = max(round(scale * count), 1)
    if wanted == count:
        return profile
    sums = np.concatenate((np.zeros(1), np.cumsum(profile)))
    at = np.interp(np.linspace(0.0, count, wanted + 1), np.arange(count + 1), sums)
    return np.rint(np.diff(at) * (wanted / count)).astype(np.int64)


@compiled_without_gil
def _profile(
    image: NDArray[np.uint8], x_min: int, x_max: int, y_min: int, y_max: int, profile: Profile
) -> None:
    """Add the column sums of a window to ``profile`` (w,)."""
    width = x_max - x_min
    band = np.empty(width, np.uint16)
    for top in range(y_min, y_max, BAND_ROWS):
        band[:] = 0
        for y in range(top, min(top + BAND_ROWS, y_max)):
            row = image[y, x_min:x_max]
            for x in range(width):
                band[x] += row[x]
        for x in range(width):
            profile[x] += band[x]


@compiled
def _difference(now: Profile, before: Profile, shift: int) -> np.int64:
    """Return the sum of absolute differences of two profiles at a shift in px."""
    now, before = now[max(shift, 0) :], before[max(-shift, 0) :]
    total = np.int64(0)
    for k in range(min(now.shape[0], before.shape[0])):
        total += abs(now[k] - before[k])
    return total


@compiled
def _compare(now: Profile, before: Profile, max_shift: int) -> tuple[int, float]:
    """Return the shift in px with the smallest mean absolute difference, and that difference.

    Content that moved left gives a negative shift. Ties go to left before right, then to the
    smaller shift.
    """
    best_total, best_count, best = np.int64(0), 0, 0
    for n in range(2 * max_shift + 1):
        shift = -n if n <= max_shift else n - max_shift
        total, count = _difference(now, before, shift), now.shape[0] - abs(shift)
        if best_count == 0 or total * best_count < best_total * count:
            best_total, best_count, best = total, count, shift
    return best, best_total / best_count


def _without_mean(profile: Profile) -> Profile:
    """Return the deviations from the mean, multiplied by the length so that they are integers."""
    return profile * len(profile) - profile.sum()


@compiled
def _refined(now: Profile, before: Profile, offset: int) -> float:
    """Return the shift near the best integer shift, in px, to a fraction of a pixel.

    The mean absolute difference grows linearly to both sides of its minimum. Two lines of opposite
    slopes through the best shift and its neighbours intersect at the refined shift.
    """
    if abs(offset) + 1 >= now.shape[0]:
        return float(offset)
    left, here, right = [
        _difference(now, before, shift) / (now.shape[0] - abs(shift))
        for shift in (offset - 1, offset, offset + 1)
    ]
    slope = max(left, right) - here
    if slope <= 0.0:  # without texture all shifts are equal
        return float(offset)
    return offset + min(max(0.5 * (left - right) / slope, -0.5), 0.5)
