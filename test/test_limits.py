# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Inputs from others are refused before they cost memory or time, and never run code.

docs/security.md lists every input with its limit and the test here that proves it.
"""

from __future__ import annotations

import ast
import bz2
import json
import os
import re
import sqlite3
import subprocess
import sys
from collections.abc import Callable
from contextlib import closing
from pathlib import Path
from typing import Any

import cv2
import lz4.frame
import numpy as np
import pytest
import zstandard

from ratslam_ros.errors import UnusableInput
from ratslam_ros.files.config import load_config
from ratslam_ros.history.file import HISTORY, HistoryMeta
from ratslam_ros.history.history_run import HistoryRun
from ratslam_ros.history.recorded_images import encoded_jpeg
from ratslam_ros.images import EncodedImage, UndecodableImage
from ratslam_ros.limits import MAX_CHUNK_BYTES, MAX_PIXELS, MAX_YAML_DEPTH, is_below
from ratslam_ros.maps.reader import read_map
from ratslam_ros.maps.schema import MAP, Layout
from ratslam_ros.messages.goals import MAX_GOALS, GoalRequest, GoalStatus, NameRequest
from ratslam_ros.messages.json_schema import MAX_PAYLOAD_CHARACTERS, MalformedMessage, decode
from ratslam_ros.messages.mapping import TemplatePayload
from ratslam_ros.recordings import open_recording, rosbag2, salvage
from ratslam_ros.recordings.decode import UndecodableMessage, template_event
from ratslam_ros.recordings.decode import decode as decode_message
from ratslam_ros.recordings.rosbag2 import METADATA, _read_metadata
from ratslam_ros.recordings.salvage import decompress
from ratslam_ros.recordings.stream import Channel, Message, Warnings
from ratslam_ros.results.trajectory import read_tum
from ratslam_simulator import floor_plan

ROOT = Path(__file__).parents[1]
ZEROS = bytes(2**24)


# Code


def test_nothing_unpickles_or_evaluates_inputs() -> None:
    forbidden = {'pickle', 'cPickle', '_pickle', 'marshal', 'shelve', 'dill', 'joblib'}
    permitted = {
        # Writes message classes from the project's own definitions; see the module.
        'rclpy_standin/types.py': {'exec'},
        # Weights of an installed package, and pairs of VPR-Bench, by an unpickler that imports
        # nothing and calls only what it is given; see test_tensors.py and test_lap_benchmarks.py.
        'ratslam_ros/descriptors/tensors.py': {'pickle'},
    }
    suspicious = '|'.join((
        *forbidden, r'\beval\b', r'\bexec\b', 'enable_load_extension', 'unsafe_load',
        'UnsafeLoader', 'full_load', 'FullLoader',
    ))
    for folder in (
        'ratslam_ros', 'ratslam_simulator', 'ratslam_tuning', 'rclpy_standin', 'tools',
        'benchmarks', 'examples',
        'launch',
    ):
        for path in sorted((ROOT / folder).rglob('*.py')):
            name = path.relative_to(ROOT).as_posix()
            found: set[str] = set()
            text = path.read_text(encoding='utf-8')
            if not re.search(suspicious, text):  # Most files need not be parsed.
                continue
            for node in ast.walk(ast.parse(text)):
                if isinstance(node, ast.Import):
                    found |= forbidden & {alias.name.split('.')[0] for alias in node.names}
                elif isinstance(node, ast.ImportFrom):
                    found |= forbidden & {str(node.module).split('.')[0]}
                elif isinstance(node, ast.Call):
                    called = node.func
                    if isinstance(called, ast.Name):
                        found |= {'eval', 'exec'} & {called.id}
                    found |= {
                        'allow_pickle' for keyword in node.keywords
                        if keyword.arg == 'allow_pickle'
                        and not (isinstance(keyword.value, ast.Constant)
                                 and keyword.value.value is False)
                    }
                elif isinstance(node, ast.Attribute):
                    found |= {'enable_load_extension', 'unsafe_load', 'UnsafeLoader',
                              'full_load', 'FullLoader'} & {node.attr}
            assert found <= permitted.get(name, set()), name


# Images


def test_image_size_is_checked_before_memory_is_used() -> None:
    program = """
import ratslam_ros, resource, struct, zlib
from ratslam_ros.images import EncodedImage, UndecodableImage
from ratslam_ros.limits import MAX_PIXELS

def chunk(kind, data):
    return struct.pack('>I', len(data)) + kind + data + struct.pack(
        '>I', zlib.crc32(kind + data))

def png(width, height):
    rows = zlib.compress(bytes((width + 1) * min(height, 500)))
    head = struct.pack('>IIBBBBB', width, height, 8, 0, 0, 0, 0)
    parts = chunk(b'IHDR', head) + chunk(b'IDAT', rows) + chunk(b'IEND', b'')
    return b'\\x89PNG\\r\\n\\x1a\\n' + parts

EncodedImage(png(64, 48)).grey()
before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
try:
    EncodedImage(png(2**14, MAX_PIXELS // 2**14 + 1)).grey()
except UndecodableImage as error:
    print(error)
print(resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before)
"""
    done = subprocess.run(
        [sys.executable, '-c', program], capture_output=True, text=True, check=True
    )
    reason, grown_kib = done.stdout.splitlines()
    assert 'OpenCV refuses the image' in reason
    assert int(grown_kib) < 2**14  # 1/4 of the picture


def test_png_with_chunk_beyond_its_end_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    data = bytearray(cv2.imencode('.png', np.zeros((6, 8), np.uint8))[1].tobytes())
    assert EncodedImage(bytes(data)).grey().shape == (6, 8)
    at = data.index(b'IDAT') - 4
    data[at : at + 4] = b'\xff' * 4
    monkeypatch.delattr(cv2, 'imdecode')  # It would allocate 4 GB.
    with pytest.raises(UndecodableImage, match='not a complete JPEG'):
        EncodedImage(bytes(data)).grey()


@pytest.mark.parametrize('data', [b'GIF89a' + bytes(30), b'\0\0\0\x1cftypavif' + bytes(30)])
def test_unusual_image_format_is_refused(data: bytes) -> None:
    with pytest.raises(UndecodableImage, match='not a complete JPEG'):
        EncodedImage(data).grey()


@pytest.mark.parametrize('suffix', ['.png', '.jpg', '.bmp', '.pgm', '.tiff', '.webp'])
def test_usual_image_format_is_decoded(suffix: str) -> None:
    data = cv2.imencode(suffix, np.full((6, 8), 100, np.uint8))[1]
    assert EncodedImage(data).grey().shape == (6, 8)


def test_image_too_tall_for_jpeg_is_refused() -> None:
    with pytest.raises(UndecodableImage, match='cannot be written as JPEG'):
        encoded_jpeg(np.zeros((65_501, 2), np.uint8), 640, 80)


# Recordings


PACKERS: dict[str, Callable[[bytes], bytes]] = {
    'zstd': zstandard.compress, 'lz4': lz4.frame.compress, 'bz2': bz2.compress,
}


@pytest.mark.parametrize('compression', sorted(PACKERS))
def test_chunk_is_decompressed_up_to_its_stated_size(compression: str) -> None:
    packed = PACKERS[compression](ZEROS)
    assert len(packed) < 2**17
    assert decompress(packed, compression, len(ZEROS)) == (ZEROS, True)
    plain, is_whole = decompress(packed, compression, 1000)
    assert (plain, is_whole) == (bytes(1000), False)
    assert decompress(packed, compression, MAX_CHUNK_BYTES + 1) == (b'', False)


def test_chunk_of_unknown_size_is_limited(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(salvage, 'MAX_CHUNK_BYTES', 2**20)
    for compression, pack in PACKERS.items():
        plain, is_whole = decompress(pack(ZEROS), compression)
        assert (len(plain), is_whole) == (2**20, False)


@pytest.mark.parametrize('with_size', [True, False])
def test_compressed_message_is_limited(monkeypatch: pytest.MonkeyPatch, with_size: bool) -> None:
    monkeypatch.setattr(salvage, 'MAX_MESSAGE_BYTES', 2**20)
    packed = zstandard.ZstdCompressor(write_content_size=with_size).compress(ZEROS)
    message = Message(0, Channel('/a', 'std_msgs/msg/String', 'cdr'), packed)
    with pytest.raises(UndecodableMessage, match='expected at most 1048576'):
        decode_message(message)


def test_compressed_recording_may_not_fill_the_disk(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(rosbag2, '_SMALL_BYTES', 2**20)
    path = tmp_path / 'drive.mcap.zstd'
    path.write_bytes(zstandard.compress(ZEROS))
    with pytest.raises(UnusableInput, match='1000 times its size'):
        open_recording(path)


@pytest.mark.parametrize('topics', [
    'CREATE VIEW topics AS SELECT 1 AS id, 2 AS name, 3 AS type, 4 AS serialization_format',
    'CREATE TABLE topics (id INTEGER, name TEXT, type TEXT, serialization_format TEXT '
    'GENERATED ALWAYS AS (hex(zeroblob(100))))',
    'CREATE VIRTUAL TABLE topics USING fts5(id, name, type, serialization_format)',
])
def test_recording_database_that_computes_is_refused(tmp_path: Path, topics: str) -> None:
    path = tmp_path / 'drive.db3'
    with closing(sqlite3.connect(path)) as database:
        database.executescript(
            f'{topics}; CREATE TABLE messages (id INTEGER PRIMARY KEY, topic_id INTEGER, '
            'timestamp INTEGER, data BLOB);'
        )
    with pytest.raises(UnusableInput, match='expected'):
        open_recording(path)


def test_stamp_of_recorded_json_is_in_range() -> None:
    huge = '{"stamp":{"sec":' + '9' * 4000 + ',"nanosec":0}}'
    assert template_event(huge, 7).stamp_ns == 7


@pytest.mark.parametrize('text', [
    'a: &a [1, 1]\nb: &b [*a, *a]\nrosbag2_bagfile_information: *b\n', '[' * 100_000,
])
def test_bomb_in_metadata_is_reported_as_damage(tmp_path: Path, text: str) -> None:
    (tmp_path / METADATA).write_text(text)
    warnings = Warnings()
    assert _read_metadata(tmp_path, warnings).names == []
    assert 'is damaged' in warnings.texts[0]


# Paths


@pytest.mark.parametrize('path', [
    '/etc', '..', '{0}/../other', '{0}/link/other', '{0}-other', '{0}/a\n', '~',
])
def test_received_path_stays_below_folder(tmp_path: Path, path: str) -> None:
    folder = tmp_path / 'maps'
    folder.mkdir()
    (folder / 'link').symlink_to(tmp_path)
    assert not is_below(path.format(folder), str(folder))
    assert is_below(f'{folder}/home', str(folder)) and is_below(str(folder), str(folder))


# Histories


@pytest.mark.parametrize('change', [
    'DROP TABLE visits; CREATE VIEW visits AS SELECT 1 AS experience, 2 AS number, 3 AS stamp_ns, '
    '4 AS record',
    'DROP TABLE visits',
    'DROP TABLE segments; CREATE TABLE segments (first_record INTEGER PRIMARY KEY, '
    'begin_ns, end_ns, data BLOB GENERATED ALWAYS AS (zeroblob(1e9)))',
])
def test_history_with_other_tables_is_refused(tmp_path: Path, change: str) -> None:
    path = tmp_path / 'history.sqlite'
    with closing(sqlite3.connect(path)) as database:
        database.executescript(HISTORY.schema)
        database.execute(f'PRAGMA application_id = {HISTORY.application_id}')
        database.execute(f'PRAGMA user_version = {HISTORY.version}')
        database.execute('INSERT INTO meta VALUES (?, ?)', ('run', HistoryMeta('a').to_json()))
        database.commit()
        HistoryRun(path).close()
        database.executescript(change)
    with pytest.raises(UnusableInput, match='its tables are not those of history format'):
        HistoryRun(path)


@pytest.mark.parametrize(('name', 'layout', 'read'), [
    ('history.sqlite', HISTORY, HistoryRun), ('bag.db3', MAP, open_recording),
    ('home.map', MAP, read_map),
])
def test_schema_that_claims_endless_rows_is_refused(
    tmp_path: Path, name: str, layout: Layout, read: Callable[[Path], object]
) -> None:
    """SQLite fails to allocate the memory for them."""
    path = tmp_path / name
    with closing(sqlite3.connect(path)) as database:
        database.execute('PRAGMA page_size = 512')
        database.execute(f'PRAGMA application_id = {layout.application_id}')
        database.execute(f'PRAGMA user_version = {layout.version}')
        database.execute('CREATE TABLE messages (number)')
    data = bytearray(path.read_bytes())
    begin = int.from_bytes(data[108:110], 'big')  # of the first row, with its length in front
    data[begin : begin + 11] = b'\xff' * 9 + b'\0E'
    path.write_bytes(data)
    with pytest.raises(UnusableInput, match=name) as caught:
        read(path)
    assert '\n' not in str(caught.value)


# Configurations, plans, trajectories


@pytest.mark.parametrize(('text', 'reason'), [
    ('local_view: &a {vt_max: 50}\npose_cells: *a\n', 'has the alias'),
    ('a: ' + '[' * 100_000, 'cannot be read'),
    ('a: ' + '[' * (MAX_YAML_DEPTH + 1) + ']' * (MAX_YAML_DEPTH + 1), 'levels deep'),
    ('#' * 2**20 + '\n', 'more than 1048576 bytes'),
    ('local_view: !!python/object/apply:os.system ["true"]', 'cannot be read'),
    ('local_view: {vt_max: .nan}', 'vt_max'),
])
def test_hostile_configuration_is_refused(tmp_path: Path, text: str, reason: str) -> None:
    path = tmp_path / 'config.yaml'
    path.write_text(text)
    with pytest.raises(Exception, match=reason) as caught:
        load_config(str(path))
    assert type(caught.value).__name__ in ('UnusableInput', 'UnusableParameter')


def test_floor_plan_of_too_many_cells_is_refused(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = tmp_path / 'plan.txt'
    path.write_text('cell_m: 0.5\n' + '####\n' * 5)
    floor_plan.load_floor_plan(path)
    monkeypatch.setattr(floor_plan, 'MAX_CELLS', 19)
    with pytest.raises(UnusableInput, match='at most 19 cells'):
        floor_plan.load_floor_plan(path)


def test_trajectory_with_endless_line_is_refused(tmp_path: Path) -> None:
    path = tmp_path / 'truth.tum'
    path.write_text('0' * 10_001)
    with pytest.raises(UnusableInput, match='longer than 10000'):
        read_tum(path)
    path.write_text('1 1e300 0 0 0 0 0 1\n')
    with pytest.raises(UnusableInput, match='farther than'):
        read_tum(path)


# Messages


@pytest.mark.parametrize(('payload', 'reason'), [
    ('{"name":"\\ud800"}', 'not JSON'),
    ('{"name":"a\\u001b[31m"}', 'printable'),
    (json.dumps({'name': 'a' * 101}), '<= 100'),
    (json.dumps({'goals': [{'name': 'a'}] * (MAX_GOALS + 1)}), '<= 1000'),
    ('{"x_m":1e12,"y_m":0}', 'x_m is 1000000000000.0'),
    ('"' + 'a' * MAX_PAYLOAD_CHARACTERS + '"', 'characters; expected at most'),
    ('[' * 100_000, 'expected `object`'), ('{"a":' + '[' * 100_000, 'unknown field'),
    ('{"x_m":' + '9' * 5000 + ',"y_m":0}', 'out of range'),
])
def test_hostile_goal_is_refused_in_short(payload: str, reason: str) -> None:
    with pytest.raises(MalformedMessage, match=reason) as caught:
        decode(GoalRequest, payload)
    assert len(str(caught.value)) < 400


def test_hostile_name_and_template_are_refused() -> None:
    with pytest.raises(MalformedMessage, match='rename_to'):
        decode(NameRequest, '{"name":"a","rename_to":"\\n"}')
    with pytest.raises(MalformedMessage, match='expected `object`') as caught:
        decode(TemplatePayload, json.dumps({'schema_version': 1, 'stamp': 'a' * 100_000}))
    assert len(str(caught.value)) < 300


@pytest.mark.parametrize(('key', 'value'), [
    ('queue', [1]), ('queue', [{'number': 'a'}]), ('outcomes', [[]]), ('neighbours', [{'id': 1}]),
    ('goal', 5), ('goal', {'x_m': 'a', 'y_m': 1.0}), ('remaining_s', 'soon'), ('behaviour', 5),
])
def test_status_with_wrong_content_is_refused(key: str, value: Any) -> None:
    fields: dict[str, Any] = {
        'schema_version': 1, 'stamp': {'sec': 1, 'nanosec': 0}, 'status': 'none',
        'explore': False, 'reason': '', 'experience_id': 0, 'neighbours': [], 'replanned': 0,
        'switched': 0, 'queue': [], 'outcomes': [],
    }
    decode(GoalStatus, json.dumps(fields))
    with pytest.raises(MalformedMessage, match='expected'):
        decode(GoalStatus, json.dumps({**fields, key: value}))


def test_limit_of_images_is_that_of_opencv() -> None:
    assert int(os.environ['OPENCV_IO_MAX_IMAGE_PIXELS']) == MAX_PIXELS
