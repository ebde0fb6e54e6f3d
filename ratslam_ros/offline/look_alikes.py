# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""How much different places of a recording look alike, estimated before it is replayed.

For a camera without odometry: while driving, only odometry of known scale shows it.
"""

from __future__ import annotations

import contextlib

from ratslam_ros.core.common.odometry import MotionFromOdometry, Odometry
from ratslam_ros.core.config import Config
from ratslam_ros.core.vision.look_alikes import LookAlikes
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

MIN_EVIDENCE_COUNT = 100
"""With fewer views of places known to be different, look-alikes cannot be measured."""


def look_alike_ratio(
    recording: Recording, selection: Selection, config: Config, start_s: float = 0.0,
    duration_s: float | None = None,
) -> float | None:  # fmt: skip
    """Return the difference that few views fall below to a view of another place.

    Args:
        recording: the recording.
        selection: its topics to use.
        config: the parameters of the replay; the motion is calibrated.
        start_s, duration_s: the part of the recording to use, in s, as for a replay.

    Returns:
        The difference relative to the median between unrelated views, or None if there are too
        few views of places that odometry shows to be different.
    """
    encoder = encoder_of(config.local_view)
    found = LookAlikes(encoder.layout)
    p = config.inputs
    motion_of = MotionFromOdometry(p.odom_source, p.max_odom_gap_s, p.turn_correction)
    visual = VisualOdometry(config.visual_odometry) if selection.odom_topic is None else None

    def drive(odometry: Odometry) -> None:
        motion = motion_of.update(odometry) if motion_of.accepts(odometry) else None
        if motion is not None:
            found.move(motion)

    last_ns = -1
    for event in recording.events(selection, start_s, duration_s):
        if isinstance(event, OdometryEvent):
            drive(odometry_from_event(event))
        elif isinstance(event, ImageEvent) and event.stamp_ns > last_ns:
            last_ns = event.stamp_ns
            if visual is None and not found.is_due:
                continue
            with contextlib.suppress(UndecodableImage):
                image = event.grey(p.image_grey)
                odometry = None if visual is None else visual.estimate(last_ns, image)
                if odometry is not None:
                    drive(odometry)
                compared = event.bgr() if encoder.wants_colour else image
                view = encoder.encode(compared) if found.is_due else None
                if view is not None:
                    found.see(view)
    return found.ratio if found.evidence_count >= MIN_EVIDENCE_COUNT else None
