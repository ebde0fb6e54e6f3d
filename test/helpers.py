# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Small worlds and recordings, and simple reference implementations for the tests."""

from __future__ import annotations

import json
import math
import os
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from domains import own_domain
from numpy.typing import NDArray
from scipy.ndimage import convolve1d

from ratslam_ros.core.common.odometry import Motion, Odometry, Twist
from ratslam_ros.core.common.pose import Pose
from ratslam_ros.core.common.scan import Scan
from ratslam_ros.core.config import (
    Config,
    ExperienceMapParameters,
    LocalViewParameters,
    PoseCellsParameters,
)
from ratslam_ros.core.mapping.experience_map import ExperienceMap
from ratslam_ros.core.pose_cells.map_action import Action, MapAction
from ratslam_ros.core.pose_cells.torus import Place
from ratslam_ros.core.vision.local_view import ViewMatch
from ratslam_ros.files.config import EXTENDED, preset_config

START_NS = 1_700_000_000_000_000_000
PERIOD_NS = 100_000_000
S = 1_000_000_000
STILL = Motion(0.1, 0.0, 0.0)
IMAGE_TOPIC, ODOM_TOPIC, TEMPLATE_TOPIC = '/camera/image', '/odom', '/local_view/template'
SCAN_TOPIC = '/scan'
SMALL_IMAGES: dict[str, Any] = {
    'local_view.template_x_size': 16, 'local_view.template_y_size': 8,
    'local_view.vt_shift_match': 2, 'pose_cells.pc_cell_x_size': 0.5,
    'pose_cells.exp_delta_pc_threshold': 1.0,
}
"""Settings for images of 32 x 24 pixels and steps of about 0.4 m, as of ``circles``."""


@cache
def _extended() -> Config:
    return preset_config(EXTENDED)


def extended(section: str = '', **values: Any) -> Any:
    """Return the values of the preset extended, OpenRatSLAM's apart from our first additions.

    Of a section, if one is named, apart from the given values.
    """
    return replace(getattr(_extended(), section), **values) if section else _extended()


def twist(stamp_ns: int, speed: float = 0.0, turn_rate: float = 0.0) -> Odometry:
    """Return an odometry message without a pose."""
    return Odometry(stamp_ns, Twist(speed, turn_rate))


def ahead(distance_m: float, dt_s: float = 0.1) -> Motion:
    return Motion(dt_s, distance_m, 0.0)


def turning(turn_rad: float, dt_s: float = 0.1) -> Motion:
    return Motion(dt_s, 0.0, turn_rad)


def seen(template_id: int, relative_rad: float = 0.0, is_new: bool = False) -> ViewMatch:
    return ViewMatch(template_id, is_new, 0.0, relative_rad)


# Dense reference of the pose cells


class DenseNetwork:
    """Reference implementation of the network: the whole torus, with bilinear shifts."""

    def __init__(self, p: PoseCellsParameters) -> None:
        self.dims = (p.pc_dim_th, p.pc_dim_y, p.pc_dim_x)
        self._excitation = gaussian(p.pc_w_e_dim, p.pc_w_e_var)
        self._inhibition = gaussian(p.pc_w_i_dim, p.pc_w_i_var)
        self._cutoff = p.pc_global_inhib
        self.activity = np.zeros(self.dims)
        self.activity[tuple(n // 2 for n in self.dims)] = 1.0

    def step(self, cells: float = 0.0, planes: float = 0.0) -> None:
        """Compete, normalise, shift every plane along its heading, then all planes along theta."""
        p = _convolved(self.activity, self._excitation)
        p = p - _convolved(p, self._inhibition)
        p = np.maximum(p - self._cutoff, 0.0)
        surviving = p if p.sum() > 0.0 else self.activity
        self.activity = surviving / surviving.sum()
        if cells != 0.0:
            for k in range(self.dims[0]):
                heading = 2.0 * math.pi * k / self.dims[0]
                plane = shifted(self.activity[k], cells * math.sin(heading), 0)
                self.activity[k] = shifted(plane, cells * math.cos(heading), 1)
        self.activity = shifted(self.activity, planes, 0)

    def inject(self, theta: float, y: float, x: float, energy: float) -> None:
        """Distribute energy over the eight cells around a place."""
        for i, w_i in _two_cells(theta, self.dims[0]):
            for j, w_j in _two_cells(y, self.dims[1]):
                for k, w_k in _two_cells(x, self.dims[2]):
                    self.activity[i, j, k] += energy * w_i * w_j * w_k

    def peak(self) -> tuple[float, float, float]:
        """Return theta, y and x of the peak."""
        return peak_of(self.activity)


def gaussian(width: int, deviation: float) -> NDArray[np.float64]:
    """Return one axis of the separable kernel exp(-r^2 / (2 sigma^2)), with a sum of 1."""
    k = np.arange(width) - width // 2
    weights = np.exp(-(k**2) / (2.0 * deviation**2))
    return weights / weights.sum()


def peak_of(activity: NDArray[np.float64]) -> tuple[float, float, float]:
    """Decode theta, y and x by population vectors within 3 cells of the largest cell."""
    largest = np.unravel_index(int(activity.argmax()), activity.shape)
    radii = [min(3, (n - 1) // 2) for n in activity.shape]
    around = [np.arange(c - r, c + r + 1) for c, r in zip(largest, radii, strict=True)]
    box = activity[np.ix_(*[i % n for i, n in zip(around, activity.shape, strict=True)])]
    place = []
    for axis, n in enumerate(activity.shape):
        weights = box.sum(tuple({0, 1, 2} - {axis}))
        angles = 2.0 * math.pi * around[axis] / n
        angle = math.atan2((weights * np.sin(angles)).sum(), (weights * np.cos(angles)).sum())
        place.append(angle * n / (2.0 * math.pi) % n)
    return place[0], place[1], place[2]


def centroid(
    activity: NDArray[np.float64], near: tuple[float, float, float], radius: int = 4
) -> tuple[float, float, float]:
    """Return the population vector of the cells within a box around a place."""
    mask = np.ones(activity.shape, bool)
    for axis, n in enumerate(activity.shape):
        d = np.abs(around(np.arange(n) - near[axis], n)) <= radius
        mask &= d.reshape([-1 if a == axis else 1 for a in range(3)])
    part = np.where(mask, activity, 0.0)
    place = []
    for axis, n in enumerate(activity.shape):
        weights = part.sum(tuple({0, 1, 2} - {axis}))
        angles = 2.0 * math.pi * np.arange(n) / n
        angle = math.atan2((weights * np.sin(angles)).sum(), (weights * np.cos(angles)).sum())
        place.append(angle * n / (2.0 * math.pi) % n)
    return place[0], place[1], place[2]


def shifted(a: NDArray[np.float64], cells: float, axis: int) -> NDArray[np.float64]:
    """Shift cyclically by any number of cells, with linear interpolation."""
    whole = math.floor(cells)
    part = cells - whole
    return (1.0 - part) * np.roll(a, whole, axis) + part * np.roll(a, whole + 1, axis)


def around(difference: Any, circle: float) -> Any:
    """Wrap a difference on a circle to the shortest one."""
    return (difference + circle / 2) % circle - circle / 2


def _convolved(a: NDArray[np.float64], weights: NDArray[np.float64]) -> NDArray[np.float64]:
    for axis in range(3):
        if len(weights) > a.shape[axis]:  # the kernel wraps around the axis more than once
            radius = len(weights) // 2
            a = sum(w * np.roll(a, k - radius, axis) for k, w in enumerate(weights))
        else:
            a = convolve1d(a, weights, axis, mode='wrap')
    return a


def _two_cells(place: float, circle: int) -> tuple[tuple[int, float], tuple[int, float]]:
    whole = math.floor(place)
    part = place - whole
    return (whole % circle, 1.0 - part), ((whole + 1) % circle, part)


# Reference implementation of the local view


def plain_view(image: NDArray[np.uint8], p: LocalViewParameters) -> NDArray[np.uint8]:
    """Return the (rows, columns) uint8 view of an image, as docs/algorithm.md defines it."""
    return np.floor(plain_brightness(image, p) + 0.5).astype(np.uint8)


def plain_brightness(image: NDArray[np.uint8], p: LocalViewParameters) -> NDArray[np.float64]:
    """Return the (rows, columns) view of an image before it is rounded, 0 to 255."""
    x_max = image.shape[1] if p.image_crop_x_max < 0 else p.image_crop_x_max
    y_max = image.shape[0] if p.image_crop_y_max < 0 else p.image_crop_y_max
    crop = image[p.image_crop_y_min : y_max, p.image_crop_x_min : x_max].astype(np.float64)
    rows, columns = p.template_y_size, p.template_x_size
    y_edges = [i * crop.shape[0] // rows for i in range(rows + 1)]
    x_edges = [i * crop.shape[1] // columns for i in range(columns + 1)]
    v = np.array(
        [
            [crop[y_edges[j] : y_edges[j + 1], x_edges[i] : x_edges[i + 1]].mean() / 255.0
             for i in range(columns)]
            for j in range(rows)
        ]
    )
    if p.vt_normalise_range:
        about, to = (v.mean(), p.vt_normalisation) if p.vt_normalisation > 0.0 else (v.min(), 0.0)
        v = np.clip(to + (v - about) / (np.ptp(v) or 1.0), 0.0, 1.0)
    elif p.vt_normalisation > 0.0 and v.mean() > 0.0:
        v = np.clip(v * p.vt_normalisation / v.mean(), 0.0, 1.0)
    n = p.vt_patch_normalise
    if n > 0:
        padded = np.pad(v, n, mode='edge')
        patches = np.lib.stride_tricks.sliding_window_view(padded, (2 * n + 1, 2 * n + 1))
        mean, std = patches.mean((2, 3)), patches.std((2, 3))
        plain = (std <= 1e-12) | (std < p.vt_min_patch_normalisation_std)
        z = ((v - mean) / np.where(plain, 1.0, std) + 3.0) / 6.0
        v = np.where(plain, 0.5, np.clip(z, 0.0, 1.0))
    return 255.0 * v


def plain_match(
    templates: Iterable[NDArray[np.uint8]], view: NDArray[np.uint8], p: LocalViewParameters
) -> tuple[int, int, int] | None:
    """Return (id, offset, sum of absolute differences) of the best match; None without templates.

    Ties: lowest id, then lowest offset.
    """
    width = view.shape[1]
    now = view.astype(np.int64)
    shift = p.vt_shift_match
    best = None
    for number, template in enumerate(templates):
        known = template.astype(np.int64)
        last = width - 1 if p.vt_panoramic else 2 * shift
        for offset in range(0, last + 1, p.vt_step_match):
            if p.vt_panoramic:  # template column (x + o) mod W over view column x
                sad = int(np.abs(now - np.roll(known, -offset, 1)).sum())
            else:
                part = known[:, offset : offset + width - 2 * shift]
                sad = int(np.abs(now[:, shift : width - shift] - part).sum())
            if best is None or sad < best[2]:
                best = number, offset, sad
    return best


# Images


def picture(seed: int, height: int = 12, width: int = 16) -> NDArray[np.uint8]:
    """Return a (height, width) image of noise."""
    return np.random.default_rng(seed).integers(0, 256, (height, width), dtype=np.uint8)


class Hue:
    """Descriptor of the mean of each channel."""

    wants_colour = True

    def compute(self, images: Sequence[NDArray[np.uint8]]) -> NDArray[np.float64]:
        return np.array([np.full(3, image.mean((0, 1))) for image in images])


def panorama(place: tuple[int, int], turns: int, width: int = 60) -> NDArray[np.uint8]:
    """Return the image of a panoramic camera; it differs between places.

    ``turns``: heading of the robot in columns, counter-clockwise. Columns run clockwise: column c
    shows the direction ``turns - c``.
    """
    seed = (place[0] + 1000) * 10_000 + place[1] + 1000
    return np.roll(picture(seed, 8, width), turns, axis=1)


# Recordings


def set_options(settings: Mapping[str, Any]) -> list[str]:
    """Return settings as options of a command."""
    return [word for key, value in settings.items() for word in ('--set', f'{key}={value}')]


def real_recordings() -> Path:
    """Return the folder of real recordings, RATSLAM_DATA; skip the test if there is none."""
    default = Path(__file__).parents[2] / 'shared' / 'data'
    folder = Path(os.environ.get('RATSLAM_DATA', default)).resolve()
    if not folder.is_dir():
        pytest.skip(f'the real recordings are missing: {folder} does not exist; set RATSLAM_DATA')
    return folder


def real_recording(name: str) -> Path:
    """Return a real recording by its path in the folder; skip the test if it is missing."""
    path = real_recordings() / name
    if not path.exists():
        pytest.skip(f'no recording at {path}; set RATSLAM_DATA')
    return path


TYPES = {
    'image': 'sensor_msgs/msg/Image',
    'compressed': 'sensor_msgs/msg/CompressedImage',
    'odometry': 'nav_msgs/msg/Odometry',
    'string': 'std_msgs/msg/String',
    'scan': 'sensor_msgs/msg/LaserScan',
    'camera_info': 'sensor_msgs/msg/CameraInfo',
}
Recorded = tuple[int, str, str, Any]
"""Time of recording in ns, topic, type or its key of ``TYPES``, and message."""


def _store() -> Any:
    from rosbags.typesys import Stores, get_typestore

    return get_typestore(Stores.ROS2_JAZZY)


def write_bag(
    folder: Path, messages: Iterable[Recorded], storage: str = 'mcap', mode: str = 'none'
) -> Path:
    """Write a rosbag2 folder; ``mode``: its compression, none, file, message or storage."""
    from rosbags.rosbag2 import CompressionFormat, CompressionMode, StoragePlugin, Writer

    store = _store()
    writer = Writer(folder, version=9, storage_plugin=StoragePlugin[storage.upper()])
    if mode != 'none':
        writer.set_compression(CompressionMode[mode.upper()], CompressionFormat.ZSTD)
    with writer:
        connections: dict[str, Any] = {}
        for log_ns, topic, key, message in messages:
            kind = TYPES.get(key, key)
            if topic not in connections:
                connections[topic] = writer.add_connection(topic, kind, typestore=store)
            is_ready = isinstance(message, bytes)
            data = message if is_ready else store.serialize_cdr(message, kind)
            writer.write(connections[topic], log_ns, data)
    return folder


def header(store: Any, stamp_ns: int, frame_id: str = 'camera') -> Any:
    time = store.types['builtin_interfaces/msg/Time'](*divmod(stamp_ns, 10**9))
    kind = store.types['std_msgs/msg/Header']
    number = (0,) * ('seq' in kind.__dataclass_fields__)  # in ROS 1
    return kind(*number, time, frame_id)


def image_message(stamp_ns: int, pixels: NDArray[np.uint8]) -> Any:
    store = _store()
    height, width = pixels.shape
    data = np.ascontiguousarray(pixels).reshape(-1)
    return store.types[TYPES['image']](
        header(store, stamp_ns), height, width, 'mono8', 0, width, data
    )


def undecodable_message(stamp_ns: int) -> Any:
    """Return an image message with too few bytes for its size."""
    store = _store()
    return store.types[TYPES['image']](
        header(store, stamp_ns), 8, 8, 'mono8', 0, 8, np.zeros(3, np.uint8)
    )


def odometry_message(
    stamp_ns: int, speed: float, turn_rate: float, pose: Pose, sideways: float = 0.0,
    store: Any = None,
) -> Any:
    store = store or _store()
    types = store.types
    vector, point = types['geometry_msgs/msg/Vector3'], types['geometry_msgs/msg/Point']
    turn = types['geometry_msgs/msg/Quaternion'](
        0.0, 0.0, math.sin(pose.heading_rad / 2), math.cos(pose.heading_rad / 2)
    )
    place = types['geometry_msgs/msg/Pose'](point(pose.x_m, pose.y_m, 0.0), turn)
    motion = types['geometry_msgs/msg/Twist'](
        vector(speed, sideways, 0.0), vector(0.0, 0.0, turn_rate)
    )
    return types[TYPES['odometry']](
        header(store, stamp_ns),
        'base_link',
        types['geometry_msgs/msg/PoseWithCovariance'](place, np.zeros(36)),
        types['geometry_msgs/msg/TwistWithCovariance'](motion, np.zeros(36)),
    )


def camera_info_message(stamp_ns: int, focal_px: float) -> Any:
    """Return the calibration of a camera with 32 x 24 pixels."""
    store = _store()
    k = np.zeros(9)
    k[0] = focal_px
    return store.types[TYPES['camera_info']](
        header(store, stamp_ns), 24, 32, 'plumb_bob', np.zeros(5), k, np.zeros(9), np.zeros(12),
        0, 0, store.types['sensor_msgs/msg/RegionOfInterest'](0, 0, 0, 0, False),
    )


def scan_message(scan: Scan) -> Any:
    """Return the scan of a laser with a range of 0.05 to 8 m."""
    store, first, step = _store(), scan.angle_min_rad, scan.angle_increment_rad
    return store.types[TYPES['scan']](
        header(store, scan.stamp_ns, 'base_link'), first,
        first + step * (len(scan.ranges_m) - 1), step, 0.0, 0.1, 0.05, 8.0,
        scan.ranges_m.astype(np.float32), np.empty(0, np.float32),
    )


def string_message(text: str) -> Any:
    return _store().types[TYPES['string']](text)


def circles(laps: int = 3, per_lap: int = 30, radius_m: float = 2.0) -> Iterator[Recorded]:
    """Yield odometry and images of a robot that drives in a circle; the images repeat each lap."""
    length_m = 2.0 * math.pi * radius_m
    for i in range(laps * per_lap):
        stamp_ns = START_NS + i * PERIOD_NS
        speed = length_m / per_lap / (PERIOD_NS * 1e-9)
        turn_rate = 2.0 * math.pi / per_lap / (PERIOD_NS * 1e-9)
        message = odometry_message(stamp_ns, speed, turn_rate, Pose(0.0, 0.0, 0.0))
        yield stamp_ns, ODOM_TOPIC, 'odometry', message
        pixels = picture(i % per_lap, 24, 32)
        yield stamp_ns + 1_000_000, IMAGE_TOPIC, 'image', image_message(stamp_ns, pixels)


def template_text(stamp_ns: int, template_id: int, **changes: Any) -> str:
    """Return a valid template payload, with some fields replaced or added."""
    sec, nanosec = divmod(stamp_ns, 10**9)
    fields = {
        'schema_version': 1, 'stamp': {'sec': sec, 'nanosec': nanosec}, 'id': template_id,
        'is_new': False, 'error': 0.01, 'relative_rad': 0.0, 'memory': START_NS,
    }
    return json.dumps({**fields, **changes})


def circles_of_actions(places: int, laps: int) -> Iterator[tuple[int, MapAction]]:
    """Yield sequence number and action of each place on a circle that is driven several times."""
    for n in range(places * laps):
        source = (n - 1) % places if n else -1
        kind: Action = 'create' if n < places else 'link' if n == places else 'set'
        yield n, MapAction(kind, source, n % places, n % places, 0.0, Place(1.0, 2.0, 3.0))


def restored(
    graph: ExperienceMap, parameters: ExperienceMapParameters, **changes: Any
) -> ExperienceMap:
    """Return a copy of a map with other parameters, and with some items of its state replaced."""
    copy = ExperienceMap(parameters)
    copy.restore({**graph.state(), **changes})
    return copy


# Live nodes


def live_environment(number: int = 0) -> dict[str, str]:
    """Return environment variables that isolate the nodes of a test from other tests and hosts.

    Args:
        number: of the domain, see ``own_domain``.
    """
    return {
        'ROS_DOMAIN_ID': str(own_domain(number)),
        'ROS_AUTOMATIC_DISCOVERY_RANGE': 'LOCALHOST',
        'PYTHONUNBUFFERED': '1',
        'PYTHONPATH': os.pathsep.join(
            filter(None, [str(Path(__file__).parents[1]), os.environ.get('PYTHONPATH')])
        ),
    }
