# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Variants of a recording that show the same places, made while the recording is read."""

from __future__ import annotations

import math
import zlib
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace

import cv2
import numpy as np

from ratslam_ros.images import Image, Pixels
from ratslam_ros.recordings import Event, ImageEvent, OdometryEvent, Recording, Selection
from ratslam_ros.recordings.topics import ODOMETRY_TYPES


@dataclass(frozen=True)
class Variant:
    """A change of a recording.

    change: applied to the pixels of each image. every: every n-th image is kept. lost: share of
    the images that are lost at random. skip_s: length that is left out at the start. duration:
    factor of all times, but not of velocities. odometry: applied to each message of the odometry,
    and None if that is left out. has_odometry: whether the odometry is kept. from_ns: stamp of the
    first image that is changed. until_ns: stamp from which on everything is left out. cuts: start
    and end of intervals that are left out, in seconds from the start of the recording.
    """

    change: Callable[[Pixels], Pixels] = lambda pixels: pixels
    every: int = 1
    lost: float = 0.0
    skip_s: float = 0.0
    duration: float = 1.0
    odometry: Callable[[OdometryEvent], OdometryEvent | None] = lambda event: event
    has_odometry: bool = True
    from_ns: int = 0
    until_ns: int = 2**63 - 1
    cuts: Sequence[tuple[float, float]] = ()


def _size(factor: float, height: float = 1.0) -> Callable[[Pixels], Pixels]:
    kind = cv2.INTER_AREA if factor < 1.0 else cv2.INTER_LINEAR
    return lambda pixels: _pixels(
        cv2.resize(pixels, None, fx=factor, fy=factor * height, interpolation=kind)
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


def _blurred(share: float) -> Callable[[Pixels], Pixels]:
    return lambda pixels: _pixels(cv2.GaussianBlur(pixels, (0, 0), share * pixels.shape[1]))


def _cropped(left: float, right: float, top: float, bottom: float) -> Callable[[Pixels], Pixels]:
    def change(pixels: Pixels) -> Pixels:
        height, width = pixels.shape[:2]
        rows = slice(int(top * height), height - int(bottom * height))
        columns = slice(int(left * width), width - int(right * width))
        return np.ascontiguousarray(pixels[rows, columns])

    return change


def _tilted(angle_deg: float) -> Callable[[Pixels], Pixels]:
    def change(pixels: Pixels) -> Pixels:
        height, width = pixels.shape[:2]
        turn = cv2.getRotationMatrix2D((width / 2, height / 2), angle_deg, 1.0)
        return _pixels(
            cv2.warpAffine(pixels, turn, (width, height), borderMode=cv2.BORDER_REPLICATE)
        )

    return change


def _dark_corners(depth: float) -> Callable[[Pixels], Pixels]:
    def change(pixels: Pixels) -> Pixels:
        height, width = pixels.shape[:2]
        y, x = np.mgrid[-1 : 1 : height * 1j, -1 : 1 : width * 1j]
        light = 1.0 - depth * (x * x + y * y) / 2.0
        return _curved(pixels * light.reshape(height, width, *[1] * (pixels.ndim - 2)))

    return change


def _mirrored_pixels(pixels: Pixels) -> Pixels:
    return _pixels(cv2.flip(pixels, 1))


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
    'mirrored': Variant(_mirrored_pixels, odometry=_mirrored),
    'gamma 0.5': Variant(_curve(lambda grey: 255.0 * (grey / 255.0) ** 0.5)),
    'gamma 2': Variant(_curve(lambda grey: 255.0 * (grey / 255.0) ** 2)),
    'contrast 0.5': Variant(_curve(lambda grey: 127.5 + 0.5 * (grey - 127.5))),
    'brightness +50': Variant(_curve(lambda grey: grey + 50.0)),
    CAMERA_ONLY: Variant(has_odometry=False),
}

DRAWN = 'drawn '
"""Start of the names of drawn variants; a number follows."""

DRAWN_COUNT = 3
"""Number of changes that are drawn."""


def variant_of(name: str, recording: str, has_odometry: bool) -> tuple[Variant, str]:
    """Return a variant of a recording, and what it changes; has_odometry: of the recording."""
    if not name.startswith(DRAWN):
        return VARIANTS[name], name
    rng = np.random.default_rng([int(name.removeprefix(DRAWN)), zlib.crc32(recording.encode())])
    images, odometry = _changes(rng.uniform)
    changes = [*images, *(odometry if has_odometry else ())]
    chosen = [changes[k] for k in rng.choice(len(changes), DRAWN_COUNT, replace=False)]
    return _together([change for change, _ in chosen]), ', '.join(text for _, text in chosen)


def _changes(
    draw: Callable[[float, float], float]
) -> tuple[list[tuple[Variant, str]], list[tuple[Variant, str]]]:
    """Draw the sizes of all changes of images and times, and of all those of the odometry."""
    gamma, size, height = 2.0 ** draw(-1, 1), 2.0 ** draw(-1, 1), 2.0 ** draw(-0.5, 0.5)
    contrast, brightness, duration = draw(0.5, 1.5), draw(-30, 30), 2.0 ** draw(-1, 1)
    edges = [draw(0, 0.12) for _ in range(4)]
    blur, tilt, corners, noise = draw(0.003, 0.015), draw(-5, 5), draw(0.3, 0.9), draw(2, 10)
    quality, skip_s, lost, levels = int(draw(15, 60)), draw(1, 25), draw(0.05, 0.3), draw(8, 32)
    speed, turn, speed_noise = 2.0 ** draw(-2, 2), draw(0.9, 1.1), draw(0.05, 0.3)
    bias_radps, turn_noise_radps, late_s = draw(-0.05, 0.05), draw(0.05, 0.3), draw(-0.2, 0.2)
    return [
        (Variant(_curve(lambda grey: 255.0 * (grey / 255.0) ** gamma)), f'gamma {gamma:.2f}'),
        (Variant(_curve(lambda grey: 127.5 + contrast * (grey - 127.5) + brightness)),
         f'contrast {contrast:.2f} and brightness {brightness:+.0f}'),
        (Variant(_curve(lambda grey: levels * (grey // levels + 0.5))), f'steps of {levels:.0f}'),
        (Variant(_size(size, height)), f'size {size:.2f} by {size * height:.2f}'),
        (Variant(_cropped(*edges)), 'edges ' + ' '.join(f'{edge:.2f}' for edge in edges)),
        (Variant(_blurred(blur)), f'blur {blur:.3f}'),
        (Variant(_tilted(tilt)), f'tilt {tilt:.1f} deg'),
        (Variant(_dark_corners(corners)), f'corners darker by {corners:.2f}'),
        (Variant(_noise(noise)), f'noise {noise:.1f}'),
        (Variant(_jpeg(quality)), f'JPEG quality {quality}'),
        (VARIANTS['mirrored'], 'mirrored'),
        (VARIANTS['every second frame'], 'every second frame'),
        (Variant(lost=lost), f'{lost:.2f} of the images lost'),
        (Variant(skip_s=skip_s), f'start {skip_s:.0f} s later'),
        (Variant(duration=duration, odometry=_twist(1.0 / duration, 1.0 / duration)),
         f'duration x{duration:.2f}'),
    ], [
        (Variant(odometry=_twist(speed=speed)), f'speed x{speed:.2f}'),
        (Variant(odometry=_twist(turn=turn)), f'turns x{turn:.2f}'),
        (Variant(odometry=_twist(bias_radps=bias_radps)), f'turn rate {bias_radps:+.2f} rad/s'),
        (Variant(odometry=_twist(speed_noise=speed_noise)), f'speed noise {speed_noise:.2f}'),
        (Variant(odometry=_twist(turn_noise_radps=turn_noise_radps)),
         f'turn noise {turn_noise_radps:.2f} rad/s'),
        (Variant(odometry=_twist(late_s=late_s)), f'odometry late by {late_s:.2f} s'),
        (Variant(odometry=_with_gaps), 'odometry with gaps of 1 s'),
    ]


def _together(variants: Sequence[Variant]) -> Variant:
    def change(pixels: Pixels) -> Pixels:
        for one in variants:
            pixels = one.change(pixels)
        return pixels

    def odometry(event: OdometryEvent) -> OdometryEvent | None:
        changed: OdometryEvent | None = event
        for one in variants:
            changed = changed and one.odometry(changed)
        return changed

    return Variant(
        change, math.prod(one.every for one in variants), sum(one.lost for one in variants),
        sum(one.skip_s for one in variants), math.prod(one.duration for one in variants), odometry,
    )


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
        self.start_ns = self.stamp_ns(source.start_ns + round(variant.skip_s * 1e9))
        self.end_ns = self.stamp_ns(source.end_ns)

    def stamp_ns(self, stamp_ns: int) -> int:
        """Return the stamp that a stamp of the source is changed to."""
        start_ns, duration = self._source.start_ns, self._variant.duration
        return start_ns + round(duration * (stamp_ns - start_ns))

    def read_events(self, selection: Selection, start_ns: int, stop_ns: int) -> Iterator[Event]:
        """Yield the changed events with start_ns <= log_ns < stop_ns."""
        variant, images = self._variant, 0
        random = np.random.default_rng(1)
        # Read from the start, so that the same images are kept for every start_ns.
        source = self._source
        for event in source.read_events(selection, source.start_ns, source.end_ns + 1):
            time_s = (event.log_ns - source.start_ns) * 1e-9
            if any(start_s <= time_s < end_s for start_s, end_s in variant.cuts):
                continue
            if isinstance(event, ImageEvent):
                images += 1
                if random.random() < variant.lost or (images - 1) % variant.every:
                    continue
            event = replace(
                event, stamp_ns=self.stamp_ns(event.stamp_ns), log_ns=self.stamp_ns(event.log_ns)
            )
            if event.log_ns >= stop_ns:
                return
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
