# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The search returns the same match as an exhaustive comparison."""

from dataclasses import dataclass
from typing import Any

import numba
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from ratslam_ros.core.vision import template_memory
from ratslam_ros.core.vision.encoder import Layout
from ratslam_ros.core.vision.sad import PIECE_BYTES, pieces_of, sad_by
from ratslam_ros.core.vision.template_memory import Match, TemplateMemory

Views = NDArray[np.uint8]


@dataclass(frozen=True)
class Shape:
    """Constructor arguments of a memory."""

    width: int = 60
    height: int = 10
    shift_x: int = 5
    shift_y: int = 0
    step: int = 1
    panoramic: bool = False
    signed: bool = False
    planes: int = 1

    def memory(self, views: Views) -> TemplateMemory:
        memory = TemplateMemory(Layout(
            self.width, self.height, self.planes, self.shift_x, self.shift_y, self.step,
            self.panoramic, self.signed,
        ))
        for view in views:
            memory.append(view)
        return memory


def all_sads(views: Views, view: Views, s: Shape) -> tuple[NDArray[np.int64], list[int]]:
    """Return (n, places) SADs computed with NumPy, and the offset of each place."""
    left = 0 if s.panoramic else s.shift_x
    columns, rows = s.width - 2 * left, s.height // s.planes - 2 * s.shift_y
    views = views.reshape(len(views), s.planes, -1, s.width)
    now = view.reshape(s.planes, -1, s.width).astype(np.int64)
    now = now[:, s.shift_y : s.shift_y + rows, left : left + columns]
    sads, places = [], []
    for dy in range(2 * s.shift_y + 1):
        known = views[:, :, dy : dy + rows].astype(np.int64)
        for offset in range(0, s.width if s.panoramic else 2 * s.shift_x + 1, s.step):
            part = np.roll(known, -offset, 3) if s.panoramic else known[..., offset:]
            sads.append(np.abs(part[..., :columns] - now).sum((1, 2, 3)))
            places.append(offset)
    return np.stack(sads, 1), places


def check(views: Views, queries: Views, s: Shape) -> None:
    memory = s.memory(views)
    assert np.array_equal(memory.views(), views)
    for query in queries:
        sads, offsets = all_sads(views, query, s)
        search = memory.search(query)
        at, place = divmod(int(sads.argmin()), len(offsets))
        least = int(sads[at, place])
        expected = Match(at, offsets[place], least)
        assert search.best() == expected
        assert search.best(limit=least) == expected
        assert search.best(limit=least + 1) == expected
        assert search.best(limit=least - 1) is None
        half = len(views) // 2
        older = search.best(half)
        if half == 0:
            assert older is None
        else:
            at, place = divmod(int(sads[:half].argmin()), len(offsets))
            assert older == (at, offsets[place], int(sads[at, place]))


SHAPES = [
    Shape(),
    Shape(signed=True),
    Shape(panoramic=True, shift_x=0),
    Shape(panoramic=True, shift_x=0, signed=True, step=5),
    Shape(shift_y=1, step=2),
    Shape(61, 11, 4, 2, signed=True),
    Shape(31, 7, 0, 1, panoramic=True),
    Shape(60, 20, 4),
    Shape(11, 1, 5),
    Shape(3, 3, 1, 1, signed=True),
    Shape(1, 1, 0),
    Shape(160, 120, 3),
    Shape(14, 54, 1, 1, planes=6),
    Shape(12, 20, 0, 1, panoramic=True, planes=4),
    Shape(50, 1, 0),
]


@pytest.mark.parametrize('s', SHAPES, ids=str)
def test_search_noise_matches_exhaustive_search(s: Shape) -> None:
    rng = np.random.default_rng(4)
    for levels, scale in ((2, 1), (3, 100), (256, 1)):
        images = (rng.integers(0, levels, (48, s.height, s.width)) * scale).astype(np.uint8)
        check(images[:40], images[36:], s)


@pytest.mark.parametrize('s', [*SHAPES[:6], SHAPES[12]], ids=str)
def test_search_near_ties_matches_exhaustive_search(s: Shape) -> None:
    """The templates are copies of one view, identical or different in a few pixels."""
    rng = np.random.default_rng(5)
    base = rng.integers(1, 255, (s.height, s.width))
    views = np.repeat(base[None], 60, 0)
    for view in views:
        for _ in range(rng.integers(0, 3)):
            view[rng.integers(s.height), rng.integers(s.width)] += rng.choice([-1, 1])
    check(views.astype(np.uint8), np.stack([base, 255 - base, views[7]]).astype(np.uint8), s)


@pytest.mark.parametrize('s', [*SHAPES[:5], SHAPES[12], SHAPES[13]], ids=str)
def test_search_after_removals_matches_exhaustive_search(s: Shape) -> None:
    """Templates are removed and added in small chunks; a dictionary is the reference."""
    rng = np.random.default_rng(8)
    memory, known = s.memory(np.empty((0, s.height, s.width), np.uint8)), dict[int, Any]()
    memory._per_chunk = 7
    for n in range(90):
        view = rng.integers(0, 256, (s.height, s.width), np.uint8)
        if len(known) > 25 or (known and n % 5 == 4):
            removed = list(known)[int(rng.integers(len(known)))]
            memory.remove(removed)
            del known[removed]
            for use in (memory.view, memory.remove):
                with pytest.raises(KeyError):
                    use(removed)
        known[memory.append(view)] = view
        assert list(known)[-1] == n  # ids are never reused
        search = memory.search(view // 2)
        sads, offsets = all_sads(np.stack(list(known.values())), view // 2, s)
        for count in (len(known), len(known) // 2):
            found = search.best(count)
            if count > 0:
                at, place = divmod(int(sads[:count].argmin()), len(offsets))
                assert found == (list(known)[at], offsets[place], int(sads[at, place]))
        assert [search.sad(i) for i in known] == sads.min(1).tolist()
        assert [memory.nth_id(rank) for rank in range(len(known))] == list(known)
    assert len(memory) == len(known) < 30
    assert len(memory._chunks) == 4  # memory of removed templates is used again
    assert sorted(memory.ids.tolist()) == list(known)
    for template_id, kept in zip(memory.ids.tolist(), memory.views(), strict=True):
        assert np.array_equal(kept, known[template_id])
        assert np.array_equal(memory.view(template_id), kept)


@pytest.mark.parametrize('s', SHAPES[:6], ids=str)
def test_search_views_with_equal_blocks_matches_exhaustive_search(s: Shape) -> None:
    """Block bounds cannot distinguish these views, as differences cancel within each block."""
    rng = np.random.default_rng(6)
    views = np.empty((50, s.height, s.width), np.uint8)
    for view in views:
        depth = rng.integers(0, 100, (s.height, (s.width + 1) // 2))
        view[:, ::2] = 128 + depth
        view[:, 1::2] = (128 - depth)[:, : s.width // 2]
    check(views[:44], views[40:], s)


@settings(max_examples=60)
@given(st.integers(0, 10**6), st.booleans(), st.booleans())
def test_block_bound_never_exceeds_minimum_sad(
    seed: int, panoramic: bool, signed: bool
) -> None:
    rng = np.random.default_rng(seed)
    planes = int(rng.integers(1, 4))
    s = Shape(
        int(rng.integers(3, 40)), planes * int(rng.integers(1, 13)), 1, panoramic=panoramic,
        signed=signed, planes=planes,
    )
    shape = (9, s.height, s.width)
    images = rng.choice([0, 1, 127, 128, 254, 255], shape).astype(np.uint8)
    memory = s.memory(images[:8])
    memory.search(images[8])
    least = memory._chunks[0].bounds[:8].astype(np.int64)
    sads, _ = all_sads(images[:8], images[8], s)
    assert (least * memory._divisor - memory._slack <= sads.min(1)).all()


def test_search_several_chunks_matches_exhaustive_search(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(template_memory, 'CHUNK_BYTES', 5000)
    rng = np.random.default_rng(7)
    views = rng.integers(0, 256, (40, 10, 60), dtype=np.uint8)
    views[31] = views[3]
    check(views, np.concatenate([views[[3, 31, 20, 39]], views[:2] // 2]), Shape())


def test_templates_never_move_and_memory_overhead_is_small() -> None:
    memory = Shape().memory(np.zeros((1, 10, 60), np.uint8))
    before = memory._chunks[0].pixels.ctypes.data
    for value in range(1000):
        memory.append(np.full((10, 60), value % 256, np.uint8))
    assert memory._chunks[0].pixels.ctypes.data == before
    assert memory.nbytes <= 1.5 * 600 * len(memory)


@pytest.mark.parametrize('width', [None, 16, 0])
def test_sad_is_equal_for_every_register_width(width: int | None) -> None:
    """16 bytes exist on every x86; 0 is the generic code for other processors."""
    if width and not numba.core.registry.cpu_target.target_context.codegen().magic_tuple()[
        0
    ].startswith('x86_64'):
        pytest.skip('psadbw is an x86 instruction')
    sad_of = sad_by(width)

    @numba.njit
    def call(a: Any, at_a: int, b: Any, at_b: int, pieces: int, inside: Any) -> int:
        return sad_of(a, at_a, b, at_b, pieces, inside)

    rng = np.random.default_rng(8)
    a, b = rng.integers(0, 256, (2, 2000 + PIECE_BYTES), dtype=np.uint8)
    for length in (0, 1, 63, 64, 65, 127, 500, 600, 640, 641, 1500):
        for at_a, at_b in ((0, 0), (1, 64), (77, 3)):
            parts = a[at_a : at_a + length].astype(int), b[at_b : at_b + length].astype(int)
            assert call(a, at_a, b, at_b, *pieces_of(length)) == np.abs(parts[0] - parts[1]).sum()
