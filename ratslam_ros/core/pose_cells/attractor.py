# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The continuous attractor network of the pose cells, computed only where there is activity.

Activity lives in packets: boxes of cells that are too far apart to act on each other, each on a
lattice of its own that may lie anywhere between the cells (``frames``). Path integration moves
the lattice by the packet's mean motion, and shifts the cells only by what each heading plane
moves differently from that mean. A packet thus follows the odometry exactly at any speed, where
shifting the cells themselves would leave it pinned to the lattice by the competition
(algorithm.md, Tracking), and the cost follows the activity, not the size of the torus.

All arrays are ordered (theta, y, x).
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ratslam_ros.core.pose_cells.attractor_kernels import (
    compete,
    decode,
    extent,
    join,
    mass,
    move,
    tighten,
)

Cells = NDArray[np.float64]
Box = NDArray[np.int64]
Frame = NDArray[np.float64]
Dims = NDArray[np.int64]


class Packet(NamedTuple):
    """A box of activity that nothing outside it acts on; its arrays are never changed.

    ``cells``: (n_theta, n_y, n_x) activity. ``box``: (6,) first cell and number of cells on each
    axis, wrapping round the torus. ``frame``: (3,) where its lattice lies from the torus' own,
    in cells, -0.5 to 0.5.
    """

    cells: Cells
    box: Box
    frame: Frame


class Network:
    """The fixed part: extents of the torus, kernels, inhibition."""

    def __init__(
        self, dims: tuple[int, int, int], excitation: Cells, inhibition: Cells, cutoff: float
    ) -> None:
        """Describe a network.

        Args:
            dims: cells along theta, y and x.
            excitation: one axis of the excitatory kernel, odd length, summing to 1.
            inhibition: the same for the inhibitory one.
            cutoff: global inhibition, activity.
        """
        self.dims = np.array(dims, np.int64)
        self._w_e = excitation
        self._w_i = inhibition
        self._cutoff = cutoff
        # Two packets act on each other when, both excited, one is in the inhibition of the other;
        # one cell more for the difference of their lattices.
        self._reach = 2 * (len(excitation) // 2) + len(inhibition) // 2 + 1

    def start(self) -> list[Packet]:
        """Return all activity in the middle cell."""
        middle = [int(n) // 2 for n in self.dims]
        return [Packet(np.ones((1, 1, 1)), np.array([*middle, 1, 1, 1], np.int64), np.zeros(3))]

    def step(self, packets: list[Packet], chord: float, turn: float) -> list[Packet]:
        """Compete, normalise to a sum of 1, integrate one motion.

        Args:
            packets: the activity before.
            chord: way ahead, in cells; negative is back.
            turn: counter-clockwise, in planes; half of it comes before the way, half behind.
        """
        competed = []
        total = 0.0
        for p in packets:
            cells, box, part = compete(
                p.cells, p.box, self.dims, self._w_e, self._w_i, self._cutoff
            )
            if part > 0.0:
                competed += self._trimmed(Packet(cells, box, p.frame))
                total += part
        if not competed:  # nothing survived: keep the activity before
            competed = packets
            total = sum([mass(p.cells) for p in packets])
        moved = [Packet(*move(*p, self.dims, 1.0 / total, chord, turn)) for p in competed]
        return self._merged(moved)

    def inject(
        self, packets: list[Packet], theta: float, y: float, x: float, energy: float
    ) -> list[Packet]:
        """Add ``energy`` at a place in cells, spread over the eight cells around it."""
        place = np.array([theta, y, x])
        whole = np.floor(place)
        point = Packet(
            np.full((1, 1, 1), energy), np.array([*whole, 1, 1, 1], np.int64), place - whole
        )
        near = [p for p in packets if self._within_reach(p, point)]
        # What joins a packet is put onto that packet's lattice at once; else onto the torus'.
        frame = max(near, key=lambda p: mass(p.cells)).frame if near else np.zeros(3)
        spread = Packet(np.zeros((1, 1, 1)), point.box, frame)
        return self._merged([*packets, _joined(spread, point, self.dims)])

    def peak(self, packets: list[Packet]) -> tuple[float, float, float]:
        """Return theta, y and x, in cells, of the largest cell, refined by the +-3 box around."""
        largest = packets[0]
        if len(packets) > 1:
            largest = max(packets, key=lambda p: float(p.cells.max()))
        theta, y, x = decode(largest.cells, largest.box, largest.frame, self.dims)
        return theta, y, x

    def dense(self, packets: list[Packet]) -> Cells:
        """Return the activity of the whole torus, (n_theta, n_y, n_x), on the torus' lattice."""
        dims = self.dims
        whole = Packet(np.zeros(tuple(dims)), np.array([0, 0, 0, *dims], np.int64), np.zeros(3))
        for packet in packets:
            whole = _joined(whole, packet, dims)
        return np.roll(whole.cells, tuple(whole.box[:3]), (0, 1, 2))

    def projected(self, packets: list[Packet]) -> tuple[NDArray[np.int64], Cells]:
        """Return the activity summed over theta where there is any, on the torus' lattice.

        Returns:
            (n,) cells of the (y, x) plane, y * n_x + x, ascending, and (n,) their activity.
        """
        n_y, n_x = int(self.dims[1]), int(self.dims[2])
        cells: list[NDArray[np.int64]] = []
        shares: list[Cells] = []
        for packet in packets:
            # Onto the lattice by bilinear weights: as in ``dense``, but for the plane alone.
            plane = packet.cells.sum(axis=0)
            for axis, along in enumerate(packet.frame[1:]):
                part = float(along) % 1.0
                zero = np.zeros_like(plane.take([0], axis))
                plane = np.concatenate([plane, zero], axis) * (1.0 - part) + part * (
                    np.concatenate([zero, plane], axis)
                )
            low_y, low_x = np.floor(packet.frame[1:]).astype(np.int64) + packet.box[1:3]
            y = (low_y + np.arange(plane.shape[0])) % n_y
            x = (low_x + np.arange(plane.shape[1])) % n_x
            active = plane > 0.0
            cells.append((y[:, None] * n_x + x)[active])
            shares.append(plane[active])
        found, at = np.unique(np.concatenate(cells), return_inverse=True)
        activity = np.zeros(len(found))
        np.add.at(activity, at, np.concatenate(shares))
        return found, activity

    def _within_reach(self, a: Packet, b: Packet) -> bool:
        for axis in range(3):
            n = self.dims[axis]
            ahead = (b.box[axis] - a.box[axis]) % n
            behind = (a.box[axis] - b.box[axis]) % n
            if ahead >= a.box[3 + axis] + self._reach and behind >= b.box[3 + axis] + self._reach:
                return False
        return True

    def _merged(self, packets: list[Packet]) -> list[Packet]:
        """Join packets until none is within reach of another; the heavier keeps its lattice."""
        for i, a in enumerate(packets):
            for j in range(i + 1, len(packets)):
                b = packets[j]
                if self._within_reach(a, b):
                    keep, give = (a, b) if mass(a.cells) >= mass(b.cells) else (b, a)
                    rest = packets[:i] + packets[i + 1 : j] + packets[j + 1 :]
                    return self._merged([*rest, _joined(keep, give, self.dims)])
        return packets

    def _trimmed(self, packet: Packet) -> list[Packet]:
        """Cut a packet down to its active cells, and in two where it has fallen apart."""
        is_tight, cells, box = tighten(packet.cells, packet.box, self.dims, self._reach)
        if is_tight:
            return [Packet(cells, box, packet.frame)]
        extents = extent(cells)
        for axis in range(3):
            first, last, gap_start, gap = extents[axis]
            n = cells.shape[axis]
            if n == self.dims[axis]:
                around = first + n - 1 - last
                if gap > around:  # the longest gap is inside: open the circle there
                    cells = np.roll(cells, -(gap_start + gap), axis)
                    box = box.copy()
                    box[axis] += gap_start + gap
                    return self._trimmed(Packet(cells, box, packet.frame))
            if gap > self._reach:
                spans = (0, gap_start), (gap_start + gap, n - gap_start - gap)
                parts = [_slice(cells, box, packet.frame, axis, *span) for span in spans]
                return [trimmed for part in parts for trimmed in self._trimmed(part)]
        lows, highs = extents[:, 0], extents[:, 1] + 1
        box = box.copy()
        box[:3] += lows
        box[3:] = highs - lows
        inner = cells[lows[0] : highs[0], lows[1] : highs[1], lows[2] : highs[2]]
        return [Packet(np.ascontiguousarray(inner), box, packet.frame)]


def kernel(width: int, deviation: float) -> Cells:
    """Return one axis of a Gaussian cube, (width,) summing to 1; the cube is its outer product."""
    radius = width // 2
    steps = range(-radius, radius + 1)
    weights = [math.exp(-(k * k) / (2.0 * deviation * deviation)) for k in steps]
    return np.array(weights) / math.fsum(weights)


def _slice(
    cells: Cells, box: Box, frame: Frame, axis: int, first: int, length: int
) -> Packet:
    """Return the slices from ``first`` on along an axis as a packet."""
    index = [slice(None)] * 3
    index[axis] = slice(first, first + length)
    box = box.copy()
    box[axis] += first
    box[3 + axis] = length
    return Packet(np.ascontiguousarray(cells[tuple(index)]), box, frame)


def _joined(keep: Packet, give: Packet, dims: Dims) -> Packet:
    cells, box = join(*keep, *give, dims)
    return Packet(cells, box, keep.frame)
