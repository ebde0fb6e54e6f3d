# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Writers of small test recordings in every format, based on rosbags, mcap and sqlite3."""

import sqlite3
from collections.abc import Iterator
from pathlib import Path

import cv2
import numpy as np
from helpers import PERIOD_NS, START_NS, header, odometry_message, picture
from mcap.writer import CompressionType, Writer
from rosbags.rosbag1 import Writer as Writer1
from rosbags.typesys import Stores, get_typestore

from ratslam_ros.core.common.pose import Pose

ROS2 = get_typestore(Stores.ROS2_JAZZY)
ROS1 = get_typestore(Stores.ROS1_NOETIC)

IMAGE = 'sensor_msgs/msg/Image'
COMPRESSED = 'sensor_msgs/msg/CompressedImage'
ODOMETRY = 'nav_msgs/msg/Odometry'
STRING = 'std_msgs/msg/String'
SCAN = 'sensor_msgs/msg/LaserScan'


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


def odometry(stamp_ns: int = START_NS, linear: float = 0.5, store=ROS2):
    return odometry_message(stamp_ns, linear, 0.1, Pose(1.0, 2.0, 0.3), store=store)


def laser_scan(stamp_ns: int = START_NS, ranges=(1.0, 2.0, np.inf), first: float = -0.5,
               store=ROS2, frame: str = 'base_link'):
    return store.types[SCAN](
        header(store, stamp_ns, frame), first, -first, 0.5, 0.0, 0.1, 0.25, 8.0,
        np.array(ranges, np.float32), np.empty(0, np.float32))


def drive(frames: int = 20, store=ROS2, image_topic: str = '/camera/image/compressed',
          stamped: bool = True) -> Iterator[tuple[int, str, str, object]]:
    """Yield (log_ns, topic, type, message): an odometry message and an image every 0.1 s."""
    for index in range(frames):
        log_ns = START_NS + index * PERIOD_NS
        stamp_ns = log_ns - 1_000_000 if stamped else 0
        yield log_ns, '/odom', ODOMETRY, odometry(stamp_ns, 0.01 * index, store=store)
        yield (log_ns + 2_000_000, image_topic, COMPRESSED,
               compressed_image(picture(index), stamp_ns, store))


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
