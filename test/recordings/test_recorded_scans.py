# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Tests of the selection and content of laser scans in recordings of every format."""

import math

import numpy as np
import pytest
from fabricate import ROS1, ROS2, SCAN, drive, laser_scan, write_mcap, write_rosbag1, write_sqlite
from helpers import PERIOD_NS, START_NS, header, write_bag
from rosbags.typesys import get_types_from_msg

from ratslam_ros.core.common.mount import CENTRED, Mount
from ratslam_ros.errors import UnusableInput
from ratslam_ros.event_inputs import laser_mount
from ratslam_ros.recordings import ScanEvent, Selection, describe, open_recording
from ratslam_ros.recordings.topics import ROS1_TF, TF

RANGES = (0.1, 1.25, np.inf, -np.inf, np.nan)


def scans(topic='/scan', frames=20, store=ROS2, stamped=True, frame='laser'):
    """Yield a scan every 0.1 s, between the odometry message and the image of ``drive``."""
    for index in range(frames):
        log_ns = START_NS + index * PERIOD_NS + 1_000_000
        stamp_ns = log_ns - 2_000_000 if stamped else 0
        yield log_ns, topic, SCAN, laser_scan(stamp_ns, RANGES, store=store, frame=frame)


def with_drive(*others, store=ROS2):
    streams = [drive(store=store), *others]
    return sorted((message for stream in streams for message in stream), key=lambda m: m[0])


@pytest.mark.parametrize('kind', ['mcap', 'sqlite', 'rosbag2', 'rosbag1'])
def test_scans_are_read_from_every_format(tmp_path, kind):
    if kind == 'rosbag1':
        messages = with_drive(scans(store=ROS1), store=ROS1)
        path = write_rosbag1(tmp_path / 'r.bag', messages)
    else:
        write, name = {
            'mcap': (write_mcap, 'r.mcap'), 'sqlite': (write_sqlite, 'r.db3'),
            'rosbag2': (write_bag, 'r'),
        }[kind]
        path = write(tmp_path / name, with_drive(scans()))
    with open_recording(path) as recording:
        selection = recording.select(scans=True)
        assert selection == Selection('/camera/image/compressed', '/odom', None, '/scan')
        events = list(recording.events(selection))
        assert recording.warnings == []
    assert [isinstance(event, ScanEvent) for event in events] == [False, True, False] * 20
    event = events[4]
    assert isinstance(event, ScanEvent)
    assert (event.log_ns, event.stamp_ns) == (
        START_NS + PERIOD_NS + 1_000_000, START_NS + PERIOD_NS - 1_000_000,
    )
    numbers = (event.angle_min_rad, event.angle_increment_rad, event.range_min_m,
               event.range_max_m)
    assert numbers == (-0.5, 0.5, 0.25, 8.0)
    assert np.array_equal(event.ranges_m, np.array(RANGES, np.float32), equal_nan=True)


def test_scans_are_read_only_on_request(tmp_path):
    with open_recording(write_mcap(tmp_path / 'r.mcap', with_drive(scans(), scans('/rear')))) as r:
        assert r.select().scan_topic is None
        assert len(list(r.events(r.select()))) == 40
        for name in ('/rear', 'rear'):  # The leading slash is optional.
            assert r.select(scan_topic=name, scans=True).scan_topic == '/rear'


@pytest.mark.parametrize(('arguments', 'message'), [
    ({}, 'holds 2 topics with scans: .* --scan-topic /rear or --scan-topic /scan'),
    ({'scan_topic': '/odom'}, '--scan-topic /odom is of type .* one of /rear'),
    ({'scan_topic': '/x'}, '--scan-topic /x does not exist .* with scans: one of /rear'),
    ({'scan_topic': '/scan', 'scans': False}, 'nothing uses them: set .*exp_align_scans'),
])
def test_ambiguous_or_invalid_choice_lists_the_options(tmp_path, arguments, message):
    path = write_mcap(tmp_path / 'r.mcap', with_drive(scans(), scans('/rear')))
    with open_recording(path) as recording:
        with pytest.raises(UnusableInput, match=message) as error:
            recording.select(**{'scans': True, **arguments})
        assert '\n' not in str(error.value)


def test_undecodable_scans_are_skipped_and_counted(tmp_path):
    broken = [(START_NS + 5, '/scan', SCAN, b'\x00\x01\x00\x00garbage')]
    with open_recording(write_mcap(tmp_path / 'r.mcap', with_drive(scans(), broken))) as recording:
        assert len(list(recording.events(recording.select(scans=True)))) == 60
        assert recording.skipped == 1
        assert recording.warnings[0].startswith('1 of the messages of /scan cannot be decoded')


def test_unstamped_scans_get_the_recording_time(tmp_path):
    path = write_mcap(tmp_path / 'r.mcap', with_drive(scans(stamped=False)))
    with open_recording(path) as recording:
        events = list(recording.events(recording.select(scans=True)))
        found = [event for event in events if isinstance(event, ScanEvent)]
        assert all(event.stamp_ns == event.log_ns for event in found)
        assert recording.warnings == [
            'the messages of /scan are not stamped: the recording times are used instead'
        ]


def test_description_lists_readable_scans(tmp_path):
    with open_recording(write_mcap(tmp_path / '1.mcap', with_drive(scans()))) as recording:
        described = describe(recording)
    assert described.endswith(f'\nnext: ratslam replay {tmp_path / "1.mcap"}')
    note = 'note: the scans of /scan are read if experience_map.exp_align_scans is set'
    assert f'{note}\n' in described
    assert 'cannot be decoded' not in described
    broken = [(START_NS + 5, '/broken', SCAN, b'\x00\x01\x00\x00garbage')]
    with open_recording(write_mcap(tmp_path / '2.mcap', with_drive(scans(), broken))) as recording:
        described = describe(recording)
    (line,) = [line for line in described.splitlines() if line.startswith('/broken')]
    assert line.endswith('cannot be decoded')
    assert f'{note}; give --scan-topic /scan\n' in described
    assert described.endswith('2.mcap')  # No --scan-topic: scans are off.


TRANSLATION, HALF = (0.2, -0.1, 0.3), math.sqrt(0.5)
"""Place of the laser, which is turned by 90 degrees."""


def mounted(topic, store, kind=TF):
    """Yield a transform of the laser to the robot, which some robots repeat."""
    types = store.types
    register(store)
    frames = [('base_link', 'laser', TRANSLATION, (0.0, 0.0, HALF, HALF)),
              ('odom', 'base_link', (5.0, 0.0, 0.0), (0.0, 0.0, 0.0, 1.0))]
    for index in range(3):
        log_ns = START_NS + index * PERIOD_NS + 2_000_000
        made = [
            types['geometry_msgs/msg/TransformStamped'](
                header(store, log_ns, parent), child,
                types['geometry_msgs/msg/Transform'](
                    types['geometry_msgs/msg/Vector3'](*translation),
                    types['geometry_msgs/msg/Quaternion'](*quaternion),
                ),
            )
            for parent, child, translation, quaternion in frames
        ]
        yield log_ns, topic, kind, types[kind](made)


def register(store):
    if store is ROS1 and TF not in store.types:
        for kind in (TF, ROS1_TF):
            store.register(get_types_from_msg('geometry_msgs/TransformStamped[] transforms', kind))


def mount_of(path):
    with open_recording(path) as recording:
        selection = recording.select(scans=True)
        mount = laser_mount(recording, selection)
        assert laser_mount(recording, selection) == mount
        return mount, recording.warnings


@pytest.mark.parametrize('kind', ['/tf_static', '/tf', 'ros1', 'old ros1'])
def test_the_place_of_the_laser_is_read(tmp_path, kind):
    if 'ros1' in kind:
        frames = mounted('/tf', ROS1, ROS1_TF if 'old' in kind else TF)
        messages = with_drive(scans(store=ROS1, frame='/laser'), frames, store=ROS1)
        path = write_rosbag1(tmp_path / 'r.bag', messages)
    else:
        path = write_mcap(tmp_path / 'r.mcap', with_drive(scans(), mounted(kind, ROS2)))
    assert mount_of(path) == (Mount(0.2, -0.1, round(math.pi / 2, 9)), [])


def test_an_unknown_place_of_the_laser_is_the_centre_with_a_warning(tmp_path):
    path = write_mcap(tmp_path / 'r.mcap', with_drive(scans()))
    mount, warnings = mount_of(path)
    assert mount == CENTRED
    [text] = warnings
    assert text.startswith('the recording has no transform from base_link to laser on /tf_static')
    path = write_mcap(tmp_path / 's.mcap', with_drive(scans(frame='base_link')))
    assert mount_of(path) == (CENTRED, [])


def test_without_scans_no_frames_are_read(tmp_path):
    path = write_mcap(tmp_path / 'r.mcap', with_drive(mounted('/tf_static', ROS2)))
    assert mount_of(path) == (CENTRED, [])
