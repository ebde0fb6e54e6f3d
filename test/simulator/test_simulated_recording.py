# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
import cv2
import numpy as np
import pytest
from rosbags.highlevel import AnyReader

from ratslam_ros.errors import UnusableInput
from ratslam_simulator.picture import draw_run
from ratslam_simulator.recording import write_recording


@pytest.fixture(scope='module')
def run(tmp_path_factory):
    return write_recording(tmp_path_factory.mktemp('first') / 'run', seed=3, duration_s=5.0)


def bytes_of(folder):
    return {file.name: file.read_bytes() for file in folder.iterdir()}


def test_equal_seeds_write_equal_recordings(run, tmp_path):
    again = write_recording(tmp_path / 'again' / 'run', seed=3, duration_s=5.0)
    other = write_recording(tmp_path / 'other' / 'run', seed=4, duration_s=5.0)
    first = bytes_of(run.recording)
    assert sorted(first) == ['metadata.yaml', 'run.mcap', 'truth.tum']
    assert bytes_of(again.recording) == first
    assert bytes_of(other.recording)['run.mcap'] != first['run.mcap']
    assert bytes_of(other.recording)['truth.tum'] != first['truth.tum']


def test_recording_contains_expected_topics_and_messages(run):
    with AnyReader([run.recording]) as reader:
        messages = {
            connection.topic: [
                (at_ns, reader.deserialize(data, connection.msgtype))
                for _, at_ns, data in reader.messages([connection])
            ]
            for connection in reader.connections
        }
    assert {topic: len(found) for topic, found in messages.items()} == {
        '/camera/image/compressed': 41,
        '/camera/camera_info': 41,
        '/odom': 101,
        '/ground_truth/pose': 101,
    }
    for found in messages.values():
        for at_ns, message in found:
            assert at_ns == message.header.stamp.sec * 10**9 + message.header.stamp.nanosec
    image = cv2.imdecode(messages['/camera/image/compressed'][0][1].data, cv2.IMREAD_UNCHANGED)
    assert image.shape == (120, 160)
    focal_px = messages['/camera/camera_info'][0][1].k[0]
    assert 2 * np.degrees(np.arctan(80 / focal_px)) == pytest.approx(50.0)
    last = messages['/odom'][-1][1]
    assert last.pose.pose.position.x == run.odometry_pose[-1, 0]
    assert last.twist.twist.linear.x > 0.4


def test_truth_file_has_line_per_odometry_message(run):
    lines = run.truth.read_text().splitlines()
    assert len(lines) == len(run.truth_stamp_ns) == 101
    stamp, x, y, z, qx, qy, qz, qw = lines[-1].split()
    sec, nanosec = stamp.split('.')
    assert int(sec) * 10**9 + int(nanosec) == run.truth_stamp_ns[-1]
    assert (float(x), float(y)) == pytest.approx(tuple(run.truth_pose[-1, :2]), abs=1e-9)
    assert (z, qx, qy) == ('0', '0', '0')
    assert 2 * np.arctan2(float(qz), float(qw)) == pytest.approx(run.truth_pose[-1, 2], abs=1e-8)


def test_write_recording_to_existing_folder_is_refused(run):
    with pytest.raises(UnusableInput, match='exists already'):
        write_recording(run.recording, seed=3, duration_s=1.0)


def test_draw_run_is_reproducible(run, tmp_path):
    first, again = (draw_run(run, tmp_path / name).read_bytes() for name in ('1.png', '2.png'))
    assert first == again
    assert cv2.imread(str(tmp_path / '1.png')).shape[1] > 800
