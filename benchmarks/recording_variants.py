# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Variants of a recording that show the same places, made while the recording is read."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace

import cv2
import numpy as np

from ratslam_ros.images import Image, Pixels
from ratslam_ros.recordings import Event, ImageEvent, OdometryEvent, Recording, Selection
from ratslam_ros.recordings.topics import ODOMETRY_TYPES


@dataclass(frozen=True)
class Variant:
    """A change of a recording.

    change: applied to the pixels of each image. every: every n-th image is kept. skip_s: length
    that is left out at the start. odometry: applied to each message of the odometry, and None if
    that is left out. has_odometry: whether the odometry is kept. from_ns: stamp of the first image
    that is changed. until_ns: stamp from which on everything is left out.
    """

    change: Callable[[Pixels], Pixels] = lambda pixels: pixels
    every: int = 1
    skip_s: float = 0.0
    odometry: Callable[[OdometryEvent], OdometryEvent | None] = lambda event: event
    has_odometry: bool = True
    from_ns: int = 0
    until_ns: int = 2**63 - 1


def _size(factor: float) -> Callable[[Pixels], Pixels]:
    kind = cv2.INTER_AREA if factor < 1.0 else cv2.INTER_LINEAR
    return lambda pixels: _pixels(
        cv2.resize(pixels, None, fx=factor, fy=factor, interpolation=kind)
    )


def _curve(change: Callable[[np.ndarray], np.ndarray]) -> Callable[[Pixels], Pixels]:
    """Return a map of grey levels; it changes (256,) values from 0 to 255."""
    table = _curved(change(np.arange(256.0)))
    return lambda pixels: table[pixels]


def _curved(values: np.ndarray) -> Pixels:
    return np.clip(np.rint(values), 0.0, 255.0).astype(np.uint8)


def _jpeg(quality: int) -> Callable[[Pixels], Pixels]:
    def change(pixels: Pixels) -> Pixels:
        _, data = cv2.imencode('.jpg', pixels, [cv2.IMWRITE_JPEG_QUALITY, quality])
        return _pixels(cv2.imdecode(data, cv2.IMREAD_UNCHANGED))

    return change


def _pixels(array: object) -> Pixels:
    return np.asarray(array, np.uint8)


def _noise(sd: float) -> Callable[[Pixels], Pixels]:
    def change(pixels: Pixels) -> Pixels:
        random = np.random.default_rng(int(pixels.sum()))  # the same for each reading
        return _curved(pixels + random.normal(0.0, sd, pixels.shape))

    return change


def _cropped(pixels: Pixels) -> Pixels:
    y, x = (max(size // 10, 1) for size in pixels.shape[:2])
    return np.ascontiguousarray(pixels[y : len(pixels) - y, x : pixels.shape[1] - x])


def _tilted(pixels: Pixels) -> Pixels:
    height, width = pixels.shape[:2]
    turn = cv2.getRotationMatrix2D((width / 2, height / 2), 5.0, 1.0)
    return _pixels(
        cv2.warpAffine(pixels, turn, (width, height), borderMode=cv2.BORDER_REPLICATE)
    )


def _covered(pixels: Pixels) -> Pixels:
    changed = pixels.copy()
    changed[len(pixels) * 4 // 5 :] = 0
    return changed


def _letterbox(pixels: Pixels) -> Pixels:
    border = max(len(pixels) // 6, 1)
    return _pixels(
        cv2.copyMakeBorder(pixels, border, border, 0, 0, cv2.BORDER_CONSTANT, value=0)
    )


def _mirrored(event: OdometryEvent) -> OdometryEvent:
    x, y, z, w = event.orientation
    return replace(
        event, angular_z=-event.angular_z, y=-event.y, linear_y=-event.linear_y,
        orientation=type(event.orientation)(-x, y, -z, w),
    )


def _twist(
    speed: float = 1.0, turn: float = 1.0, bias_radps: float = 0.0, speed_noise: float = 0.0,
    turn_noise_radps: float = 0.0, late_s: float = 0.0,
) -> Callable[[OdometryEvent], OdometryEvent]:
    """Return a change of velocities by factors, a bias and noise, and of stamps."""

    def change(event: OdometryEvent) -> OdometryEvent:
        first, second = np.random.default_rng(event.stamp_ns).normal(size=2).tolist()
        return replace(
            event, stamp_ns=event.stamp_ns + round(1e9 * late_s),
            linear_x=speed * event.linear_x * (1.0 + speed_noise * first),
            angular_z=turn * event.angular_z + bias_radps + turn_noise_radps * second,
        )

    return change


def _with_gaps(event: OdometryEvent) -> OdometryEvent | None:
    return None if event.stamp_ns // 10**9 % 20 == 7 else event


ORIGINAL, DOUBLE, CAMERA_ONLY = 'original', 'double size', 'camera only'

VARIANTS = {
    ORIGINAL: Variant(),
    'half size': Variant(_size(0.5)),
    DOUBLE: Variant(_size(2.0)),
    'JPEG quality 15': Variant(_jpeg(15)),
    'every second frame': Variant(every=2),
    'start 10 s later': Variant(skip_s=10.0),
    'mirrored': Variant(lambda pixels: _pixels(cv2.flip(pixels, 1)), odometry=_mirrored),
    'gamma 0.5': Variant(_curve(lambda grey: 255.0 * (grey / 255.0) ** 0.5)),
    'gamma 2': Variant(_curve(lambda grey: 255.0 * (grey / 255.0) ** 2)),
    'contrast 0.5': Variant(_curve(lambda grey: 127.5 + 0.5 * (grey - 127.5))),
    'brightness +50': Variant(_curve(lambda grey: grey + 50.0)),
    CAMERA_ONLY: Variant(has_odometry=False),
}

FURTHER = {
    'noise of 10 levels': Variant(_noise(10.0)),
    'blurred': Variant(
        lambda pixels: _pixels(cv2.GaussianBlur(pixels, (0, 0), max(pixels.shape[1] / 80, 1)))
    ),
    'cropped to 0.8': Variant(_cropped),
    'tilted by 5 deg': Variant(_tilted),
    'every third frame': Variant(every=3),
    'start 20 s later': Variant(skip_s=20.0),
    'lower fifth black': Variant(_covered),
    'letterbox': Variant(_letterbox),
    'width 1.5': Variant(lambda pixels: _pixels(cv2.resize(pixels, None, fx=1.5, fy=1.0))),
    '16 grey levels': Variant(_curve(lambda grey: 16.0 * (grey // 16.0) + 8.0)),
    'contrast 1.6': Variant(_curve(lambda grey: 127.5 + 1.6 * (grey - 127.5))),
    'brightness x0.15': Variant(_curve(lambda grey: 0.15 * grey)),
}
"""Variants that were not looked at before the program was finished, but the last, which changed
the inspection."""

OTHER_ODOMETRY = {
    'speed x3': Variant(odometry=_twist(speed=3.0)),
    'speed x0.2': Variant(odometry=_twist(speed=0.2)),
    'speed noise 20 %': Variant(odometry=_twist(speed_noise=0.2)),
    'turns x1.1': Variant(odometry=_twist(turn=1.1)),
    'turns x0.9': Variant(odometry=_twist(turn=0.9)),
    'turn bias 0.05/s': Variant(odometry=_twist(bias_radps=0.05)),
    'turn noise 0.5/s': Variant(odometry=_twist(turn_noise_radps=0.5)),
    'odometry 0.1 s late': Variant(odometry=_twist(late_s=0.1)),
    'odometry 0.1 s early': Variant(odometry=_twist(late_s=-0.1)),
    'odometry 0.3 s late': Variant(odometry=_twist(late_s=0.3)),
    'odometry 0.3 s early': Variant(odometry=_twist(late_s=-0.3)),
    'odometry gaps of 1 s': Variant(odometry=_with_gaps),
}
"""The same for recordings with odometry. Turns x0.9 and the delays changed the program."""

ALL = {**VARIANTS, **FURTHER, **OTHER_ODOMETRY}


@dataclass(frozen=True, slots=True)
class _ChangedImage:
    image: Image
    change: Callable[[Pixels], Pixels]

    @property
    def encoding(self) -> str:
        return self.image.encoding

    @property
    def is_depth(self) -> bool:
        return self.image.is_depth

    def grey(self, by: str = 'luma') -> Pixels:
        return self.change(self.image.grey(by))

    def bgr(self) -> Pixels:
        return self.change(self.image.bgr())


class ChangedRecording(Recording):
    """Images and odometry of another recording with a change."""

    def __init__(self, source: Recording, variant: Variant) -> None:
        super().__init__(source.path, source._warnings)
        self._source, self._variant = source, variant
        self.kind = source.kind
        left_out = frozenset() if variant.has_odometry else ODOMETRY_TYPES
        self.topics = tuple(topic for topic in source.topics if topic.type not in left_out)
        self.start_ns = source.start_ns + round(variant.skip_s * 1e9)
        self.end_ns = source.end_ns

    def read_events(self, selection: Selection, start_ns: int, stop_ns: int) -> Iterator[Event]:
        """Yield the changed events with start_ns <= log_ns < stop_ns."""
        variant, images = self._variant, 0
        # Read from the start, so that the same images are kept for every start_ns.
        for event in self._source.read_events(selection, self._source.start_ns, stop_ns):
            if isinstance(event, ImageEvent):
                images += 1
                if (images - 1) % variant.every:
                    continue
            if event.log_ns < start_ns or event.stamp_ns >= variant.until_ns:
                continue
            if isinstance(event, ImageEvent) and event.stamp_ns >= variant.from_ns:
                yield replace(event, image=_ChangedImage(event.image, variant.change))
            elif isinstance(event, OdometryEvent):
                if (changed := variant.odometry(event)) is not None:
                    yield changed
            else:
                yield event

    def close(self) -> None:
        """Close the files."""
        self._source.close()
