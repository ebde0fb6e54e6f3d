# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Video of a replay: one frame for every fourth image that RatSLAM processed."""

from __future__ import annotations

import time
from pathlib import Path
from typing import Self

import cv2
import numpy as np

from ratslam_ros.core.pose_cells.pose_cells import PoseCells
from ratslam_ros.errors import UnusableInput
from ratslam_ros.pipeline.items import Step, ViewStep
from ratslam_ros.pipeline.ratslam import RatSLAM
from ratslam_ros.recordings import ImageEvent, UndecodableImage
from ratslam_ros.results.video import Activity, compose

STRIDE = 4
"""Number of images for each frame, so that the video at most doubles the time of a replay."""

RATE_HZ, SIZE_PX = 10.0, (960, 540)
"""Frame rate, and width and height of the frames, which encoders require to be even."""


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
            SIZE_PX, image,
            # A held step may be of a template that has been removed since.
            local_view.picture(local_view.template(template_id))
            if template_id in local_view else None,
            _sums(self._slam.pose_cells), self._slam.experience_map.poses[:, :2],
            self._slam.experience_map.pose,
            f'template {template_id}  experience {step.action.target_id}  {step.action.action}',
        ))


def _sums(pose_cells: PoseCells) -> Activity:
    """Return the sums of the activity, of the few cells that are active."""
    n_x, n_y, n_theta = pose_cells.dims
    cells, activity = pose_cells.active()
    theta, y, x = cells.T
    plane, headings = np.zeros((n_y, n_x)), np.zeros(n_theta)
    np.add.at(plane, (y, x), activity)
    np.add.at(headings, theta, activity)
    return Activity(plane, headings)
