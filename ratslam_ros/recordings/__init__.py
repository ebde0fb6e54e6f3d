# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Recordings of every kind as one stream of events in order of time.

Start with ``open_recording``; ``Recording.select`` chooses the topics and ``Recording.events``
yields what they tell. ``describe`` is what ``ratslam info`` shows.
"""

from ratslam_ros.images import UndecodableImage
from ratslam_ros.recordings.describe import Description, describe
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
    'Description',
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
