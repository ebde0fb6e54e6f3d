# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Conversion of images from ROS messages, files and videos to NumPy arrays, without cv_bridge.

cv_bridge requires ROS, and a build for NumPy 1 does not work with NumPy 2. This module accepts
messages of both rclpy and rosbags: they have the same fields, and ``data`` may be any buffer.
"""

from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import cv2
import numpy as np
import numpy.typing as npt

from ratslam_ros.errors import RatslamError
from ratslam_ros.limits import MAX_PIXELS

Pixels = npt.NDArray[np.uint8]

DEPTH_ENCODINGS = frozenset({'16uc1', '32fc1'})

_NO_CONVERSION = None
# encoding: (bytes per pixel, channels of the array, OpenCV conversion to grey, to BGR)
_ENCODINGS: dict[str, tuple[int, int, int | None, int | None]] = {
    'mono8': (1, 1, _NO_CONVERSION, cv2.COLOR_GRAY2BGR),
    '8uc1': (1, 1, _NO_CONVERSION, cv2.COLOR_GRAY2BGR),
    'mono16': (2, 1, _NO_CONVERSION, cv2.COLOR_GRAY2BGR),
    '16uc1': (2, 1, _NO_CONVERSION, cv2.COLOR_GRAY2BGR),
    'bgr8': (3, 3, cv2.COLOR_BGR2GRAY, _NO_CONVERSION),
    '8uc3': (3, 3, cv2.COLOR_BGR2GRAY, _NO_CONVERSION),
    'rgb8': (3, 3, cv2.COLOR_RGB2GRAY, cv2.COLOR_RGB2BGR),
    'bgra8': (4, 4, cv2.COLOR_BGRA2GRAY, cv2.COLOR_BGRA2BGR),
    '8uc4': (4, 4, cv2.COLOR_BGRA2GRAY, cv2.COLOR_BGRA2BGR),
    'rgba8': (4, 4, cv2.COLOR_RGBA2GRAY, cv2.COLOR_RGBA2BGR),
    # ROS names a Bayer pattern after the pixels of its first two rows, OpenCV after the second
    # and third pixels of the second row.
    'bayer_rggb8': (1, 1, cv2.COLOR_BayerBG2GRAY, cv2.COLOR_BayerBG2BGR),
    'bayer_bggr8': (1, 1, cv2.COLOR_BayerRG2GRAY, cv2.COLOR_BayerRG2BGR),
    'bayer_gbrg8': (1, 1, cv2.COLOR_BayerGR2GRAY, cv2.COLOR_BayerGR2BGR),
    'bayer_grbg8': (1, 1, cv2.COLOR_BayerGB2GRAY, cv2.COLOR_BayerGB2BGR),
    'yuv422': (2, 2, cv2.COLOR_YUV2GRAY_UYVY, cv2.COLOR_YUV2BGR_UYVY),
    'uyvy': (2, 2, cv2.COLOR_YUV2GRAY_UYVY, cv2.COLOR_YUV2BGR_UYVY),
    'yuv422_yuy2': (2, 2, cv2.COLOR_YUV2GRAY_YUY2, cv2.COLOR_YUV2BGR_YUY2),
    'yuyv': (2, 2, cv2.COLOR_YUV2GRAY_YUY2, cv2.COLOR_YUV2BGR_YUY2),
}


_PNG = b'\x89PNG\r\n\x1a\n'
_PNG_CHUNK_BYTES = 12  # Length, name and checksum of a chunk.
_SIGNATURES = (
    (0, b'\xff\xd8\xff'),  # JPEG
    (0, _PNG),
    (0, b'BM'),
    (0, b'P1'), (0, b'P2'), (0, b'P3'), (0, b'P4'), (0, b'P5'), (0, b'P6'),
    (0, b'II*\0'), (0, b'MM\0*'),  # TIFF
    (8, b'WEBP'),
    (4, b'jP  \r\n\x87\n'), (0, b'\xff\x4f\xff\x51'),  # JPEG 2000
)
"""Position and first bytes of the formats that cameras and datasets use. OpenCV has decoders of
others, such as GIF, AVIF and OpenEXR, which no recording needs."""

_PAIRED_PIXELS = {cv2.COLOR_YUV2BGR_UYVY, cv2.COLOR_YUV2BGR_YUY2}
"""Conversions in which two pixels share their colour; OpenCV 4.6 does not check for odd widths."""


class UndecodableImage(RatslamError):  # noqa: N818 - as the others in ratslam_ros.errors
    """The bytes of an image cannot be converted to pixels."""


@dataclass(frozen=True, slots=True)
class RawImage:
    """A sensor_msgs/Image of rclpy or of rosbags, decoded on demand.

    mono16 and 16UC1 are reduced to 8 bits as value / 256, rounded down. The factor is the same
    for every image, so that images of one place stay comparable.
    """

    message: Any

    @property
    def encoding(self) -> str:
        """Encoding as named by the message."""
        return str(self.message.encoding)

    @property
    def is_depth(self) -> bool:
        """Whether the pixels are distances."""
        return self.encoding.lower() in DEPTH_ENCODINGS

    def grey(self, by: str = 'luma') -> Pixels:
        """Return the grey image as (H, W) uint8.

        Args:
            by: how colours become grey, as ``image_grey``: luma or mean.

        Raises:
            UndecodableImage: the bytes do not fit the fields of the message.
        """
        pixels, grey, _ = self._pixels()
        if grey is None:
            return pixels
        return _convert(pixels, grey, self.encoding) if by == 'luma' else _mean(self.bgr())

    def bgr(self) -> Pixels:
        """Return the image as (H, W, 3) uint8 in BGR order; raises UndecodableImage."""
        pixels, _, bgr = self._pixels()
        return pixels if bgr is None else _convert(pixels, bgr, self.encoding)

    def _pixels(self) -> tuple[Pixels, int | None, int | None]:
        """Validate the size fields and remove the row padding.

        Returns:
            (H, W) or (H, W, channels) uint8, and the OpenCV conversions to grey and to BGR.
        """
        message = self.message
        height, width, step = int(message.height), int(message.width), int(message.step)
        layout = _ENCODINGS.get(self.encoding.lower())
        if layout is None:
            raise UndecodableImage(
                f'the image encoding {self.encoding[:40]!r} is not supported: expected one of '
                f'{", ".join(_ENCODINGS)}; convert the topic, for instance with image_proc'
            )
        pixel_bytes, channels, grey, bgr = layout
        row_bytes = width * pixel_bytes
        data = np.frombuffer(message.data, np.uint8)
        needed = (height - 1) * step + row_bytes  # Some drivers omit the last row's padding.
        if height <= 0 or width <= 0 or height * width > MAX_PIXELS:
            raise UndecodableImage(f'the message gives an image size of {width} x {height} pixels')
        if step < row_bytes:
            raise UndecodableImage(
                f'the message says that a row is {step} bytes, but {width} pixels of '
                f'{self.encoding} need {row_bytes}'
            )
        if len(data) < needed:
            raise UndecodableImage(
                f'the image holds {len(data)} bytes, but {width} x {height} pixels of '
                f'{self.encoding} with {step} bytes per row need {needed}'
            )
        rows = np.lib.stride_tricks.as_strided(data, (height, row_bytes), (step, 1))
        if self.encoding.lower() in ('mono16', '16uc1'):
            return np.ascontiguousarray(rows[:, 0 if message.is_bigendian else 1 :: 2]), grey, bgr
        shape = (height, width) if channels == 1 else (height, width, channels)
        return np.ascontiguousarray(rows).reshape(shape), grey, bgr


@dataclass(frozen=True, slots=True)
class EncodedImage:
    """The bytes of a JPEG, PNG or other file that OpenCV reads, decoded on demand."""

    data: Any
    encoding: str = ''

    @property
    def is_depth(self) -> bool:
        """Whether the pixels are distances."""
        return _is_depth(self.encoding)

    def grey(self, by: str = 'luma') -> Pixels:
        """Return the grey image as (H, W) uint8; raises UndecodableImage."""
        return self._decode(cv2.IMREAD_GRAYSCALE) if by == 'luma' else _mean(self.bgr())

    def bgr(self) -> Pixels:
        """Return the image as (H, W, 3) uint8 in BGR order; raises UndecodableImage."""
        return self._decode(cv2.IMREAD_COLOR)

    def _decode(self, flags: int) -> Pixels:
        data = np.frombuffer(self.data, np.uint8)
        if self.is_depth:
            raise UndecodableImage(
                f'the image is a depth image ({self.encoding!r}): choose a topic of camera images'
            )
        try:
            pixels = cv2.imdecode(data, flags) if _is_image(data) else None
        except cv2.error as error:  # For example, the header gives a size above OpenCV's limit.
            raise UndecodableImage(f'OpenCV refuses the image: {error.err}') from None
        if pixels is None:
            raise UndecodableImage(
                f'{len(data)} bytes are not a complete JPEG, PNG or other image that OpenCV reads'
                + (f' (the message says {self.encoding[:40]!r})' if self.encoding else '')
            )
        return np.asarray(pixels, np.uint8)


@dataclass(frozen=True, slots=True)
class Frame:
    """An image that is already an array, such as a frame of a video."""

    pixels: Pixels
    encoding: str = 'bgr8'
    is_depth: bool = False

    def grey(self, by: str = 'luma') -> Pixels:
        """Return the grey image as (H, W) uint8."""
        if self.pixels.ndim == 2:
            return self.pixels
        if by == 'mean':
            return _mean(self.pixels)
        return _convert(self.pixels, cv2.COLOR_BGR2GRAY, self.encoding)

    def bgr(self) -> Pixels:
        """Return the image as (H, W, 3) uint8 in BGR order."""
        return (
            self.pixels
            if self.pixels.ndim == 3
            else _convert(self.pixels, cv2.COLOR_GRAY2BGR, self.encoding)
        )


Image = RawImage | EncodedImage | Frame
"""An image that can be converted to grey and to colour pixels."""


def image_of(message: Any) -> Image:
    """Wrap a sensor_msgs Image or CompressedImage of rclpy or of rosbags."""
    if hasattr(message, 'encoding'):
        return RawImage(message)
    return EncodedImage(message.data, str(message.format))


@lru_cache
def _is_depth(encoding: str) -> bool:
    words = encoding.lower().replace(';', ' ').split()
    return 'compresseddepth' in words or not DEPTH_ENCODINGS.isdisjoint(words)


def _is_image(data: Pixels) -> bool:
    """Return whether data begins like an image that is decoded, and whether its parts fit."""
    head = data[:16].tobytes()
    if not any(head.startswith(signature, begin) for begin, signature in _SIGNATURES):
        return False
    at = len(_PNG)
    if head.startswith(_PNG):
        # OpenCV 5.0 allocates as many bytes as a chunk claims to have, up to 4 GB.
        while at + _PNG_CHUNK_BYTES <= len(data):
            at += _PNG_CHUNK_BYTES + int.from_bytes(data[at : at + 4].tobytes(), 'big')
    return at <= len(data)


def _mean(bgr: Pixels) -> Pixels:
    """Return the mean of three channels, rounded to the nearest: (H, W) uint8."""
    return np.asarray(cv2.transform(bgr, np.full((1, 3), 1.0 / 3.0)), np.uint8)


def _convert(pixels: Pixels, code: int, encoding: str) -> Pixels:
    if code in _PAIRED_PIXELS and pixels.shape[1] % 2:
        raise UndecodableImage(
            f'an image of {pixels.shape[1]} x {pixels.shape[0]} pixels has an odd width; expected '
            f'an even one for {encoding}'
        )
    try:
        return np.asarray(cv2.cvtColor(pixels, code), np.uint8)
    except cv2.error as error:
        height, width = pixels.shape[:2]
        raise UndecodableImage(
            f'OpenCV cannot convert {width} x {height} pixels of {encoding}: {error.err}'
        ) from None
