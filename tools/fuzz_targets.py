# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Targets of tools/fuzz.py: functions that pass arbitrary bytes to the readers of inputs.

A target returns, or raises a ``RatslamError``, for all bytes. Everything else is a defect. Files
are written to the given folder only. ``seeds`` returns valid inputs, from which fuzzing begins.
"""

from __future__ import annotations

import io
import json
import re
import sqlite3
import struct
import sys
import tempfile
from collections.abc import Callable, Iterator
from contextlib import closing, suppress
from functools import cache
from pathlib import Path
from random import Random
from typing import Any

import cv2
import numpy as np

from ratslam_ros.core.common.odometry import MotionFromOdometry
from ratslam_ros.core.common.scan import points_of
from ratslam_ros.core.mapping.map_changes import MapMirror
from ratslam_ros.errors import RatslamError, UnusableInput
from ratslam_ros.event_inputs import odometry_from_event, scan_from_event
from ratslam_ros.files.config import load_config
from ratslam_ros.history.file import HISTORY, HistoryMeta
from ratslam_ros.history.history_run import HistoryRun
from ratslam_ros.images import EncodedImage
from ratslam_ros.maps import MapMeta, read_map, save_map
from ratslam_ros.maps.chunks import Compressor
from ratslam_ros.messages.commands import PassedItem
from ratslam_ros.messages.goals import BehaviourReport, GoalRequest, GoalStatus, NameRequest
from ratslam_ros.messages.json_schema import Payload, decode
from ratslam_ros.messages.map_changes import ClosurePayload, MapChangePayload
from ratslam_ros.messages.map_commands import MapCommand, MapRequest, MapResult, MapStatus
from ratslam_ros.messages.mapping import (
    ActionPayload,
    Correction,
    RelocationPayload,
    TemplatePayload,
)
from ratslam_ros.messages.pose_cells import PacketsPayload
from ratslam_ros.recordings import ImageEvent, OdometryEvent, ScanEvent, Selection, open_recording
from ratslam_ros.recordings.decode import UndecodableMessage, decode_event
from ratslam_ros.recordings.stream import Channel, Message
from ratslam_ros.results.trajectory import read_tum
from ratslam_simulator.floor_plan import load_floor_plan

ROOT = Path(__file__).resolve().parents[1]
sys.path += [str(ROOT / 'test'), str(ROOT / 'test/recordings')]

import fabricate  # noqa: E402 - in these folders

Target = Callable[[bytes, Path], None]

KINDS = (
    'sensor_msgs/msg/Image', 'sensor_msgs/msg/CompressedImage', 'nav_msgs/msg/Odometry',
    'sensor_msgs/msg/LaserScan', 'std_msgs/msg/String',
)
PAYLOADS: tuple[type[Payload], ...] = (
    TemplatePayload, ActionPayload, RelocationPayload, MapChangePayload, ClosurePayload,
    PacketsPayload, GoalRequest, NameRequest, GoalStatus, BehaviourReport, Correction, MapRequest,
    MapCommand, MapResult, MapStatus, PassedItem,
)
FORMATS = '.mcap', '.db3', '.bag', '.csv', '.mcap.zstd'
MAX_EVENTS = 50
STAMP_NS = 1_700_000_000_000_000_000


def messages(data: bytes, folder: Path) -> None:
    """Decode a message of ROS 2 or ROS 1, and convert it to an input of RatSLAM.

    The first byte selects the type.
    """
    kind, encoding = KINDS[data[0] % len(KINDS)], 'cdr' if data[0] < 128 else 'ros1'
    with suppress(UndecodableMessage):
        _use(decode_event(Message(STAMP_NS, Channel('/topic', kind, encoding), data[1:])))


def payloads(data: bytes, folder: Path) -> None:
    """Decode a JSON payload. The first byte selects the topic."""
    decoded = decode(PAYLOADS[data[0] % len(PAYLOADS)], data[1:].decode(errors='replace'))
    if isinstance(decoded, MapChangePayload):
        mirror = MapMirror()
        mirror.apply(decoded.change)
        assert len(mirror.links) == mirror.link_count


def images(data: bytes, folder: Path) -> None:
    """Decode a compressed image."""
    image = EncodedImage(data, 'jpeg')
    image.grey()
    image.bgr()


def history(data: bytes, folder: Path) -> None:
    """Read a history.

    The first byte selects whether the rest is the file, a segment or a checkpoint, which a fuzzer
    could not compress itself.
    """
    path = folder / 'history.sqlite'
    kind, content = data[0] % 3, data[1:]
    if kind:
        content = _history_of(content, b'') if kind == 1 else _history_of(b'\x90', content)
    path.write_bytes(content)
    run = HistoryRun(path)
    try:
        state = run.seek(run.begin_ns)
        run.advance(state, run.end_ns)
        run.visits(0, run.end_ns)
        run.step(run.begin_ns, 1)
        run.view_at(run.end_ns)
        run.image_at(run.end_ns)
    finally:
        run.close()


def maps(data: bytes, folder: Path) -> None:
    """Read a map file.

    The first byte selects whether the rest is the file or the outline of a state, which a fuzzer
    could not compress itself.
    """
    path = folder / 'home.map'
    if data[0] % 2 == 0:
        path.write_bytes(data[1:])
    else:
        path.write_bytes(_map_of(data[1:]))
    read_map(path)


def recordings(data: bytes, folder: Path) -> None:
    """Read a recording. The first byte selects the suffix of the file."""
    path = folder / f'recording{FORMATS[data[0] % len(FORMATS)]}'
    path.write_bytes(data[1:])
    with closing(open_recording(path)) as recording:
        recording.count()
        by_type = {topic.type: topic.name for topic in recording.topics if topic.problem is None}
        image = by_type.get(KINDS[1]) or by_type.get(KINDS[0])
        selection = Selection(
            image, by_type.get(KINDS[2]), by_type.get(KINDS[4]), by_type.get(KINDS[3])
        )
        recording.calibration(selection)
        for number, event in enumerate(recording.events(selection)):
            with suppress(RatslamError):
                _use(event)
            if number == MAX_EVENTS:
                break


def configuration(data: bytes, folder: Path) -> None:
    """Read a configuration. The first byte selects YAML or INI."""
    path = folder / ('config.yaml' if data[0] % 2 == 0 else 'config.ini')
    path.write_bytes(data[1:])
    load_config(str(path))


def floor_plan(data: bytes, folder: Path) -> None:
    """Read a floor plan. The first byte selects a text or a picture."""
    path = folder / ('plan.txt' if data[0] % 2 == 0 else 'plan.png')
    path.write_bytes(data[1:])
    load_floor_plan(path, 0.25, {'A': (0.5, 0.5)} if data[0] & 2 else None)


def trajectory(data: bytes, folder: Path) -> None:
    """Read a TUM file."""
    path = folder / 'truth.tum'
    path.write_bytes(data)
    read_tum(path)


TARGETS: dict[str, Target] = {
    target.__name__: target
    for target in (
        messages, payloads, images, history, maps, recordings, configuration, floor_plan,
        trajectory,
    )
}


def _use(event: Any) -> None:
    """Convert an event as the nodes do."""
    if isinstance(event, ImageEvent):
        event.image.grey()
        event.image.bgr()
    elif isinstance(event, OdometryEvent):
        odometry = odometry_from_event(event)
        for source in ('twist', 'pose'):
            motion = MotionFromOdometry(source)
            if motion.accepts(odometry):
                motion.update(odometry)
                motion.update(odometry)
    elif isinstance(event, ScanEvent):
        points_of(scan_from_event(event))
    else:
        decode(TemplatePayload, event.payload)


def _history_of(segment: bytes, checkpoint: bytes) -> bytes:
    """Return a history file with a segment, or a checkpoint if it is not empty."""
    pack = Compressor().compressed
    with closing(sqlite3.connect(':memory:')) as database:
        database.execute('PRAGMA page_size = 512')
        database.execute(f'PRAGMA application_id = {HISTORY.application_id}')
        database.execute(f'PRAGMA user_version = {HISTORY.version}')
        database.executescript(HISTORY.schema)
        database.execute(
            'INSERT INTO meta VALUES (?, ?)', ('run', HistoryMeta('a drive').to_json())
        )
        database.execute("INSERT INTO meta VALUES ('ended', '1')")
        database.execute(
            'INSERT INTO segments VALUES (0, 0, ?, ?)', (2**40, pack(segment))
        )
        if checkpoint:
            database.execute('INSERT INTO checkpoints VALUES (0, 0, ?)', (pack(checkpoint),))
        # A list of one record, which may be a view.
        if segment[:1] == b'\x91':
            database.execute('INSERT INTO visits VALUES (0, 0, 0, ?)', (segment[1:],))
        database.commit()
        return database.serialize()


@cache
def _empty_map() -> bytes:
    """Return a map file with one part, whose outline is in one chunk."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / 'home.map'
        state = {'core': {'templates': np.zeros((2, 1, 3), np.uint8)}}
        save_map(path, {'local_view': state}, MapMeta())
        data = bytearray(path.read_bytes())
    data[18:20] = b'\1\1'  # Databases in memory cannot have a write-ahead log.
    return bytes(data)


def _map_of(outline: bytes) -> bytes:
    """Return a map file with another outline."""
    with closing(sqlite3.connect(':memory:')) as database:
        database.deserialize(_empty_map())
        data = Compressor().compressed(outline)
        database.execute("UPDATE chunks SET data = ? WHERE array = ''", (data,))
        database.execute('UPDATE cuts SET outline_bytes = ?', (len(outline),))
        database.commit()
        return database.serialize()


# Seeds


def seeds(name: str) -> Iterator[bytes]:
    """Yield valid inputs of a target."""
    yield from _SEEDS[name]()
    for path in sorted((ROOT / 'test' / 'data' / 'fuzz' / name).glob('*')):
        yield path.read_bytes()


def _recorded(store: Any) -> list[tuple[int, str, str, Any]]:
    """Return a message of every kind of ROS 1 or 2, as in a recording."""
    pixels = np.arange(48, dtype=np.uint8).reshape(6, 8)
    made = [
        fabricate.raw_image(pixels, store=store),
        fabricate.compressed_image(pixels, store=store, form='png'),
        fabricate.odometry(store=store), fabricate.laser_scan(store=store),
        store.types[KINDS[4]](next(_payloads())[1:].decode()),
    ]
    return [
        (STAMP_NS + number, f'/t{number}', kind, message)
        for number, (kind, message) in enumerate(zip(KINDS, made, strict=True))
    ]


def _messages() -> Iterator[bytes]:
    for number, (_, _, kind, message) in enumerate(_recorded(fabricate.ROS2)):
        yield bytes([number]) + fabricate.ROS2.serialize_cdr(message, kind)
    for number, (_, _, kind, message) in enumerate(_recorded(fabricate.ROS1)):
        first = 128 + -128 % len(KINDS)
        yield bytes([first + number]) + fabricate.ROS1.serialize_ros1(message, kind)


def _payloads() -> Iterator[bytes]:
    page = (ROOT / 'docs' / 'topics.md').read_text(encoding='utf-8')
    for text in re.findall(r'```json\n(.*?)\n```', page):
        for number, kind in enumerate(PAYLOADS):
            with suppress(UnusableInput):
                decode(kind, text)
                yield bytes([number]) + text.encode()


def _images() -> Iterator[bytes]:
    pixels = np.random.default_rng(1).integers(0, 256, (6, 8, 3), dtype=np.uint8)
    for suffix in ('.png', '.jpg', '.bmp', '.ppm', '.tiff', '.webp', '.jp2'):
        with suppress(cv2.error):  # OpenCV may have been built without one of them.
            is_written, data = cv2.imencode(suffix, pixels)
            if is_written:
                yield data.tobytes()


def _history() -> Iterator[bytes]:
    from ratslam_ros.core.common.pose import Pose
    from ratslam_ros.core.mapping.map_changes import MapChange
    from ratslam_ros.core.pose_cells.torus import Place
    from ratslam_ros.history import records
    from ratslam_ros.history.encoding import encode
    from ratslam_ros.history.run_state import RunState

    message = mapping_change()
    view = records.ViewRecord(
        2, 3, True, 0.1, 0.2, 0.0, 'create', 0, 1, Place(1.0, 2.0, 3.0), -1, 0.0, 'why', -1
    )
    made: list[Any] = [
        message, view, records.PoseRecord(3, Pose(1.0, 2.0, 0.5), None, None),
        records.ScanRecord(4, np.ones((3, 2))), records.RouteRecord(5, np.ones((2, 2))),
        records.StatusRecord(6, '{}'), records.ImageRecord(7, next(_images())),
    ]
    assert isinstance(message, MapChange)
    data = encode(made)
    state = RunState()
    for record in made:
        state.apply(record)
    yield b'\1' + data
    yield b'\1' + encode([view])
    yield b'\2' + encode(state)
    yield b'\0' + _history_of(data, encode(state))


def mapping_change() -> Any:
    """Return the change of the map of the example in docs/topics.md."""
    for data in _payloads():
        if PAYLOADS[data[0]] is MapChangePayload:
            return decode(MapChangePayload, data[1:].decode()).change
    raise AssertionError('docs/topics.md has no example of experience_map/changes')


def _recordings() -> Iterator[bytes]:
    import zstandard
    from mcap.writer import CompressionType, Writer

    found = _recorded(fabricate.ROS2)
    for compression in (CompressionType.NONE, CompressionType.ZSTD, CompressionType.LZ4):
        packed = io.BytesIO()
        writer = Writer(packed, chunk_size=500, compression=compression)
        writer.start('ros2', 'fuzz')
        for log_ns, topic, kind, message in found:
            schema = writer.register_schema(kind, 'ros2msg', b'')
            channel = writer.register_channel(topic, 'cdr', schema)
            data = bytes(fabricate.ROS2.serialize_cdr(message, kind))
            writer.add_message(channel, log_ns, data, log_ns)
        writer.finish()
        yield b'\0' + packed.getvalue()
    yield b'\4' + zstandard.compress(packed.getvalue())
    with tempfile.TemporaryDirectory() as folder:
        path = fabricate.write_sqlite(Path(folder) / 'a.db3', found, schema=2)
        with closing(sqlite3.connect(path)) as database:
            database.executescript('PRAGMA page_size = 512; VACUUM')
        yield b'\1' + path.read_bytes()
        for form in ('none', 'lz4', 'bz2'):
            path = Path(folder) / f'{form}.bag'
            fabricate.write_rosbag1(path, _recorded(fabricate.ROS1), form)
            yield b'\2' + path.read_bytes()
    yield b'\3image,stamp_s,linear_x_mps,angular_z_radps\n,1.5,0.5,0.1\nrecording.csv,2.5,,\n'


def _configuration() -> Iterator[bytes]:
    for preset in ('default', 'navigation', 'openratslam'):
        yield b'\0' + (ROOT / 'config' / f'{preset}.yaml').read_bytes()
    yield b'\0/**:\n  ros__parameters:\n    exp_max: 100\nlocal_view: {vt_max: 50}\n'
    yield b'\1vt_match_threshold=0.1 # comment\n[exp]\nexp_loops=20\n'


def _floor_plan() -> Iterator[bytes]:
    yield b'\0cell_m: 0.5\nname: a room\n#####\n#A.B#\n#####\n'
    pixels = np.zeros((5, 5), np.uint8)
    pixels[1:4, 1:4] = 255
    yield b'\3' + cv2.imencode('.png', pixels)[1].tobytes()


def _maps() -> Iterator[bytes]:
    yield b'\0' + _empty_map()
    yield b'\1{"core":{"templates":{"$array":["|u1",[2,1,3]]}}}'


def _trajectory() -> Iterator[bytes]:
    yield b'# t x y z qx qy qz qw\n1.5 0 0 0 0 0 0 1\n1.6 0.5 0.1 0 0 0 0.5 0.866\n'


_SEEDS: dict[str, Callable[[], Iterator[bytes]]] = {
    'messages': _messages, 'payloads': _payloads, 'images': _images,
    'history': _history, 'recordings': _recordings, 'configuration': _configuration,
    'maps': _maps, 'floor_plan': _floor_plan, 'trajectory': _trajectory,
}
"""Valid inputs of each target."""

VALUES: tuple[Any, ...] = (
    None, True, -1, 0, 1, 2**31, 2**53, 2**63, -(2**64), 10**30, 0.5, -1e300, 1e308, '', 'a',
    'a' * 2000, '\ud800', '\n\x1b[31m', [], {}, [[]], [None], [{}], [1, 2, 3], {'sec': 1},
)
"""Values that replace one in a JSON text."""


def mutated_json(data: bytes, seed: int) -> bytes | None:
    """Return data whose JSON text, after the first byte, has another value somewhere.

    None if it is no JSON text with a value in it.
    """
    random = Random(seed)
    try:
        content = json.loads(data[1:])
    except (ValueError, RecursionError):
        return None
    places: list[tuple[Any, Any]] = []
    waiting = [content]
    while waiting and len(places) < 1000:
        value = waiting.pop()
        keys = value if isinstance(value, dict) else range(len(value)) if (
            isinstance(value, list)
        ) else ()
        places += [(value, key) for key in keys]
        waiting += [value[key] for key in keys]
    if not places:
        return None
    for _ in range(random.randint(1, 3)):
        container, key = random.choice(places)
        if random.random() < 0.1 and isinstance(container, list):
            container.append(random.choice(container))
        elif random.random() < 0.1 and isinstance(container, dict):
            container.pop(key, None)
        else:
            others = random.uniform(-10.0, 10.0), random.randint(0, 99)
            container[key] = random.choice((*VALUES, *others))
    return data[:1] + json.dumps(content).encode()


DICTIONARY = (
    b'NaN', b'Infinity', b'-1', b'1e999', b'9' * 30, b'null', b'true', b'[]', b'{}', b'\\ud800',
    struct.pack('<I', 2**32 - 1), struct.pack('<Q', 2**63), struct.pack('<d', np.nan),
    struct.pack('<f', np.inf), b'&a', b'*a', b'<<:', b'../', b'zstd', b'lz4', b'bz2',
)
"""Words that a fuzzer should insert."""
