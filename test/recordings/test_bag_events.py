# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Tests that bags of every format yield the same events."""

import os
import sqlite3
from pathlib import Path

import numpy as np
import pytest
import zstandard
from fabricate import (
    COMPRESSED,
    IMAGE,
    ODOMETRY,
    ROS1,
    STRING,
    compressed_image,
    drive,
    odometry,
    raw_image,
    write_mcap,
    write_rosbag1,
    write_sqlite,
)
from helpers import PERIOD_NS, START_NS, picture, string_message, template_text, write_bag

from ratslam_ros.errors import UnusableInput
from ratslam_ros.recordings import (
    ImageEvent,
    OdometryEvent,
    Selection,
    TemplateEvent,
    open_recording,
)


def compress(path: Path) -> Path:
    packed = path.with_name(path.name + '.zstd')
    packed.write_bytes(zstandard.compress(path.read_bytes()))
    path.unlink()
    return packed


WRITERS = {
    'mcap folder': lambda tmp: write_bag(tmp / 'r', drive()),
    'mcap compressed by chunk': lambda tmp: write_bag(tmp / 'r', drive(), mode='storage'),
    'mcap compressed by message': lambda tmp: write_bag(tmp / 'r', drive(), mode='message'),
    'mcap compressed by file': lambda tmp: write_bag(tmp / 'r', drive(), mode='file'),
    'sqlite3 folder': lambda tmp: write_bag(tmp / 'r', drive(), 'sqlite3'),
    'sqlite3 by message': lambda tmp: write_bag(tmp / 'r', drive(), 'sqlite3', 'message'),
    'sqlite3 by file': lambda tmp: write_bag(tmp / 'r', drive(), 'sqlite3', 'file'),
    'bare mcap, zstd': lambda tmp: write_mcap(tmp / 'r.mcap', drive()),
    'bare mcap, lz4': lambda tmp: write_mcap(tmp / 'r.mcap', drive(), 'lz4'),
    'bare mcap, no chunks': lambda tmp: write_mcap(tmp / 'r.mcap', drive(), chunked=False),
    'bare mcap, no statistics': lambda tmp: write_mcap(
        tmp / 'r.mcap', drive(), use_statistics=False),
    'bare mcap, file': lambda tmp: compress(write_mcap(tmp / 'r.mcap', drive())),
    'bare db3, schema 1': lambda tmp: write_sqlite(tmp / 'r.db3', drive()),
    'bare db3, schema 2': lambda tmp: write_sqlite(tmp / 'r.db3', drive(), 2),
    'bare db3, no index': lambda tmp: write_sqlite(tmp / 'r.db3', drive(), index=False),
    'bare db3, file': lambda tmp: compress(write_sqlite(tmp / 'r.db3', drive())),
    'ROS 1, none': lambda tmp: write_rosbag1(tmp / 'r.bag', drive(store=ROS1)),
    'ROS 1, lz4': lambda tmp: write_rosbag1(tmp / 'r.bag', drive(store=ROS1), 'lz4'),
    'ROS 1, bz2': lambda tmp: write_rosbag1(tmp / 'r.bag', drive(store=ROS1), 'bz2'),
}


@pytest.mark.parametrize('write', WRITERS.values(), ids=WRITERS)
def test_every_format_yields_the_same_events(tmp_path, write):
    path = write(tmp_path)
    before = sorted(tmp_path.rglob('*'))
    with open_recording(path) as recording:
        assert recording.name == 'r'
        assert (recording.start_ns, recording.end_ns) == (
            START_NS, START_NS + 19 * PERIOD_NS + 2_000_000)
        selection = recording.select()
        assert selection == Selection('/camera/image/compressed', '/odom', None)
        for _ in range(2):  # A recording can be read repeatedly.
            events = list(recording.events(selection))
            assert [type(event) for event in events] == [OdometryEvent, ImageEvent] * 20
            assert [event.log_ns for event in events[::2]] == [
                START_NS + index * PERIOD_NS for index in range(20)]
            assert all(e.stamp_ns - e.log_ns in (-1_000_000, -3_000_000) for e in events)
            odometry_event = events[6]
            assert (odometry_event.linear_x, odometry_event.angular_z) == (0.03, 0.1)
            assert (odometry_event.x, odometry_event.y) == (1.0, 2.0)
            assert odometry_event.heading_rad == pytest.approx(0.3)
            for index, event in enumerate(events[1::2]):
                assert np.abs(event.grey().astype(int) - picture(index)).mean() < 40
        assert recording.count() == {'/camera/image/compressed': 20, '/odom': 20}
        assert recording.warnings == []
    with pytest.raises(UnusableInput, match='is closed: open the recording again'):
        next(recording.events(selection))
    assert sorted(tmp_path.rglob('*')) == before, 'files were added to the folder of the recording'


def test_events_with_start_and_duration_yield_that_part(tmp_path):
    with open_recording(write_mcap(tmp_path / 'r.mcap', drive())) as recording:
        selection = recording.select()
        events = list(recording.events(selection, start_s=0.5, duration_s=0.3))
        assert [event.log_ns - START_NS for event in events[::2]] == [
            500_000_000, 600_000_000, 700_000_000]
        assert len(list(recording.events(selection, 0.0, 1e9))) == 40
        for start, duration in ((-1.0, None), (99.0, None), (float('nan'), None), (0.0, 0.0),
                                (0.0, float('nan'))):
            with pytest.raises(UnusableInput, match='expected'):
                recording.events(selection, start, duration)


@pytest.mark.parametrize('storage', ['mcap', 'sqlite3'])
def test_split_recording_is_read_in_time_order(tmp_path, storage):
    messages = list(drive(30))
    late = messages.pop(19)  # Written by the recorder after the split.
    folder = tmp_path / 'r'
    folder.mkdir()
    suffix = 'mcap' if storage == 'mcap' else 'db3'
    write = write_mcap if storage == 'mcap' else write_sqlite
    for number, part in ((10, messages[40:]), (2, [*messages[20:40], late]), (1, messages[:20])):
        write(folder / f'r_{number}.{suffix}', part)
    with open_recording(folder) as recording:
        events = list(recording.events(recording.select()))
    assert len(events) == 60
    assert [event.log_ns for event in events] == sorted(event.log_ns for event in events)


@pytest.mark.parametrize(('second_s', 'topic', 'found'), [
    (2, '/odom', ''), (3600, '/odom', 'are 3597 s apart'), (3600, '/other', 'are 3597 s apart'),
    (0, '/odom', 'hold the same topics at the same time'), (0, '/other', ''),
])
def test_folder_of_several_recordings_causes_a_warning(tmp_path, second_s, topic, found):
    first = [one for one in drive(30) if one[1] == '/odom']
    second = [(ns + second_s * 10**9, topic, *rest) for ns, _, *rest in first]
    write_mcap(tmp_path / 'a.mcap', first)
    write_mcap(tmp_path / 'b.mcap', second)
    with open_recording(tmp_path) as recording:
        assert [f'two of the 2 files in {tmp_path} {found}: ' in text
                for text in recording.warnings] == ([True] if found else [])


def test_split_recording_missing_files_cause_warnings(tmp_path):
    folder = write_bag(tmp_path / 'r', drive())
    text = (folder / 'metadata.yaml').read_text()
    (folder / 'metadata.yaml').write_text(
        text.replace('  - r.mcap\n', '  - r.mcap\n  - r_1.mcap\n  - r_2.mcap\n'))
    (folder / 'r_2.mcap').touch()
    with open_recording(folder) as recording:
        assert len(list(recording.events(recording.select()))) == 40
        assert '1 of 3 files of the recording are missing: r_1.mcap' in recording.warnings
        assert any('r_2.mcap is an empty file' in text for text in recording.warnings)


@pytest.mark.parametrize('text', ['', 'a: [', 'rosbag2_bagfile_information: {}', '- 1', '\x00'])
def test_damaged_metadata_is_ignored_with_a_warning(tmp_path, text):
    folder = write_bag(tmp_path / 'r', drive())
    (folder / 'metadata.yaml').write_text(text)
    with open_recording(folder) as recording:
        assert len(list(recording.events(recording.select()))) == 40
        assert 'metadata.yaml is damaged' in recording.warnings[0]


def test_write_ahead_log_is_read_without_changing_the_recording(tmp_path):
    source, target = tmp_path / 'source', tmp_path / 'target'
    source.mkdir()
    target.mkdir()
    write_sqlite(source / 'r.db3', list(drive(20))[:20])
    database = sqlite3.connect(source / 'r.db3')
    database.execute('PRAGMA journal_mode = WAL')
    rows = database.execute('SELECT topic_id, timestamp + 1000000000, data FROM messages')
    database.executemany('INSERT INTO messages(topic_id, timestamp, data) VALUES(?, ?, ?)',
                         rows.fetchall())
    database.commit()
    for suffix in ('', '-wal'):  # The state while the recorder runs.
        (target / f'r.db3{suffix}').write_bytes((source / f'r.db3{suffix}').read_bytes())
    database.close()
    before = {path: path.read_bytes() for path in target.iterdir()}
    with open_recording(target) as recording:
        assert len(list(recording.events(recording.select()))) == 40
        assert 'write-ahead log' in recording.warnings[0]
    assert before == {path: path.read_bytes() for path in target.iterdir()}


def test_recording_in_read_only_folder_is_read(tmp_path):
    folder = write_bag(tmp_path / 'r', drive(), 'sqlite3')
    (folder / 'r.db3-wal').touch()
    (folder / 'r.db3-shm').write_bytes(bytes(32768))
    folder.chmod(0o555)
    try:
        with open_recording(folder) as recording:
            assert len(list(recording.events(recording.select()))) == 40
            assert recording.warnings == []
    finally:
        folder.chmod(0o755)


def test_unstamped_messages_get_the_recording_time(tmp_path):
    with open_recording(write_mcap(tmp_path / 'r.mcap', drive(stamped=False))) as recording:
        events = list(recording.events(recording.select()))
        assert all(event.stamp_ns == event.log_ns for event in events)
        assert len([text for text in recording.warnings if 'not stamped' in text]) == 2


def test_single_zero_stamp_is_kept(tmp_path):
    messages = list(drive())
    messages[1] = (*messages[1][:3], compressed_image(picture(0), 0))
    with open_recording(write_mcap(tmp_path / 'r.mcap', messages)) as recording:
        stamps = [e.stamp_ns for e in recording.events(recording.select())]
        assert stamps[1] == 0 and stamps[3] > 0
        assert recording.warnings == []


def test_undecodable_messages_are_skipped_and_counted(tmp_path):
    messages = list(drive())
    messages[4] = (*messages[4][:3], b'\x00\x01\x00\x00garbage')
    messages[6] = (*messages[6][:3], odometry(START_NS, float('nan')))
    messages[9] = (*messages[9][:3], b'')
    with open_recording(write_mcap(tmp_path / 'r.mcap', messages)) as recording:
        assert len(list(recording.events(recording.select()))) == 38
        assert recording.skipped == 2
        assert any(text.startswith('1 of the messages of /odom cannot be decoded and are skipped, '
                                   'the first at 0.2 s') for text in recording.warnings)
        assert any(text.startswith('1 of the messages of /camera') for text in recording.warnings)


def test_recorded_templates_are_selected_without_images(tmp_path):
    messages = []
    for index in range(5):
        log_ns = START_NS + index * PERIOD_NS
        messages.append((log_ns, '/robot/odom', ODOMETRY, odometry(log_ns)))
        text = template_text(log_ns - 5, index) if index != 3 else 'no JSON'
        messages.append((log_ns, '/robot/local_view/template', STRING, string_message(text)))
    with open_recording(write_mcap(tmp_path / 'r.mcap', messages)) as recording:
        selection = recording.select()
        assert selection.template_topic == '/robot/local_view/template'
        assert selection.image_topic is None
        events = [e for e in recording.events(selection) if isinstance(e, TemplateEvent)]
        assert [e.stamp_ns - e.log_ns for e in events] == [-5, -5, -5, 0, -5]
        assert events[3].payload == 'no JSON'
        with pytest.raises(UnusableInput, match='leave out --visual-odometry'):
            recording.select(visual_odometry=True)


@pytest.mark.parametrize('store', ['cdr', 'ros1'])
def test_raw_images_are_decoded_exactly(tmp_path, store):
    if store == 'ros1':
        messages = [(START_NS, '/image', IMAGE, raw_image(picture(1), store=ROS1))]
        path = write_rosbag1(tmp_path / 'r.bag', messages)
    else:
        path = write_mcap(tmp_path / 'r.mcap', [(START_NS, '/image', IMAGE,
                                                 raw_image(picture(1)))])
    with open_recording(path) as recording:
        event, = recording.events(recording.select())
        np.testing.assert_array_equal(event.grey(), picture(1))
        assert event.bgr().shape == (12, 16, 3)


def test_events_are_read_lazily(tmp_path):
    path = write_mcap(tmp_path / 'r.mcap', drive(200))
    with open_recording(path) as recording:
        events = recording.events(recording.select())
        next(events)
        assert recording._storages[0]._file.tell() < path.stat().st_size / 4
        events.close()


def test_topic_with_two_types_yields_the_first(tmp_path):
    messages = list(drive(3))
    path = write_sqlite(tmp_path / 'r.db3', messages)
    database = sqlite3.connect(path)
    database.execute(f"INSERT INTO topics VALUES(9, '/odom', '{STRING}', 'cdr')")
    database.execute('INSERT INTO messages(topic_id, timestamp, data) VALUES(9, ?, ?)',
                     (START_NS, b''))
    database.commit()
    database.close()
    with open_recording(path) as recording:
        assert len(list(recording.events(recording.select()))) == 6
        assert 'only the messages of the first type are read' in recording.warnings[0]


@pytest.mark.skipif(os.geteuid() == 0, reason='root may read everything')
def test_unreadable_file_is_rejected(tmp_path):
    path = write_mcap(tmp_path / 'r.mcap', drive())
    path.chmod(0)
    with pytest.raises(UnusableInput, match='permissions'):
        open_recording(path)


def test_other_serialisation_formats_are_rejected(tmp_path):
    path = write_sqlite(tmp_path / 'r.db3', [(START_NS, '/image', COMPRESSED, b'')])
    database = sqlite3.connect(path)
    database.execute("UPDATE topics SET serialization_format = 'protobuf'")
    database.commit()
    database.close()
    with pytest.raises(UnusableInput, match="format is 'protobuf' and not cdr"):
        open_recording(path)
