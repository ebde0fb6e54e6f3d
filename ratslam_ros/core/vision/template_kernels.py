# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Compiled loops of the template memory: block sums of views, their bounds, and exact SADs."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ratslam_ros.core.common.compiled import compiled
from ratslam_ros.core.vision.sad import sad

Bytes = NDArray[np.uint8]
Indices = NDArray[np.int64]

MAX_SAD = 2**31 - 1
"""Upper bound of any SAD."""

BLOCK_COLUMNS = 2
"""Width of a block, in pixels."""


@compiled
def arrange(
    planes: Bytes, top: int, left: int, count: int, edges: Indices, signs: Indices, divisor: int,
    pixels: Bytes, blocks: Bytes,
) -> None:
    """Fill ``pixels`` with columns of a view, one after the other, and ``blocks`` with their sums.

    A single call, because NumPy releases the interpreter lock for every copy of this size, and
    taking it again from a thread that decodes images takes longer than the copy.

    Args:
        planes: (planes, rows, width) the view.
        top: first row of every plane.
        left: first column; columns beyond the last one wrap.
        count: number of columns.
        edges, signs, divisor: see ``fill_blocks``.
        pixels: (at least count * compared rows,) result.
        blocks: result, see ``fill_blocks``.
    """
    rows = edges[-1]
    in_plane = rows // planes.shape[0]
    columns = pixels[: count * rows].reshape((count, rows))
    for n in range(count):
        column = (left + n) % planes.shape[2]
        for row in range(rows):
            columns[n, row] = planes[row // in_plane, top + row % in_plane, column]
    fill_blocks(columns, edges, signs, divisor, blocks)


@compiled
def fill_blocks(
    columns: Bytes, edges: Indices, signs: Indices, divisor: int, blocks: Bytes
) -> None:
    """Fill ``blocks`` from ``columns`` (w, rows).

    Column pairs that start at even columns come first, then those that start at odd columns. Rows
    with a negative sign are inverted (255 - value), which keeps the sums positive.
    """
    pairs = columns.shape[0] // BLOCK_COLUMNS
    groups = edges.shape[0] - 1
    for phase in range(2):
        for pair in range((columns.shape[0] - phase) // BLOCK_COLUMNS):
            left = columns[BLOCK_COLUMNS * pair + phase]
            right = columns[BLOCK_COLUMNS * pair + phase + 1]
            for group in range(groups):
                total = np.int64(0)
                for row in range(edges[group], edges[group + 1]):
                    value = np.int64(left[row]) + np.int64(right[row])
                    total += value if signs[row] > 0 else 510 - value
                blocks[(phase * pairs + pair) * groups + group] = total // divisor


@compiled
def fill_bounds(
    blocks: Bytes, count: int, stride: int, in_template: Indices, in_query: Indices, pieces: int,
    inside: Bytes, query: Bytes, bounds: NDArray[np.int32],
) -> int:
    """Fill ``bounds`` (n,) with the minimum block SAD per template; return the best row."""
    likely = 0
    for row in range(count):
        base = row * stride
        smallest = np.int64(MAX_SAD)
        for place in range(in_template.shape[0]):
            at, in_query_at = base + in_template[place], in_query[place]
            if pieces == 2:  # The size for 60 x 10 px: a compile-time constant avoids a branch.
                found = sad(blocks, at, query, in_query_at, 2, inside)
            else:
                found = sad(blocks, at, query, in_query_at, pieces, inside)
            smallest = min(smallest, found)
        bounds[row] = smallest
        if smallest < bounds[likely]:
            likely = row
    return likely


@compiled
def best_of_row(
    pixels: Bytes, stride: int, in_template: Indices, in_query: Indices, pieces: int,
    inside: Bytes, query: Bytes, row: int,
) -> tuple[np.int64, int]:
    """Return the smallest SAD of a row over all places, and the first such place."""
    smallest, best = np.int64(MAX_SAD), 0
    for place in range(in_template.shape[0]):
        at = row * stride + in_template[place]
        found = sad(pixels, at, query, in_query[place], pieces, inside)
        if found < smallest:
            smallest, best = found, place
    return smallest, best


@compiled
def smallest_sads(
    pixels: Bytes, stride: int, in_template: Indices, in_query: Indices, pieces: int,
    inside: Bytes, query: Bytes, rows: Indices,
) -> Indices:
    """Return the smallest SAD over all places of each of some rows."""
    found = np.empty(rows.shape[0], np.int64)
    for n in range(rows.shape[0]):
        found[n] = best_of_row(
            pixels, stride, in_template, in_query, pieces, inside, query, rows[n]
        )[0]
    return found


@compiled
def refine(
    pixels: Bytes, stride: int, in_template: Indices, in_query: Indices, pieces: int,
    inside: Bytes, query: Bytes,
    blocks: Bytes, block_stride: int, block_in_template: Indices, block_in_query: Indices,
    block_pieces: int, block_inside: Bytes, block_query: Bytes,
    bounds: NDArray[np.int32], divisor: int, slack: int, first: int, last: int, bound: int,
    likely: int,
) -> tuple[int, int, int]:
    """Return row, place and SAD of the first best match below ``bound``; row -1 if none.

    The row ``likely`` is compared first, unless it is -1, because its SAD excludes most others.
    """
    best_row = -1
    best_place = -1
    checked = 0
    skipped = 0
    for step in range(first if likely < 0 else first - 1, last):
        row = step
        if step < first:
            row = likely
        elif step == first and best_row >= 0:
            # One above its SAD, so that an equally good template in an earlier row is found.
            bound += 1
            best_row = -1
        if np.int64(bounds[row]) * divisor - slack >= bound:
            continue
        at = row * stride
        for place in range(in_template.shape[0]):
            # Check the block bound of each place first, as long as at least a quarter is skipped.
            if skipped * 4 >= checked - 1000:
                checked += 1
                at_block = row * block_stride + block_in_template[place]
                block_sad = sad(
                    blocks, at_block, block_query, block_in_query[place], block_pieces,
                    block_inside,
                )
                if block_sad * divisor - slack >= bound:
                    skipped += 1
                    continue
            found = sad(pixels, at + in_template[place], query, in_query[place], pieces, inside)
            if found < bound:
                bound = found
                best_row = row
                best_place = place
    return best_row, best_place, bound
