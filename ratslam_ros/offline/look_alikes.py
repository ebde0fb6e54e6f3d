# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Similarity of views of different places, known to be different by odometry.

An environment may contain places that look alike, such as offices with the same furniture. Images
alone cannot show this: a view that matches an old one is a revisit or a look-alike. Over a path
that leads away from its start, odometry can: its errors are small compared to the displacement.
"""

from __future__ import annotations

import contextlib
import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ratslam_ros.core.common.odometry import MotionFromOdometry, Odometry, moved
from ratslam_ros.core.common.pose import Pose
from ratslam_ros.core.config import Config
from ratslam_ros.core.vision.encoder import View
from ratslam_ros.core.vision.template_memory import TemplateMemory
from ratslam_ros.core.vision.visual_odometry import VisualOdometry
from ratslam_ros.descriptors import encoder_of
from ratslam_ros.event_inputs import odometry_from_event
from ratslam_ros.recordings import (
    ImageEvent,
    OdometryEvent,
    Recording,
    Selection,
    UndecodableImage,
)

MAX_VIEW_COUNT = 900
"""Number of compared views, evenly spaced in time."""

MIN_VIEW_COUNT = 100
"""With fewer views that have unrelated ones, no look-alikes can be measured."""

DIRECTNESS = 0.5
"""Smallest ratio of displacement to path at which odometry shows that two places differ. A return
to the same place would need an odometry error of half the path."""

UNRELATED_LAGS = 3.0
"""Smallest displacement between unrelated views, in distances after which the view has changed."""

CHANGED_RATIO = 0.85
"""The view has changed if the difference exceeds this share of that between unrelated views."""

LOOK_ALIKE_RATE = 0.02
"""Share of the views that may match one of an unrelated place."""


@dataclass(frozen=True)
class _Track:
    """Views, and the path by odometry.

    position_m: (n, 2). path_m: (n,) distance driven. part: (n,) number of odometry gaps before.
    """

    views: list[View]
    position_m: NDArray[np.float64]
    path_m: NDArray[np.float64]
    part: NDArray[np.int64]


def look_alike_ratio(
    recording: Recording, selection: Selection, config: Config, start_s: float = 0.0,
    duration_s: float | None = None,
) -> float | None:  # fmt: skip
    """Return the difference that few views fall below to a view of another place.

    Args:
        recording: the recording.
        selection: its topics to use.
        config: the parameters of the replay.
        start_s, duration_s: the part of the recording to use, in s, as for a replay.

    Returns:
        The difference relative to the median between unrelated views, or None if there are too
        few views of places that odometry shows to be different.
    """
    encoder = encoder_of(config.local_view)
    track = _read(recording, selection, config, start_s, duration_s)
    count = len(track.views)
    if count < MIN_VIEW_COUNT:
        return None
    memory = TemplateMemory(encoder.layout)
    away_m = np.linalg.norm(track.position_m[:, None] - track.position_m, axis=2)
    driven_m = np.abs(track.path_m[:, None] - track.path_m)
    apart = (away_m > DIRECTNESS * driven_m) & (track.part[:, None] == track.part)
    difference = np.full((count, count), np.nan)
    for later, view in enumerate(track.views):
        search = memory.search(view)
        for earlier in np.flatnonzero(apart[later, :later]):
            difference[later, earlier] = search.sad(int(earlier))
        memory.append(view)
    lag_m = _changed_after_m(difference, driven_m)
    if lag_m is None:
        return None
    unrelated = apart & (away_m > UNRELATED_LAGS * lag_m)
    difference[~unrelated] = np.nan
    has_unrelated = np.isfinite(difference).any(axis=1)
    if has_unrelated.sum() < MIN_VIEW_COUNT:
        return None
    nearest = np.nanmin(difference[has_unrelated], axis=1)
    return float(np.quantile(nearest, LOOK_ALIKE_RATE) / np.nanmedian(difference))


def _changed_after_m(
    difference: NDArray[np.float64], driven_m: NDArray[np.float64]
) -> float | None:
    """Return the driven distance after which the median difference is that of unrelated views."""
    known = np.isfinite(difference)
    values, distances_m = difference[known], driven_m[known]
    if not len(values) or distances_m.max() <= 0.0:
        return None
    order = np.argsort(distances_m, kind='stable')
    values, distances_m = values[order], distances_m[order]
    size = max(len(values) // 200, 20)
    groups = range(0, len(values) - size + 1, size)
    medians = np.array([np.median(values[k : k + size]) for k in groups])
    limit = CHANGED_RATIO * np.median(medians[len(medians) // 2 :])
    changed = np.flatnonzero(medians >= limit)
    return float(distances_m[changed[0] * size]) if len(changed) else None


def _read(
    recording: Recording, selection: Selection, config: Config, start_s: float,
    duration_s: float | None,
) -> _Track:  # fmt: skip
    encoder = encoder_of(config.local_view)
    p = config.pose_cells
    motion_of = MotionFromOdometry(p.odom_source, p.max_odom_gap_s, p.turn_correction)
    visual = VisualOdometry(config.visual_odometry) if selection.odom_topic is None else None
    length_s = (recording.end_ns - recording.start_ns) * 1e-9 - start_s
    length_s = length_s if duration_s is None else min(length_s, duration_s)
    step_ns, due_ns, last_ns = length_s * 1e9 / MAX_VIEW_COUNT, -math.inf, -1
    pose, path_m, part = Pose(0.0, 0.0, 0.0), 0.0, 0
    views: list[View] = []
    places: list[tuple[float, float, float, int]] = []

    def drive(odometry: Odometry) -> None:
        nonlocal pose, path_m, part
        motion = motion_of.update(odometry) if motion_of.accepts(odometry) else None
        if motion is not None:
            pose, path_m = moved(pose, motion), path_m + abs(motion.distance_m)
            part += not motion.is_known

    for event in recording.events(selection, start_s, duration_s):
        if isinstance(event, OdometryEvent):
            drive(odometry_from_event(event))
        elif isinstance(event, ImageEvent) and event.stamp_ns > last_ns:
            last_ns = event.stamp_ns
            is_due = event.log_ns >= due_ns
            if visual is None and not is_due:
                continue
            with contextlib.suppress(UndecodableImage):
                image = event.grey()
                odometry = None if visual is None else visual.estimate(last_ns, image)
                if odometry is not None:
                    drive(odometry)
                view = encoder.encode(image) if is_due else None
                if view is not None:
                    due_ns = event.log_ns + step_ns
                    views.append(view)
                    places.append((pose.x_m, pose.y_m, path_m, part))
    table = np.array(places, np.float64).reshape(-1, 4)
    return _Track(views, table[:, :2], table[:, 2], table[:, 3].astype(np.int64))
