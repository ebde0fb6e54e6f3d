# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""RatSLAM for ROS 2 Jazzy, and for recordings without ROS.

The names below are the library's public interface; examples/ shows how to use them. They are
imported on first use, because a node needs only a part of them and has to start quickly.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

from ratslam_ros.limits import limit_images
from ratslam_ros.version import __version__ as __version__

if TYPE_CHECKING:
    from ratslam_ros.core.common.odometry import Odometry, Twist
    from ratslam_ros.core.common.pose import Pose
    from ratslam_ros.core.config import Config
    from ratslam_ros.core.mapping.experience_map import ExperienceMap
    from ratslam_ros.core.vision.local_view import ViewMatch
    from ratslam_ros.event_inputs import recorded_inputs
    from ratslam_ros.files.config import load_config
    from ratslam_ros.images import Frame
    from ratslam_ros.maps.reader import read_map
    from ratslam_ros.maps.system import load_map, save_map
    from ratslam_ros.messages.mapping import encode_map
    from ratslam_ros.offline.map_recording import MapResult, map_recording
    from ratslam_ros.pipeline.ratslam import RatSLAM
    from ratslam_ros.pipeline.stage import Output, Stage
    from ratslam_ros.recordings import (
        Event,
        ImageEvent,
        OdometryEvent,
        Orientation,
        Recording,
        Selection,
        Topic,
        open_recording,
    )

limit_images()  # before any module imports OpenCV

_HOME = {
    'Config': 'core.config',
    'Event': 'recordings',
    'ExperienceMap': 'core.mapping.experience_map',
    'Frame': 'images',
    'ImageEvent': 'recordings',
    'MapResult': 'offline.map_recording',
    'Odometry': 'core.common.odometry',
    'OdometryEvent': 'recordings',
    'Orientation': 'recordings',
    'Output': 'pipeline.stage',
    'Pose': 'core.common.pose',
    'RatSLAM': 'pipeline.ratslam',
    'Recording': 'recordings',
    'Selection': 'recordings',
    'Stage': 'pipeline.stage',
    'Topic': 'recordings',
    'Twist': 'core.common.odometry',
    'ViewMatch': 'core.vision.local_view',
    'encode_map': 'messages.mapping',
    'load_config': 'files.config',
    'load_map': 'maps.system',
    'map_recording': 'offline.map_recording',
    'open_recording': 'recordings',
    'read_map': 'maps.reader',
    'recorded_inputs': 'event_inputs',
    'save_map': 'maps.system',
}

__all__ = [
    'Config', 'Event', 'ExperienceMap', 'Frame', 'ImageEvent', 'MapResult', 'Odometry',
    'OdometryEvent', 'Orientation', 'Output', 'Pose', 'RatSLAM', 'Recording', 'Selection', 'Stage',
    'Topic', 'Twist', 'ViewMatch', 'encode_map', 'load_config', 'load_map', 'map_recording',
    'open_recording', 'read_map', 'recorded_inputs', 'save_map',
]


def __getattr__(name: str) -> Any:
    """Import a public name on first use (PEP 562)."""
    if name not in _HOME:
        raise AttributeError(f'module {__name__!r} has no attribute {name!r}')
    value = getattr(import_module(f'{__name__}.{_HOME[name]}'), name)
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})
