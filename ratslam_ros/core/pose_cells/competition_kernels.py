# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Compiled competition within one packet: excitation, inhibition and global inhibition."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ratslam_ros.core.common.compiled import compiled
from ratslam_ros.core.pose_cells.packet_kernels import Box, Cells, Dims, tighten

Reals = NDArray[np.float64]


@compiled
def _add_taps(
    flat: Reals, at: int, step: int, w: Reals, first: int, last: int, out: Reals, to: int, n: int
) -> None:
    """Add w[k] * flat[at - k * step + i] to out[to + i] for i < n and for each k in order."""
    target = out[to : to + n]
    k = first
    while k + 4 <= last:  # four at once reduce the reads and writes of the result
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
def _convolve(a: Cells, w: Reals, first: Box, size: Box) -> Cells:
    """Convolve all axes with ``w``, without wrapping; return the part of size ``size``.

    Zeros are inserted between planes and between rows, so that the sums run over long contiguous
    stretches of memory.

    Args:
        a: activity.
        w: one axis of the kernel.
        first: (3,) first cell of the result, in cells of ``a``; may be negative.
        size: (3,) size of the result.

    Returns:
        (n_theta, n_y, at least n_x) result; cells beyond n_x in a row are undefined.
    """
    around = w.shape[0] - 1
    radius = around // 2
    n_t, n_y, n_x = size
    # Range of input cells that contribute to the result, and their offset in the padded arrays.
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
        middle = t + around - to_t  # input plane of the first tap
        _add_taps(
            inner, middle * l_y * l_x, l_y * l_x, w, max(0, middle - l_t + 1),
            min(w.shape[0], middle + 1), along_t, t * plane + to_y * l_x, l_y * l_x,
        )

    along_y = np.zeros(n_y * l_x)
    # Adjacent rows share their padding.
    width = n_x + around - min(to_x, n_x + around - to_x - l_x)
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
def _wrapped(a: Cells, is_whole: NDArray[np.bool_], dims: Dims, radius: int) -> Cells:
    """Return ``a`` with ``radius`` cells of the opposite end beyond both ends of whole axes.

    Args:
        a: activity; it may end before a whole axis does.
        is_whole: (3,) which axes are as long as the torus.
        dims: (3,) extents of the torus.
        radius: number of cells.
    """
    length = np.where(is_whole, dims, np.array(a.shape))
    added = np.where(is_whole, radius, 0)
    size = length + 2 * added
    out = np.zeros((size[0], size[1], size[2]))
    for t in range(size[0]):
        i = (t - added[0]) % length[0]
        for y in range(size[1]):
            j = (y - added[1]) % length[1]
            for x in range(size[2]):
                k = (x - added[2]) % length[2]
                if i < a.shape[0] and j < a.shape[1] and k < a.shape[2]:
                    out[t, y, x] = a[i, j, k]
    return out


@compiled
def compete(
    packet: Cells, old_box: Box, dims: Dims, w_e: Cells, w_i: Cells, cutoff: float, reach: int
) -> tuple[bool, Cells, Box, float]:
    """Apply excitation, inhibition and global inhibition to one packet, and crop it.

    Args:
        packet: (n_theta, n_y, n_x) activity.
        old_box: (6,) first cell and number of cells per axis.
        dims: (3,) extents of the torus.
        w_e: one axis of the excitatory kernel.
        w_i: one axis of the inhibitory kernel.
        cutoff: global inhibition.
        reach: see ``tighten``.

    Returns:
        Whether the packet was cropped, its cells and box, and the sum of its activity.
    """
    box = old_box.copy()
    r_e = w_e.shape[0] // 2
    r_i = w_i.shape[0] // 2
    is_whole = np.zeros(3, np.bool_)
    for axis in range(3):
        # Use the whole axis if the two ends of the packet would interact around the torus.
        if box[3 + axis] + 2 * r_e + r_i >= dims[axis]:
            box[3 + axis] = dims[axis]
            is_whole[axis] = True
        else:
            box[axis] -= r_e
            box[3 + axis] += 2 * r_e
    if is_whole.any():
        low, size = np.zeros(3, np.int64), box[3:].copy()
        at = np.where(is_whole, r_e, -r_e)
        excited = _convolve(_wrapped(packet, is_whole, dims, r_e), w_e, at, size)
        around = _wrapped(excited[:, :, : size[2]], is_whole, dims, r_i)
        inhibited = _convolve(around, w_i, np.where(is_whole, r_i, 0), size)
    else:
        excited = _convolve(packet, w_e, np.full(3, -r_e), box[3:])
        low, size = _above(excited[:, :, : box[5]], cutoff)
        if size[0] <= 0:
            return False, packet, box, 0.0
        inhibited = _convolve(excited[:, :, : box[5]], w_i, low, size)
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
    if total <= 0.0:
        return False, left, box, total
    is_tight, left, box = tighten(left, box, dims, reach)
    return is_tight, left, box, total


@compiled
def _above(excited: Cells, cutoff: float) -> tuple[Box, Box]:
    """Return first cell and size of the part above the cutoff; inhibition cannot raise others."""
    low = np.array(excited.shape)
    high = np.zeros(3, np.int64)
    for t in range(excited.shape[0]):
        for y in range(excited.shape[1]):
            row = excited[t, y]
            most = 0.0
            for x in range(row.shape[0]):
                most = max(most, row[x])
            if most > cutoff:
                low[0] = min(low[0], t)
                high[0] = t + 1
                low[1] = min(low[1], y)
                high[1] = max(high[1], y + 1)
                begin = 0
                while row[begin] <= cutoff:
                    begin += 1
                end = row.shape[0]
                while row[end - 1] <= cutoff:
                    end -= 1
                low[2] = min(low[2], begin)
                high[2] = max(high[2], end)
    return low, high - low
