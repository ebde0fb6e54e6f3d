# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Template memory with exact search by branch and bound.

For each template, the sums of small pixel blocks are stored, two columns wide and two or three
rows high. The difference between the sums of two blocks is at most the sum of absolute differences
(SAD) of their pixels. The blocks therefore give a lower bound of the SAD for every offset, at a
quarter of the cost, and only templates whose bound is below the best SAD are compared pixel by
pixel. The result equals that of an exhaustive search.

Templates are stored in chunks of memory that are never moved, so that the cost of learning one
does not depend on the number of templates, and little memory is allocated in advance. Ids count
from 0 and are never reused. If a template is removed, the last one takes its slot.
"""

from __future__ import annotations

from array import array
from bisect import bisect_left
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ratslam_ros.core.vision.encoder import Layout
from ratslam_ros.core.vision.image_window import contiguous
from ratslam_ros.core.vision.sad import PIECE_BYTES, pieces_of
from ratslam_ros.core.vision.template_kernels import (
    BLOCK_COLUMNS,
    MAX_SAD,
    Bytes,
    Indices,
    arrange,
    best_of_row,
    fill_bounds,
    refine,
    smallest_sads,
)

CHUNK_BYTES = 1 << 24
"""Memory allocated at once for templates; the operating system maps it as it is filled."""

BLOCK_ROWS = 3
"""Largest height of a block, in pixels. Smaller blocks give tighter bounds, larger blocks less
work; the size was tuned on noise, simulated views and real views."""

PLANE_BLOCK_ROWS = 4
"""The same for views of several planes, whose neighbouring cells overlap and so differ less."""


class Match(NamedTuple):
    """The best match of a view."""

    template_id: int
    offset: int
    """Column of the template at which the compared columns begin."""
    sad: int
    """Sum of absolute differences at this offset."""


class _Chunk(NamedTuple):
    """Memory for a number of templates."""

    pixels: Bytes
    blocks: Bytes
    bounds: NDArray[np.int32]
    """Scratch: lower bound of the SAD of each template in the present search."""


class _Layer(NamedTuple):
    """Memory layout of the pixels or of the blocks.

    The offset of a view against a template, vertical and horizontal, is numbered by a place.
    """

    stride: int
    """Bytes per template."""
    in_template: Indices
    """(places,) first compared byte within a template."""
    in_query: Indices
    """(places,) first compared byte within the query."""
    pieces: int
    """Number of compared pieces; see ``pieces_of``."""
    inside: Bytes
    """Mask of the last piece."""


class TemplateMemory:
    """Memory of views of one size, uint8.

    Pixels are stored column by column, so that a horizontal offset is a shift in memory, and
    separately for every vertical offset.
    """

    def __init__(self, layout: Layout) -> None:
        """Create an empty memory for views of a layout.

        If the layout is signed, blocks hold differences between rows instead of sums, which give
        tighter bounds.
        """
        width, height, planes = layout.width, layout.height, layout.planes
        shift_x, shift_y = layout.shift_x, layout.shift_y
        panoramic = layout.panoramic
        self._width, self._height, self._planes = width, height, planes
        plane_rows = height // planes - 2 * shift_y
        self._rows = rows = planes * plane_rows
        self._vertical_count = 2 * shift_y + 1
        self._top, self._left = shift_y, 0 if panoramic else shift_x
        columns = width - 2 * self._left
        self.full_sum = 255 * columns * rows
        """Largest possible SAD: that between a black and a white view."""

        in_plane = -(-plane_rows // (BLOCK_ROWS if planes == 1 else PLANE_BLOCK_ROWS))
        groups = planes * in_plane
        self._edges = np.array(
            [g // in_plane * plane_rows + g % in_plane * plane_rows // in_plane
             for g in range(groups + 1)]
        )
        negative = (np.arange(rows) + 1) // 2 % 2 == 1  # + - - + + - - +
        self._signs = np.where(layout.signed & negative, -1, 1)
        max_rows = int(np.diff(self._edges).max())
        self._divisor = BLOCK_COLUMNS * max_rows
        pairs = columns // BLOCK_COLUMNS
        self._compared = pairs * groups
        # Block sums are divided and rounded down to a byte, so that the difference between two
        # views' blocks can be too large by up to this.
        self._slack = (self._divisor - 1) * self._compared

        offsets = np.arange(0, width if panoramic else 2 * shift_x + 1, layout.step)
        vertical = np.arange(self._vertical_count)[:, None]
        self._offsets = np.tile(offsets, self._vertical_count)
        """(places,) horizontal offset of each place; ties go to the first place."""
        turns = (width - offsets) % width if panoramic else offsets
        zero = np.zeros_like(turns)
        per_phase = (width + (width if panoramic else 0)) // BLOCK_COLUMNS * groups
        block_turns = turns % 2 * per_phase + turns // 2 * groups
        self._pixels_per_offset = width * rows
        self._blocks_per_offset = 2 * (width // BLOCK_COLUMNS) * groups

        def layer(offset_size: int, moves: Indices, length: int) -> _Layer:
            in_template = vertical * offset_size + (zero if panoramic else moves)
            in_query = 0 * vertical + (moves if panoramic else zero)
            stride = self._vertical_count * offset_size
            aligned = -(-stride // PIECE_BYTES) * PIECE_BYTES
            # Panoramic templates are always read from their first pixel, so aligning them to cache
            # lines is worth a little memory.
            if panoramic and 8 * (aligned - stride) <= stride:
                stride = aligned
            return _Layer(stride, in_template.ravel(), in_query.ravel(), *pieces_of(length))

        self._fine = layer(self._pixels_per_offset, turns * rows, columns * rows)
        self._coarse = layer(self._blocks_per_offset, block_turns, self._compared)
        # Two periods of a panorama, so that every rotation is contiguous.
        self._query_columns = count = 2 * width if panoramic else columns
        self._query = _aligned(count * rows), _aligned(2 * (count // BLOCK_COLUMNS) * groups)
        """Columns of the view of the present search, and their blocks."""
        self._chunks: list[_Chunk] = []
        self._per_chunk = max(CHUNK_BYTES // (self._fine.stride + self._coarse.stride), 1)
        self._count = 0
        self._id_of_slot = array('q')
        # All ids in ascending order, and their slots.
        self._ids, self._slots = array('q'), array('q')
        # Copies of the views in the first slots, as ``views`` returns them.
        self._views = np.empty((0, height, width), np.uint8)
        self._copied = self._given = 0
        self._outdated: set[int] = set()
        self.next_id = 0
        """Id of the next new template."""

    def __len__(self) -> int:
        return self._count

    def __contains__(self, template_id: int) -> bool:
        rank = bisect_left(self._ids, template_id)
        return rank < self._count and self._ids[rank] == template_id

    @property
    def ids(self) -> Indices:
        """(n,) ids of ``views``."""
        return np.array(self._id_of_slot, np.int64)

    def nth_id(self, rank: int) -> int:
        """Return the id of the template before which ``rank`` of the present ones were learned."""
        return self._ids[rank] if rank < self._count else self.next_id

    def rank(self, template_id: int) -> int:
        """Return the number of templates with a lower id."""
        return bisect_left(self._ids, template_id)

    @property
    def nbytes(self) -> int:
        """Memory used by the learned templates and their blocks, in bytes."""
        return self._count * (self._fine.stride + self._coarse.stride + 4)

    def view(self, template_id: int) -> Bytes:
        """Return a copy of one template: (height, width) uint8."""
        return self._view_at(self._slot_of(template_id))

    def _view_at(self, slot: int) -> Bytes:
        chunk, row = divmod(slot, self._per_chunk)
        at = row * self._fine.stride
        size = self._vertical_count * self._pixels_per_offset
        pixels = self._chunks[chunk].pixels[at : at + size]
        parts = pixels.reshape(self._vertical_count, self._width, self._rows)
        out = np.empty((self._height, self._width), np.uint8)
        for dy in range(self._vertical_count):
            self._rows_from(out, dy)[:] = parts[dy].T.reshape(self._planes, -1, self._width)
        return out

    def views(self) -> Bytes:
        """Return all templates, in the order of ``ids``: (n, height, width) uint8, read only.

        The array never changes. Only templates that were learned since the last call are copied,
        unless some were removed.
        """
        count = self._count
        outdated = sorted(slot for slot in self._outdated if slot < self._copied)
        first = min([*outdated, self._copied])
        if count > len(self._views) or (first < self._given and first < count):
            grown = np.empty((max(2 * count, 64), self._height, self._width), np.uint8)
            grown[: self._copied] = self._views[: self._copied]
            self._views, self._given = grown, 0
        for slot in [*outdated, *range(self._copied, count)]:
            self._views[slot] = self._view_at(slot)
        self._copied, self._given = count, max(self._given, count)
        self._outdated.clear()
        views = self._views[:count]
        views.flags.writeable = False
        return views

    def restore(self, views: Bytes, ids: Indices, next_id: int) -> None:
        """Learn the templates of an empty memory, as ``views`` and ``ids`` returned them."""
        for template_id, view in zip(ids.tolist(), views, strict=True):
            self.append(view, template_id)
        self.next_id = next_id
        self._views, self._copied, self._given = views, len(views), len(views)

    def append(self, view: Bytes, template_id: int | None = None) -> int:
        """Add a view, (height, width) uint8, as a template and return its id.

        Args:
            view: the view.
            template_id: an id that is not in use, to restore a memory; None: the next one.
        """
        template_id = self.next_id if template_id is None else template_id
        self.next_id = max(self.next_id, template_id + 1)
        self._put(self._count, view)
        rank = bisect_left(self._ids, template_id)
        self._ids.insert(rank, template_id)
        self._slots.insert(rank, self._count)
        self._id_of_slot.append(template_id)
        self._count += 1
        return template_id

    def remove(self, template_id: int) -> None:
        """Remove a template; the template in the last slot takes its slot."""
        slot, last = self._slot_of(template_id), self._count - 1
        rank = bisect_left(self._ids, template_id)
        del self._ids[rank], self._slots[rank]
        last_id = self._id_of_slot.pop()
        self._count = last
        self._copied = min(self._copied, last)
        if slot != last:
            self._outdated.add(slot)
            self._put(slot, self._view_at(last))
            self._id_of_slot[slot] = last_id
            self._slots[bisect_left(self._ids, last_id)] = slot

    def _put(self, slot: int, view: Bytes) -> None:
        """Store a view in a slot, at most the first one that is not in use."""
        number, row = divmod(slot, self._per_chunk)
        if number == len(self._chunks):
            n = self._per_chunk
            self._chunks.append(
                _Chunk(
                    _aligned(n * self._fine.stride), _aligned(n * self._coarse.stride),
                    np.empty(n, np.int32),
                )
            )
        chunk = self._chunks[number]
        planes = self._planes_of(view)
        for dy in range(self._vertical_count):
            arrange(
                planes, dy, 0, self._width, self._edges, self._signs, self._divisor,
                chunk.pixels[row * self._fine.stride + dy * self._pixels_per_offset :],
                chunk.blocks[row * self._coarse.stride + dy * self._blocks_per_offset :],
            )

    def _slot_of(self, template_id: int) -> int:
        if template_id not in self:
            raise KeyError(f'template {template_id} is not stored')
        return self._slots[self.rank(template_id)]

    def search(self, view: Bytes) -> Search:
        """Start a search for a view, (height, width) uint8.

        It is valid until the next search, or until a template is added or removed.
        """
        arrange(
            self._planes_of(view), self._top, self._left, self._query_columns, self._edges,
            self._signs, self._divisor, *self._query,
        )
        return Search(self, *self._query)

    def _rows_from(self, view: Bytes, top: int) -> Bytes:
        """Return the compared rows of all planes from row ``top`` on: (planes, rows, width)."""
        planes = view.reshape(self._planes, -1, self._width)
        return planes[:, top : top + self._rows // self._planes]

    def _planes_of(self, view: Bytes) -> Bytes:
        """Return a view as (planes, rows, width)."""
        return contiguous(view).reshape(self._planes, -1, self._width)


class Search:
    """Search for one view in a memory."""

    def __init__(self, memory: TemplateMemory, pixels: Bytes, blocks: Bytes) -> None:
        self._memory = memory
        self._pixels = pixels
        self._blocks = blocks
        likely, min_bound = 0, MAX_SAD
        for number, chunk, count in self._chunks():
            row = fill_bounds(chunk.blocks, count, *memory._coarse, blocks, chunk.bounds)
            if chunk.bounds[row] < min_bound:
                likely, min_bound = number * memory._per_chunk + row, int(chunk.bounds[row])
        self._likely = likely

    def best(self, count: int | None = None, limit: int | None = None) -> Match | None:
        """Return the best match, or None if there is none.

        Ties go to the template stored first, which has the lowest id as long as none was removed,
        then to the lowest vertical and horizontal offset.

        Args:
            count: search only the oldest ``count`` templates, from now on; None: all.
            limit: largest SAD of a match; a limit makes the search faster.
        """
        m = self._memory
        for slot in m._slots[count:] if count is not None else ():
            number, row = divmod(slot, m._per_chunk)
            m._chunks[number].bounds[row] = MAX_SAD  # excluded by its bound
        bound = MAX_SAD if limit is None else limit + 1
        home, likely = divmod(self._likely, m._per_chunk)
        if home > 0:
            bound = min(bound, self._refine(m._chunks[home], likely, likely + 1, bound)[2] + 1)
            likely = -1
        best: Match | None = None
        for number, chunk, learned in self._chunks():
            row, place, found_sad = self._refine(
                chunk, 0, learned, bound, likely if number == 0 else -1
            )
            if row >= 0:
                bound = found_sad
                template_id = m._id_of_slot[number * m._per_chunk + row]
                best = Match(template_id, int(m._offsets[place]), found_sad)
        return best

    def match(self, template_id: int) -> Match:
        """Return the match of one template, at its best offset."""
        m = self._memory
        number, row = divmod(m._slot_of(template_id), m._per_chunk)
        sad, place = best_of_row(m._chunks[number].pixels, *m._fine, self._pixels, row)
        return Match(template_id, int(m._offsets[place]), int(sad))

    def sad(self, template_id: int) -> int:
        """Return the smallest SAD of one template over all offsets."""
        return self.match(template_id).sad

    def sads(self, ranks: Sequence[int] | Indices) -> Indices:
        """Return the smallest SAD over all offsets of each of some templates.

        Args:
            ranks: places of the templates in the order of their ids.
        """
        m = self._memory
        slots = np.array(m._slots, np.int64)[np.asarray(ranks, np.int64)]
        numbers, rows = np.divmod(slots, m._per_chunk)
        found = np.empty(len(ranks), np.int64)
        for number in np.unique(numbers).tolist():
            of_chunk = numbers == number
            pixels = m._chunks[number].pixels
            found[of_chunk] = smallest_sads(pixels, *m._fine, self._pixels, rows[of_chunk])
        return found

    def _chunks(self) -> list[tuple[int, _Chunk, int]]:
        """Return index, chunk and number of its templates, without empty chunks."""
        count, size = len(self._memory), self._memory._per_chunk
        chunks = self._memory._chunks[: -(-count // size)]
        return [(n, chunk, min(count - n * size, size)) for n, chunk in enumerate(chunks)]

    def _refine(
        self, chunk: _Chunk, first: int, last: int, bound: int, likely: int = -1
    ) -> tuple[int, int, int]:
        m = self._memory
        row, place, found = refine(
            chunk.pixels, *m._fine, self._pixels, chunk.blocks, *m._coarse, self._blocks,
            chunk.bounds, m._divisor, m._slack, first, last, bound, likely,
        )
        return int(row), int(place), int(found)


def _aligned(size: int) -> Bytes:
    """Return (size + PIECE_BYTES,) uint8, uninitialised, aligned to cache lines."""
    padded = np.empty(size + 2 * PIECE_BYTES, np.uint8)
    return padded[-padded.ctypes.data % PIECE_BYTES :][: size + PIECE_BYTES]
