# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Table of the streams: what flows through a pipeline, and in which order at equal stamps."""

from __future__ import annotations

from dataclasses import dataclass

from ratslam_ros.core.common.odometry import Odometry
from ratslam_ros.core.common.scan import Scan, scan_stream
from ratslam_ros.core.config.experience_map import MAX_LASERS
from ratslam_ros.core.vision.local_view import ViewMatch
from ratslam_ros.core.vision.prepared_image import PreparedImage
from ratslam_ros.pipeline.items import Answer, MapStep, NumberedAction, OdometryStep


@dataclass(frozen=True, slots=True)
class Stream:
    """A stream of items.

    name: its name. item: class of its items. is_regular: whether its next stamp is predicted from
    its rhythm, so that other streams need not wait for it. answers: stream whose items it answers,
    one by one, against the direction of flow; '' if it flows forward.
    """

    name: str
    item: object
    is_regular: bool = False
    answers: str = ''


STREAMS = (
    Stream('odometry', Odometry, is_regular=True),
    *(Stream(scan_stream(laser), Scan) for laser in range(MAX_LASERS)),
    Stream('image', PreparedImage | None),
    Stream('template', ViewMatch),
    Stream('action', NumberedAction),
    Stream('relocation', Answer, answers='template'),
    Stream('pose', OdometryStep),
    Stream('update', MapStep),
    Stream('landmarks', int),
)
"""All streams. At equal stamps, the one named first is processed first."""
