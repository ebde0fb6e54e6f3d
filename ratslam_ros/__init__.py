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

_NAMES = {
    'core.common.odometry': ('Odometry', 'Twist'),
    'core.common.pose': ('Pose',),
    'core.config': ('Config',),
    'core.mapping.experience_map': ('ExperienceMap',),
    'core.vision.local_view': ('ViewMatch',),
    'event_inputs': ('recorded_inputs',),
    'files.config': ('load_config',),
    'images': ('Frame',),
    'maps.reader': ('read_map',),
    'maps.system': ('load_map', 'save_map'),
    'messages.mapping': ('encode_map',),
    'offline.map_recording': ('MapResult', 'map_recording'),
    'pipeline.ratslam': ('RatSLAM',),
    'pipeline.stage': ('Output', 'Stage'),
    'recordings': (
        'Event', 'ImageEvent', 'OdometryEvent', 'Orientation', 'Recording', 'Selection', 'Topic',
        'open_recording',
    ),
}
"""The names that each module has."""

__all__ = [
    'Config', 'Event', 'ExperienceMap', 'Frame', 'ImageEvent', 'MapResult', 'Odometry',
    'OdometryEvent', 'Orientation', 'Output', 'Pose', 'RatSLAM', 'Recording', 'Selection', 'Stage',
    'Topic', 'Twist', 'ViewMatch', 'encode_map', 'load_config', 'load_map', 'map_recording',
    'open_recording', 'read_map', 'recorded_inputs', 'save_map',
]


def __getattr__(name: str) -> Any:
    """Import a public name on first use (PEP 562)."""
    for module, names in _NAMES.items():
        if name in names:
            globals()[name] = value = getattr(import_module(f'{__name__}.{module}'), name)
            return value
    raise AttributeError(f'module {__name__!r} has no attribute {name!r}')


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})
