# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Tests that the readable part of truncated and damaged files is used, with a warning."""

import random
import re
import sqlite3
from contextlib import suppress

import pytest
from fabricate import ROS1, drive, write_mcap, write_rosbag1, write_sqlite
from helpers import START_NS, write_bag

from ratslam_ros.errors import RatslamError, UnusableInput
from ratslam_ros.recordings import ImageEvent, describe, open_recording

FRAMES = 100
FORMATS = {
    'mcap': lambda path: write_mcap(path / 'r.mcap', drive(FRAMES)),
    'mcap, lz4': lambda path: write_mcap(path / 'r.mcap', drive(FRAMES), 'lz4'),
    'mcap, plain': lambda path: write_mcap(path / 'r.mcap', drive(FRAMES), 'none'),
    'mcap, no chunks': lambda path: write_mcap(path / 'r.mcap', drive(FRAMES), chunked=False),
    'db3': lambda path: write_sqlite(path / 'r.db3', drive(FRAMES)),
    'db3, no index': lambda path: write_sqlite(path / 'r.db3', drive(FRAMES), index=False),
    'ROS 1': lambda path: write_rosbag1(path / 'r.bag', drive(FRAMES, ROS1)),
    'ROS 1, lz4': lambda path: write_rosbag1(path / 'r.bag', drive(FRAMES, ROS1), 'lz4'),
    'ROS 1, bz2': lambda path: write_rosbag1(path / 'r.bag', drive(FRAMES, ROS1), 'bz2'),
}
every_format = pytest.mark.parametrize('write', FORMATS.values(), ids=FORMATS)


def read(path):
    """Read a complete recording as a replay does; return its events and warnings."""
    with open_recording(path) as recording:
        events = list(recording.events(recording.select()))
        for event in events:
            if isinstance(event, ImageEvent):
                with suppress(RatslamError):
                    event.grey()
        return events, list(recording.warnings)


@every_format
def test_truncated_file_yields_the_remaining_messages(tmp_path, write):
    path = write(tmp_path)
    whole = path.read_bytes()
    path.write_bytes(whole[:len(whole) // 2])
    events, warnings = read(path)
    assert 40 < len(events) < 160
    assert [event.log_ns for event in events] == sorted(event.log_ns for event in events)
    warning = next(text for text in warnings if 'is truncated: read ' in text)
    # The numbers in the warning match the events.
    number, seconds = re.search(r'read (\d+) .*up to ([\d.]+) s$', warning).groups()
    assert int(number) == len(events)
    last_s = (events[-1].log_ns - START_NS) / 1e9
    assert float(seconds) == pytest.approx(last_s, abs=0.06)


@pytest.mark.parametrize('storage', ['mcap', 'sqlite3'])
def test_truncation_warning_states_the_count_from_metadata(tmp_path, storage):
    folder = write_bag(tmp_path / 'r', drive(FRAMES), storage)
    path = next(path for path in folder.iterdir() if path.suffix != '.yaml')
    path.write_bytes(path.read_bytes()[:path.stat().st_size * 2 // 3])
    for given in (folder, path):
        _, warnings = read(given)
        pattern = r'is truncated: read \d+ of about 200 messages, up to \d+\.\d s'
        assert any(re.search(pattern, text) for text in warnings)


def test_truncation_warning_estimates_the_count_from_headers(tmp_path):
    for path in (
        write_sqlite(tmp_path / 'r.db3', drive(FRAMES)),
        write_rosbag1(tmp_path / 'r.bag', drive(FRAMES, ROS1)),
    ):
        path.write_bytes(path.read_bytes()[:path.stat().st_size // 2])
        _, warnings = read(path)
        warning = next(text for text in warnings if 'of about' in text)
        about = int(re.search(r'read \d+ of about (\d+) messages', warning).group(1))
        assert 160 < about < 240


def test_mcap_without_index_is_read_completely(tmp_path):
    path = write_mcap(tmp_path / 'r.mcap', drive(FRAMES))
    whole = path.read_bytes()
    path.write_bytes(whole[:-30])
    events, warnings = read(path)
    assert len(events) == 2 * FRAMES
    assert 'has no index or a damaged one: read 200 messages, up to 9.9 s' in warnings[0]


def test_unclosed_ros1_bag_is_read_completely(tmp_path):
    path = write_rosbag1(tmp_path / 'r.bag', drive(FRAMES, ROS1))
    whole = bytearray(path.read_bytes())
    at = whole.index(b'index_pos=') + len(b'index_pos=')
    whole[at:at + 8] = bytes(8)  # The value until the recorder closes the bag.
    path.write_bytes(whole)
    events, warnings = read(path)
    assert len(events) == 2 * FRAMES
    assert warnings == ['r.bag has no index: read 200 messages, up to 9.9 s']


@every_format
def test_damage_in_the_middle_loses_few_messages(tmp_path, write):
    path = write(tmp_path)
    data = bytearray(path.read_bytes())
    middle = len(data) // 2
    data[middle:middle + 64] = random.Random(1).randbytes(64)
    path.write_bytes(data)
    events, _ = read(path)
    assert len(events) > 100


@every_format
def test_random_damage_ends_in_events_or_unusable_input(tmp_path, write):
    path = write(tmp_path)
    whole = path.read_bytes()
    rng = random.Random(0)
    for _ in range(6):
        data = bytearray(whole)
        if rng.random() < 0.4:
            del data[rng.randrange(len(data)):]
        for _ in range(rng.choice((0, 1, 3, 30))):
            if data and rng.random() < 0.25:
                del data[rng.randrange(len(data))]
            if data:
                data[rng.randrange(len(data))] ^= 1 << rng.randrange(8)
        path.write_bytes(data)
        try:
            events, warnings = read(path)
            with open_recording(path) as recording:
                assert describe(recording)
            assert len(events) <= 2 * FRAMES
        except UnusableInput as error:
            warnings = [str(error)]
        assert all('\n' not in text for text in warnings)


def test_sqlite_rows_of_wrong_type_are_skipped(tmp_path):
    path = write_sqlite(tmp_path / 'r.db3', drive(10))
    database = sqlite3.connect(path)
    database.execute("UPDATE messages SET data = 'text' WHERE id = 3")
    database.execute("UPDATE messages SET timestamp = 'noon' WHERE id = 5")
    database.commit()
    database.close()
    events, warnings = read(path)
    assert len(events) == 18
    assert warnings


def test_files_without_readable_messages_are_rejected(tmp_path):
    for path, kept in (
        (write_mcap(tmp_path / 'r.mcap', drive()), 60),
        (write_sqlite(tmp_path / 'r.db3', drive()), 4096),
        (write_rosbag1(tmp_path / 'r.bag', drive(store=ROS1)), 4200),
    ):
        path.write_bytes(path.read_bytes()[:kept])
        with pytest.raises(UnusableInput, match=r'expected .*; (copy|give|look)'):
            read(path)


@pytest.mark.parametrize(('name', 'content', 'message'), [
    ('a.bag', b'', 'is an empty file'),
    ('a.mcap', b'', 'is an empty file'),
    ('a.db3', b'no database', 'begins with'),
    ('a.bag', b'#ROSBAG V1.2\n' + bytes(40), 'expected an mcap, an SQLite or a ROS 1 bag'),
    ('a.txt', b'hello', 'no known recording format'),
    ('a.png', b'hello', 'a single image'),
    ('a.mcap.zstd', b'\x28\xb5\x2f\xfd', 'truncated or damaged'),
])
def test_files_of_other_formats_are_rejected(tmp_path, name, content, message):
    path = tmp_path / name
    path.write_bytes(content)
    with pytest.raises(UnusableInput, match=message) as error:
        open_recording(path)
    assert '\n' not in str(error.value)


def test_paths_without_recording_are_rejected(tmp_path):
    with pytest.raises(UnusableInput, match='does not exist: expected'):
        open_recording(tmp_path / 'nothing')
    with pytest.raises(UnusableInput, match='is an empty folder'):
        open_recording(tmp_path)
    write_mcap(tmp_path / 'r.mcap', [])
    with pytest.raises(UnusableInput, match='holds no messages'):
        open_recording(tmp_path)
    (tmp_path / 'r.mcap').unlink()
    (tmp_path / 'inside').mkdir()
    write_mcap(tmp_path / 'inside' / 'r.mcap', drive(2))
    with pytest.raises(UnusableInput, match=r'give one of .*inside'):
        open_recording(tmp_path)
    (tmp_path / 'metadata.yaml').write_text('{}')
    with pytest.raises(UnusableInput, match='no file with messages'):
        open_recording(tmp_path)
    database = sqlite3.connect(tmp_path / 'other.sqlite')
    database.execute('CREATE TABLE notes(id INTEGER)')
    database.commit()
    database.close()
    with pytest.raises(UnusableInput, match=r"the tables \['notes'\]"):
        open_recording(tmp_path / 'other.sqlite')
