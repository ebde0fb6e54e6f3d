# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Messages of events: a node reads the same values as an offline replay."""

import struct
from random import Random
from typing import Any

import cv2
import numpy as np
import pytest
from helpers import START_NS, image_message

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


def test_odometry_is_received_without_loss_and_as_a_replay_reads_it() -> None:
    from ratslam_ros.ros.convert import odometry_of

    chance = Random(1)
    for _ in range(500):
        *motion, sideways = [chance.uniform(-1e3, 1e3) for _ in range(5)]
        turn = Orientation(*(chance.uniform(-1.0, 1.0) for _ in range(4)))
        sent = OdometryEvent(START_NS, START_NS, *motion, turn, sideways)
        got = odometry_of(message_of(sent))
        assert got == odometry_from_event(sent)
        assert got.stamp_ns == START_NS
        assert bits(*got.twist, *got.pose) == bits(
            *motion[:2], sideways, *motion[2:], sent.heading_rad
        )


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
