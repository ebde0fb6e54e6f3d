# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Video of a run: the camera image, the template, the pose cells and the growing map.

    ┌────────┬──────┬───────────┐
    │ camera │ view │           │
    ├────────┴──────┤    map    │
    │  pose cells   │           │
    ├───────────────┴───────────┤
    │ caption                   │
    └───────────────────────────┘

It is drawn with OpenCV, which is fast enough for a replay.
"""

from __future__ import annotations

import math
from pathlib import Path
from typing import NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from ratslam_ros.errors import UnusableInput

Image = NDArray[np.uint8]
Floats = NDArray[np.float64]

SUFFIXES = ('.mp4', '.m4v', '.mov')
MARGIN_PX, CAPTION_HEIGHT_PX = 6, 28
INK, FAINT = (40, 40, 40), (200, 200, 200)  # BGR
WHITE = 255  # a single number, because filling with one is ten times as fast
BLUE, VERMILLION = (0xB2, 0x72, 0x00), (0x00, 0x5E, 0xD5)
FONT = cv2.FONT_HERSHEY_SIMPLEX


class Activity(NamedTuple):
    """Sums of the activity of the pose cells.

    plane: (n_y, n_x) over heading. headings: (n_theta,) over x and y.
    """

    plane: Floats
    headings: Floats


def check_path(path: Path) -> None:
    """Check the name of a video, before anything is computed.

    Raises:
        UnusableInput: it has no suffix of a video, or cannot be written there.
    """
    if path.suffix.lower() not in SUFFIXES:
        raise UnusableInput(f'{path}: expected a name that ends in {", ".join(SUFFIXES)}')
    if not path.parent.is_dir():
        raise UnusableInput(f'{path}: the folder {path.parent} does not exist')
    if path.is_dir():
        raise UnusableInput(f'{path}: is a folder, expected the name of a file')


def compose(size: tuple[int, int], image_bgr: Image, template: Image | None, activity: Activity,
            experiences_xy: Floats, current_xy_heading: tuple[float, float, float] | None,
            caption: str = '') -> Image:
    """Draw one frame of the video.

    Args:
        size: (width, height) in pixels.
        image_bgr: camera image, (H, W, 3) uint8 BGR or (H, W) uint8 grey.
        template: template that was recognised or learned, (h, w) uint8; None for none.
        activity: activity of the pose cells.
        experiences_xy: positions of the experiences in m, (n, 2), by id.
        current_xy_heading: pose of the robot on the map, in m and rad; None if unknown.
        caption: one line of text.

    Returns:
        The frame, (height, width, 3) uint8 BGR.
    """
    width, height = size
    frame = np.full((height, width, 3), WHITE, np.uint8)
    half = width // 2
    body = height - CAPTION_HEIGHT_PX
    split = body * 55 // 100
    view_x = half * 62 // 100
    _draw_image(frame[:split, :view_x], image_bgr, 'camera', cv2.INTER_AREA)
    _draw_image(frame[:split, view_x:half], template, 'view', cv2.INTER_NEAREST)
    _draw_activity(frame[split:body, :half], activity)
    _draw_map(frame[:body, half:], experiences_xy, current_xy_heading)
    at = (2 * MARGIN_PX, height - 9)
    cv2.putText(frame, _ascii(caption), at, FONT, 0.5, INK, 1, cv2.LINE_AA)
    return frame


def _draw_image(box: Image, image: Image | None, title: str, shrinking: int) -> None:
    """Fit an image into a box below its title; enlarge it without smoothing."""
    area = _titled(box, title)
    if image is None or not image.size:
        return
    if image.ndim == 2:
        image = np.repeat(image[:, :, np.newaxis], 3, axis=2)
    scale = min(area.shape[1] / image.shape[1], area.shape[0] / image.shape[0])
    size = (max(1, int(image.shape[1] * scale)), max(1, int(image.shape[0] * scale)))
    fitted = cv2.resize(image, size,
                        interpolation=shrinking if scale < 1.0 else cv2.INTER_NEAREST)
    x, y = (area.shape[1] - size[0]) // 2, (area.shape[0] - size[1]) // 2
    area[y:y + size[1], x:x + size[0]] = fitted


def _draw_activity(box: Image, activity: Activity) -> None:
    """Draw the activity summed over heading as an image, and summed over x and y as bars."""
    turn = activity.headings
    n_theta = len(turn)
    plane = activity.plane[::-1]  # Upwards is positive y, as on the map.
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
    highest = float(turn.max())
    for k, value in enumerate(turn if highest > 0.0 else []):
        left, right = k * area.shape[1] // n_theta, (k + 1) * area.shape[1] // n_theta
        top = bottom - round(bottom * float(value) / highest)
        cv2.rectangle(area, (left, top), (max(left, right - 2), bottom), BLUE, cv2.FILLED)


def _draw_map(box: Image, experiences_xy: Floats,
              robot: tuple[float, float, float] | None) -> None:
    """Draw the experiences, joined in the order of their ids, and the robot."""
    area = _titled(box, f'experience map: {len(experiences_xy)} experiences')
    shown = np.asarray(experiences_xy, np.float64).reshape(-1, 2)
    points_m = shown if robot is None else np.vstack((shown, robot[:2]))
    points_m = points_m[np.isfinite(points_m).all(axis=1)]
    if not len(points_m):
        return
    low, high = points_m.min(axis=0), points_m.max(axis=0)
    height, width = area.shape[:2]
    extent = np.maximum(high - low, 1.0)
    scale = float(min((width - 30) / extent[0], (height - 30) / extent[1]))
    middle = (low + high) / 2.0

    def to_pixels(xy: Floats) -> NDArray[np.int32]:
        at = (xy - middle) * (scale, -scale) + (width / 2.0, height / 2.0)
        return np.asarray(np.rint(at), np.int32)

    if len(shown) and np.isfinite(shown).all():
        points = to_pixels(shown)
        cv2.polylines(area, [points.reshape(-1, 1, 2)], False, FAINT, 1, cv2.LINE_AA)
        for x, y in np.unique(points, axis=0).tolist():
            cv2.circle(area, (x, y), 2, BLUE, cv2.FILLED)
    if robot is not None and all(map(math.isfinite, robot)):
        x, y, heading = robot
        at = to_pixels(np.array([[x, y]]))[0]
        corners = [(12.0, 0.0), (-7.0, 7.0), (-3.0, 0.0), (-7.0, -7.0)]
        c, s = math.cos(heading), math.sin(heading)
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
