# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""A simulated town of unlimited size: streets on a grid, a drive through them, and a camera.

Only a set of facades is stored. Whether a lot is built on, and the height, facade and colour of
its building, are hashes of its position and the seed. Images are in perspective, with one ray per
column, rendered at half size.
"""

from __future__ import annotations

import math
import time
from array import array
from collections import defaultdict
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
from numba import njit
from numpy.typing import NDArray

Pixels = NDArray[np.uint8]
Passage = tuple[int, int, int, int]
"""A section of a drive past a junction: the junction's column and row, and the headings before and
after it in quarter turns. The heading after is -1 before the turn, the heading before -1 after it.
"""

FACADES, TEXELS, BLUR_LEVELS = 64, 64, 6
"""Number of facades, their side in texels, and their blur levels."""

REACH_LOTS = 40
"""Range of vision, in sides of a lot."""


@dataclass(frozen=True)
class Town:
    """Dimensions of the town and properties of the drive; the defaults suit a car in a suburb.

    lot_m: side of a lot
    block, street: lots along a block and across a street
    eye_m: height of the camera
    fov_deg: horizontal field of view
    lane_m: lateral offset of the lane to the left of the middle of the street
    corner_m: radius of turns
    columns: junctions along each side of the town, 0 for an unlimited town
    speed_mps, turning_mps, brake_mps2: speed on straights and in curves, and deceleration
    sway_m: variation of the lateral offset
    light: relative variation of the brightness
    known: weight of a street driven before relative to a new one, in the choice at a junction
    """

    lot_m: float = 8.0
    block: int = 18
    street: int = 2
    eye_m: float = 1.5
    fov_deg: float = 53.0
    lane_m: float = 3.0
    corner_m: float = 10.0
    columns: int = 7
    speed_mps: float = 14.0
    turning_mps: float = 5.0
    brake_mps2: float = 2.5
    sway_m: float = 0.35
    light: float = 0.15
    known: float = 8.0

    @property
    def pitch_m(self) -> float:
        """Distance between neighbouring junctions."""
        return (self.block + self.street) * self.lot_m


@dataclass(frozen=True, slots=True)
class At:
    """State of the camera: pose, speeds, section, and number of its earlier passages."""

    x_m: float
    y_m: float
    heading_rad: float
    speed_mps: float
    turn_radps: float
    passage: Passage
    times_before: int


def drive(town: Town, seed: int, step_s: float) -> Iterator[At]:
    """Yield the states of an endless drive, which prefers known streets and never turns back."""
    rng = np.random.default_rng(seed)
    sway = _Wave(rng, town.sway_m, (7.0, 23.0, 61.0))
    driven: defaultdict[Passage, int] = defaultdict(int)
    half_m, along_m, now_s = town.pitch_m / 2.0, 0.0, 0.0
    column = row = max(town.columns // 2, 0)
    heading = 0
    while True:
        turn = _turn(town, rng, driven, column, row, heading)
        after = (heading + turn) % 4
        parts = (column, row, heading, -1), (column, row, heading, after), (column, row, -1, after)
        before = [driven[part] for part in parts]
        bend_m = town.corner_m * (math.pi / 2.0 if turn else 2.0)
        bends = half_m - town.corner_m, half_m - town.corner_m + bend_m
        while along_m < bends[1] + half_m - town.corner_m:
            part = (along_m >= bends[0]) + (along_m >= bends[1])
            to_bend_m = max(bends[0] - along_m, along_m - bends[1], 0.0)
            speed = math.sqrt(town.turning_mps**2 + 2.0 * town.brake_mps2 * to_bend_m)
            speed = min(speed, town.speed_mps) if turn else town.speed_mps
            x, y, facing = _on_way(town, column, row, heading, turn, along_m, bends)
            left = town.lane_m + sway(now_s)
            yield At(
                x - left * math.sin(facing), y + left * math.cos(facing), facing, speed,
                turn * speed / town.corner_m if turn and part == 1 else 0.0,
                parts[part], before[part],
            )
            along_m += speed * step_s
            now_s += step_s
        along_m -= bends[1] + half_m - town.corner_m
        for passed in parts:
            driven[passed] += 1
        heading = after
        column += (1, 0, -1, 0)[heading]
        row += (0, 1, 0, -1)[heading]


class Camera:
    """Renders colour images with varying brightness and pixel noise."""

    def __init__(self, town: Town, seed: int, width: int, height: int) -> None:
        rng = np.random.default_rng((seed, 1))
        self._town = town
        self._facades = _facades(rng)
        self._ground = _ground(rng)
        self._light = _Wave(rng, town.light, (11.0, 41.0, 301.0))
        self._small = np.empty((height // 2, width // 2, 3), np.uint8)
        self._size = width, height
        self._seed = seed

    def take(self, at: At, stamp_s: float, out: Pixels) -> None:
        """Render a view into ``out``, (height, width, 3) uint8 in BGR."""
        town = self._town
        _render(
            self._facades, self._ground, self._seed, town.lot_m, town.block, town.street,
            town.eye_m, math.radians(town.fov_deg), at.x_m, at.y_m, at.heading_rad,
            1.0 + self._light(stamp_s), np.uint64(round(stamp_s * 1e6)), self._small,
        )
        cv2.resize(self._small, self._size, out, interpolation=cv2.INTER_LINEAR)


class Laps:
    """Stopwatch that keeps every duration by step, with the interface of StepTimes."""

    def __init__(self) -> None:
        self.s: defaultdict[str, array[float]] = defaultdict(lambda: array('d'))

    @contextmanager
    def __call__(self, step: str) -> Iterator[None]:
        """Measure the duration of the context as one of a step."""
        start_s = time.perf_counter()
        yield
        self.s[step].append(time.perf_counter() - start_s)


def resident_mb() -> float:
    """Return the resident memory of this process in MB; Linux only."""
    pages = int(Path('/proc/self/statm').read_text().split()[1])
    return pages * 4096 / 2**20


class _Wave:
    """A sum of sines with random phases, as a function of time."""

    def __init__(self, rng: np.random.Generator, amplitude: float, periods_s: tuple[float, ...]):
        self._terms = [(2.0 * math.pi / period, rng.uniform(0.0, 6.3)) for period in periods_s]
        self._share = amplitude / len(periods_s)

    def __call__(self, at_s: float) -> float:
        return self._share * sum(math.sin(w * at_s + phase) for w, phase in self._terms)


def _turn(
    town: Town, rng: np.random.Generator, driven: defaultdict[Passage, int],
    column: int, row: int, heading: int,
) -> int:
    """Draw the turn at a junction: -1 for right, 0 for straight on, 1 for left."""
    turns, weights = [], []
    for turn in (-1, 0, 1):
        after = (heading + turn) % 4
        to = column + (1, 0, -1, 0)[after], row + (0, 1, 0, -1)[after]
        if town.columns == 0 or all(0 <= n < town.columns for n in to):
            turns.append(turn)
            weights.append(town.known if driven[column, row, -1, after] else 1.0)
    return int(rng.choice(turns, p=np.array(weights) / sum(weights)))


def _on_way(
    town: Town, column: int, row: int, heading: int, turn: int, along_m: float,
    bends: tuple[float, float],
) -> tuple[float, float, float]:
    """Return x, y and heading on the centre line, from half a block before a junction on."""
    radius = town.corner_m
    bent = min(max(along_m - bends[0], 0.0), bends[1] - bends[0])
    ahead, left, angle = min(along_m, bends[0]) - town.pitch_m / 2.0, 0.0, 0.0
    if turn == 0:
        ahead += bent
    else:
        angle = turn * bent / radius
        ahead += radius * math.sin(abs(angle))
        left += turn * radius * (1.0 - math.cos(angle))
    beyond = max(along_m - bends[1], 0.0)
    ahead += beyond * math.cos(angle)
    left += beyond * math.sin(angle)
    facing = heading * math.pi / 2.0
    c, s = math.cos(facing), math.sin(facing)
    middle_m = town.street * town.lot_m / 2.0
    return (
        column * town.pitch_m + middle_m + c * ahead - s * left,
        row * town.pitch_m + middle_m + s * ahead + c * left,
        facing + angle,
    )


def _facades(rng: np.random.Generator) -> NDArray[np.float32]:
    """Paint facades at random: (levels, facades, v from the ground up, u), 0 to 1."""
    sharp = np.empty((FACADES, TEXELS, TEXELS), np.float32)
    for facade in sharp:
        facade[:] = rng.uniform(0.3, 1.0)
        for size in (40, 24, 24, 16, 16, 12, 12, 12, 8, 8, 8, 8, 5, 5, 5, 5):
            v, u = rng.integers(-4, TEXELS - 4, 2)
            h, w = rng.integers(size // 2, size + 1, 2)
            facade[max(v, 0) : v + h, max(u, 0) : u + w] = rng.uniform(0.0, 1.0)
    levels = [[cv2.blur(facade, (2**k, 2**k)) for facade in sharp] for k in range(BLUR_LEVELS)]
    return np.array(levels, np.float32)


def _ground(rng: np.random.Generator) -> NDArray[np.float32]:
    """Paint 256 x 256 texels of ground with patches of several sizes, periodic at the edges."""
    out = np.zeros((256, 256), np.float32)
    for cells, amplitude in ((16, 0.2), (64, 0.08), (256, 0.03)):
        patches = rng.uniform(-amplitude, amplitude, (cells, cells)).astype(np.float32)
        wide = np.pad(patches, 1, mode='wrap')
        scale = 256 // cells
        grown = cv2.resize(wide, None, fx=scale, fy=scale, interpolation=cv2.INTER_LINEAR)
        out += grown[scale:-scale, scale:-scale]
    return out


@njit(cache=True)
def _hash(seed, a, b):  # type: ignore[no-untyped-def]
    """Return a 64-bit hash of a position, with the mixing function of SplitMix64."""
    z = np.uint64(seed) * np.uint64(0x9E3779B97F4A7C15)
    z += np.uint64(a) * np.uint64(0xD1B54A32D192ED03)
    z += np.uint64(b) * np.uint64(0x8CB92BA72F3D8DD7)
    z = (z ^ (z >> np.uint64(30))) * np.uint64(0xBF58476D1CE4E5B9)
    z = (z ^ (z >> np.uint64(27))) * np.uint64(0x94D049BB133111EB)
    return z ^ (z >> np.uint64(31))


@njit(cache=True)
def _built(seed, column, row, block, street):  # type: ignore[no-untyped-def]
    """Return whether a lot is built on: never in a street, mostly near one, always further in."""
    a = column % (block + street) - street
    b = row % (block + street) - street
    if a < 0 or b < 0:
        return False
    deep = min(min(a, block - 1 - a), min(b, block - 1 - b))
    if deep > 1:
        return True
    share = 0.55 if deep == 0 else 0.7
    return (_hash(seed, column, row) & np.uint64(1023)) < share * 1024


@njit(cache=True, nogil=True)
def _render(  # type: ignore[no-untyped-def]
    facades, ground, seed, lot_m, block, street, eye_m, fov_rad, x_m, y_m, heading_rad, gain, key,
    image,
):
    height, width, _ = image.shape
    focal_px = width / 2 / math.tan(fov_rad / 2)
    texel_m = lot_m / TEXELS
    reach_m = REACH_LOTS * lot_m
    forward_x, forward_y = math.cos(heading_rad), math.sin(heading_rad)
    noise = key * np.uint64(0x9E3779B97F4A7C15) | np.uint64(1)
    for i in range(width):
        # The forward component of each ray is 1, so that its length parameter is the depth.
        left = (width / 2 - i - 0.5) / focal_px
        ray_x, ray_y = forward_x - left * forward_y, forward_y + left * forward_x
        column, row = math.floor(x_m / lot_m), math.floor(y_m / lot_m)
        step_x, step_y = (1 if ray_x > 0 else -1), (1 if ray_y > 0 else -1)
        gap_x, gap_y = lot_m / max(abs(ray_x), 1e-9), lot_m / max(abs(ray_y), 1e-9)
        next_x = abs((column + (step_x > 0)) * lot_m - x_m) / max(abs(ray_x), 1e-9)
        next_y = abs((row + (step_y > 0)) * lot_m - y_m) / max(abs(ray_y), 1e-9)
        depth, of_x, hit = 0.0, True, False
        while depth < reach_m:
            of_x = next_x < next_y
            if of_x:
                depth = next_x
                next_x += gap_x
                column += step_x
            else:
                depth = next_y
                next_y += gap_y
                row += step_y
            if _built(seed, column, row, block, street):
                hit = True
                break
        lot = _hash(seed + 1, column, row)
        facade = np.int64(lot & np.uint64(FACADES - 1))
        high_m = lot_m * (0.2 + 1.2 * np.float64((lot >> np.uint64(8)) & np.uint64(255)) / 255.0)
        shade = 0.06 + 0.94 * np.float64((lot >> np.uint64(16)) & np.uint64(255)) / 255.0
        along = (y_m + depth * ray_y if of_x else x_m + depth * ray_x) / lot_m
        u = np.int64((along - math.floor(along)) * TEXELS) & (TEXELS - 1)
        slant = max(abs(ray_x) if of_x else abs(ray_y), 0.02)
        covered = depth * (1.0 + left * left) / (focal_px * slant * texel_m)
        level = min(np.int64(math.log2(max(covered, 1.0)) + 0.5), BLUR_LEVELS - 1)
        haze = min(depth / reach_m, 1.0) if hit else 1.0
        if not of_x:
            shade *= 0.8  # makes corners visible
        for j in range(height):
            up = (height / 2 - j - 0.5) / focal_px
            z_m = eye_m + up * depth
            red, green, blue = 0.85, 0.9, 1.0  # the sky
            if z_m < 0.0:
                far_m = -eye_m / up
                lots_x, lots_y = (x_m + far_m * ray_x) / lot_m, (y_m + far_m * ray_y) / lot_m
                on_x, on_y = math.floor(lots_x), math.floor(lots_y)
                green = 0.3
                if on_x % (block + street) >= street and on_y % (block + street) >= street:
                    green = 0.05 + 0.6 * (_hash(seed + 2, on_x, on_y) & np.uint64(255)) / 255.0
                patch = ground[int(lots_y * 32.0) & 255, int(lots_x * 32.0) & 255]
                green += patch * (1.0 - min(far_m / reach_m, 1.0))
                red, blue = green * 1.02, green * 0.97
            elif hit and z_m < high_m:
                v = np.int64(z_m / texel_m) & (TEXELS - 1)
                light = shade * facades[level, facade, v, u] * (1.0 - haze)
                red = light * (0.7 + 0.3 * np.float64((lot >> np.uint64(24)) & np.uint64(1)))
                green = light
                blue = light * (0.7 + 0.3 * np.float64((lot >> np.uint64(25)) & np.uint64(1)))
                red, green, blue = red + 0.8 * haze, green + 0.85 * haze, blue + 0.9 * haze
            noise ^= noise << np.uint64(13)
            noise ^= noise >> np.uint64(7)
            noise ^= noise << np.uint64(17)
            grain = np.float64(noise & np.uint64(15)) - 7.0
            scale = 235.0 * gain
            image[j, i, 0] = np.uint8(min(max(scale * blue + grain, 0.0), 255.0))
            image[j, i, 1] = np.uint8(min(max(scale * green + grain, 0.0), 255.0))
            image[j, i, 2] = np.uint8(min(max(scale * red + grain, 0.0), 255.0))
