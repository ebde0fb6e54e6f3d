# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Messages of events: a node reads the same values as an offline replay."""

import struct
from pathlib import Path
from random import Random
from typing import Any

import cv2
import numpy as np
import pytest
from helpers import PERIOD_NS, START_NS, image_message, odometry_message, write_bag

from ratslam_ros.core.common.pose import Pose
from ratslam_ros.errors import UnusableInput
from ratslam_ros.event_inputs import odometry_from_event, scan_from_event
from ratslam_ros.images import EncodedImage, Frame, RawImage, image_of
from ratslam_ros.recordings import (
    Event,
    ImageEvent,
    OdometryEvent,
    Orientation,
    ScanEvent,
    TemplateEvent,
    open_recording,
)

pytestmark = pytest.mark.usefixtures('ros')


def message_of(event: Event) -> Any:
    from ratslam_ros.live.messages import message_of as convert

    return convert(event)


def event(image: Any, stamp_ns: int = START_NS + 123_456_789) -> ImageEvent:
    return ImageEvent(stamp_ns, START_NS, image)


def raw(encoding: str, channels: int, bytes_each: int, padding: int, big: int) -> RawImage:
    pixels = np.random.default_rng(1).integers(0, 256, (10, 12 * channels * bytes_each + padding))
    message = image_message(1, np.zeros((10, 12), np.uint8))
    message.encoding, message.is_bigendian = encoding, big
    message.step = pixels.shape[1]
    message.data = pixels.astype(np.uint8).reshape(-1)
    return RawImage(message)


@pytest.mark.parametrize('padding', [0, 5])
@pytest.mark.parametrize('big', [0, 1])
@pytest.mark.parametrize(
    ('encoding', 'channels', 'bytes_each'),
    [('mono8', 1, 1), ('bgr8', 3, 1), ('rgb8', 3, 1), ('rgba8', 4, 1), ('mono16', 1, 2),
     ('bayer_rggb8', 1, 1), ('yuv422', 1, 2)],
)
def test_raw_image_keeps_every_field(encoding, channels, bytes_each, big, padding) -> None:
    image = raw(encoding, channels, bytes_each, padding, big)
    message = message_of(event(image))
    for name in ('height', 'width', 'encoding', 'is_bigendian', 'step'):
        assert getattr(message, name) == getattr(image.message, name)
    assert bytes(message.data) == image.message.data.tobytes()
    assert message.header.frame_id == image.message.header.frame_id == 'camera'
    assert (message.header.stamp.sec, message.header.stamp.nanosec) == (1_700_000_000, 123_456_789)
    assert np.array_equal(image_of(message).grey(), image.grey())
    assert np.array_equal(image_of(message).bgr(), image.bgr())


@pytest.mark.parametrize('ending', ['jpg', 'png', 'pgm'])
def test_compressed_image_keeps_bytes_and_format(ending: str) -> None:
    pixels = np.random.default_rng(2).integers(0, 256, (20, 30, 3), dtype=np.uint8)
    shown = pixels[:, :, 0] if ending == 'pgm' else pixels
    image = EncodedImage(cv2.imencode(f'.{ending}', shown)[1].tobytes(), ending)
    message = message_of(event(image))
    assert (bytes(message.data), message.format) == (image.data, ending)
    assert np.array_equal(image_of(message).grey(), image.grey())


def test_undecodable_image_is_published_unchanged() -> None:
    assert len(message_of(event(EncodedImage(b'', 'jpg'))).data) == 0
    assert bytes(message_of(event(EncodedImage(b'no image', ''))).data) == b'no image'


@pytest.mark.parametrize('shape', [(6, 8, 3), (6, 8)])
def test_video_frame_is_published_as_raw_image(shape: tuple[int, ...]) -> None:
    pixels = np.random.default_rng(3).integers(0, 256, shape, dtype=np.uint8)[:, ::-1]
    frame = Frame(pixels)
    message = message_of(event(frame))
    assert np.array_equal(image_of(message).grey(), frame.grey())
    assert np.array_equal(image_of(message).bgr(), frame.bgr())


def bits(*values: float) -> bytes:
    return struct.pack(f'{len(values)}d', *values)


@pytest.mark.parametrize('seed', range(5))
def test_odometry_is_received_without_loss(seed: int) -> None:
    from ratslam_ros.ros.convert import odometry_of

    chance = Random(seed)
    for _ in range(500):
        *motion, sideways = [chance.uniform(-1e3, 1e3) for _ in range(5)]
        turn = Orientation(*(chance.uniform(-1.0, 1.0) for _ in range(4)))
        sent = OdometryEvent(START_NS, START_NS, *motion, turn, sideways)
        got = odometry_of(message_of(sent))
        assert got.stamp_ns == START_NS
        assert bits(*got.twist, *got.pose) == bits(
            *motion[:2], sideways, *motion[2:], sent.heading_rad
        )


def test_odometry_of_bag_and_table_is_same_live(tmp_path: Path) -> None:
    from ratslam_ros.ros.convert import odometry_of

    chance = Random(7)
    table = ['image,stamp_ns,linear_x_mps,angular_z_radps']
    messages = []
    for i in range(100):
        stamp_ns = START_NS + i * PERIOD_NS
        speed, turn_rate = chance.uniform(-1.0, 1.0), chance.uniform(-9.0, 9.0)
        table.append(f'{"0.png" if i == 0 else ""},{stamp_ns},{speed!r},{turn_rate!r}')
        pose = Pose(speed, turn_rate, chance.uniform(-3.2, 3.2))
        odometry = odometry_message(stamp_ns, speed, turn_rate, pose)
        messages.append((stamp_ns, '/odom', 'odometry', odometry))
    pixels = np.zeros((4, 4), np.uint8)
    messages.append((START_NS, '/image', 'image', image_message(START_NS, pixels)))
    folder = tmp_path / 'folder'
    folder.mkdir()
    cv2.imwrite(str(folder / '0.png'), pixels)
    (folder / 'table.csv').write_text('\n'.join(table))
    for path in (folder, write_bag(tmp_path / 'bag', sorted(messages, key=lambda m: m[0]))):
        with open_recording(path) as recording:
            events = [
                e for e in recording.events(recording.select()) if isinstance(e, OdometryEvent)
            ]
        assert len(events) == 100
        for sent in events:
            assert odometry_of(message_of(sent)) == odometry_from_event(sent)


@pytest.mark.parametrize('beams', [0, 1, 181])
def test_scan_is_received_without_loss(beams: int) -> None:
    from ratslam_ros.core.common.scan import UnusableScan
    from ratslam_ros.ros.mapping.scans import scan_from_message

    first, step = (float(np.float32(number)) for number in (-1.57, 0.017))
    ranges_m = np.random.default_rng(4).uniform(-1.0, 40.0, beams).astype(np.float32)
    ranges_m[::7], ranges_m[1::7], ranges_m[2::7] = np.inf, np.nan, -np.inf
    sent = ScanEvent(START_NS + 5, START_NS, first, step, 0.25, 30.0, ranges_m)
    message = message_of(sent)
    if not beams:
        with pytest.raises(UnusableScan):
            scan_from_message(message)
        return
    got, expected = scan_from_message(message), scan_from_event(sent)
    assert got.ranges_m.tobytes() == expected.ranges_m.tobytes()
    assert got.stamp_ns == expected.stamp_ns == START_NS + 5
    assert bits(got.angle_min_rad, got.angle_increment_rad) == bits(first, step)


def test_template_is_published_unchanged() -> None:
    assert message_of(TemplateEvent(1, 1, '{"id":  3}')).data == '{"id":  3}'


@pytest.mark.parametrize('stamp_s', [2**31, 2**32 - 1, -(2**31) - 1])
def test_stamp_beyond_message_range_is_rejected(stamp_s: int) -> None:
    with pytest.raises(UnusableInput, match='does not fit'):
        message_of(TemplateEvent(1, 1, '')) and message_of(
            event(Frame(np.zeros((1, 1), np.uint8)), stamp_s * 10**9)
        )


@pytest.mark.parametrize('stamp_ns', [0, -1, 2**31 * 10**9 - 1])
def test_stamp_is_kept_to_the_nanosecond(stamp_ns: int) -> None:
    stamp = message_of(event(Frame(np.zeros((1, 1), np.uint8)), stamp_ns)).header.stamp
    assert stamp.sec * 10**9 + stamp.nanosec == stamp_ns


def test_a_robot_would_publish_this_transform_with_its_odometry() -> None:
    from ratslam_ros.live.messages import transform_of

    turn = Orientation(0.0, 0.0, 0.6, 0.8)
    played = message_of(OdometryEvent(START_NS, START_NS, 1.0, 0.5, 2.0, -1.0, turn))
    sent = transform_of(played)
    assert (sent.header.frame_id, sent.child_frame_id) == ('odom', 'base_link')
    assert sent.header.stamp == played.header.stamp
    assert (sent.transform.translation.x, sent.transform.translation.y) == (2.0, -1.0)
    assert sent.transform.rotation.z == pytest.approx(0.6)
    assert sent.transform.rotation.w == pytest.approx(0.8)
    played.pose.pose.position.x = float('nan')
    assert transform_of(played) is None
