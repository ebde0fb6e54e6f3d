# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The templates and the exact search among them, which looks at few of them in full.

Beside each template lie the sums of its blocks, two columns wide and two or three rows high. The
difference of two blocks' sums is at most the sum of their pixels' differences, so the blocks tell
a least SAD for every offset, at a quarter of the work; only a template whose least could still win
is compared pixel by pixel. The result is that of comparing all of them.

Templates lie on shelves, stretches of memory that never move: to learn one costs the same at any
size, and little memory waits for more.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ratslam_ros.core.common.compiled import compiled
from ratslam_ros.core.vision.sad import PIECE, pieces_of, sad

Bytes = NDArray[np.uint8]
Places = NDArray[np.int64]

SHELF_BYTES = 1 << 24
"""Room that is made at once for templates; the system lends it as it is filled."""

LARGEST_SAD = 2**31 - 1
BLOCK_COLUMNS = 2
BLOCK_ROWS = 3
"""Blocks have at most this many rows. Found on noise, simulated and real views: smaller blocks
bound the SAD better, larger ones are fewer."""


class Match(NamedTuple):
    """A template, at which horizontal offset it fits best, and the SAD there."""

    template_id: int
    offset: int
    sad: int


class _Shelf(NamedTuple):
    """Room for some templates: their pixels, their blocks, and scratch for what a search finds."""

    pixels: Bytes
    blocks: Bytes
    least: NDArray[np.int32]


class _Layer(NamedTuple):
    """What is compared at a place: where it begins in template and query, and how much it is."""

    stride: int
    in_template: Places
    in_query: Places
    pieces: int
    inside: Bytes


class TemplateMemory:
    """Views of one size, uint8, column by column, each once for every vertical offset."""

    def __init__(
        self, width: int, height: int, shift_x: int, shift_y: int, step: int, *,
        panoramic: bool, signed: bool,
    ) -> None:  # fmt: skip
        """Prepare an empty memory.

        Args:
            width, height: of a view, in pixels.
            shift_x, shift_y: how far a view is shifted to either side, and up and down.
            step: of the horizontal shifts.
            panoramic: shift round the full circle instead of by ``shift_x``.
            signed: blocks hold differences of rows in place of sums, which tells views apart
                that have been brought to the same brightness everywhere.
        """
        self._width, self._height = width, height
        self._rows = rows = height - 2 * shift_y
        self._falls = 2 * shift_y + 1
        self._top, self._left = shift_y, 0 if panoramic else shift_x
        self._columns = columns = width - 2 * self._left
        self._panoramic = panoramic
        self.full_sum = 255 * columns * rows
        """The largest SAD there can be."""

        groups = -(-rows // BLOCK_ROWS)
        self._edges = np.array([g * rows // groups for g in range(groups + 1)])
        negative = (np.arange(rows) + 1) // 2 % 2 == 1  # + - - + + - - +
        self._signs = np.where(signed & negative, -1, 1)
        most_rows = int(np.diff(self._edges).max())
        self._divisor = BLOCK_COLUMNS * most_rows
        pairs = columns // BLOCK_COLUMNS
        self._compared = pairs * groups
        # A block's sum is rounded down to a byte: two may be this much nearer than their sums.
        self._slack = (self._divisor - 1) * self._compared

        offsets = np.arange(0, width if panoramic else 2 * shift_x + 1, step)
        falls = np.arange(self._falls)[:, None]
        self._offsets = np.tile(offsets, self._falls)
        """The offset of every place, in the order in which ties are decided."""
        turns = (width - offsets) % width if panoramic else offsets
        still = np.zeros_like(turns)
        per_phase = (width + (width if panoramic else 0)) // BLOCK_COLUMNS * groups
        block_turns = turns % 2 * per_phase + turns // 2 * groups
        self._fall_pixels = width * rows
        self._fall_blocks = 2 * (width // BLOCK_COLUMNS) * groups

        def layer(fall_size: int, moves: Places, length: int) -> _Layer:
            in_template = falls * fall_size + (still if panoramic else moves)
            in_query = 0 * falls + (moves if panoramic else still)
            stride = self._falls * fall_size
            whole = -(-stride // PIECE) * PIECE
            # Templates that are always read from their first pixel on are worth a little room, so
            # that no load straddles two lines of the cache.
            if panoramic and 8 * (whole - stride) <= stride:
                stride = whole
            return _Layer(stride, in_template.ravel(), in_query.ravel(), *pieces_of(length))

        self._fine = layer(self._fall_pixels, turns * rows, columns * rows)
        self._coarse = layer(self._fall_blocks, block_turns, self._compared)
        self._shelves: list[_Shelf] = []
        self._per_shelf = max(SHELF_BYTES // (self._fine.stride + self._coarse.stride), 1)
        self._count = 0

    def __len__(self) -> int:
        return self._count

    @property
    def nbytes(self) -> int:
        """Bytes that the learned templates take, all that lies beside them included."""
        return self._count * (self._fine.stride + self._coarse.stride + 4)

    def view(self, template_id: int) -> Bytes:
        """Return one template: (height, width) uint8, a copy."""
        shelf, row = divmod(template_id, self._per_shelf)
        at = row * self._fine.stride
        pixels = self._shelves[shelf].pixels[at : at + self._falls * self._fall_pixels]
        falls = pixels.reshape(self._falls, self._width, self._rows)
        out = np.empty((self._height, self._width), np.uint8)
        for fall in range(self._falls):
            out[fall : fall + self._rows] = falls[fall].T
        return out

    def views(self) -> Bytes:
        """Return all templates: (n, height, width) uint8, a copy."""
        out = np.empty((self._count, self._height, self._width), np.uint8)
        for template_id in range(self._count):
            out[template_id] = self.view(template_id)
        return out

    def append(self, view: Bytes) -> int:
        """Learn a view, (height, width) uint8, and return its id."""
        number, row = divmod(self._count, self._per_shelf)
        if number == len(self._shelves):
            n = self._per_shelf
            self._shelves.append(
                _Shelf(
                    _aligned(n * self._fine.stride), _aligned(n * self._coarse.stride),
                    np.empty(n, np.int32),
                )
            )
        shelf = self._shelves[number]
        fine, coarse = self._fall_pixels, self._fall_blocks
        for fall in range(self._falls):
            columns = np.ascontiguousarray(view[fall : fall + self._rows].T)
            at = row * self._fine.stride + fall * fine
            shelf.pixels[at : at + fine] = columns.reshape(-1)
            at = row * self._coarse.stride + fall * coarse
            _blocks(
                columns, self._edges, self._signs, self._divisor, shelf.blocks[at : at + coarse]
            )
        self._count += 1
        return self._count - 1

    def search(self, view: Bytes) -> Search:
        """Begin a search for a view, (height, width) uint8; valid until one is learned."""
        columns = view[self._top : self._top + self._rows].T
        if self._panoramic:  # twice round, so that every turn of the view is one stretch
            columns = np.concatenate([columns, columns])
        else:
            columns = columns[self._left : self._left + self._columns]
        columns = np.ascontiguousarray(columns)
        pixels = _aligned(columns.size)
        pixels[: columns.size] = columns.reshape(-1)
        groups = len(self._edges) - 1
        blocks = _aligned(2 * (len(columns) // BLOCK_COLUMNS) * groups)
        _blocks(columns, self._edges, self._signs, self._divisor, blocks)
        return Search(self, pixels, blocks)


class Search:
    """One view held against a memory."""

    def __init__(self, memory: TemplateMemory, pixels: Bytes, blocks: Bytes) -> None:
        self._memory = memory
        self._pixels = pixels
        self._blocks = blocks
        likely, least = 0, LARGEST_SAD
        for number, shelf, count in self._shelves(len(memory)):
            row = _bound(shelf.blocks, count, *memory._coarse, blocks, shelf.least)
            if shelf.least[row] < least:
                likely, least = number * memory._per_shelf + row, int(shelf.least[row])
        self._likely = likely

    def best(self, count: int | None = None, limit: int | None = None) -> Match | None:
        """Return the best match, None where there is none.

        Ties go to the lowest id, then to the lowest vertical and horizontal offset.

        Args:
            count: search the oldest ``count`` templates only.
            limit: matches with a SAD above this are none; far ones then cost nothing.
        """
        m = self._memory
        count = len(m) if count is None else count
        bound = LARGEST_SAD if limit is None else limit + 1
        if self._likely < count:
            # Wherever it lies, a good match found first spares most others; one more than its
            # SAD, so that a lower id that is as good is found again.
            number, row = divmod(self._likely, m._per_shelf)
            found = self._refine(m._shelves[number], row, row + 1, bound)
            bound = min(bound, found[2] + 1)
        best: Match | None = None
        for number, shelf, learned in self._shelves(count):
            row, place, found_sad = self._refine(shelf, 0, learned, bound)
            if row >= 0:
                bound = found_sad
                template_id = number * m._per_shelf + row
                best = Match(template_id, int(m._offsets[place]), found_sad)
        return best

    def _shelves(self, count: int) -> list[tuple[int, _Shelf, int]]:
        """Return number, shelf and how many templates of it are among the oldest ``count``."""
        size = self._memory._per_shelf
        shelves = self._memory._shelves[: -(-count // size)]
        return [(n, shelf, min(count - n * size, size)) for n, shelf in enumerate(shelves)]

    def _refine(self, shelf: _Shelf, first: int, last: int, bound: int) -> tuple[int, int, int]:
        m = self._memory
        row, place, found = _refine(
            shelf.pixels, *m._fine, self._pixels, shelf.blocks, *m._coarse, self._blocks,
            shelf.least, m._divisor, m._slack, first, last, bound,
        )  # fmt: skip
        return int(row), int(place), int(found)


def _aligned(size: int) -> Bytes:
    """Return (size + PIECE,) uint8 that begin where a piece does: loads that straddle cost two."""
    room = np.empty(size + 2 * PIECE, np.uint8)
    return room[-room.ctypes.data % PIECE :][: size + PIECE]


@compiled
def _blocks(
    columns: Bytes, edges: Places, signs: Places, divisor: int, blocks: Bytes
) -> None:
    """Fill ``blocks`` from (w, rows): pairs of columns from the first, then from the second on.

    A block is a sum, rows with a negative sign turned over (255 - value) to keep it positive.
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
def _bound(
    blocks: Bytes, count: int, stride: int, in_template: Places, in_query: Places, pieces: int,
    inside: Bytes, query: Bytes, least: NDArray[np.int32],
) -> int:  # fmt: skip
    """Fill ``least`` (n,) with each template's least SAD of blocks; return where it is least."""
    likely = 0
    for row in range(count):
        base = row * stride
        smallest = np.int64(LARGEST_SAD)
        for place in range(in_template.shape[0]):
            at, there = base + in_template[place], in_query[place]
            if pieces == 2:  # as at 60x10: known when compiled, it needs no branch
                found = sad(blocks, at, query, there, 2, inside)
            else:
                found = sad(blocks, at, query, there, pieces, inside)
            smallest = min(smallest, found)
        least[row] = smallest
        if smallest < least[likely]:
            likely = row
    return likely


@compiled
def _refine(
    pixels: Bytes, stride: int, in_template: Places, in_query: Places, pieces: int,
    inside: Bytes, query: Bytes,
    blocks: Bytes, block_stride: int, block_in_template: Places, block_in_query: Places,
    block_pieces: int, block_inside: Bytes, block_query: Bytes,
    least: NDArray[np.int32], divisor: int, slack: int, first: int, last: int, bound: int,
) -> tuple[int, int, int]:  # fmt: skip
    """Return row, place and SAD of the first best match below ``bound``; row -1 for none."""
    best_row = -1
    best_place = -1
    looked = 0
    spared = 0
    for row in range(first, last):
        if np.int64(least[row]) * divisor - slack >= bound:
            continue
        at = row * stride
        for place in range(in_template.shape[0]):
            # The blocks again, place by place, as long as that spares a quarter of the pixels.
            if spared * 4 >= looked - 1000:
                looked += 1
                at_block = row * block_stride + block_in_template[place]
                least_here = sad(
                    blocks, at_block, block_query, block_in_query[place], block_pieces,
                    block_inside,
                )  # fmt: skip
                if least_here * divisor - slack >= bound:
                    spared += 1
                    continue
            found = sad(pixels, at + in_template[place], query, in_query[place], pieces, inside)
            if found < bound:
                bound = found
                best_row = row
                best_place = place
    return best_row, best_place, bound
