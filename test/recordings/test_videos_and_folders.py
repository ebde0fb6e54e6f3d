# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Tests of videos and folders of images as recordings."""

import itertools

import cv2
import numpy as np
import pytest
from helpers import picture

from ratslam_ros.errors import UnusableInput
from ratslam_ros.recordings import (
    ImageEvent,
    OdometryEvent,
    UndecodableImage,
    describe,
    open_recording,
)
from ratslam_ros.recordings import video as module


def write_images(folder, names):
    folder.mkdir(exist_ok=True)
    for index, name in enumerate(names):
        cv2.imwrite(str(folder / name), picture(index))
    return folder


def read(path, **options):
    with open_recording(path, **options) as recording:
        return list(recording.events(recording.select())), recording


def test_images_without_table_have_natural_order(tmp_path):
    folder = write_images(tmp_path / 'run', ['image1.png', 'image2.png', 'image10.PNG'])
    (folder / 'notes.txt').write_text('hello')
    (folder / 'truth.csv').write_text('image,place\nimage1.png,3\n')
    events, recording = read(folder, images_rate_hz=4.0)
    assert (recording.name, recording.kind) == ('run', 'image folder')
    assert [event.stamp_ns for event in events] == [0, 250_000_000, 500_000_000]
    for index, event in enumerate(events):
        np.testing.assert_array_equal(event.grey(), picture(index))
    assert 'an image rate of 4 Hz is assumed' in recording.warnings[0]
    assert '16x12 png' in describe(recording)


@pytest.mark.parametrize('names', [
    ['1305031102.175304.png', '1305031102.211214.png', '1305031103.png'],
    ['frame_1305031102175.png', 'frame_1305031102211.png', 'frame_1305031103000.png'],
    ['1305031102175304.png', 'b1305031102211214.png', '1305031103000000.png'],
    ['1305031102175304000.png', '1305031102211214000.png', '1305031103000000000.png'],
])
def test_names_that_are_unix_times_are_the_stamps(tmp_path, names):
    events, recording = read(write_images(tmp_path / 'run', names), images_rate_hz=4.0)
    assert [event.stamp_ns // 1_000_000 for event in events] == [
        1305031102175, 1305031102211, 1305031103000
    ]
    assert not recording.warnings
    assert 'used as their times' in recording.notices[0]


@pytest.mark.parametrize('names', [
    ['0000000001.png', '0000000002.png'], ['1305031102.png', 'logo.png'],
    ['a1305031102.png', 'b1305031102.png'], ['13050311021.png', '13050311022.png'],
    ['9305031102.png', '9305031103.png'],
])
def test_names_that_are_no_times_count_images(tmp_path, names):
    events, recording = read(write_images(tmp_path / 'run', names), images_rate_hz=4.0)
    assert [event.stamp_ns for event in events] == [0, 250_000_000]
    assert 'an image rate of 4 Hz is assumed' in recording.warnings[0]


@pytest.mark.parametrize(
    ('folders', 'name'),
    [
        ('run/images', 'run'), ('run/Data/rgb', 'run'), ('run/left', 'left'), ('run', 'run'),
        ('run/recording', 'run'),
    ],
)
def test_generic_folder_is_named_after_the_one_above(tmp_path, folders, name):
    folder = tmp_path / folders
    folder.mkdir(parents=True)
    with open_recording(write_images(folder, ['a.png', 'b.png'])) as recording:
        assert recording.name == name
    table = folder / 'frames.csv'
    table.write_text('stamp_s,image\n1.0,a.png\n')
    with open_recording(table) as recording:
        assert recording.name == name


@pytest.mark.parametrize('names', [['img9.png', 'img10.png', 'logo.png'], ['a.png', 'b.png']])
def test_stray_images_are_refused_and_sequences_are_not(tmp_path, names):
    folder = write_images(tmp_path / 'home', names)
    is_sequence = names[0] == 'img9.png'
    with open_recording(folder):  # a folder of nothing else holds a recording, whatever the names
        pass
    for number in range(5):
        (folder / f'letter{number}.txt').write_text('hello')
    if is_sequence:
        with open_recording(folder) as recording:
            assert '3 images' in recording.warnings[0]
    else:
        with pytest.raises(UnusableInput, match=r'2 images .* a\.png and b\.png, among 7 files'):
            open_recording(folder)
    write_table = folder / 'frames.csv'
    write_table.write_text(f'stamp_s,image\n1.0,{names[0]}\n')
    with open_recording(folder) as recording:
        assert recording.topics[0].count == 1


@pytest.mark.parametrize('separator', [',', ';', '\t'])
def test_table_gives_stamps_and_odometry(tmp_path, separator):
    folder = write_images(tmp_path / 'run', ['a.png', 'b.png'])
    table = (
        '\ufeffstamp_s, image, linear_x_mps, angular_z_radps\n'
        '1700000000.123456789,a.png,0.5,0.0\n'
        '1700000002.123456789,,0.5,0.0\n'
        '1700000003.123456789,b.png,,\n'
    )
    (folder / 'frames.csv').write_text(table.replace(',', separator), encoding='utf-8')
    for path in (folder, folder / 'frames.csv'):
        events, recording = read(path)
        assert [type(event) for event in events] == [
            OdometryEvent, ImageEvent, OdometryEvent, ImageEvent]
        assert events[0].stamp_ns == 1_700_000_000_123_456_789
        assert (events[2].x, events[2].y, events[2].heading_rad) == (1.0, 0.0, 0.0)
        np.testing.assert_array_equal(events[3].grey(), picture(1))
        assert recording.warnings == []
        selection = recording.select(visual_odometry=True)
        assert len(list(recording.events(selection))) == 2


@pytest.mark.parametrize(('header', 'stamp', 'motion', 'columns'), [
    ('time,file,speed,yawrate', '2.5', '0.5,0.1', 'time from time (s), image from file, speed'),
    ('t,path,v,omega', '2.5', '0.5,0.1', 'turn rate from omega (radps)'),
    ('Stamp,Image,vx,vth,vy', '2.5', '0.5,0.1,-1.0', 'speed to the left from vy (mps)'),
    ('#timestamp [ns],filename,velocity_mps,wz_radps', '2500000000', '0.5,0.1', '(ns), image'),
    ('time_ms,file,speed_kmph,yaw_rate_degps', '2500', '1.8,5.729577951308232', '(kmph)'),
    ('time_us,file,speed,yaw_rate,lat', '2500000', '0.5,0.1,3.0', '; not used: lat'),
])
def test_table_with_usual_names_gives_odometry(tmp_path, header, stamp, motion, columns):
    folder = write_images(tmp_path / 'run', ['a.png'])
    (folder / 'frames.csv').write_text(f'{header}\n{stamp},a.png,{motion}\n')
    events, recording = read(folder)
    assert [type(event) for event in events] == [OdometryEvent, ImageEvent]
    assert events[0].stamp_ns == 2_500_000_000
    assert (events[0].linear_x, events[0].angular_z) == pytest.approx((0.5, 0.1))
    assert events[0].linear_y == (-1.0 if 'vy' in header else 0.0)
    assert f'note: frames.csv: time from {header.partition(",")[0]} (' in (
        text := describe(recording)
    )
    assert columns in text


def test_table_of_odometry_beside_table_of_images_is_reported(tmp_path):
    folder = write_images(tmp_path / 'run', ['a.png'])
    (folder / 'frames.csv').write_text('time,file\n1,a.png\n')
    (folder / 'odom.csv').write_text('time,speed,yaw_rate\n1,0.5,0.1\n')
    assert 'odom.csv is not used' in read(folder)[1].warnings[0]


def test_table_odometry_is_integrated_along_arcs(tmp_path):
    folder = write_images(tmp_path / 'run', ['a.png'])
    rows = ''.join(f',{index * 10_000_000},1.0,0.5\n' for index in range(1, 201))
    (folder / 'frames.csv').write_text(
        f'image,stamp_ns,linear_x_mps,angular_z_radps\na.png,0,1.0,0.5\n{rows}')
    last = read(folder)[0][-1]
    assert (last.x, last.y, last.heading_rad) == pytest.approx(
        (2 * np.sin(1.0), 2 - 2 * np.cos(1.0), 1.0), abs=1e-4)


@pytest.mark.parametrize(('table', 'message'), [
    ('image,stamp_s\na.png,noon\n', "line 2, .*not 'noon'"),
    ('image,stamp_ns\na.png,1.5\n', 'line 2'),
    ('image,stamp_s\na.png,nan\n', 'line 2'),
    ('image,stamp_s\nz.png,1\n', 'z.png does not exist'),
    ('image,stamp_s\na.png\n', 'line 2'),
    ('image,stamp_s\n', 'has no rows'),
    ('image,stamp_s,linear_x_mps,angular_z_radps\na.png,1,inf,0\n',
     "expected a number with a decimal point for the speed, .*, not 'inf'"),
    ('image;stamp_s;linear_x_mps;angular_z_radps\na.png;1;0.5;1,0\n',
     "decimal point for the turn rate, .*, not '1,0'"),
    ('image,stamp_s,linear_x_mps,angular_z_radps\n,1,1,0\n', 'lists no images'),
    ('time,file,speed\n1,a.png,1\n', r'frames.csv .*none for the turn rate: .*yaw_rate.* as in'),
    ('time,file,omega\n1,a.png,1\n', 'none for the speed: expected linear_x, vx, speed, '),
    ('time,file,speed_knots,yaw_rate\n1,a.png,1,0\n', 'none for the speed: .* mps, .* suffix'),
    ('file,speed,yaw_rate\na.png,1,0\n', 'none for the time: expected stamp, timestamp, '),
    ('t,v,wz\n1,1,0\n', 'none for the image: expected image, file, filename or path'),
    ('image,time\na.png,1700000000123456789\n', 'rename the column time, as in time_ns'),
    (f'image,time_ns\na.png,{2**63}\n', 'time of 9223372036854775808 ns is out of range'),
    ('image,time\na.png,-0.5\n', 'expected a time of 0 or more, not -0.5'),
    ('image,time_ns\na.png,-' + '9' * 999, 'expected a time of 0 or more, not -9'),
    ('image,time\na.png,1e999999\n', "expected a time in s, not '1e999999'"),
    ('image,time\n"a.png,1\n' + 'b.png,2\n' * 600, 'line 602, .* does not exist$'),
])
def test_invalid_tables_are_rejected(tmp_path, table, message):
    folder = write_images(tmp_path / 'run', ['a.png'])
    (folder / 'frames.csv').write_text(table)
    with pytest.raises(UnusableInput, match=message) as error:
        open_recording(folder)
    assert len(str(error.value)) < 600


def test_unrelated_tables_and_invalid_rates_are_rejected(tmp_path):
    folder = write_images(tmp_path / 'run', ['a.png'])
    (tmp_path / 'a.mp4').touch()
    for rate in (0.0, -1.0, float('nan')):
        for path in (folder, tmp_path / 'a.mp4'):
            with pytest.raises(UnusableInput, match='rate of the images'):
                open_recording(path, images_rate_hz=rate)
    (folder / 'x.csv').write_text('a,b\n1,2\n')
    with pytest.raises(UnusableInput, match='columns a, b, and none for the image: expected'):
        open_recording(folder / 'x.csv')
    for name in ('x.csv', 'y.csv'):
        (folder / name).write_text('image,stamp_s\na.png,1\n')
    with pytest.raises(UnusableInput, match='2 tables of images'):
        open_recording(folder)


def test_unknown_table_beside_a_folder_of_images_is_named(tmp_path):
    write_images(tmp_path / 'images', ['a.png'])
    (tmp_path / 'data.csv').write_text('header.stamp,image\n1,images/a.png\n')
    with pytest.raises(UnusableInput, match=r'give one of .*images, or the table data.csv, to'):
        open_recording(tmp_path)


def test_invalid_image_file_is_rejected_on_decoding(tmp_path):
    folder = write_images(tmp_path / 'run', ['a.png'])
    (folder / 'b.png').write_bytes(b'')
    events, _ = read(folder)
    with pytest.raises(UndecodableImage, match='0 bytes'):
        events[1].grey()


@pytest.fixture
def video(tmp_path):
    path = tmp_path / 'drive.avi'
    writer = cv2.VideoWriter(str(path), cv2.VideoWriter_fourcc(*'MJPG'), 20.0, (64, 48))
    if not writer.isOpened():
        pytest.skip('this OpenCV cannot write MJPG videos')
    for index in range(30):
        writer.write(np.full((48, 64, 3), 8 * index, np.uint8))
    writer.release()
    return path


def test_video_yields_frames_at_their_times(video):
    events, recording = read(video)
    assert (recording.name, recording.kind) == ('drive', 'video')
    assert [event.stamp_ns for event in events] == [index * 50_000_000 for index in range(30)]
    for index, event in enumerate(events):
        assert event.bgr().shape == (48, 64, 3)
        assert abs(int(event.grey()[20, 20]) - 8 * index) < 4
    assert recording.warnings == []
    part = list(recording.events(recording.select(), start_s=0.5, duration_s=0.25))
    assert [event.stamp_ns for event in part] == [
        500_000_000, 550_000_000, 600_000_000, 650_000_000, 700_000_000]
    assert '64x48 bgr8' in describe(recording)
    with pytest.raises(UnusableInput, match='does not exist'):
        recording.select(image_topic='/camera')


def test_truncated_video_yields_the_remaining_frames(video):
    content = video.read_bytes()
    video.write_bytes(content[:len(content) // 2])
    try:
        events, _ = read(video)
    except UnusableInput:
        return
    assert 0 < len(events) < 30


@pytest.mark.parametrize(('period_ns', 'is_truncated'), [
    (100_000_000, False), (50_000_000, True),
])
def test_video_of_varying_rate_is_not_truncated(video, monkeypatch, period_ns, is_truncated):
    opened = module._opened

    def capture(path):
        found = opened(path)
        found.frames = 60  # by a duration of 3 s, at 20 Hz
        times = itertools.count(0, period_ns)
        found.time_ns = lambda: next(times)
        return found

    monkeypatch.setattr(module, '_opened', capture)
    events, recording = read(video)
    assert len(events) == 30
    assert ['truncated' in text for text in recording.warnings] == [True] * is_truncated


def test_file_that_is_not_a_video_is_rejected(tmp_path):
    path = tmp_path / 'a.mp4'
    path.write_bytes(b'no video')
    with pytest.raises(UnusableInput, match='cannot be opened as a video'):
        open_recording(path)


def test_warnings_that_differ_in_numbers_are_counted(tmp_path):
    folder = write_images(tmp_path / 'run', [f'image{n}.png' for n in range(40)])
    for path in folder.iterdir():
        path.unlink()
        path.mkdir()  # It has the name of an image, and cannot be read.
    _, recording = read(folder, images_rate_hz=4.0)
    found = [text for text in recording.warnings if 'cannot be read' in text]
    assert len(found) == 3
    assert found[-1].endswith('(37 more of this kind)')
