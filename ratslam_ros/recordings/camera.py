# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""A camera or a stream as a recording without an end, which may be kept in an mcap file."""

from __future__ import annotations

import sys
import time
from collections.abc import Iterator
from contextlib import closing
from pathlib import Path
from typing import BinaryIO

import cv2
import numpy as np
from mcap.writer import CompressionType, Writer
from rosbags.typesys import Stores, get_typestore

from ratslam_ros.errors import UnusableInput
from ratslam_ros.images import EncodedImage, Frame, Pixels
from ratslam_ros.recordings.capture import Capture
from ratslam_ros.recordings.events import Event, ImageEvent
from ratslam_ros.recordings.recording import Recording
from ratslam_ros.recordings.topics import COMPRESSED_IMAGE, VIDEO, Selection, Topic

TOPIC = '/camera/image/compressed'
FRAME_ID = 'camera'
JPEG_QUALITY = 95
"""An image of 640 x 480 pixels has about 50 kB."""


class Camera(Recording):
    """The images of a camera or a stream, stamped when they arrive, until ``stop``."""

    kind = 'camera'
    is_endless = True

    def __init__(self, source: str, record: Path | None = None) -> None:
        """Check that the camera sends images.

        Args:
            source: number of a camera, a device such as /dev/video2, or the URL of a stream.
            record: mcap file in which the images are kept as JPEG; then these are yielded, as a
                replay of the file does. None: the images are not kept.

        Raises:
            UnusableInput: there is no such camera, it sends no image, or the file exists.
        """
        # Stored in map files, so not the URL, which may contain a password.
        super().__init__(record or Path('camera:'))
        self.name, self._source = 'camera', source
        self.topics = (Topic(TOPIC, VIDEO, None),)
        self._is_stopped = False
        with closing(_opened(source)) as capture:
            if not capture.grab():
                raise UnusableInput(
                    f'camera {source} is open but sends no image: expected a camera that no other '
                    'program uses, or a stream that is running'
                )
        self._file = None if record is None else ImageFile(record)
        self.start_ns = self.end_ns = time.time_ns()

    def read_events(self, selection: Selection, start_ns: int, stop_ns: int) -> Iterator[Event]:
        """Yield the images that arrive until ``stop``, or until the camera sends no more."""
        # A step of the wall clock must not appear in the stamps.
        offset_ns = time.time_ns() - time.monotonic_ns()
        # Opened only now: while the loops are compiled, images would wait.
        with closing(_opened(self._source)) as capture:
            while not self._is_stopped:
                if not capture.grab():
                    self.warn('the camera sends no more images: the map ends here')
                    return
                stamp_ns, pixels = offset_ns + time.monotonic_ns(), capture.frame()
                image = Frame(pixels) if self._file is None else self._file.add(stamp_ns, pixels)
                yield ImageEvent(stamp_ns, stamp_ns, image)

    def stop(self) -> None:
        """End the events after the current image; may be called from any thread."""
        self._is_stopped = True

    def close(self) -> None:
        """Complete the file."""
        if self._file is not None:
            self._file.close()


class ImageFile:
    """An mcap file of JPEG images, as ROS 2 records them.

    A chunk is written for each 1 MiB. If the process is killed, the chunks stay readable.
    """

    def __init__(self, path: Path) -> None:
        """Create the file.

        Raises:
            UnusableInput: it exists, has another suffix, or cannot be created.
        """
        check_record(path)
        try:
            self._stream: BinaryIO = path.open('xb')
        except OSError as error:
            raise UnusableInput(
                f'{path} cannot be written ({error.strerror}); give another --record'
            ) from None
        self._store = get_typestore(Stores.ROS2_JAZZY)
        self._writer = Writer(self._stream, compression=CompressionType.NONE)  # JPEG is compressed
        self._writer.start('ros2')
        definition, _ = self._store.generate_msgdef(COMPRESSED_IMAGE, ros_version=2)
        schema = self._writer.register_schema(COMPRESSED_IMAGE, 'ros2msg', definition.encode())
        self._channel = self._writer.register_channel(TOPIC, 'cdr', schema)

    def add(self, stamp_ns: int, pixels: Pixels) -> EncodedImage:
        """Append an image, (H, W, 3) uint8 in BGR order; return it as a reader would."""
        types = self._store.types
        _, jpeg = cv2.imencode('.jpg', pixels, [cv2.IMWRITE_JPEG_QUALITY, JPEG_QUALITY])
        stamp = types['builtin_interfaces/msg/Time'](*divmod(stamp_ns, 10**9))
        header = types['std_msgs/msg/Header'](stamp, FRAME_ID)
        data = np.asarray(jpeg, np.uint8).reshape(-1)
        message = types[COMPRESSED_IMAGE](header, 'jpeg', data)
        cdr = bytes(self._store.serialize_cdr(message, COMPRESSED_IMAGE))
        self._writer.add_message(self._channel, stamp_ns, cdr, stamp_ns)
        return EncodedImage(data, 'jpeg')

    def close(self) -> None:
        """Write the index, and close the file."""
        self._writer.finish()  # type: ignore[no-untyped-call]
        self._stream.close()


def check_record(path: Path) -> None:
    """Raise UnusableInput unless a file for images can be created."""
    if path.suffix != '.mcap':
        raise UnusableInput(f'{path} is no name of an mcap file; expected --record FILE.mcap')
    if path.exists():
        raise UnusableInput(f'{path} exists already; give another --record, or remove it')


def _opened(source: str) -> Capture:
    _check_present(source)
    return Capture(int(source) if source.isdecimal() else source, _refusal(source))


def _check_present(source: str) -> None:
    """Raise UnusableInput if a camera is not there, before OpenCV prints lines of its own."""
    if Path(source).is_file():
        raise UnusableInput(
            f'{source} is a file; expected a camera or the URL of a stream: use "ratslam replay '
            f'{source}"'
        )
    device = _device(source)
    if device is None or device.exists():
        return
    found = sorted(str(path) for path in Path('/dev').glob('video[0-9]*'))
    others = f'{", ".join(found)}: give one of them' if found else 'no camera: connect one'
    raise UnusableInput(
        f'camera {device} does not exist; this machine has {others}, or give the URL of a stream'
    )


def _refusal(source: str) -> str:
    """Return the error for a camera that OpenCV cannot open."""
    if source.isdecimal() or source.startswith('/dev/'):
        return (
            f'camera {_device(source) or source} cannot be opened; expected one that no other '
            'program uses, and that you may read (on Linux: group video); cameras also have '
            'devices without images: try another number'
        )
    return (
        f'{source} cannot be opened; expected the number of a camera or the URL of a stream that '
        'OpenCV can decode, such as rtsp://HOST/PATH: check it in a video player'
    )


def _device(source: str) -> Path | None:
    """Return the device of a camera on Linux; None elsewhere, and for a stream."""
    if sys.platform != 'linux':
        return None
    if source.isdecimal():
        return Path(f'/dev/video{source}')
    return Path(source) if source.startswith('/dev/') else None
