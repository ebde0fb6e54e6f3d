# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Keyframes of a search for the robot's place: scans, and the landmarks that they have seen."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ratslam_ros.core.common.angles import wrap
from ratslam_ros.core.common.pose import Pose, composed, inverse
from ratslam_ros.core.landmarks.features import BAR_SIZE, Features
from ratslam_ros.core.landmarks.line_extraction import extract_landmarks
from ratslam_ros.core.landmarks.models import LaserModel
from ratslam_ros.core.mapping.odometry_noise import UNMEASURED
from ratslam_ros.core.mapping.place_landmarks import features_of, moved_landmark, nearest_same
from ratslam_ros.core.mapping.scan_matching import MAX_RANGE_M, Observed

EXTRACTION = LaserModel(max_range_m=MAX_RANGE_M, min_length_m=0.25)
"""Short walls count: the landmarks of a person are seen by one experience only."""


@dataclass(frozen=True, slots=True)
class Keyframe:
    """A scan: pose and distance by odometry, points and landmarks in the robot's frame."""

    odometry: Pose
    odometer_m: float
    points: NDArray[np.float64]
    landmarks: NDArray[np.float64]


def landmarks_of(observed: Observed) -> NDArray[np.float64]:
    """Return the corners and ends of walls in scans, (n, 4), as for ``PlaceLandmarks.add``.

    Each scan is examined on its own, because walls are found between neighbouring beams.
    """
    rows = []
    for scan, pose in observed.scans:
        found = extract_landmarks(scan, EXTRACTION).features.values.reshape(-1, BAR_SIZE)
        rows += [moved_landmark(pose, shape) for shape in found.tolist()]
    return np.array(rows, np.float64).reshape(-1, BAR_SIZE)


def seen_landmarks(frames: Sequence[Keyframe], odometer_m: float) -> Features:
    """Return the landmarks that were seen twice or more, in the frame of the last keyframe.

    Args:
        frames: the keyframes, the newest last.
        odometer_m: present odometer reading, in m: variances grow with the distance since.
    """
    now = frames[-1].odometry
    means = np.empty((0, BAR_SIZE))
    counts: list[int] = []
    last_m: list[float] = []
    for frame in frames:
        to_now = composed(inverse(now), frame.odometry)
        for seen in frame.landmarks.tolist():
            shape = moved_landmark(to_now, seen)
            k = nearest_same(means, *shape)
            if k < 0:
                means = np.concatenate([means, [shape]])
                counts.append(1)
                last_m.append(frame.odometer_m)
                continue
            counts[k] += 1
            last_m[k] = frame.odometer_m
            change = np.array(shape) - means[k]
            change[2] = wrap(float(change[2]))
            means[k] += change / counts[k]
    kept = [k for k, count in enumerate(counts) if count >= 2]
    since_m = odometer_m - np.array(last_m)[kept]
    return features_of(means[kept], UNMEASURED.m2_per_m * since_m[:, None])
