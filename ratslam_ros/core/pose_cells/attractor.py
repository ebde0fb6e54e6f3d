# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Continuous attractor network of the pose cells, computed only where there is activity.

The activity consists of packets: boxes of cells too far apart to interact. Each packet has its own
lattice, offset from the lattice of the torus by its frame. Path integration moves the lattice by
the mean motion of the packet, and shifts the cells only by the difference of each heading plane
from that mean. A packet therefore follows the odometry exactly at any speed, whereas the
competition pins a packet on a fixed lattice to its cells. The cost of a step depends on the amount
of activity, not on the size of the torus.

With a fixed lattice, as published, all frames are 0, and path integration shifts the cells: the
packets are then the parts of one matrix of cells that are active.

All arrays are ordered (theta, y, x).
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from ratslam_ros.core.pose_cells.competition_kernels import compete
from ratslam_ros.core.pose_cells.packet import Packet
from ratslam_ros.core.pose_cells.packet_kernels import (
    Box,
    Cells,
    Dims,
    Frame,
    are_near,
    cell_of,
    decode,
    extent,
    mass,
    merge,
    move,
    point,
)


class Network:
    """The extents, kernels and inhibition of a network; callers hold the activity."""

    def __init__(
        self, dims: tuple[int, int, int], excitation: Cells, inhibition: Cells, cutoff: float,
        is_fixed: bool = False,
    ) -> None:
        """Describe a network.

        Args:
            dims: number of cells along theta, y and x.
            excitation: one axis of the excitatory kernel, of odd length and with a sum of 1.
            inhibition: one axis of the inhibitory kernel, likewise.
            cutoff: global inhibition: activity subtracted from every cell.
            is_fixed: whether the lattices of packets stay on that of the torus.
        """
        self.dims = np.array(dims, np.int64)
        self._w_e = excitation
        self._w_i = inhibition
        self._cutoff = cutoff
        self._is_fixed = is_fixed
        # Two packets interact if, after excitation of both, one lies within the inhibition of the
        # other. The additional cell covers the offset between their lattices.
        self._reach = 2 * (len(excitation) // 2) + len(inhibition) // 2 + 1

    def start(self) -> list[Packet]:
        """Return the initial activity: 1 in the middle cell."""
        middle = [int(n) // 2 for n in self.dims]
        return [Packet(np.ones((1, 1, 1)), np.array([*middle, 1, 1, 1], np.int64), np.zeros(3))]

    def step(
        self, packets: list[Packet], chord: float, turn: float, course: float = 0.0
    ) -> list[Packet]:
        """Apply the competition, normalise the activity to a sum of 1 and integrate one motion.

        Args:
            packets: the activity.
            chord: distance ahead in cells; negative is backwards.
            turn: counter-clockwise turn in planes, half before and half after the translation.
            course: direction of the translation relative to the heading, in planes.

        Returns:
            The new activity.
        """
        competed = []
        total = 0.0
        for p in packets:
            is_tight, cells, box, part = compete(
                p.cells, p.box, self.dims, self._w_e, self._w_i, self._cutoff, self._reach
            )
            if part > 0.0:
                packet = Packet(cells, box, p.frame)
                competed += [packet] if is_tight else self._trimmed(packet)
                total += part
        if not competed:  # no activity survived: skip the competition
            competed = packets
            total = sum([mass(p.cells) for p in packets])
        moved = [
            Packet(*move(*p, self.dims, 1.0 / total, chord, turn, course, self._is_fixed))
            for p in competed
        ]
        return self._merged(moved)

    def inject(
        self, packets: list[Packet], theta: float, y: float, x: float, energy: float,
        interpolate: bool = True,
    ) -> list[Packet]:
        """Add ``energy`` at a place in cells.

        It is distributed over the eight cells around the place, or else given to the nearest one.
        """
        cell = cell_of(theta, y, x)
        near = [p for p in packets if are_near(p.box, cell, self.dims, self._reach)]
        # Resample directly onto the lattice of the packet that it will be merged with, if any.
        frame = max(near, key=lambda p: mass(p.cells)).frame if near else np.zeros(3)
        if interpolate:
            added = Packet(*point(theta, y, x, energy, frame, self.dims), frame)
        else:
            nearest = np.rint(np.array([theta, y, x]) - frame).astype(np.int64) % self.dims
            box = np.concatenate((nearest, np.ones(3, np.int64)))
            added = Packet(np.full((1, 1, 1), energy), box, frame)
        return self._merged([*packets, added])

    def add(
        self, packets: list[Packet], cells: NDArray[np.int64], activity: Cells
    ) -> list[Packet]:
        """Add activity to cells of the torus.

        Args:
            packets: the activity.
            cells: (n, 3) theta, y and x; at least one.
            activity: (n,) what is added, above 0.
        """
        whole = np.zeros(tuple(self.dims))
        whole[tuple(cells.T)] = activity
        box = np.array([0, 0, 0, *self.dims], np.int64)
        return self._merged([*packets, *self._trimmed(Packet(whole, box, np.zeros(3)))])

    def displaced(self, packet: Packet, y: float, x: float) -> Packet:
        """Return a packet moved by y and x, in cells."""
        frame = packet.frame + np.array([0.0, y, x])
        whole = np.rint(frame)
        box = packet.box.copy()
        box[:3] = (box[:3] + whole.astype(np.int64)) % self.dims
        moved = Packet(packet.cells, box, frame - whole)
        if self._is_fixed:
            none = Packet(np.zeros((1, 1, 1)), np.array([*box[:3], 1, 1, 1]), np.zeros(3))
            return _merge_pair(none, moved, self.dims)
        return moved

    def peak(self, packets: list[Packet]) -> tuple[float, float, float]:
        """Return theta, y and x, in cells, of the peak of the packet with the largest cell."""
        largest = packets[0]
        if len(packets) > 1:
            largest = max(packets, key=lambda p: float(p.cells.max()))
        theta, y, x = decode(largest.cells, largest.box, largest.frame, self.dims)
        return theta, y, x

    def dense(self, packets: list[Packet]) -> Cells:
        """Resample all packets onto the lattice of the torus; return (n_theta, n_y, n_x)."""
        dims = self.dims
        whole = Packet(np.zeros(tuple(dims)), np.array([0, 0, 0, *dims], np.int64), np.zeros(3))
        for packet in packets:
            whole = _merge_pair(whole, packet, dims)
        return np.roll(whole.cells, tuple(whole.box[:3]), (0, 1, 2))

    def projected(self, packets: list[Packet]) -> tuple[NDArray[np.int64], Cells]:
        """Sum the activity over theta, on the lattice of the torus.

        Bilinear interpolation of the plane equals the trilinear one of ``dense``, summed.

        Returns:
            (n,) cell numbers y * n_x + x of the active cells, ascending, and (n,) their activity.
        """
        return self._sampled([p.cells.sum(axis=0) for p in packets], packets, 1)

    def active(self, packets: list[Packet]) -> tuple[NDArray[np.int64], Cells]:
        """Resample all packets onto the lattice of the torus, without allocating the torus.

        Returns:
            (n, 3) theta, y and x of the active cells, ascending, and (n,) their activity.
        """
        found, activity = self._sampled([p.cells for p in packets], packets, 0)
        return np.stack(np.unravel_index(found, tuple(self.dims)), axis=1), activity

    def _sampled(
        self, cells: list[Cells], packets: list[Packet], axis: int
    ) -> tuple[NDArray[np.int64], Cells]:
        """Interpolate the activity of packets, along the axes from ``axis`` on."""
        dims = self.dims[axis:]
        numbers: list[NDArray[np.int64]] = []
        shares: list[Cells] = []
        for own, packet in zip(cells, packets, strict=True):
            frame = packet.frame[axis:]
            box = _resampled(own, frame)
            at = np.argwhere(box > 0.0)
            low = np.floor(frame).astype(np.int64) + packet.box[axis:3]
            numbers.append(np.ravel_multi_index(((low + at) % dims).T, tuple(dims)))
            shares.append(box[tuple(at.T)])
        found = np.concatenate(numbers)
        if np.all(found[1:] > found[:-1]):  # a packet alone, within the edges of the torus
            return found, np.concatenate(shares)
        found, rows = np.unique(found, return_inverse=True)
        return found, np.asarray(np.bincount(rows, np.concatenate(shares)), np.float64)

    def places(self, packets: list[Packet]) -> NDArray[np.float64]:
        """Return theta, y and x of the peak of each packet, and its total activity, (m, 4)."""
        return np.array(
            [(*decode(*p, self.dims), mass(p.cells)) for p in packets], np.float64
        ).reshape(-1, 4)

    def _merged(self, packets: list[Packet]) -> list[Packet]:
        """Merge packets within reach of each other; the stronger one keeps its lattice."""
        for i, a in enumerate(packets):
            for j in range(i + 1, len(packets)):
                b = packets[j]
                if are_near(a.box, b.box, self.dims, self._reach):
                    keep, give = (a, b) if mass(a.cells) >= mass(b.cells) else (b, a)
                    rest = packets[:i] + packets[i + 1 : j] + packets[j + 1 :]
                    return self._merged([*rest, _merge_pair(keep, give, self.dims)])
        return packets

    def _trimmed(self, packet: Packet) -> list[Packet]:
        """Crop a packet to its active cells, and split it at gaps longer than the reach."""
        cells, box, frame = packet
        extents = extent(cells)
        for axis in range(3):
            first, last, gap_start, gap = extents[axis]
            n = cells.shape[axis]
            if n == self.dims[axis]:
                around = first + n - 1 - last
                if gap > around:  # the longest gap is inside: move it to the end of the box
                    cells = np.roll(cells, -(gap_start + gap), axis)
                    box = box.copy()
                    box[axis] += gap_start + gap
                    return self._trimmed(Packet(cells, box, frame))
            if gap > self._reach:
                spans = (0, gap_start), (gap_start + gap, n - gap_start - gap)
                parts = [_slice(cells, box, frame, axis, *span) for span in spans]
                return [trimmed for part in parts for trimmed in self._trimmed(part)]
        lows, highs = extents[:, 0], extents[:, 1] + 1
        box = box.copy()
        box[:3] += lows
        box[3:] = highs - lows
        inner = cells[lows[0] : highs[0], lows[1] : highs[1], lows[2] : highs[2]]
        return [Packet(np.ascontiguousarray(inner), box, frame)]


def kernel(width: int, deviation: float) -> Cells:
    """Return one axis of a separable Gaussian kernel: (width,) with a sum of 1."""
    radius = width // 2
    steps = range(-radius, radius + 1)
    weights = [math.exp(-(k * k) / (2.0 * deviation * deviation)) for k in steps]
    return np.array(weights) / math.fsum(weights)


def _resampled(cells: Cells, frame: NDArray[np.float64]) -> Cells:
    """Interpolate activity linearly onto the lattice of the torus; each axis gains a cell.

    The first cell of the result is that of the box, moved by the whole part of ``frame``.
    """
    for axis, along in enumerate(frame):
        part = float(along) % 1.0
        zero = np.zeros_like(cells.take([0], axis))
        cells = np.concatenate([cells, zero], axis) * (1.0 - part) + part * (
            np.concatenate([zero, cells], axis)
        )
    return cells


def _slice(
    cells: Cells, box: Box, frame: Frame, axis: int, first: int, length: int
) -> Packet:
    """Return ``length`` slices along an axis, from ``first``, as a packet."""
    index = [slice(None)] * 3
    index[axis] = slice(first, first + length)
    box = box.copy()
    box[axis] += first
    box[3 + axis] = length
    return Packet(np.ascontiguousarray(cells[tuple(index)]), box, frame)


def _merge_pair(keep: Packet, give: Packet, dims: Dims) -> Packet:
    cells, box = merge(*keep, *give, dims)
    return Packet(cells, box, keep.frame)
