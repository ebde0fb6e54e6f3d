# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The pose cells' inner loops: what happens within one packet. See ``attractor``."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from ratslam_ros.core.common.compiled import compiled

Cells = NDArray[np.float64]
Reals = NDArray[np.float64]
Box = NDArray[np.int64]
Frame = NDArray[np.float64]
Dims = NDArray[np.int64]


@compiled
def mass(cells: Cells) -> float:
    """Return the sum, in a fixed order."""
    total = 0.0
    for t in range(cells.shape[0]):
        for y in range(cells.shape[1]):
            for x in range(cells.shape[2]):
                total += cells[t, y, x]
    return total


@compiled
def extent(cells: Cells) -> NDArray[np.int64]:
    """Return (3, 4), an axis a row: first and last active slice, start, length of longest gap."""
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
def tighten(cells: Cells, old_box: Box, dims: Dims, reach: int) -> tuple[bool, Cells, Box]:
    """Cut a packet down to its active cells; the first is False, and nothing cut, if that is more.

    It is more where an axis is whole, or where the packet may have fallen apart.
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
def _spread_axis(a: Cells, w: Cells, after: int, cyclic: bool) -> Cells:
    """Convolve the middle axis of ``a`` with ``w``; the result is ``after`` long.

    A cyclic axis wraps; any other keeps its middle, and what leaves the result is cut off.
    """
    outer, length, inner = a.shape
    out = np.zeros((outer, after, inner))
    radius = w.shape[0] // 2
    before = 0 if cyclic else (after - length) // 2
    for k in range(w.shape[0]):
        weight = w[k]
        shift = k - radius + before
        if inner == 1 and not cyclic:  # neighbours along this axis lie side by side in memory
            first = max(0, -shift)
            count = min(length, after - shift) - first
            for o in range(outer):
                source = a[o, first:, 0]
                target = out[o, first + shift :, 0]
                for i in range(count):
                    target[i] += weight * source[i]
            continue
        for i in range(length):
            j = i + shift
            if cyclic:
                j %= after
            elif j < 0 or j >= after:
                continue
            for o in range(outer):
                source = a[o, i]
                target = out[o, j]
                for x in range(inner):
                    target[x] += weight * source[x]
    return out


@compiled
def _spread(a: Cells, w: Cells, n_t: int, n_y: int, n_x: int, dims: Dims) -> Cells:
    """Convolve with the cube of ``w``; the result is (n_t, n_y, n_x), whole axes wrap."""
    l_t, l_y, l_x = a.shape
    a = _spread_axis(a.reshape((1, l_t, l_y * l_x)), w, n_t, n_t == dims[0])
    a = _spread_axis(a.reshape((n_t, l_y, l_x)), w, n_y, n_y == dims[1])
    a = _spread_axis(a.reshape((n_t * n_y, l_x, 1)), w, n_x, n_x == dims[2])
    return a.reshape((n_t, n_y, n_x))


@compiled
def _add_taps(
    flat: Reals, at: int, step: int, w: Reals, first: int, last: int, out: Reals, to: int, n: int
) -> None:
    """Add w[k] * flat[at - k * step + i] to out[to + i], i below n, for each k in its order."""
    target = out[to : to + n]
    k = first
    while k + 4 <= last:  # four at once: the result is read and written less often
        w_0, w_1, w_2, w_3 = w[k], w[k + 1], w[k + 2], w[k + 3]
        a_0 = flat[at - k * step :]
        a_1 = flat[at - (k + 1) * step :]
        a_2 = flat[at - (k + 2) * step :]
        a_3 = flat[at - (k + 3) * step :]
        for i in range(n):
            target[i] = (((target[i] + w_0 * a_0[i]) + w_1 * a_1[i]) + w_2 * a_2[i]) + w_3 * a_3[i]
        k += 4
    while k < last:
        weight = w[k]
        source = flat[at - k * step :]
        for i in range(n):
            target[i] += weight * source[i]
        k += 1


@compiled
def _spread_apart(a: Cells, w: Reals, first: Box, size: Box) -> Cells:
    """Convolve with the cube of ``w`` where no axis is whole; the part that begins at ``first``.

    The result is that of ``_spread``, cell for cell; its rows may be longer, by cells that mean
    nothing. Zeros lie between planes and between rows, so that whatever an axis adds up lies in
    long stretches of memory.
    """
    around = w.shape[0] - 1
    radius = around // 2
    n_t, n_y, n_x = size
    # The cells that the result draws on, and how far each axis' first tap is from them.
    low = np.empty(3, np.int64)
    high = np.empty(3, np.int64)
    for axis in range(3):
        low[axis] = max(0, first[axis] - radius)
        high[axis] = min(a.shape[axis], first[axis] + size[axis] + radius)
    l_t, l_y, l_x = high - low
    to_t, to_y, to_x = low - first + radius

    inner = np.empty(l_t * l_y * l_x)
    at = 0
    for t in range(low[0], high[0]):
        for y in range(low[1], high[1]):
            for x in range(low[2], high[2]):
                inner[at] = a[t, y, x]
                at += 1

    plane = (n_y + around) * l_x
    along_t = np.zeros(n_t * plane)
    for t in range(n_t):
        middle = t + around - to_t  # the plane that the first tap takes
        _add_taps(
            inner, middle * l_y * l_x, l_y * l_x, w, max(0, middle - l_t + 1),
            min(w.shape[0], middle + 1), along_t, t * plane + to_y * l_x, l_y * l_x,
        )  # fmt: skip

    along_y = np.zeros(n_y * l_x)
    width = n_x + around - min(to_x, n_x + around - to_x - l_x)  # zeros serve two rows
    rows = np.zeros(n_t * n_y * width + 2 * around)
    for t in range(n_t):
        along_y[:] = 0.0
        _add_taps(
            along_t, t * plane + around * l_x, l_x, w, 0, w.shape[0], along_y, 0, n_y * l_x
        )
        for y in range(n_y):
            row = (t * n_y + y) * width + to_x
            for x in range(l_x):
                rows[row + x] = along_y[y * l_x + x]

    along_x = np.zeros(n_t * n_y * width)
    _add_taps(rows, around, 1, w, 0, w.shape[0], along_x, 0, n_t * n_y * width)
    return along_x.reshape((n_t, n_y, width))


@compiled
def compete(
    packet: Cells, old_box: Box, dims: Dims, w_e: Cells, w_i: Cells, cutoff: float
) -> tuple[Cells, Box, float]:
    """Excite, inhibit and cut off one packet; return its cells, box and mass."""
    box = old_box.copy()
    r_e = w_e.shape[0] // 2
    r_i = w_i.shape[0] // 2
    apart = True
    for axis in range(3):
        # The axis is whole where the packet's two ends would meet behind the torus.
        if box[3 + axis] + 2 * r_e + r_i >= dims[axis]:
            box[3 + axis] = dims[axis]
            apart = False
        else:
            box[axis] -= r_e
            box[3 + axis] += 2 * r_e
    if apart:
        return _compete_apart(packet, box, w_e, w_i, cutoff)
    excited = _spread(packet, w_e, box[3], box[4], box[5], dims)
    inhibited = _spread(excited, w_i, box[3], box[4], box[5], dims)
    total = 0.0
    for t in range(excited.shape[0]):
        for y in range(excited.shape[1]):
            for x in range(excited.shape[2]):
                p = max(excited[t, y, x] - inhibited[t, y, x] - cutoff, 0.0)
                excited[t, y, x] = p
                total += p
    return excited, box, total


@compiled
def _compete_apart(
    packet: Cells, box: Box, w_e: Cells, w_i: Cells, cutoff: float
) -> tuple[Cells, Box, float]:
    """Compete in a box that is whole on no axis; only where enough is excited to survive."""
    r_e = w_e.shape[0] // 2
    n_t, n_y, n_x = box[3], box[4], box[5]
    excited = _spread_apart(packet, w_e, np.full(3, -r_e), box[3:])
    low = np.array([n_t, n_y, n_x])
    high = np.zeros(3, np.int64)
    for t in range(n_t):
        for y in range(n_y):
            row = excited[t, y]
            most = 0.0
            for x in range(n_x):
                most = max(most, row[x])
            if most > cutoff:  # inhibition only takes away
                low[0] = min(low[0], t)
                high[0] = t + 1
                low[1] = min(low[1], y)
                high[1] = max(high[1], y + 1)
                begin = 0
                while row[begin] <= cutoff:
                    begin += 1
                end = n_x
                while row[end - 1] <= cutoff:
                    end -= 1
                low[2] = min(low[2], begin)
                high[2] = max(high[2], end)
    if high[0] == 0:
        return np.zeros((1, 1, 1)), box, 0.0
    size = high - low
    inhibited = _spread_apart(excited[:, :, :n_x], w_i, low, size)
    left = np.empty((size[0], size[1], size[2]))
    total = 0.0
    for t in range(size[0]):
        for y in range(size[1]):
            for x in range(size[2]):
                e = excited[t + low[0], y + low[1], x + low[2]]
                p = max(e - inhibited[t, y, x] - cutoff, 0.0)
                left[t, y, x] = p
                total += p
    box[:3] += low
    box[3:] = size
    return left, box, total


@compiled
def _taps(shift: float, spread_as: float) -> tuple[np.int64, float, float, float]:
    """Return a whole shift and the weights of the cells before, at and after it.

    Their mean is ``shift`` and their variance that of a bilinear shift by ``spread_as`` cells,
    or by ``shift`` itself where that is more (no weights of one sign have less).
    """
    whole = math.floor(shift + 0.5)
    e = shift - whole
    f = spread_as - math.floor(spread_as)
    second = max(f * (1.0 - f), abs(e) * (1.0 - abs(e))) + e * e
    # Rounding must not make activity negative where a weight is nothing.
    before = max(0.5 * (second - e), 0.0)
    after = max(0.5 * (second + e), 0.0)
    return np.int64(whole), before, 1.0 - second, after


@compiled
def move(
    packet: Cells, old_box: Box, old_frame: Frame, dims: Dims,
    scale: float, chord: float, turn: float,
) -> tuple[Cells, Box, Frame]:  # fmt: skip
    """Scale a packet, move it ``chord`` cells ahead and ``turn`` planes, half the turn before.

    Each plane goes its own way: the mean way by moving the frame, the rest by shifting its cells,
    which leaves the packet's centre of mass where it is. The cells are spread as much as bilinear
    shifts by the whole way would spread them: a moving packet is wider and weaker than one at
    rest, and who wins shall not depend on where the lattice is. Returns cells, box and frame.
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
        heading = (box[0] + t + frame[0] + 0.5 * turn) * plane_angle
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
    # A packet spread over several headings has a mean shorter than 1; it still moves at the
    # robot's speed. Below a half it has no heading worth the name.
    unit = max(math.sqrt(mean_cos * mean_cos + mean_sin * mean_sin), 0.5)
    ahead_x = chord * mean_cos / unit
    ahead_y = chord * mean_sin / unit
    frame[2] += ahead_x
    frame[1] += ahead_y
    frame[0] += turn

    reach_x = 0.0
    reach_y = 0.0
    for t in range(n_t):
        reach_x = max(reach_x, abs(chord * (cosines[t] - mean_cos)))
        reach_y = max(reach_y, abs(chord * (sines[t] - mean_sin)))
    still = 0 if chord != 0.0 else 1
    grow = np.empty(3, np.int64)
    grow[0] = 1 if turn != 0.0 else 0
    # A packet of one plane moves with its mean; what rounding leaves of that is no cell.
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
    _, t_before, t_at, t_after = _taps(0.0, turn)
    for t in range(n_t):
        dy, y_before, y_at, y_after = _taps(chord * (sines[t] - mean_sin), ahead_y)
        dx, x_before, x_at, x_after = _taps(chord * (cosines[t] - mean_cos), ahead_x)
        for k in range(-1, 2):
            w_t = scale * (t_at if k == 0 else (t_before if k < 0 else t_after))
            if w_t == 0.0:
                continue
            plane_out = out[(t + grow[0] + k) % m_t]
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
def join(
    packet: Cells, old_box: Box, frame: Frame,
    other: Cells, other_box: Box, other_frame: Frame, dims: Dims,
) -> tuple[Cells, Box]:  # fmt: skip
    """Add another packet, resampled onto this one's lattice (trilinear); return cells and box."""
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
def _inside(index: int, length: int, circle: int) -> int:
    """Return the index in a packet, the way round the circle included; -1 if outside."""
    wrapped = index % circle
    return wrapped if wrapped < length else -1


@compiled
def decode(packet: Cells, box: Box, frame: Frame, dims: Dims) -> tuple[float, float, float]:
    """Return theta, y and x in cells of the largest cell, refined by the +-3 box around it.

    Population vector decoding, per axis: the angle of the sums of sine and cosine.
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
        if place[axis] >= dims[axis]:  # a value just below 0 rounds up to the whole circle
            place[axis] = 0.0
    return place[0], place[1], place[2]
