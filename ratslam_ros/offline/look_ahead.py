# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""What a camera without odometry needs to know of a recording before it is replayed.

Its field of view, which is the unit of the turns that it sees, and how much different places look
alike. While driving, the first takes some loops, and without the first the second cannot be
measured: among look-alikes, most loops are false then.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ratslam_ros.core.common.odometry import Motion, MotionFromOdometry, Odometry
from ratslam_ros.core.common.rotation_gain import scale_of_turns
from ratslam_ros.core.common.turn_correction import TurnCorrection
from ratslam_ros.core.config import Config, InputParameters
from ratslam_ros.core.vision.encoder import Layout, View
from ratslam_ros.core.vision.look_alikes import MAX_VIEW_COUNT, LookAlikes
from ratslam_ros.core.vision.match_threshold import RELATED_RATIO
from ratslam_ros.core.vision.template_kernels import MAX_SAD
from ratslam_ros.core.vision.template_memory import TemplateMemory
from ratslam_ros.core.vision.visual_odometry import VisualOdometry
from ratslam_ros.descriptors import encoder_of
from ratslam_ros.errors import UnusableParameter
from ratslam_ros.recordings import Event, ImageEvent, UndecodableImage

MIN_EVIDENCE_COUNT = 100
"""With fewer views of places known to be different, look-alikes cannot be measured."""

CERTAIN_RATIO = 0.45
"""Difference between two views, relative to the median between all, below which they are taken at
one place even where places look alike (docs/benchmarks.md, Constants)."""

NARROWEST_DEG, WIDEST_DEG = 30.0, 200.0
"""Fields of view of cameras."""


class Look(NamedTuple):
    """What an image shows: the motion since the last one, and the view; None if it shows none."""

    odometry: Odometry | None
    view: View | None


def look_ahead(events: Iterator[Event], config: Config) -> list[Look]:
    """Look at the images of a recording.

    Args:
        events: those of the recording.
        config: the parameters of the replay.
    """
    encoder = encoder_of(config.local_view)
    visual = VisualOdometry(config.visual_odometry)
    looks: list[Look] = []
    last_ns = -1
    for event in events:
        if isinstance(event, ImageEvent) and event.stamp_ns > last_ns:
            last_ns = event.stamp_ns
            try:
                image = event.grey(config.inputs.image_grey)
                odometry = visual.estimate(last_ns, image)
                view = encoder.encode(event.bgr() if encoder.wants_colour else image)
            except UndecodableImage:
                continue
            except UnusableParameter:
                if not looks:
                    raise
                continue  # a single image of another size is skipped, as by the stages
            looks.append(Look(odometry, view))
    return looks


def field_of_view_deg(looks: Sequence[Look], config: Config) -> float | None:
    """Estimate the field of view from the turns between certain returns to a place.

    Args:
        looks: the images, looked at with ``config``.
        config: the parameters.

    Returns:
        The horizontal field of view of the whole image in degrees, or None if there are too few
        returns, or if they contradict each other.
    """
    views: list[View] = []
    turned_rad: list[float] = []
    parts: list[int] = []
    seen = sum(look.view is not None for look in looks)
    step = -(-seen // MAX_VIEW_COUNT)
    total_rad, part, number = 0.0, 0, 0
    for motion, view in _moves(looks, config.inputs, 1.0):
        if motion is not None:
            total_rad += motion.turn_rad
            part += not motion.is_known
        if view is not None:
            if number % step == 0:
                views.append(view)
                turned_rad.append(total_rad)
                parts.append(part)
            number += 1
    turns_rad = _turns_of_returns(
        encoder_of(config.local_view).layout, views, np.array(turned_rad), np.array(parts)
    )
    assumed_deg = config.visual_odometry.camera_fov_deg
    found = scale_of_turns(turns_rad, NARROWEST_DEG / assumed_deg, WIDEST_DEG / assumed_deg)
    return None if found is None else assumed_deg * found.gain


def look_alike_ratio(looks: Sequence[Look], config: Config, fov_deg: float) -> float | None:
    """Return the difference that few views fall below to a view of another place.

    Args:
        looks: the images, looked at with ``config``.
        config: the parameters.
        fov_deg: the true field of view.

    Returns:
        The difference relative to the median between unrelated views, or None if there are too
        few views of places that odometry shows to be different.
    """
    found = LookAlikes(encoder_of(config.local_view).layout)
    gain = fov_deg / config.visual_odometry.camera_fov_deg
    for motion, view in _moves(looks, config.inputs, gain):
        if motion is not None:
            found.move(motion)
        if view is not None:
            found.see(view)
    return found.ratio if found.evidence_count >= MIN_EVIDENCE_COUNT else None


def _moves(
    looks: Sequence[Look], p: InputParameters, gain: float
) -> Iterator[tuple[Motion | None, View | None]]:
    """Yield motions, their turns multiplied by a gain, and views."""
    correction = TurnCorrection(gain * p.odom_rotation_gain, p.odom_turn_per_m)
    motion_of = MotionFromOdometry(p.odom_source, p.max_odom_gap_s, correction)
    for odometry, view in looks:
        motion = None
        if odometry is not None and motion_of.accepts(odometry):
            motion = motion_of.update(odometry)
        yield motion, view


def _turns_of_returns(
    layout: Layout, views: Sequence[View], turned_rad: NDArray[np.float64],
    parts: NDArray[np.int64],
) -> NDArray[np.float64]:
    """Return how far the robot has turned before each certain return, since its last visit.

    Args:
        layout: of the views.
        views: n views.
        turned_rad: (n,) the turns before each.
        parts: (n,) number of the part in which all motions are known.
    """
    memory = TemplateMemory(layout)
    differences: list[NDArray[np.int64]] = []
    for number, view in enumerate(views):
        differences.append(memory.search(view).sads(range(number)))
        memory.append(view)
    median = float(np.median(np.concatenate(differences))) if len(views) > 1 else 0.0
    turns_rad = []
    for number, found in enumerate(differences):
        found[parts[:number] != parts[number]] = MAX_SAD  # the turns in between are unknown
        # The robot has left the place in between, or else it is no return.
        unrelated = np.flatnonzero(found > RELATED_RATIO * median)
        before = unrelated[-1] if len(unrelated) else 0
        certain = np.flatnonzero(found[:before] < CERTAIN_RATIO * median)
        if len(certain):
            left = unrelated[unrelated < certain[-1]]
            visit = found[(first := int(left[-1]) if len(left) else 0) : certain[-1] + 1]
            turns_rad.append(turned_rad[number] - turned_rad[first + int(visit.argmin())])
    return np.array(turns_rad)
