# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Recordings of every supported format, read as one stream of events in time order.

``open_recording`` opens a recording, ``Recording.select`` chooses the topics, and
``Recording.events`` yields their messages as events. ``describe`` summarises a recording for
``ratslam info``.
"""

from ratslam_ros.images import UndecodableImage
from ratslam_ros.recordings.describe import describe
from ratslam_ros.recordings.events import (
    Event,
    ImageEvent,
    OdometryEvent,
    Orientation,
    ScanEvent,
    TemplateEvent,
)
from ratslam_ros.recordings.opening import open_recording
from ratslam_ros.recordings.recording import Recording
from ratslam_ros.recordings.topics import Selection, Topic

__all__ = [
    'Event',
    'ImageEvent',
    'OdometryEvent',
    'Orientation',
    'Recording',
    'ScanEvent',
    'Selection',
    'TemplateEvent',
    'Topic',
    'UndecodableImage',
    'describe',
    'open_recording',
]
