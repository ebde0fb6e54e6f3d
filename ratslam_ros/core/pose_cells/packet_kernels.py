# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Compiled operations on one packet of activity: cropping, motion, resampling, decoding."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from ratslam_ros.core.common.compiled import compiled

Cells = NDArray[np.float64]
"""(n_theta, n_y, n_x) activity."""
Box = NDArray[np.int64]
"""(6,) first cell and number of cells along theta, y and x."""
Frame = NDArray[np.float64]
"""(3,) offset of a packet's lattice from the lattice of the torus, in cells."""
Dims = NDArray[np.int64]
"""(3,) extents of the torus along theta, y and x, in cells."""


@compiled
def mass(cells: Cells) -> float:
    """Return the sum of the activity, added in a fixed order."""
    total = 0.0
    for t in range(cells.shape[0]):
        for y in range(cells.shape[1]):
            for x in range(cells.shape[2]):
                total += cells[t, y, x]
    return total


@compiled
def extent(cells: Cells) -> NDArray[np.int64]:
    """Find the range of active slices and the longest inactive gap along each axis.

    Args:
        cells: (n_theta, n_y, n_x) activity.

    Returns:
        (3, 4): per axis the first and the last active slice, and the start and length of the
        longest gap between active slices.
    """
    out = np.zeros((3, 4), np.int64)
    n_t, n_y, n_x = cells.shape
    slices = np.zeros((3, max(n_t, n_y, n_x)), np.bool_)
    for t in range(n_t):
        for y in range(n_y):
            any_x = False
            for x in range(n_x):
                if cells[t, y, x] != 0.0:
                    slices[2, x] = True
                    any_x = True
            if any_x:
                slices[0, t] = True
                slices[1, y] = True
    for axis in range(3):
        used = slices[axis, : cells.shape[axis]]
        first = -1
        last = -1
        for i in range(used.shape[0]):
            if used[i]:
                if first < 0:
                    first = i
                elif i - last - 1 > out[axis, 3]:
                    out[axis, 2] = last + 1
                    out[axis, 3] = i - last - 1
                last = i
        out[axis, 0] = first
        out[axis, 1] = last
    return out


@compiled
def are_near(a: Box, b: Box, dims: Dims, reach: int) -> bool:
    """Return whether two boxes are closer than ``reach`` cells along all axes of the torus."""
    for axis in range(3):
        ahead = (b[axis] - a[axis]) % dims[axis]
        behind = (a[axis] - b[axis]) % dims[axis]
        if ahead >= a[3 + axis] + reach and behind >= b[3 + axis] + reach:
            return False
    return True


@compiled
def tighten(cells: Cells, old_box: Box, dims: Dims, reach: int) -> tuple[bool, Cells, Box]:
    """Crop a packet to its active cells in the simple case.

    The case is not simple if the packet covers a whole axis of the torus, or if a gap longer than
    ``reach`` may have split it; see ``Network``.

    Args:
        cells: (n_theta, n_y, n_x) activity.
        old_box: (6,) first cell and number of cells per axis.
        dims: (3,) extents of the torus.
        reach: distance in cells beyond which activities do not interact.

    Returns:
        Whether the packet was cropped, and its cells and box, unchanged if it was not.
    """
    box = old_box.copy()
    for axis in range(3):
        if cells.shape[axis] == dims[axis]:
            return False, cells, old_box
    extents = extent(cells)
    for axis in range(3):
        if extents[axis, 3] > reach:
            return False, cells, old_box
        box[axis] += extents[axis, 0]
        box[3 + axis] = extents[axis, 1] + 1 - extents[axis, 0]
    out = np.empty((box[3], box[4], box[5]))
    for t in range(box[3]):
        for y in range(box[4]):
            for x in range(box[5]):
                out[t, y, x] = cells[t + extents[0, 0], y + extents[1, 0], x + extents[2, 0]]
    return True, out, box


@compiled
def _taps(shift: float, spread_as: float) -> tuple[np.int64, float, float, float]:
    """Return a shift in whole cells and the weights of the cells before, at and after it.

    The mean of the weights is ``shift``. Their variance is that of linear interpolation for a
    shift by ``spread_as`` cells, or by ``shift`` if that is larger: it is the minimum for
    non-negative weights.
    """
    whole = math.floor(shift + 0.5)
    e = shift - whole
    f = spread_as - math.floor(spread_as)
    second = max(f * (1.0 - f), abs(e) * (1.0 - abs(e))) + e * e
    # Rounding errors must not make a weight negative.
    before = max(0.5 * (second - e), 0.0)
    after = max(0.5 * (second + e), 0.0)
    return np.int64(whole), before, 1.0 - second, after


@compiled
def move(
    packet: Cells, old_box: Box, old_frame: Frame, dims: Dims,
    scale: float, chord: float, turn: float, course: float, is_fixed: bool,
) -> tuple[Cells, Box, Frame]:
    """Scale a packet and integrate one motion: half the turn, the chord, half the turn.

    Each heading plane moves in its own direction. The mean displacement moves the frame; the
    difference from the mean shifts the cells, which leaves the centre of mass in place. The cells
    are diffused as much as bilinear interpolation of the whole displacement would diffuse them: a
    moving packet is then wider and weaker than a stationary one, independent of the position of
    its lattice, and so is the result of the competition between packets.

    On a fixed lattice the whole displacement shifts the cells, by linear interpolation along each
    axis, and the frame stays.

    Args:
        packet: (n_theta, n_y, n_x) activity.
        old_box: (6,) first cell and number of cells per axis.
        old_frame: (3,) offset of the packet's lattice from the lattice of the torus, in cells.
        dims: (3,) extents of the torus.
        scale: factor for the activity.
        chord: distance ahead in cells; negative is backwards.
        turn: counter-clockwise turn in heading planes.
        course: direction of the chord relative to the heading, in heading planes.
        is_fixed: whether the lattice stays where it is.

    Returns:
        Cells, box and frame.
    """
    n_t, n_y, n_x = packet.shape
    box = old_box.copy()
    frame = old_frame.copy()

    plane_angle = 2.0 * math.pi / dims[0]
    cosines = np.empty(n_t)
    sines = np.empty(n_t)
    mass = 0.0
    mean_cos = 0.0
    mean_sin = 0.0
    for t in range(n_t):
        heading = (box[0] + t + frame[0] + 0.5 * turn + course) * plane_angle
        cosines[t] = math.cos(heading)
        sines[t] = math.sin(heading)
        plane = 0.0
        for y in range(n_y):
            for x in range(n_x):
                plane += packet[t, y, x]
        mass += plane
        mean_cos += plane * cosines[t]
        mean_sin += plane * sines[t]
    mean_cos /= mass
    mean_sin /= mass
    # The mean direction of a packet that covers several headings is shorter than 1, but the packet
    # must move at the robot's speed. Below 0.5 the heading is undefined.
    unit = max(math.sqrt(mean_cos * mean_cos + mean_sin * mean_sin), 0.5)
    if is_fixed:
        mean_cos = 0.0
        mean_sin = 0.0
    ahead_x = chord * mean_cos / unit
    ahead_y = chord * mean_sin / unit
    ahead_t = 0.0 if is_fixed else turn
    frame[2] += ahead_x
    frame[1] += ahead_y
    frame[0] += ahead_t

    reach_x = 0.0
    reach_y = 0.0
    for t in range(n_t):
        reach_x = max(reach_x, abs(chord * (cosines[t] - mean_cos)))
        reach_y = max(reach_y, abs(chord * (sines[t] - mean_sin)))
    still = 0 if chord != 0.0 else 1
    grow = np.empty(3, np.int64)
    grow[0] = math.ceil(abs(turn - ahead_t)) + 1 if turn != 0.0 else 0
    # A packet of one plane moves with its mean: rounding errors must not enlarge its box.
    grow[1] = math.ceil(reach_y - 1e-9) + 1 - still
    grow[2] = math.ceil(reach_x - 1e-9) + 1 - still
    for axis in range(3):
        if box[3 + axis] + 2 * grow[axis] >= dims[axis]:
            box[3 + axis] = dims[axis]
            grow[axis] = 0
        else:
            box[axis] -= grow[axis]
            box[3 + axis] += 2 * grow[axis]
    m_t = box[3]
    m_y = box[4]
    m_x = box[5]
    out = np.zeros((m_t, m_y, m_x))
    dt, t_before, t_at, t_after = _taps(turn - ahead_t, ahead_t)
    for t in range(n_t):
        dy, y_before, y_at, y_after = _taps(chord * (sines[t] - mean_sin), ahead_y)
        dx, x_before, x_at, x_after = _taps(chord * (cosines[t] - mean_cos), ahead_x)
        for k in range(-1, 2):
            w_t = scale * (t_at if k == 0 else (t_before if k < 0 else t_after))
            if w_t == 0.0:
                continue
            plane_out = out[(t + grow[0] + dt + k) % m_t]
            for y in range(n_y):
                for j in range(-1, 2):
                    w_y = w_t * (y_at if j == 0 else (y_before if j < 0 else y_after))
                    if w_y == 0.0:
                        continue
                    row_out = plane_out[(y + grow[1] + dy + j) % m_y]
                    for x in range(n_x):
                        p = w_y * packet[t, y, x]
                        if p != 0.0:
                            at = x + grow[2] + dx
                            if x_before != 0.0:
                                row_out[(at - 1) % m_x] += p * x_before
                            row_out[at % m_x] += p * x_at
                            if x_after != 0.0:
                                row_out[(at + 1) % m_x] += p * x_after
    for axis in range(3):
        cells = math.floor(frame[axis] + 0.5)
        frame[axis] -= cells
        box[axis] = (box[axis] + np.int64(cells)) % dims[axis]
    return out, box, frame


@compiled
def merge(
    packet: Cells, old_box: Box, frame: Frame,
    other: Cells, other_box: Box, other_frame: Frame, dims: Dims,
) -> tuple[Cells, Box]:
    """Add another packet, resampled onto the lattice of the first by trilinear interpolation.

    Args:
        packet, old_box, frame: the packet whose lattice is kept.
        other, other_box, other_frame: the packet to add.
        dims: (3,) extents of the torus.

    Returns:
        Cells and box of the sum.
    """
    box = old_box.copy()
    whole = np.empty(3, np.int64)
    part = np.empty(3)
    grown = other_box.copy()
    for axis in range(3):
        d = other_frame[axis] - frame[axis]
        whole[axis] = np.int64(math.floor(d))
        part[axis] = d - whole[axis]
        grown[axis] += whole[axis]
        grown[3 + axis] = min(grown[3 + axis] + (1 if part[axis] > 0.0 else 0), dims[axis])
    start = np.empty(3, np.int64)
    size = np.empty(3, np.int64)
    for axis in range(3):
        n = dims[axis]
        ahead = (grown[axis] - box[axis]) % n
        behind = (box[axis] - grown[axis]) % n
        from_box = max(box[3 + axis], ahead + grown[3 + axis])
        from_other = max(grown[3 + axis], behind + box[3 + axis])
        if from_box <= from_other:
            length = from_box
            start[axis] = box[axis]
        else:
            length = from_other
            start[axis] = grown[axis]
        size[axis] = min(length, n)
    out = np.zeros((size[0], size[1], size[2]))
    for t in range(packet.shape[0]):
        i = (t + box[0] - start[0]) % dims[0]
        for y in range(packet.shape[1]):
            j = (y + box[1] - start[1]) % dims[1]
            for x in range(packet.shape[2]):
                out[i, j, (x + box[2] - start[2]) % dims[2]] += packet[t, y, x]
    for t in range(other.shape[0]):
        for y in range(other.shape[1]):
            for x in range(other.shape[2]):
                p = other[t, y, x]
                if p == 0.0:
                    continue
                for corner in range(8):
                    dt = corner >> 2
                    dy = (corner >> 1) & 1
                    dx = corner & 1
                    weight = (
                        (part[0] if dt else 1.0 - part[0])
                        * (part[1] if dy else 1.0 - part[1])
                        * (part[2] if dx else 1.0 - part[2])
                    )
                    if weight > 0.0:
                        i = (t + dt + grown[0] - start[0]) % dims[0]
                        j = (y + dy + grown[1] - start[1]) % dims[1]
                        k = (x + dx + grown[2] - start[2]) % dims[2]
                        out[i, j, k] += p * weight
    for axis in range(3):
        box[axis] = start[axis]
        box[3 + axis] = size[axis]
    return out, box


@compiled
def cell_of(theta: float, y: float, x: float) -> Box:
    """Return the box of the cell that contains a place, in cells."""
    box = np.ones(6, np.int64)
    box[0] = math.floor(theta)
    box[1] = math.floor(y)
    box[2] = math.floor(x)
    return box


@compiled
def point(
    theta: float, y: float, x: float, energy: float, frame: Frame, dims: Dims
) -> tuple[Cells, Box]:
    """Distribute energy at a place, in cells, over the eight cells of a lattice around it.

    Args:
        theta, y, x: the place.
        energy: the energy.
        frame: (3,) offset of the lattice from the lattice of the torus, in cells.
        dims: (3,) extents of the torus.

    Returns:
        Cells and box.
    """
    box = cell_of(theta, y, x)
    part = np.array([theta - box[0], y - box[1], x - box[2]])
    return merge(
        np.zeros((1, 1, 1)), box, frame, np.full((1, 1, 1), energy), box, part, dims
    )


@compiled
def _inside(index: int, length: int, circle: int) -> int:
    """Wrap an index of a packet at the end of the torus; return -1 if it is outside the packet."""
    wrapped = index % circle
    return wrapped if wrapped < length else -1


@compiled
def decode(packet: Cells, box: Box, frame: Frame, dims: Dims) -> tuple[float, float, float]:
    """Return theta, y and x, in cells, of the peak of a packet.

    Population vector decoding per axis, of the cells within 3 cells of the largest one.
    """
    best = -1.0
    middle = np.zeros(3, np.int64)
    for t in range(packet.shape[0]):
        for y in range(packet.shape[1]):
            for x in range(packet.shape[2]):
                if packet[t, y, x] > best:
                    best = packet[t, y, x]
                    middle[0] = t
                    middle[1] = y
                    middle[2] = x
    sums = np.zeros((3, 7))
    radius = np.empty(3, np.int64)
    for axis in range(3):
        radius[axis] = min(np.int64(3), (dims[axis] - 1) // 2)
    for dt in range(-radius[0], radius[0] + 1):
        t = _inside(middle[0] + dt, packet.shape[0], dims[0])
        for dy in range(-radius[1], radius[1] + 1):
            y = _inside(middle[1] + dy, packet.shape[1], dims[1])
            if t < 0 or y < 0:
                continue
            for dx in range(-radius[2], radius[2] + 1):
                x = _inside(middle[2] + dx, packet.shape[2], dims[2])
                if x >= 0:
                    sums[0, dt + 3] += packet[t, y, x]
                    sums[1, dy + 3] += packet[t, y, x]
                    sums[2, dx + 3] += packet[t, y, x]
    place = np.empty(3)
    for axis in range(3):
        cell = 2.0 * math.pi / dims[axis]
        sine = 0.0
        cosine = 0.0
        for d in range(-3, 4):
            sine += sums[axis, d + 3] * math.sin(d * cell)
            cosine += sums[axis, d + 3] * math.cos(d * cell)
        place[axis] = box[axis] + middle[axis] + frame[axis] + math.atan2(sine, cosine) / cell
        place[axis] -= math.floor(place[axis] / dims[axis]) * dims[axis]
        if place[axis] >= dims[axis]:  # a value just below 0 is rounded up to dims
            place[axis] = 0.0
    return place[0], place[1], place[2]
