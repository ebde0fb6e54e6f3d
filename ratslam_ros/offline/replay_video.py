# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Video of a replay: the camera image, the template, the pose cells and the growing map.

    ┌────────┬──────┬───────────┐
    │ camera │ view │           │
    ├────────┴──────┤    map    │
    │  pose cells   │           │
    ├───────────────┴───────────┤
    │ caption                   │
    └───────────────────────────┘

It has a frame for every fourth image that RatSLAM processed, and is drawn with OpenCV, which is
fast enough for a replay.
"""

from __future__ import annotations

import math
import time
from pathlib import Path
from typing import Self

import cv2
import numpy as np
from numpy.typing import NDArray

from ratslam_ros.core.common.pose import Pose
from ratslam_ros.core.pose_cells.pose_cells import PoseCells
from ratslam_ros.errors import UnusableInput
from ratslam_ros.files.text import check_output
from ratslam_ros.pipeline.items import Step, ViewStep
from ratslam_ros.pipeline.ratslam import RatSLAM
from ratslam_ros.recordings import ImageEvent, UndecodableImage

Image = NDArray[np.uint8]
Floats = NDArray[np.float64]

STRIDE = 4
"""Number of images for each frame, so that the video at most doubles the time of a replay."""

RATE_HZ, SIZE_PX = 10.0, (960, 540)
"""Frame rate, and width and height of the frames, which encoders require to be even."""

SUFFIXES = ('.mp4', '.m4v', '.mov')
MARGIN_PX, CAPTION_HEIGHT_PX = 6, 28
INK, FAINT = (40, 40, 40), (200, 200, 200)  # BGR
WHITE = 255  # a single number, because filling with one is ten times as fast
BLUE, VERMILLION = (0xB2, 0x72, 0x00), (0x00, 0x5E, 0xD5)
FONT = cv2.FONT_HERSHEY_SIMPLEX


def check_path(path: Path) -> None:
    """Check the name of a video, before anything is computed.

    Raises:
        UnusableInput: it has no suffix of a video, or cannot be written there.
    """
    if path.suffix.lower() not in SUFFIXES:
        raise UnusableInput(f'{path}: expected a name that ends in {", ".join(SUFFIXES)}')
    check_output(path)


class ReplayVideo:
    """Context manager that writes the video; it holds images until their step is processed."""

    def __init__(self, path: Path, slam: RatSLAM) -> None:
        """Open the file.

        Raises:
            UnusableInput: the file cannot be written.
        """
        self.path = path
        self.frames = 0
        """Number of frames that were written."""
        self.took_s = 0.0
        """Time spent on the video in s."""
        self._slam = slam
        self._steps = 0
        self._writer = cv2.VideoWriter(
            str(path), cv2.VideoWriter.fourcc(*'mp4v'), RATE_HZ, SIZE_PX
        )
        if not self._writer.isOpened():
            raise UnusableInput(f'{path}: cannot be written, or this OpenCV has no mp4v encoder')
        self._images: dict[int, ImageEvent] = {}

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self._writer.release()

    def add_image(self, event: ImageEvent) -> None:
        """Store an image until its template message is processed."""
        self._images[event.stamp_ns] = event

    def add_step(self, step: Step) -> None:
        """Write a frame if it is due, and the step is that of an image that can be decoded."""
        if not isinstance(step, ViewStep):
            return
        start_s = time.perf_counter()
        self._steps += 1
        if (self._steps - 1) % STRIDE == 0:
            self._write(step)
        self.took_s += time.perf_counter() - start_s

    def _write(self, step: ViewStep) -> None:
        for stamp_ns in [s for s in self._images if s < step.stamp_ns]:
            del self._images[stamp_ns]
        event = self._images.pop(step.stamp_ns, None)
        if event is None:
            return
        try:
            image = event.bgr()
        except UndecodableImage:
            return
        self.frames += 1
        template_id, local_view = step.match.template_id, self._slam.local_view
        assert local_view is not None
        self._writer.write(compose(
            image,
            # A held step may be of a template that has been removed since.
            local_view.picture(local_view.template(template_id))
            if template_id in local_view else None,
            *sums(self._slam.pose_cells), self._slam.experience_map.poses[:, :2],
            self._slam.experience_map.pose,
            f'template {template_id}  experience {step.action.target_id}  {step.action.action}',
        ))


def compose(image_bgr: Image, template: Image | None, plane: Floats, headings: Floats,
            experiences_xy: Floats, robot: Pose, caption: str) -> Image:
    """Draw one frame of the video.

    Args:
        image_bgr: camera image, (H, W, 3) uint8 BGR.
        template: template that was recognised or learned, (h, w) uint8; None for none.
        plane: (n_y, n_x) activity of the pose cells, summed over heading.
        headings: (n_theta,) activity, summed over x and y.
        experiences_xy: positions of the experiences in m, (n, 2), by id.
        robot: pose of the robot on the map.
        caption: one line of text.

    Returns:
        The frame of ``SIZE_PX``, (height, width, 3) uint8 BGR.
    """
    width, height = SIZE_PX
    frame = np.full((height, width, 3), WHITE, np.uint8)
    half = width // 2
    body = height - CAPTION_HEIGHT_PX
    split = body * 55 // 100
    view_x = half * 62 // 100
    _draw_image(frame[:split, :view_x], image_bgr, 'camera', cv2.INTER_AREA)
    _draw_image(frame[:split, view_x:half], template, 'view', cv2.INTER_NEAREST)
    _draw_activity(frame[split:body, :half], plane, headings)
    _draw_map(frame[:body, half:], experiences_xy, robot)
    at = (2 * MARGIN_PX, height - 9)
    cv2.putText(frame, _ascii(caption), at, FONT, 0.5, INK, 1, cv2.LINE_AA)
    return frame


def _draw_image(box: Image, image: Image | None, title: str, shrinking: int) -> None:
    """Fit an image into a box below its title; enlarge it without smoothing."""
    area = _titled(box, title)
    if image is None:
        return
    if image.ndim == 2:
        image = np.repeat(image[:, :, np.newaxis], 3, axis=2)
    scale = min(area.shape[1] / image.shape[1], area.shape[0] / image.shape[0])
    size = (max(1, int(image.shape[1] * scale)), max(1, int(image.shape[0] * scale)))
    fitted = cv2.resize(image, size,
                        interpolation=shrinking if scale < 1.0 else cv2.INTER_NEAREST)
    x, y = (area.shape[1] - size[0]) // 2, (area.shape[0] - size[1]) // 2
    area[y:y + size[1], x:x + size[0]] = fitted


def _draw_activity(box: Image, plane: Floats, headings: Floats) -> None:
    """Draw the activity summed over heading as an image, and summed over x and y as bars."""
    n_theta = len(headings)
    plane = plane[::-1]  # Upwards is positive y, as on the map.
    bars_width = box.shape[1] * 38 // 100
    most = float(plane.max())
    # The square root makes weak packets visible.
    level = np.sqrt(np.clip(plane / most, 0.0, 1.0)) if most > 0.0 else np.zeros_like(plane)
    colours = cv2.applyColorMap((255.0 * level).astype(np.uint8), cv2.COLORMAP_VIRIDIS)
    heat = np.asarray(colours, np.uint8)
    _draw_image(box[:, :-bars_width], heat, f'pose cells {plane.shape[1]} x {plane.shape[0]}',
                cv2.INTER_AREA)
    area = _titled(box[:, -bars_width:], f'{n_theta} headings')
    bottom = area.shape[0] - 1
    cv2.line(area, (0, bottom), (area.shape[1] - 1, bottom), FAINT, 1)
    highest = float(headings.max())
    for k, value in enumerate(headings if highest > 0.0 else []):
        left, right = k * area.shape[1] // n_theta, (k + 1) * area.shape[1] // n_theta
        top = bottom - round(bottom * float(value) / highest)
        cv2.rectangle(area, (left, top), (max(left, right - 2), bottom), BLUE, cv2.FILLED)


def _draw_map(box: Image, experiences_xy: Floats, robot: Pose) -> None:
    """Draw the experiences, joined in the order of their ids, and the robot."""
    area = _titled(box, f'experience map: {len(experiences_xy)} experiences')
    points_m = np.vstack((experiences_xy, robot[:2]))
    low, high = points_m.min(axis=0), points_m.max(axis=0)
    height, width = area.shape[:2]
    extent = np.maximum(high - low, 1.0)
    scale = float(min((width - 30) / extent[0], (height - 30) / extent[1]))
    pixels = (points_m - (low + high) / 2.0) * (scale, -scale) + (width / 2.0, height / 2.0)
    *places, at = np.rint(pixels).astype(np.int32)
    if places:
        cv2.polylines(area, [np.array(places).reshape(-1, 1, 2)], False, FAINT, 1, cv2.LINE_AA)
        for x, y in np.unique(places, axis=0).tolist():
            cv2.circle(area, (x, y), 2, BLUE, cv2.FILLED)
    corners = [(12.0, 0.0), (-7.0, 7.0), (-3.0, 0.0), (-7.0, -7.0)]
    c, s = math.cos(robot.heading_rad), math.sin(robot.heading_rad)
    arrow = np.rint([(at[0] + c * u - s * v, at[1] - s * u - c * v) for u, v in corners])
    cv2.fillPoly(area, [arrow.astype(np.int32)], VERMILLION, cv2.LINE_AA)
    _draw_scale(area, scale)


def _draw_scale(area: Image, pixels_per_m: float) -> None:
    """Draw a scale bar at the lower left: 1, 2 or 5 times a power of ten, in m."""
    longest_m = area.shape[1] / 3.0 / pixels_per_m
    power = 10.0 ** math.floor(math.log10(longest_m))
    length_m = max(factor * power for factor in (1, 2, 5) if factor * power <= longest_m)
    y, length = area.shape[0] - 8, round(length_m * pixels_per_m)
    cv2.line(area, (4, y), (4 + length, y), INK, 2)
    cv2.putText(area, f'{length_m:g} m', (4, y - 6), FONT, 0.42, INK, 1, cv2.LINE_AA)


def _titled(box: Image, title: str) -> Image:
    """Write a title into a box and return the area below it."""
    cv2.putText(box, _ascii(title), (MARGIN_PX, 16), FONT, 0.45, INK, 1, cv2.LINE_AA)
    return box[22:-MARGIN_PX, MARGIN_PX:-MARGIN_PX]


def _ascii(text: str) -> str:
    """Replace the characters that OpenCV's font lacks."""
    return text.encode('ascii', 'replace').decode()


def sums(pose_cells: PoseCells) -> tuple[Floats, Floats]:
    """Return the sums of the activity over heading and over x and y, of the active cells."""
    n_x, n_y, n_theta = pose_cells.dims
    cells, activity = pose_cells.active()
    theta, y, x = cells.T
    plane, headings = np.zeros((n_y, n_x)), np.zeros(n_theta)
    np.add.at(plane, (y, x), activity)
    np.add.at(headings, theta, activity)
    return plane, headings
