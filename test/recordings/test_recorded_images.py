# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Tests of the conversion of images to pixels."""

import array
import dataclasses
from types import SimpleNamespace

import cv2
import numpy as np
import pytest
from fabricate import compressed_image, raw_image
from helpers import picture

from ratslam_ros.images import EncodedImage, Frame, RawImage, image_of
from ratslam_ros.recordings import UndecodableImage

COLOUR = np.random.default_rng(7).integers(0, 256, (6, 8, 3), dtype=np.uint8)
GREY = picture(3, 6, 8)
BAYER_GREY = {'rggb': 'BG', 'bggr': 'RG', 'gbrg': 'GR', 'grbg': 'GB'}


def padded(pixels: np.ndarray, padding: int) -> np.ndarray:
    rows = np.ascontiguousarray(pixels).reshape(len(pixels), -1).view(np.uint8)
    return np.hstack([rows, np.full((len(rows), padding), 255, np.uint8)])


@pytest.mark.parametrize('padding', [0, 5])
@pytest.mark.parametrize(('encoding', 'pixels', 'grey', 'bgr'), [
    ('mono8', GREY, GREY, cv2.cvtColor(GREY, cv2.COLOR_GRAY2BGR)),
    ('8UC1', GREY, GREY, cv2.cvtColor(GREY, cv2.COLOR_GRAY2BGR)),
    ('bgr8', COLOUR, cv2.cvtColor(COLOUR, cv2.COLOR_BGR2GRAY), COLOUR),
    ('BGR8', COLOUR, cv2.cvtColor(COLOUR, cv2.COLOR_BGR2GRAY), COLOUR),
    ('8uc3', COLOUR, cv2.cvtColor(COLOUR, cv2.COLOR_BGR2GRAY), COLOUR),
    ('rgb8', COLOUR[..., ::-1], cv2.cvtColor(COLOUR, cv2.COLOR_BGR2GRAY), COLOUR),
    ('bgra8', cv2.cvtColor(COLOUR, cv2.COLOR_BGR2BGRA),
     cv2.cvtColor(COLOUR, cv2.COLOR_BGR2GRAY), COLOUR),
    ('rgba8', cv2.cvtColor(COLOUR, cv2.COLOR_BGR2RGBA),
     cv2.cvtColor(COLOUR, cv2.COLOR_BGR2GRAY), COLOUR),
])
def test_every_encoding_gives_the_same_pixels(encoding, pixels, grey, bgr, padding):
    message = raw_image(padded(pixels, padding), encoding, size=pixels.shape[:2])
    np.testing.assert_array_equal(image_of(message).grey(), grey)
    mean = grey if grey is GREY else np.rint(COLOUR.astype(int).sum(2) / 3)
    np.testing.assert_array_equal(image_of(message).grey('mean'), mean)
    np.testing.assert_array_equal(image_of(message).bgr(), bgr)


@pytest.mark.parametrize('big', [0, 1])
@pytest.mark.parametrize('encoding', ['mono16', '16UC1'])
def test_mono16_of_either_endianness_is_divided_by_256(encoding, big):
    values = np.array([[0, 255, 256], [0x1234, 65280, 65535]], np.uint16)
    stored = padded(values.astype('>u2' if big else '<u2'), 3)
    message = raw_image(stored, encoding, big=big, size=(2, 3))
    np.testing.assert_array_equal(image_of(message).grey(), values >> 8)


@pytest.mark.parametrize('pattern', BAYER_GREY)
def test_bayer_pattern_follows_the_ros_name(pattern):
    red, green, blue = 200, 100, 50
    colours = {'r': red, 'g': green, 'b': blue}
    tile = np.array([[colours[pattern[0]], colours[pattern[1]]],
                     [colours[pattern[2]], colours[pattern[3]]]], np.uint8)
    message = raw_image(np.tile(tile, (4, 4)), f'bayer_{pattern}8')
    np.testing.assert_array_equal(image_of(message).bgr()[4, 4], [blue, green, red])
    assert image_of(message).grey().shape == (8, 8)


@pytest.mark.parametrize(('encoding', 'luma'), [('yuv422', 1), ('yuv422_yuy2', 0), ('UYVY', 1)])
def test_yuv422_grey_is_its_luma(encoding, luma):
    pixels = np.full((6, 8, 2), 128, np.uint8)
    pixels[..., luma] = GREY
    message = raw_image(pixels, encoding)
    np.testing.assert_array_equal(image_of(message).grey(), GREY)
    assert image_of(message).bgr().shape == (6, 8, 3)


def test_rclpy_message_with_array_data_is_decoded():
    message = SimpleNamespace(height=6, width=8, step=8, encoding='mono8', is_bigendian=0,
                              data=array.array('B', GREY.tobytes()))
    np.testing.assert_array_equal(image_of(message).grey(), GREY)


def test_missing_padding_after_last_row_is_accepted():
    message = raw_image(padded(GREY, 4), size=GREY.shape)
    short = dataclasses.replace(message, data=message.data[:-4])
    np.testing.assert_array_equal(image_of(short).grey(), GREY)


@pytest.mark.parametrize(('change', 'error'), [
    ({'height': 0}, '8 x 0 pixels'),
    ({'width': 0}, '0 x 6 pixels'),
    ({'width': 2**31, 'height': 2**31}, 'pixels'),
    ({'step': 7}, 'a row is 7 bytes'),
    ({'step': 2**32 - 1}, 'holds 48 bytes'),
    ({'height': 7}, 'holds 48 bytes'),
    ({'encoding': '32FC1'}, "'32FC1' is not supported"),
    ({'encoding': ''}, 'not supported'),
])
def test_inconsistent_image_fields_are_rejected(change, error):
    message = dataclasses.replace(raw_image(GREY), **change)
    for convert in (RawImage(message).grey, RawImage(message).bgr):
        with pytest.raises(UndecodableImage, match=error):
            convert()


def test_yuv422_with_odd_width_is_rejected():
    with pytest.raises(UndecodableImage, match='5 x 6'):
        image_of(raw_image(np.zeros((6, 5, 2), np.uint8), 'yuv422')).bgr()


def test_compressed_images_match_opencv_decoding():
    message = compressed_image(COLOUR)
    np.testing.assert_array_equal(
        image_of(message).grey(), cv2.imdecode(message.data, cv2.IMREAD_GRAYSCALE))
    np.testing.assert_array_equal(
        image_of(compressed_image(COLOUR, form='png')).bgr(), COLOUR)


@pytest.mark.parametrize(('data', 'form', 'error'), [
    (b'', 'jpeg', '0 bytes'),
    (b'no image', 'h264', "says 'h264'"),
    (compressed_image(COLOUR).data.tobytes()[:40], 'jpeg', '40 bytes'),
    (b'1234', '16UC1; compressedDepth png', 'depth'),
])
def test_invalid_compressed_images_are_rejected(data, form, error):
    with pytest.raises(UndecodableImage, match=error):
        EncodedImage(data, form).grey()


def test_depth_images_are_detected_by_encoding():
    assert image_of(raw_image(GREY, '16UC1')).is_depth
    assert image_of(raw_image(GREY, '32FC1')).is_depth
    assert not image_of(raw_image(GREY, 'mono16')).is_depth
    assert EncodedImage(b'', '16UC1; compressedDepth rvl').is_depth
    assert not EncodedImage(b'', 'rgb8; jpeg compressed bgr8').is_depth


def test_frames_convert_between_grey_and_colour():
    np.testing.assert_array_equal(Frame(COLOUR).bgr(), COLOUR)
    np.testing.assert_array_equal(
        Frame(COLOUR).grey(), cv2.cvtColor(COLOUR, cv2.COLOR_BGR2GRAY))
    mean = np.rint(COLOUR.astype(int).sum(2) / 3)
    np.testing.assert_array_equal(Frame(COLOUR).grey('mean'), mean)
    np.testing.assert_array_equal(Frame(GREY).grey('mean'), GREY)
    assert Frame(GREY).bgr().shape == (6, 8, 3)


def test_mean_of_channels_is_rounded_to_the_nearest():
    colours = np.array([[[0, 0, 1], [0, 1, 1], [255, 255, 254], [30, 60, 90]]], np.uint8)
    assert Frame(colours).grey('mean').tolist() == [[0, 1, 255, 60]]
    data = cv2.imencode('.png', colours)[1]
    assert EncodedImage(data, 'png').grey('mean').tolist() == [[0, 1, 255, 60]]
    assert EncodedImage(data, 'png').grey().tolist() != [[0, 1, 255, 60]]
