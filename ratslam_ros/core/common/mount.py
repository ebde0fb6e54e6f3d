# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Where a laser is mounted on the robot, from the tree of coordinate frames."""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ratslam_ros.errors import UnusableInput

MAX_TILT_RAD = math.radians(15.0)
"""Largest angle between the plane of a scan and the floor. A wall at 5 m is then measured 3.5 %
too far away, and 1.3 m above or below the laser."""

_MAX_DEPTH = 100
"""Longest chain of frames; a longer one is taken for a cycle."""


_DIGITS = 9
"""Mounts are rounded to 1 nm and 1 nrad, so that the map does not depend on the chain of
transforms by which a mount is described."""


_MAX_FRAME_COUNT = 10_000
"""Frames beyond this number are ignored: a robot has up to some hundred."""


class Mount(NamedTuple):
    """Pose of a laser in the frame of the robot, whose x axis points ahead and y axis left.

    ``yaw_rad`` is the direction of its beam 0 rad, counter-clockwise as seen from above;
    ``is_upside_down``: it turns clockwise as seen from above.
    """

    x_m: float = 0.0
    y_m: float = 0.0
    yaw_rad: float = 0.0
    is_upside_down: bool = False


CENTRED = Mount()
"""A laser at the centre of the robot that looks ahead."""


class UnusableMount(UnusableInput):
    """A laser whose scans are not parallel to the floor."""


class FrameTree:
    """Coordinate frames, each with a transform to its parent.

    The first transform of a frame is kept: parts that are mounted on a robot do not move, and a
    map must not depend on which of many equal messages arrives first.
    """

    def __init__(self) -> None:
        self._parents: dict[str, tuple[str, NDArray[np.float64]]] = {}

    def __contains__(self, frame: str) -> bool:
        return frame in self._parents

    def add_stamped(self, transform: Any) -> None:
        """Add a geometry_msgs/TransformStamped, as decoded by rclpy or rosbags; see ``add``."""
        t, q = transform.transform.translation, transform.transform.rotation
        self.add(
            str(transform.header.frame_id), str(transform.child_frame_id),
            (float(t.x), float(t.y), float(t.z)),
            (float(q.x), float(q.y), float(q.z), float(q.w)),
        )

    def add(
        self,
        parent: str,
        child: str,
        translation_m: tuple[float, float, float],
        quaternion: tuple[float, float, float, float],
    ) -> None:
        """Add the transform of a frame to its parent; one that is not finite is ignored.

        Args:
            parent, child: names of the frames.
            translation_m: origin of the child in the frame of the parent.
            quaternion: x, y, z, w of the rotation from the child to the parent.
        """
        parent, child = parent.lstrip('/'), child.lstrip('/')  # ROS 1 may begin with a slash
        x, y, z, w = quaternion
        norm = math.sqrt(x * x + y * y + z * z + w * w)
        if child in self._parents or len(self._parents) >= _MAX_FRAME_COUNT or not (
            math.isfinite(norm) and norm > 0.0 and all(map(math.isfinite, translation_m))
        ):
            return
        x, y, z, w = x / norm, y / norm, z / norm, w / norm
        matrix = np.eye(4)
        matrix[:3, :3] = (
            (1.0 - 2.0 * (y * y + z * z), 2.0 * (x * y - w * z), 2.0 * (x * z + w * y)),
            (2.0 * (x * y + w * z), 1.0 - 2.0 * (x * x + z * z), 2.0 * (y * z - w * x)),
            (2.0 * (x * z - w * y), 2.0 * (y * z + w * x), 1.0 - 2.0 * (x * x + y * y)),
        )
        matrix[:3, 3] = translation_m
        self._parents[child] = parent, matrix

    def mount_of(self, frame: str, base: str) -> Mount | None:
        """Return how a laser is mounted.

        Args:
            frame: frame of the laser; an empty name stands for the robot's own frame.
            base: frame of the robot.

        Returns:
            None if the frames are not connected.

        Raises:
            UnusableMount: the laser is tilted by more than ``MAX_TILT_RAD``.
        """
        frame, base = frame.lstrip('/'), base.lstrip('/')
        if frame in ('', base):
            return CENTRED
        to_root, root = self._to_root(frame)
        base_to_root, base_root = self._to_root(base)
        if root != base_root:
            return None
        transform = np.linalg.inv(base_to_root) @ to_root
        ahead, up = transform[:3, 0], float(transform[2, 2])
        tilt_rad = math.acos(min(abs(up), 1.0))
        if tilt_rad > MAX_TILT_RAD:
            raise UnusableMount(
                f'the laser {frame} is tilted by {math.degrees(tilt_rad):.0f} degrees against the '
                f'floor; expected at most {math.degrees(MAX_TILT_RAD):.0f}: use another laser'
            )
        yaw_rad = round(math.atan2(float(ahead[1]), float(ahead[0])), _DIGITS)
        if abs(yaw_rad) > math.pi - 10.0**-_DIGITS:
            yaw_rad = math.pi
        x_m, y_m = (round(float(value), _DIGITS) + 0.0 for value in transform[:2, 3])  # no -0.0
        return Mount(x_m, y_m, yaw_rad + 0.0, up < 0.0)

    def _to_root(self, frame: str) -> tuple[NDArray[np.float64], str]:
        """Return the transform of a frame to the root of its tree, and the name of the root."""
        transform: NDArray[np.float64] = np.eye(4)
        for _ in range(_MAX_DEPTH):
            if frame not in self._parents:
                break
            frame, to_parent = self._parents[frame]
            transform = to_parent @ transform
        return transform, frame
