# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The network's sparse packets equal those of a dense reference implementation at every step.

The network stores each packet in a box of cells. In the reference, a packet is an array over the
whole torus, on the packet's own lattice. The reference also keeps the arc that a packet spans on
each axis. The arcs decide whether two packets are merged, and which heading planes limit the
growth of a packet.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Iterator
from functools import cache
from typing import NamedTuple

import numpy as np
import pytest
from helpers import around, peak_of
from numpy.typing import NDArray

from ratslam_ros.core.pose_cells.attractor import Network, kernel
from ratslam_ros.core.pose_cells.packet import Packet

Reals = NDArray[np.float64]
Dims = tuple[int, int, int]
Arc = tuple[int, int]
"""First cell on an axis and number of cells; the first cell may lie outside the axis range."""

RUN_COUNT, STEP_COUNT = 1, 200
"""Runs per world, and steps per run. The feedback of the network amplifies rounding differences:
two references that start 1e-15 apart differ by up to 1e-12 after 200 steps, 1e-9 after 600."""

TOLERANCE = 1e-9
"""Tolerance of activities and of lattice offsets in cells."""

PEAK_TOLERANCE_CELLS = 1e-6
PEAK_EVERY_STEPS = 4


class World(NamedTuple):
    dims: Dims
    widths: tuple[int, int]
    """Widths of the excitatory and the inhibitory kernel, in cells."""
    deviations: tuple[float, float]
    cutoff: float

    def __str__(self) -> str:
        return f'{self.dims}, kernels {self.widths}, cutoff {self.cutoff}'


WIDE = (7, 5), (1.0, 2.0)
SMALL = (5, 3), (0.9, 1.5)
WORLDS = [
    World((12, 16, 20), *SMALL, 0.002),
    World((36, 12, 14), *WIDE, 0.00002),
    World((30, 8, 10), *SMALL, 0.001),
    World((28, 7, 6), *SMALL, 0.0005),
    World((8, 9, 40), *WIDE, 0.001),
    World((6, 5, 36), *SMALL, 0.0005),
    World((5, 30, 8), *SMALL, 0.001),
    World((40, 6, 5), *WIDE, 0.0002),
    World((7, 5, 8), *WIDE, 0.0002),
    World((5, 3, 30), *SMALL, 0.0005),
]
"""Most have room for several packets on one axis; in others packets span a whole axis at times."""


# The dense reference


class Whole(NamedTuple):
    """A packet: cells of the whole torus, offset of its lattice, and the arc it spans per axis."""

    cells: Reals
    frame: Reals
    arcs: tuple[Arc, ...]


class Reference:
    """The network on dense arrays. ``seen`` counts events, to check what the tests cover."""

    def __init__(self, world: World) -> None:
        w_e, w_i = (gauss(*of) for of in zip(world.widths, world.deviations, strict=True))
        self.dims = world.dims
        self._excite = [rolls(w_e, n) for n in world.dims]
        self._inhibit = [rolls(w_i, n) for n in world.dims]
        self._cutoff = world.cutoff
        self._r_e, self._r_i = len(w_e) // 2, len(w_i) // 2
        self._reach = 2 * self._r_e + self._r_i + 1
        self.packets: list[Whole] = []
        self.seen: Counter[str] = Counter()

    def start(self) -> None:
        middle = np.array([n // 2 for n in self.dims])
        self.packets = [self._point(middle, 1.0, np.zeros(3))]

    def step(self, chord: float, turn: float) -> None:
        """Compete, normalise, move."""
        competed = []
        total = 0.0
        for p in self.packets:
            excited = convolved(p.cells, self._excite)
            cells = excited - convolved(excited, self._inhibit) - self._cutoff
            cells = np.maximum(cells, 0.0)
            part = float(cells.sum())
            if part > 0.0:
                # An arc spans the whole axis if inhibition reaches around the torus.
                arcs = [grown(arc, self._r_e, n, self._r_i)
                        for arc, n in zip(p.arcs, self.dims, strict=True)]
                parts = self._trimmed(Whole(cells, p.frame, tuple(arcs)))
                self.seen['splits'] += len(parts) - 1
                competed += parts
                total += part
            else:
                self.seen['deaths'] += 1
        if not competed:
            self.seen['deaths'] -= len(self.packets)
            self.seen['nothing survived'] += 1
            competed = self.packets
            total = sum(float(p.cells.sum()) for p in competed)
        self.packets = [
            self._moved(p._replace(cells=p.cells / total), chord, turn) for p in competed
        ]
        self._merge()

    def inject(self, place: Reals, energy: float) -> None:
        whole = np.floor(place)
        point = self._point(whole.astype(int), energy, place - whole)
        near = [p for p in self.packets if self._in_reach(p, point)]
        frame = max(near, key=lambda p: float(p.cells.sum())).frame if near else np.zeros(3)
        nothing = Whole(np.zeros(self.dims), frame, point.arcs)
        self.packets.append(self._joined(nothing, point))
        self.seen['injections that join' if near else 'injections apart'] += 1
        self._merge()

    def _point(self, at: NDArray[np.int64], energy: float, frame: Reals) -> Whole:
        cells = np.zeros(self.dims)
        cells[tuple(at % self.dims)] = energy
        return Whole(cells, frame, tuple((int(i), 1) for i in at))

    def _moved(self, p: Whole, chord: float, turn: float) -> Whole:
        n_t = self.dims[0]
        headings = (np.arange(n_t) + p.frame[0] + 0.5 * turn) * (2.0 * math.pi / n_t)
        directions = np.array([np.sin(headings), np.cos(headings)])  # y, x
        planes = p.cells.sum((1, 2))
        mean = directions @ planes / planes.sum()
        ahead = chord * mean / max(math.hypot(*mean), 0.5)
        ways = chord * (directions - mean[:, None])

        first, length = p.arcs[0]
        spanned = np.abs(ways[:, np.arange(first, first + length) % n_t]).max(1)
        # Motions that are zero up to rounding do not grow an arc.
        grow = [int(turn != 0.0), *(math.ceil(way - 1e-9) + int(chord != 0.0) for way in spanned)]
        arcs = [grown(arc, by, n)
                for arc, by, n in zip(p.arcs, grow, self.dims, strict=True)]

        cells = p.cells
        if chord != 0.0:
            whole, *weights = taps(ways, ahead[:, None])
            along_y, along_x = (
                shifts(whole[i], [w[i] for w in weights], self.dims[1 + i], back=i == 1)
                for i in range(2)
            )
            cells = along_y @ cells @ along_x
        if turn != 0.0:
            cells = (turned(turn, n_t) @ cells.reshape(n_t, -1)).reshape(self.dims)

        frame = p.frame + np.array([turn, *ahead])
        whole = np.floor(frame + 0.5).astype(int)
        arcs = [(arc[0] + int(by), arc[1]) for arc, by in zip(arcs, whole, strict=True)]
        if whole.any():
            cells = np.roll(cells, tuple(whole), (0, 1, 2))
        return Whole(cells, frame - whole, tuple(arcs))

    def _joined(self, keep: Whole, give: Whole) -> Whole:
        """Add ``give`` to ``keep`` on the lattice of ``keep``, by linear interpolation."""
        cells = give.cells
        arcs = []
        for axis, n in enumerate(self.dims):
            d = float(give.frame[axis] - keep.frame[axis])
            whole = math.floor(d)
            part = d - whole
            cells = np.roll(cells, whole, axis)
            first, length = give.arcs[axis]
            if part > 0.0:
                cells = (1.0 - part) * cells + part * np.roll(cells, 1, axis)
                length = min(length + 1, n)
            arcs.append(union_arc(keep.arcs[axis], (first + whole, length), n))
        return Whole(keep.cells + cells, keep.frame, tuple(arcs))

    def _in_reach(self, a: Whole, b: Whole) -> bool:
        for p, q, n in zip(a.arcs, b.arcs, self.dims, strict=True):
            behind_p = (q[0] - p[0]) % n - p[1]
            behind_q = (p[0] - q[0]) % n - q[1]
            if min(behind_p, behind_q) >= self._reach:
                return False
        return True

    def _merge(self) -> None:
        """Merge pairs in reach until there are none; the lattice of the heavier packet is kept.

        The first pair is merged first, and the result is put last.
        """
        packets = self.packets
        while True:
            pairs = ((i, j) for i in range(len(packets)) for j in range(i + 1, len(packets)))
            pair = next((p for p in pairs if self._in_reach(*(packets[i] for i in p))), None)
            if pair is None:
                break
            a, b = (packets[i] for i in pair)
            if b.cells.sum() > a.cells.sum():
                a, b = b, a
            packets = [p for i, p in enumerate(packets) if i not in pair]
            packets.append(self._joined(a, b))
            self.seen['merges'] += 1
        self.packets = packets

    def _trimmed(self, p: Whole) -> list[Whole]:
        """Shrink the arcs to the active cells; split a packet at gaps longer than the reach."""
        arcs = []
        used = p.cells != 0.0
        columns = used.any(2)
        slices = columns.any(1), columns.any(0), used.reshape(-1, self.dims[2]).any(0)
        for axis, n in enumerate(self.dims):
            first, length = p.arcs[axis]
            places = (first + np.arange(length)) % n
            active = np.flatnonzero(slices[axis][places])
            begin, end = int(active[0]), int(active[-1]) + 1
            gaps = active[1:] - active[:-1] - 1
            gap = int(gaps.max(initial=0))
            # First active cell after the longest gap.
            after = int(active[gaps.argmax() + 1]) if gap else begin
            if length == n and gap > begin + n - end:
                # An arc over the whole axis is reopened at its longest gap.
                self.seen['circles opened'] += 1
                return self._trimmed(p._replace(arcs=changed(p.arcs, axis, (first + after, n))))
            if gap > self._reach:
                spans = (first, after - gap), (first + after, length - after)
                parts = [
                    Whole(within(p.cells, axis, span), p.frame, changed(p.arcs, axis, span))
                    for span in spans
                ]
                return [q for part in parts for q in self._trimmed(part)]
            arcs.append((first + begin, end - begin))
        return [p._replace(arcs=tuple(arcs))]


def gauss(width: int, deviation: float) -> Reals:
    k = np.arange(width) - width // 2
    weights = np.exp(-(k**2) / (2.0 * deviation**2))
    return weights / weights.sum()


def rolls(weights: Reals, n: int) -> Reals:
    """Return the circulant matrix that convolves an axis with a kernel."""
    radius = len(weights) // 2
    rolled = [w * np.roll(np.eye(n), k - radius, 0) for k, w in enumerate(weights)]
    return np.sum(rolled, axis=0)


def convolved(a: Reals, matrices: list[Reals]) -> Reals:
    along_t, along_y, along_x = matrices
    a = along_y @ (a @ along_x.T)
    return (along_t @ a.reshape(len(a), -1)).reshape(a.shape)


def taps(shift: Reals, spread_as: Reals) -> tuple[NDArray[np.int64], Reals, Reals, Reals]:
    """Return the whole-cell shift, and weights of the cells before, at and after it.

    The weights have the mean ``shift`` and the variance of bilinear interpolation.
    """
    whole = np.floor(shift + 0.5).astype(np.int64)
    e = shift - whole
    size = np.abs(e)
    part = spread_as % 1.0
    second = np.maximum(part * (1.0 - part), size * (1.0 - size)) + e * e
    before, after = (np.maximum((second + way) / 2.0, 0.0) for way in (-e, e))
    return whole, before, 1.0 - second, after


def shifts(
    whole: NDArray[np.int64], weights: list[Reals], n: int, *, back: bool = False
) -> Reals:
    """Return one matrix per shift that shifts an axis of ``n`` cells with ``taps``.

    ``back``: the matrix is for multiplication from the right; otherwise from the left.
    """
    by = np.zeros((len(whole), n))
    for k, w in zip((-1, 0, 1), weights, strict=True):
        by[np.arange(len(whole)), (whole + k) % n] += w
    return np.take(by, differences(n).T if back else differences(n), 1)


@cache
def turned(turn: float, n: int) -> Reals:
    """Return the matrix that spreads heading planes in a turn; the frame is turned separately."""
    whole, *weights = taps(np.zeros(1), np.array(turn))
    return shifts(whole, weights, n)[0]


@cache
def differences(n: int) -> NDArray[np.int64]:
    """Return (n, n) row index minus column index, modulo ``n``."""
    return (np.arange(n)[:, None] - np.arange(n)) % n


def grown(arc: Arc, by: int, n: int, more: int = 0) -> Arc:
    first, length = arc
    return (first, n) if length + 2 * by + more >= n else (first - by, length + 2 * by)


def union_arc(a: Arc, b: Arc, n: int) -> Arc:
    """Return the shorter arc that begins with one of two arcs and contains both."""
    from_a = max(a[1], (b[0] - a[0]) % n + b[1])
    from_b = max(b[1], (a[0] - b[0]) % n + a[1])
    return (a[0], min(from_a, n)) if from_a <= from_b else (b[0], min(from_b, n))


def within(a: Reals, axis: int, arc: Arc) -> Reals:
    """Return an array with zeros outside an arc of one axis."""
    n = a.shape[axis]
    inside = (np.arange(n) - arc[0]) % n < arc[1]
    return np.where(np.expand_dims(inside, tuple({0, 1, 2} - {axis})), a, 0.0)


def changed(arcs: tuple[Arc, ...], axis: int, arc: Arc) -> tuple[Arc, ...]:
    return (*arcs[:axis], arc, *arcs[axis + 1 :])


# Comparison


def dense_cells(packet: Packet, dims: Dims) -> Reals:
    """Return a packet's cells as an array over the whole torus, on its own lattice."""
    cells = np.zeros(dims)
    box = packet.box
    places = [(box[axis] + np.arange(box[3 + axis])) % dims[axis] for axis in range(3)]
    cells[np.ix_(*places)] = packet.cells
    return cells


def compare(packets: list[Packet], ref: Reference, where: str) -> None:
    assert len(packets) == len(ref.packets), f'{where}: number of packets'
    for i, (ours, theirs) in enumerate(zip(packets, ref.packets, strict=True)):
        off = float(np.abs(dense_cells(ours, ref.dims) - theirs.cells).max())
        assert off <= TOLERANCE, f'{where}: activity of packet {i} of {len(packets)}'
        off = float(np.abs(ours.frame - theirs.frame).max())
        assert off <= TOLERANCE, f'{where}: frame of packet {i} of {len(packets)}'


def compare_peak(net: Network, packets: list[Packet], ref: Reference, where: str) -> None:
    largest = max(ref.packets, key=lambda p: float(p.cells.max()))
    top = largest.cells.max() - TOLERANCE
    if sum(np.count_nonzero(p.cells >= top) for p in ref.packets) > 1:
        ref.seen['peaks that tie'] += 1
        return
    ref.seen['peaks'] += 1
    expected = peak_of(largest.cells) + largest.frame
    off = float(np.abs(around(net.peak(packets) - expected, np.array(ref.dims))).max())
    assert off <= PEAK_TOLERANCE_CELLS, f'{where}: peak'


class Injections:
    """Random injections: bursts at a place near a packet, across the torus, or anywhere."""

    def __init__(self, rng: np.random.Generator) -> None:
        self._rng = rng
        self._left = 0

    def now(self, ref: Reference) -> Iterator[tuple[Reals, float]]:
        if self._left == 0 and self._rng.random() < 0.08:
            self._left = int(self._rng.integers(1, 7))
            self._place = self._somewhere(ref)
            self._energy = float(self._rng.uniform(0.03, 0.8))
        if self._left > 0:
            self._left -= 1
            yield self._place, self._energy
        if self._rng.random() < 0.05:
            yield self._somewhere(ref), float(self._rng.uniform(0.02, 1.5))

    def _somewhere(self, ref: Reference) -> Reals:
        dims = np.array(ref.dims)
        p = ref.packets[self._rng.integers(len(ref.packets))]
        at = np.unravel_index(int(p.cells.argmax()), p.cells.shape) + p.frame
        match self._rng.choice(4, p=[0.15, 0.25, 0.4, 0.2]):
            case 0:
                at += self._rng.uniform(-2.0, 2.0, 3)
            case 1:
                at += self._rng.uniform(-8.0, 8.0, 3)
            case 2:
                at += dims / 2 + self._rng.uniform(-3.0, 3.0, 3)
            case _:
                at = self._rng.uniform(0.0, dims)
        return at % dims


@cache
def run(world: World, seed: int) -> Counter[str]:
    """Run both through the same steps, compare them at each, and return the events counted."""
    ref = Reference(world)
    w_e, w_i = (kernel(*of) for of in zip(world.widths, world.deviations, strict=True))
    net = Network(world.dims, w_e, w_i, world.cutoff)
    rng = np.random.default_rng(seed)
    injections = Injections(rng)
    packets = net.start()
    ref.start()
    chord = turn = 0.3
    for step in range(STEP_COUNT):
        where = f'{world}, seed {seed}, step {step}'
        if step % 8 == 7:
            slow, fast = rng.normal(0.0, 0.3, 2), rng.uniform(-2.0, 2.0, 2)
            chord = float(rng.choice([0.0, 1.0, *slow, *fast]))
            turn = float(rng.choice([0.0, -1.0, *rng.uniform(-1.0, 1.0, 4)]))
        for place, energy in injections.now(ref):
            packets = net.inject(packets, *place.tolist(), energy)
            ref.inject(place, energy)
        packets = net.step(packets, chord, turn)
        ref.step(chord, turn)
        compare(packets, ref, where)
        if step % PEAK_EVERY_STEPS == 0:
            compare_peak(net, packets, ref, where)
            count_arcs(ref)
        ref.seen['steps'] += 1
        ref.seen['steps with several'] += len(packets) > 1
    return ref.seen


def count_arcs(ref: Reference) -> None:
    for axis, n in enumerate(ref.dims):
        arcs = [(first % n, length) for first, length in (p.arcs[axis] for p in ref.packets)]
        ref.seen[f'whole on {axis}'] += any(length == n for _, length in arcs)
        ref.seen[f'over the end of {axis}'] += any(a + length > n > length for a, length in arcs)


@pytest.mark.parametrize('seed', range(RUN_COUNT))
@pytest.mark.parametrize('world', WORLDS, ids=str)
def test_packets_equal_dense_reference_at_every_step(world: World, seed: int) -> None:
    assert run(world, seed)['steps'] == STEP_COUNT


def test_runs_cover_all_events() -> None:
    """The comparison covers packets that merge, die and wrap around."""
    seen = sum((run(world, seed) for world in WORLDS for seed in range(RUN_COUNT)), Counter[str]())
    assert seen['steps'] == len(WORLDS) * RUN_COUNT * STEP_COUNT == 2_000
    assert seen['steps with several'] >= 200
    least = {
        'injections that join': 100, 'injections apart': 20, 'merges': 100, 'deaths': 10,
        'splits': 20, 'circles opened': 60, 'peaks': 400,
    }
    for axis in range(3):
        least |= {f'whole on {axis}': 40, f'over the end of {axis}': 40}
    assert {what: seen[what] for what, count in least.items() if seen[what] < count} == {}
