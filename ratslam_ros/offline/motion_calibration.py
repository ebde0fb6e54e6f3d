# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Calibration of the motion of a recording before it is replayed, without ground truth.

The field of view of the camera is read from camera_info. If it is not recorded, the turns that
visual odometry measures are compared with recorded odometry, or with the multiples of 360 degrees
that the robot must have turned on closed loops (`ratslam_ros.core.common.rotation_gain`).
Closed loops calibrate recorded odometry as well.
"""

from __future__ import annotations

import contextlib
import math
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field, replace
from typing import Literal

import cv2
import numpy as np
from numpy.typing import NDArray

from ratslam_ros.core.common.odometry import MotionFromOdometry, Odometry
from ratslam_ros.core.common.rotation_gain import scale_of_turns, systematic_errors
from ratslam_ros.core.config import Config
from ratslam_ros.core.vision.visual_odometry import VisualOdometry, field_of_view_deg
from ratslam_ros.event_inputs import odometry_from_event
from ratslam_ros.recordings import (
    Event,
    ImageEvent,
    OdometryEvent,
    Recording,
    Selection,
    UndecodableImage,
)
from ratslam_ros.recordings.selection import odometry_candidates

Floats = NDArray[np.float64]
Image = NDArray[np.uint8]

MAX_FRAME_COUNT = 8000
MAX_PERIOD_S = 0.12
"""Longest interval between the frames of visual odometry; a longer recording is not read to its
end."""

MAX_VIEW_COUNT = 2000
"""Number of frames that are compared with each other."""

MIN_VIEW_COUNT = 50

VIEW_WIDTH_PX, VIEW_HEIGHT_PX = 32, 16
PATCH_PX = 7
MIN_CONTRAST = 4.0
"""Contrast of a patch in grey levels, added to the divisor so that noise is not amplified."""

LEFT_SIMILARITY, SEEN_SIMILARITY = 0.1, 0.4
"""Similarities at which a place has been left, and at which it is seen again. They are cosines of
views, scaled so that the median of all pairs of views is 0 and equal views are 1."""

MIN_GAP_S = 3.0
"""Shortest duration of a loop."""

LOWEST_FOV_DEG, HIGHEST_FOV_DEG = 30.0, 200.0

COMPARED_S = 5.0
"""Length of the intervals in which the turns of visual odometry and of odometry are compared."""

MIN_CORRELATION = 0.7
MIN_TURN_RAD = 6.0
"""Smallest sum of turns that two sources are compared by."""

Source = Literal['camera_info', 'odometry', 'loops', 'guess']


@dataclass(frozen=True)
class MotionCalibration:
    """Calibration of the rotation, and the evidence for it.

    source: where it comes from. reason: explanation in one line. loops: number of loops that
    support it, 0 for other sources. settings: parameters to set, by full name; empty for a guess.
    """

    source: Source
    reason: str
    loops: int = 0
    settings: dict[str, float] = field(default_factory=dict)


def calibrate_motion(
    recording: Recording, selection: Selection, config: Config, start_s: float = 0.0,
    duration_s: float | None = None,
) -> MotionCalibration:  # fmt: skip
    """Calibrate the camera or the odometry of a recording.

    Args:
        recording: the recording.
        selection: its topics to use.
        config: the parameters of the replay.
        start_s, duration_s: the part of the recording to use, in s, as for a replay.

    Raises:
        UnusableInput: nothing can be read.
        UnusableParameter: a window of visual odometry does not fit the images.
    """
    visual = selection.odom_topic is None
    camera = recording.calibration(selection) if visual else None
    if camera is not None and config.visual_odometry.fov_from_camera_info:
        fov_deg = field_of_view_deg(camera.focal_px, camera.width_px)
        return MotionCalibration(
            'camera_info', f'field of view {fov_deg:.1f} deg, from camera_info',
            settings={'visual_odometry.camera_fov_deg': fov_deg},
        )  # fmt: skip
    if selection.image_topic is None:
        return MotionCalibration('guess', 'the rotation of the odometry is not calibrated: the '
                                 'recording has no images')
    topic = selection.odom_topic
    if visual and len(candidates := odometry_candidates(recording)) == 1:
        topic = candidates[0].name
    track = _read(
        recording, replace(selection, odom_topic=topic), config, start_s, duration_s, visual
    )
    if visual:
        return _camera(track, topic, config.visual_odometry.camera_fov_deg)
    estimate = systematic_errors(*_loops_of(track, track.odometry_rad))
    if estimate is None:
        return MotionCalibration('guess', f'the rotation of {topic} is used as it is: no closed '
                                 'loops to check it with')
    gain, per_m_rad = round(estimate.correction.gain, 4), round(estimate.correction.per_m_rad, 5)
    return MotionCalibration(
        'loops', f'{topic} is corrected by a rotation gain of {gain:g} and {per_m_rad:g} rad/m: '
        f'with them, closed loops turn by 360 deg ({estimate.loops} views, '
        f'{estimate.share:.0%} agree)', estimate.loops,
        {f'{section}.{name}': value for section in ('pose_cells', 'experience_map')
         for name, value in (('odom_rotation_gain', gain), ('odom_turn_per_m', per_m_rad))},
    )  # fmt: skip


@dataclass(frozen=True)
class _Track:
    """Frames of a recording, and the headings at their stamps, in rad, not wrapped.

    views: (m, d) descriptors, see `_describe`. time_s: (m,) times. visual_rad, odometry_rad:
    (m,) headings by visual odometry and by recorded odometry, zeros if there is none.
    odometry_m: (m,) distances driven by recorded odometry.
    """

    views: NDArray[np.float32]
    time_s: Floats
    visual_rad: Floats
    odometry_rad: Floats
    odometry_m: Floats


def _camera(track: _Track, topic: str | None, assumed_deg: float) -> MotionCalibration:
    """Return the field of view from recorded odometry, else from loops."""
    low, high = LOWEST_FOV_DEG / assumed_deg, HIGHEST_FOV_DEG / assumed_deg
    gain = None if topic is None else _ratio_of_turns(track)
    if gain is not None and low <= gain <= high:
        fov_deg = round(gain * assumed_deg, 1)
        return MotionCalibration(
            'odometry', f'field of view {fov_deg:g} deg: with it, visual odometry turns as much '
            f'as {topic}',
            settings={'visual_odometry.camera_fov_deg': fov_deg},
        )  # fmt: skip
    estimate = scale_of_turns(_loops_of(track, track.visual_rad)[0], low, high)
    if estimate is None:
        return MotionCalibration(
            'guess', f'field of view {assumed_deg:g} deg is a guess: neither camera_info nor '
            'closed loops were found; set visual_odometry.camera_fov_deg if you know it',
        )  # fmt: skip
    fov_deg = round(estimate.correction.gain * assumed_deg, 1)
    return MotionCalibration(
        'loops', f'field of view {fov_deg:g} deg: with it, closed loops turn by 360 deg '
        f'({estimate.loops} views, {estimate.share:.0%} agree)', estimate.loops,
        {'visual_odometry.camera_fov_deg': fov_deg},
    )  # fmt: skip


def _read(
    recording: Recording, selection: Selection, config: Config, start_s: float,
    duration_s: float | None, use_images: bool,
) -> _Track:  # fmt: skip
    """Read views and headings of a recording; by visual odometry only if ``use_images``."""
    length_s = (recording.end_ns - recording.start_ns) * 1e-9 - start_s
    if duration_s is not None:
        length_s = min(length_s, duration_s)
    period_ns = min(length_s / MAX_FRAME_COUNT, MAX_PERIOD_S) * 1e9
    headings = _Headings(config, use_images)
    views: list[NDArray[np.float32]] = []
    stamps_ns: list[int] = []
    visual_rad: list[float] = []
    for event in _thinned(recording.events(selection, start_s, duration_s), period_ns):
        if isinstance(event, OdometryEvent):
            headings.add(odometry_from_event(event))
        elif isinstance(event, ImageEvent) and (
            not stamps_ns or event.stamp_ns > stamps_ns[-1]
        ):
            with contextlib.suppress(UndecodableImage):
                image = event.grey()
                visual_rad.append(headings.see(event.stamp_ns, image))
                views.append(_describe(image))
                stamps_ns.append(event.stamp_ns)
    kept = np.arange(0, len(views), max(-(-len(views) // MAX_VIEW_COUNT), 1))
    stamps = np.array(stamps_ns, np.int64)[kept]
    odometry_rad, odometry_m = headings.recorded_at(stamps)
    return _Track(
        np.array(views, np.float32)[kept], stamps.astype(np.float64) * 1e-9,
        np.array(visual_rad)[kept], odometry_rad, odometry_m,
    )  # fmt: skip


class _Headings:
    """Headings by visual odometry and by recorded odometry, in rad, not wrapped."""

    def __init__(self, config: Config, visual: bool) -> None:
        self._visual_odometry = VisualOdometry(config.visual_odometry) if visual else None
        self._motion = MotionFromOdometry(config.pose_cells.odom_source)
        self._last_ns = 0
        self._visual_rad = 0.0
        self._stamps_ns = [0]
        self._recorded = [(0.0, 0.0)]

    def see(self, stamp_ns: int, image: Image) -> float:
        """Return the heading at an image by visual odometry, 0 if it is not used."""
        if self._visual_odometry is not None:
            odometry = self._visual_odometry.estimate(stamp_ns, image)
            if odometry is not None:
                dt_s = (stamp_ns - self._last_ns) * 1e-9
                self._visual_rad += odometry.twist.angular_z_radps * dt_s
            self._last_ns = stamp_ns
        return self._visual_rad

    def add(self, odometry: Odometry) -> None:
        """Integrate one message of recorded odometry."""
        if self._motion.accepts(odometry) and odometry.stamp_ns > self._stamps_ns[-1]:
            motion = self._motion.update(odometry)
            heading_rad, distance_m = self._recorded[-1]
            if motion is not None:
                heading_rad += motion.turn_rad
                distance_m += motion.distance_m
            self._stamps_ns.append(odometry.stamp_ns)
            self._recorded.append((heading_rad, distance_m))

    def recorded_at(self, stamps_ns: NDArray[np.int64]) -> tuple[Floats, Floats]:
        """Return headings and distances by recorded odometry at stamps, zeros if none."""
        heading_rad, distance_m = (
            np.asarray(np.interp(stamps_ns, self._stamps_ns, values), np.float64)
            for values in zip(*self._recorded, strict=True)
        )
        return heading_rad, distance_m


def _thinned(events: Iterable[Event], period_ns: float) -> Iterator[Event]:
    """Yield all odometry, and images that are at least almost a period apart, up to a limit."""
    due_ns, count = -math.inf, 0
    for event in events:
        if isinstance(event, ImageEvent):
            if event.log_ns < due_ns:
                continue
            if count == MAX_FRAME_COUNT:
                return
            # After a gap some frames may follow closely, so that jitter does not cost frames.
            due_ns = max(due_ns + period_ns, event.log_ns - 9.0 * period_ns)
            count += 1
        yield event


def _describe(image: Image) -> NDArray[np.float32]:
    """Return an image as a vector of local contrasts, (d,), of small integers.

    Sums of products of such integers are exact in single precision, in any order.
    """
    size = VIEW_WIDTH_PX, VIEW_HEIGHT_PX
    view = cv2.resize(image, size, interpolation=cv2.INTER_AREA).astype(np.float32)
    view -= cv2.blur(view, (PATCH_PX, PATCH_PX))
    view /= np.sqrt(cv2.blur(view * view, (PATCH_PX, PATCH_PX))) + np.float32(MIN_CONTRAST)
    vector = np.rint(32.0 * (view - view.mean())).clip(-127, 127)
    return np.asarray(vector, np.float32).reshape(-1)


def _similarities(views: NDArray[np.float32]) -> NDArray[np.float32]:
    """Return the similarity of each pair of views, (n, n), see ``LEFT_SIMILARITY``."""
    products = views @ views.T
    length = np.sqrt(np.maximum(products.diagonal(), 1.0))
    cosines = products / (length[:, np.newaxis] * length)
    median = np.median(cosines)
    return np.asarray((cosines - median) / max(1.0 - median, 1e-6), np.float32)


def _loops(views: NDArray[np.float32], time_s: Floats) -> list[tuple[int, int]]:
    """Return pairs of views: the end and the start of a closed loop.

    A loop begins at the latest view that is the same place, before the place was left. The
    similarity of two views is averaged over the views around them in sequence, as in SeqSLAM,
    Milford and Wyeth (2012). Of the loops that end while the view changes once, only the best
    is returned, because their errors are not independent.
    """
    count = len(views)
    similarity = _similarities(views)
    lag = next(
        (
            k for k in range(1, count // 8)
            if np.median(np.diagonal(similarity, -k)) < LEFT_SIMILARITY
        ),
        0,
    )  # fmt: skip
    if lag == 0:
        return []
    reach = lag
    mean = np.zeros_like(similarity)
    for k in range(-reach, reach + 1):
        to = slice(max(0, -k), count - max(0, k))
        source = slice(max(0, k), count - max(0, -k))
        mean[to, to] += similarity[source, source]
    mean /= 2 * reach + 1
    best: dict[int, tuple[float, int, int]] = {}
    for end in range(reach, count - reach):
        latest = int(np.searchsorted(time_s, time_s[end] - MIN_GAP_S))
        away = np.flatnonzero(mean[end, :end] < LEFT_SIMILARITY)
        latest = min(latest, int(away[-1]) if len(away) else 0)
        before = mean[end, reach:latest]
        seen = np.flatnonzero(before > SEEN_SIMILARITY)
        if not len(seen):
            continue
        gone = np.flatnonzero(before[: seen[-1]] < LEFT_SIMILARITY)
        first = int(gone[-1]) + 1 if len(gone) else 0
        start = first + int(before[first : seen[-1] + 1].argmax())
        candidate = float(before[start]), end, start + reach
        best[end // lag] = max(best.get(end // lag, candidate), candidate)
    return [(end, start) for _, end, start in best.values()]


def _loops_of(track: _Track, heading_rad: Floats) -> tuple[Floats, Floats, Floats]:
    """Return turn, length and difference of the headings of each closed loop."""
    loops = np.empty((0, 2), np.int64)
    if len(track.views) >= MIN_VIEW_COUNT:
        loops = np.array(_loops(track.views, track.time_s), np.int64).reshape(-1, 2)
    turns_rad = heading_rad[loops[:, 0]] - heading_rad[loops[:, 1]]
    lengths_m = track.odometry_m[loops[:, 0]] - track.odometry_m[loops[:, 1]]
    return turns_rad, lengths_m, np.zeros(len(loops))


def _ratio_of_turns(track: _Track) -> float | None:
    """Return the turns by recorded odometry divided by those by visual odometry.

    The turns are compared in intervals of ``COMPARED_S``; None if they do not correlate.
    """
    if len(track.time_s) < MIN_VIEW_COUNT:
        return None
    period_s = float(track.time_s[-1] - track.time_s[0]) / (len(track.time_s) - 1)
    step = max(round(COMPARED_S / period_s), 1)
    visual = np.diff(track.visual_rad[::step])
    recorded = np.diff(track.odometry_rad[::step])
    squares, product = float(visual @ visual), float(visual @ recorded)
    if float(np.abs(recorded).sum()) < MIN_TURN_RAD or squares == 0.0:
        return None
    correlation = product / math.sqrt(squares * float(recorded @ recorded))
    return product / squares if correlation >= MIN_CORRELATION else None
