# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Writers of small test recordings in every format, based on rosbags, mcap and sqlite3."""

import json
import sqlite3
from collections.abc import Iterator
from pathlib import Path

import cv2
import numpy as np
from mcap.writer import CompressionType, Writer
from rosbags.rosbag1 import Writer as Writer1
from rosbags.rosbag2 import CompressionFormat, CompressionMode, StoragePlugin
from rosbags.rosbag2 import Writer as Writer2
from rosbags.typesys import Stores, get_typestore

ROS2 = get_typestore(Stores.ROS2_JAZZY)
ROS1 = get_typestore(Stores.ROS1_NOETIC)
START_NS = 1_700_000_000_000_000_000
PERIOD_NS = 100_000_000

IMAGE = 'sensor_msgs/msg/Image'
COMPRESSED = 'sensor_msgs/msg/CompressedImage'
ODOMETRY = 'nav_msgs/msg/Odometry'
STRING = 'std_msgs/msg/String'
SCAN = 'sensor_msgs/msg/LaserScan'


def picture(index: int, height: int = 12, width: int = 16) -> np.ndarray:
    """Return an (H, W) uint8 image of noise, different for every index."""
    return np.random.default_rng(index).integers(0, 256, (height, width), dtype=np.uint8)


def header(store, stamp_ns: int, frame: str = 'camera'):
    types = store.types
    stamp = types['builtin_interfaces/msg/Time'](stamp_ns // 10**9, stamp_ns % 10**9)
    if store is ROS1:
        return types['std_msgs/msg/Header'](0, stamp, frame)
    return types['std_msgs/msg/Header'](stamp, frame)


def raw_image(pixels: np.ndarray, encoding: str = 'mono8', stamp_ns: int = START_NS, store=ROS2,
              step: int | None = None, big: int = 0, size: tuple[int, int] | None = None):
    height, width = size or pixels.shape[:2]
    data = np.frombuffer(np.ascontiguousarray(pixels).tobytes(), np.uint8)
    return store.types[IMAGE](header(store, stamp_ns), height, width, encoding, big,
                              len(data) // height if step is None else step, data)


def compressed_image(pixels: np.ndarray, stamp_ns: int = START_NS, store=ROS2,
                     form: str = 'jpeg'):
    data = cv2.imencode('.jpg' if form == 'jpeg' else '.png', pixels)[1].reshape(-1)
    return store.types[COMPRESSED](header(store, stamp_ns), form, data)


def odometry(stamp_ns: int = START_NS, linear: float = 0.5, angular: float = 0.1, x: float = 1.0,
             y: float = 2.0, heading: float = 0.3, store=ROS2):
    types = store.types
    vector, point = types['geometry_msgs/msg/Vector3'], types['geometry_msgs/msg/Point']
    turn = types['geometry_msgs/msg/Quaternion'](
        0.0, 0.0, float(np.sin(heading / 2)), float(np.cos(heading / 2)))
    pose = types['geometry_msgs/msg/Pose'](point(x, y, 0.0), turn)
    twist = types['geometry_msgs/msg/Twist'](vector(linear, 0.0, 0.0), vector(0.0, 0.0, angular))
    return types[ODOMETRY](
        header(store, stamp_ns), 'base_link',
        types['geometry_msgs/msg/PoseWithCovariance'](pose, np.zeros(36)),
        types['geometry_msgs/msg/TwistWithCovariance'](twist, np.zeros(36)),
    )


def laser_scan(stamp_ns: int = START_NS, ranges=(1.0, 2.0, np.inf), first: float = -0.5,
               store=ROS2, frame: str = 'base_link'):
    return store.types[SCAN](
        header(store, stamp_ns, frame), first, -first, 0.5, 0.0, 0.1, 0.25, 8.0,
        np.array(ranges, np.float32), np.empty(0, np.float32))


def template_text(stamp_ns: int, number: int = 0) -> str:
    return json.dumps({
        'schema_version': 1, 'stamp': {'sec': stamp_ns // 10**9, 'nanosec': stamp_ns % 10**9},
        'id': number,
    })


def string(text: str):
    return ROS2.types[STRING](text)


def drive(frames: int = 20, store=ROS2, image_topic: str = '/camera/image/compressed',
          stamped: bool = True) -> Iterator[tuple[int, str, str, object]]:
    """Yield (log_ns, topic, type, message): an odometry message and an image every 0.1 s."""
    for index in range(frames):
        log_ns = START_NS + index * PERIOD_NS
        stamp_ns = log_ns - 1_000_000 if stamped else 0
        yield log_ns, '/odom', ODOMETRY, odometry(stamp_ns, 0.01 * index, store=store)
        yield (log_ns + 2_000_000, image_topic, COMPRESSED,
               compressed_image(picture(index), stamp_ns, store))


def write_rosbag2(path: Path, messages, storage: str = 'mcap', mode: str = 'none') -> Path:
    """Write a rosbag2 folder; mode is the compression: none, file, message or storage."""
    plugin = StoragePlugin.MCAP if storage == 'mcap' else StoragePlugin.SQLITE3
    writer = Writer2(path, version=9, storage_plugin=plugin)
    if mode != 'none':
        writer.set_compression(CompressionMode[mode.upper()], CompressionFormat.ZSTD)
    with writer:
        connections = {}
        for log_ns, topic, kind, message in messages:
            if topic not in connections:
                connections[topic] = writer.add_connection(topic, kind, typestore=ROS2)
            data = message if isinstance(message, bytes) else ROS2.serialize_cdr(message, kind)
            writer.write(connections[topic], log_ns, data)
    return path


def write_mcap(path: Path, messages, compression: str = 'zstd', chunked: bool = True,
               chunk_size: int = 4000, **options) -> Path:
    """Write a single mcap file with the mcap library."""
    with path.open('wb') as file:
        writer = Writer(file, chunk_size=chunk_size, compression=CompressionType[
            compression.upper()], use_chunking=chunked, **options)
        writer.start('ros2', 'test')
        channels = {}
        for log_ns, topic, kind, message in messages:
            if topic not in channels:
                text, _ = ROS2.generate_msgdef(kind, ros_version=2)
                schema = writer.register_schema(kind, 'ros2msg', text.encode())
                channels[topic] = writer.register_channel(topic, 'cdr', schema)
            data = message if isinstance(message, bytes) else bytes(
                ROS2.serialize_cdr(message, kind))
            writer.add_message(channels[topic], log_ns, data, log_ns)
        writer.finish()
    return path


def write_rosbag1(path: Path, messages, compression: str = 'none', chunk: int = 4000) -> Path:
    """Write a ROS 1 bag of messages from the ROS1 type store."""
    writer = Writer1(path)
    writer.chunk_threshold = chunk
    if compression != 'none':
        writer.set_compression(Writer1.CompressionFormat[compression.upper()])
    with writer:
        connections = {}
        for log_ns, topic, kind, message in messages:
            if topic not in connections:
                connections[topic] = writer.add_connection(topic, kind, typestore=ROS1)
            writer.write(connections[topic], log_ns, bytes(ROS1.serialize_ros1(message, kind)))
    return path


def write_sqlite(path: Path, messages, schema: int = 1, index: bool = True) -> Path:
    """Write a single SQLite file with a schema of an older rosbag2 version."""
    database = sqlite3.connect(path)
    qos = ', offered_qos_profiles TEXT NOT NULL' if schema >= 2 else ''
    database.executescript(f"""
        CREATE TABLE topics(id INTEGER PRIMARY KEY, name TEXT NOT NULL, type TEXT NOT NULL,
                            serialization_format TEXT NOT NULL{qos});
        CREATE TABLE messages(id INTEGER PRIMARY KEY, topic_id INTEGER NOT NULL,
                              timestamp INTEGER NOT NULL, data BLOB NOT NULL);
    """)
    if index:
        database.execute('CREATE INDEX timestamp_idx ON messages (timestamp ASC)')
    topics: dict[str, int] = {}
    for log_ns, topic, kind, message in messages:
        if topic not in topics:
            topics[topic] = len(topics) + 1
            row = (topics[topic], topic, kind, 'cdr') + (('',) if schema >= 2 else ())
            database.execute(f'INSERT INTO topics VALUES({",".join("?" * len(row))})', row)
        data = message if isinstance(message, bytes) else bytes(ROS2.serialize_cdr(message, kind))
        database.execute('INSERT INTO messages(topic_id, timestamp, data) VALUES(?, ?, ?)',
                         (topics[topic], log_ns, data))
    database.commit()
    database.close()
    return path
