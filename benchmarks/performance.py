# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""What every step costs, at which size, and how that grows.

    python benchmarks/performance.py [--quick] [--data ../shared/data] [--out results/benchmarks]

Medians of calls in one warm process on one thread, with the 10th and 90th percentile; what is
compiled is timed apart. The C++ figures are OpenRatSLAM's core, compiled -O3, one thread, on a
machine of the same kind; where it was not run at a size its cost is extended along its growth and
marked with ~. Machines are noisy, shared ones more so: beside each figure stands what it would be
if this machine ran as fast as that one, by a yardstick taken before and after it, 20 sweeps
over the links of 6,000 experiences in the original's order, the same arithmetic in both (2.5 ms
there). The table goes to the screen, the curves to performance.png.
"""

from __future__ import annotations

import argparse
import gc
import math
import os
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, field
from pathlib import Path

import matplotlib
import numpy as np
import routes
from node_start import NODES, ready_s
from numpy.typing import NDArray
from town import resident_mb
from views import QUERIES, Kind, kinds

from ratslam_ros.core.common.odometry import Motion
from ratslam_ros.core.config import ExperienceMapParameters, PoseCellsParameters
from ratslam_ros.core.mapping.experience_map import ExperienceMap
from ratslam_ros.core.mapping.relaxation import sweep
from ratslam_ros.core.pose_cells.map_action import MapAction
from ratslam_ros.core.pose_cells.pose_cells import PoseCells
from ratslam_ros.core.pose_cells.torus import Place
from ratslam_ros.core.vision.template_memory import TemplateMemory
from ratslam_ros.core.vision.visual_odometry import VisualOdometry
from ratslam_ros.core.warm_up import warm_up
from ratslam_ros.files.config import load_config

matplotlib.use('Agg')
import matplotlib.pyplot as plt
from matplotlib.ticker import NullFormatter

ROOT = Path(__file__).resolve().parents[1]
NOWHERE = Place(0.0, 0.0, 0.0)
MOTION = Motion(0.1, 0.05, 0.002)


@dataclass(frozen=True)
class Row:
    """One line of the table; times in ms."""

    step: str
    size: str
    cpp: str
    target: float
    times_ms: list[float]
    note: str = ''

    def text(self, slower: float) -> str:
        """Return the line; ``slower``: how many times slower this machine was meanwhile."""
        median = statistics.median(self.times_ms)
        low, high = np.percentile(self.times_ms, [10, 90])
        met = 'yes' if median <= self.target else 'no'
        if met == 'no' and median <= self.target * slower:
            met = 'scaled'
        return (
            f'| {self.step} | {self.size} | {self.cpp} | {self.target:.4g} | {median:.3f} | '
            f'{low:.3f} to {high:.3f} | {median / slower:.3f} | {met} | {self.note} |'
        )


HEADER = (
    '| step | size | C++ -O3, ms | target, ms | median, ms | 10 to 90 % | scaled, ms | met | |\n'
    '| --- | --- | --- | --- | --- | --- | --- | --- | --- |'
)


class Yardstick:
    """How many times slower this machine is than the one of the C++ figures."""

    def __init__(self) -> None:
        graph = driven(6_000, ExperienceMapParameters(exp_loops=0))
        self._arrays = graph._poses, graph.link_ends, graph.link_shapes, graph.link_count
        self._before = self._now()

    def lap(self) -> float:
        """Return the mean of now and the last time."""
        before, self._before = self._before, self._now()
        return (before + self._before) / 2.0

    def _now(self) -> float:
        return statistics.median(timed_ms(lambda: sweep(*self._arrays, 0.5, 20), 21)) / 2.5


@dataclass
class Curve:
    """Cost over size, ours and the original's; times in ms."""

    title: str
    axis: str
    ours: dict[str, dict[float, float]] = field(default_factory=dict)
    cpp: dict[float, float] = field(default_factory=dict)

    def add(self, name: str, size: float, times_ms: list[float]) -> None:
        """Note the median at a size."""
        self.ours.setdefault(name, {})[size] = statistics.median(times_ms)


def timed_ms(step: Callable[[], object], repeats: int) -> list[float]:
    step()
    gc.collect()
    times_ms = []
    for _ in range(repeats):
        start_s = time.perf_counter()
        step()
        times_ms.append((time.perf_counter() - start_s) * 1e3)
    return times_ms


# Pose cells


def pose_cells(curve: Curve) -> Iterator[Row]:
    curve.cpp = {11: 0.22, 30: 0.63, 64: 3.3, 106: 5.7}
    targets = {11: None, 30: 0.08, 64: None, 106: 0.1, 300: None, 1000: 0.15}
    cpp = {30: '0.63', 106: '5.7'}
    for side, target in targets.items():
        before_mb = resident_mb()
        cells = PoseCells(PoseCellsParameters(pc_dim_x=side, pc_dim_y=side))
        for _ in range(50):
            cells.integrate(MOTION)
        times_ms = timed_ms(lambda cells=cells: cells.integrate(MOTION), 1000)
        curve.add('one packet', side, times_ms)
        active = sum(int((p.cells > 0).sum()) for p in cells._packets)
        note = f'{active} active cells, {resident_mb() - before_mb:.0f} MB'
        if target is not None:
            yield Row('pose cells, one odometry step, one packet', f'{side}x{side}x36',
                      cpp.get(side, 'none'), target, times_ms, note)  # fmt: skip
        if side >= 106:
            one = statistics.median(times_ms)
            three = three_packets_ms(cells)
            curve.add('three packets', side, three)
            if side == 1000:
                ratio = statistics.median(three) / one
                yield Row('the same, three packets', f'{side}x{side}x36', 'none', 3.0 * one, three,
                          f'{ratio:.2f} times one packet')  # fmt: skip


def three_packets_ms(cells: PoseCells) -> list[float]:
    network, packets = cells._network, cells._packets
    theta, y, x = network.peak(packets)
    for k in (1, 2):
        packets = network.inject(
            packets, theta + 12 * k, y + network.dims[1] / 3 * k, x + network.dims[2] / 3 * k, 1.0
        )
    for _ in range(3):
        packets = network.step(packets, 0.05, 0.01)
    assert len(packets) == 3, len(packets)
    return timed_ms(lambda: network.peak(network.step(packets, 0.05, 0.01)), 1000)


# Local view


def filled(kind: Kind, panoramic: bool = False) -> TemplateMemory:
    p = kind.parameters
    memory = TemplateMemory(
        60, 10, 0 if panoramic else 5, 0, 1, panoramic=panoramic, signed=p.vt_patch_normalise > 0
    )
    for view in kind.templates:
        memory.append(view)
    return memory


def search_ms(
    memory: TemplateMemory, views: Iterable[NDArray[np.uint8]], limit: int | None
) -> list[float]:
    """Return the time of a search for each view, looked for once; another one went before."""
    first, *others = views
    memory.search(first).best(limit=limit)
    gc.collect()
    times_ms = []
    for view in others:
        start_s = time.perf_counter()
        memory.search(view).best(limit=limit)
        times_ms.append((time.perf_counter() - start_s) * 1e3)
    return times_ms


def local_view(curve: Curve, quick: bool, data: Path) -> Iterator[Row]:
    count = 20_000
    found = kinds(count, data)
    worst: dict[str, tuple[float, str, list[float]]] = {}
    by_kind = []
    for kind in found:
        memory = filled(kind)
        limit = math.floor(kind.parameters.vt_match_threshold * memory.full_sum)
        times = {
            'decision': search_ms(memory, kind.unknown, limit),
            'exact': search_ms(memory, kind.unknown, None),
            'known': search_ms(memory, kind.known(), limit),
        }
        part = Kind(kind.name, kind.templates[:5000], kind.unknown, kind.parameters)
        panorama = filled(part, panoramic=True)
        times['panoramic'] = search_ms(panorama, kind.unknown, limit * 6 // 5)
        times['panoramic, exact'] = search_ms(panorama, kind.unknown, None)
        for name, times_ms in times.items():
            median = statistics.median(times_ms)
            if name not in worst or median > worst[name][0]:
                worst[name] = median, kind.name, times_ms
        by_kind.append(f'{kind.name}: ' + ', '.join(
            f'{name} {statistics.median(t):.2f}' for name, t in times.items()))  # fmt: skip
        for size in (1_000, 5_000, 20_000):
            small = filled(Kind(kind.name, kind.templates[:size], kind.unknown, kind.parameters))
            curve.add(kind.name, size, search_ms(small, kind.unknown[:8], limit))
    curve.cpp = {1_000: 2.8, 20_000: 56.0, 1_000_000: 2_700.0}
    for line in by_kind:
        print(f'  local view, ms: {line}', flush=True)
    lines = {
        'decision': ('local view, view not in memory: the decision', '20,000', '56', 1.5),
        'exact': ('the same with the exact minimum', '20,000', '56', 5.0),
        'known': ('view in memory', '20,000', '33', 1.5),
        'panoramic': ('panoramic, every offset: the decision', '5,000', '18 at every fifth', 3.0),
        'panoramic, exact': ('the same with the exact minimum', '5,000', '18 at every fifth', 3.0),
    }
    for name, (step, size, cpp, target) in lines.items():
        _, kind_name, times_ms = worst[name]
        yield Row(step, size, cpp, target, times_ms, f'worst of the kinds: {kind_name}')
    if not quick:
        yield from a_million(curve, found)


def a_million(curve: Curve, found: list[Kind]) -> Iterator[Row]:
    """Every kind again, repeated with other brightness and shifted, up to 1,000,000."""
    worst: tuple[float, str, list[float]] | None = None
    for kind in found:
        before_mb = resident_mb()
        memory = TemplateMemory(
            60, 10, 5, 0, 1, panoramic=False, signed=kind.parameters.vt_patch_normalise > 0
        )
        limit = math.floor(kind.parameters.vt_match_threshold * memory.full_sum)
        for repeat in range(50):
            for view in np.roll(kind.templates, repeat, 2) ^ np.uint8(repeat % 4):
                memory.append(view)
            if len(memory) == 100_000:
                curve.add(kind.name, len(memory), search_ms(memory, kind.unknown[:5], limit))
        times_ms = search_ms(memory, kind.unknown[:8], limit)
        curve.add(kind.name, len(memory), times_ms)
        used_mb = resident_mb() - before_mb
        median = statistics.median(times_ms)
        print(f'  a million, {kind.name}: {median:.1f} ms, templates 600 MB, '
              f'memory {memory.nbytes / 1e6:.0f} MB (resident {used_mb:.0f} MB)', flush=True)
        if worst is None or statistics.median(times_ms) > worst[0]:
            note = f'worst: {kind.name}; {memory.nbytes / 6e8:.2f} times the templates'
            worst = statistics.median(times_ms), note, times_ms
        del memory
    assert worst is not None
    yield Row('the decision', '1,000,000', '~2,700', 60.0, worst[2], worst[1])


# Experience map


def driven(count: int, parameters: ExperienceMapParameters) -> ExperienceMap:
    """Drive three laps of a circle with drifting odometry; each lap makes its own experiences."""
    rng = np.random.default_rng(5)
    graph = ExperienceMap(parameters)
    source = -1
    for target in range(count):
        graph.integrate(Motion(1.0, 1.0, 6 * math.pi / count + rng.normal(0.0, 0.003) + 1e-5))
        graph.apply(MapAction('create', source, target, target, 0.0, NOWHERE))
        source = target
    return graph


def close(graph: ExperienceMap, target: int, kind: str = 'link') -> None:
    graph.integrate(Motion(1.0, 1.0, 0.002))
    graph.apply(MapAction(kind, graph.current_id, target, target, 0.0, NOWHERE))  # type: ignore[arg-type]


def link_errors_m(graph: ExperienceMap) -> float:
    """Return the root of the sum of all links' squared errors in position."""
    ends, shapes, poses = graph.link_ends, graph.link_shapes, graph.poses
    direction = poses[ends[:, 0], 2] + shapes[:, 1]
    way = poses[ends[:, 1], :2] - poses[ends[:, 0], :2]
    way -= shapes[:, :1] * np.stack([np.cos(direction), np.sin(direction)], 1)
    return float(np.sqrt((way**2).sum()))


def loop_closure(curve: Curve, quick: bool) -> Iterator[Row]:
    for count in (1_000, 6_000) if quick else (1_000, 6_000, 50_000):
        times_ms = []
        for _ in range(3 if count > 6_000 else 7):
            graph = driven(count, ExperienceMapParameters())
            start_s = time.perf_counter()
            close(graph, count // 3)  # a whole lap back
            times_ms.append((time.perf_counter() - start_s) * 1e3)
        aim = link_errors_m(graph)
        curve.add('closing a loop', count, times_ms)
        if count == 6_000:
            sweeps, reached = sweeps_until(count, 1.01 * aim, 3_000 if quick else 40_000)
            cpp_ms = sweeps * 0.125
            about = '' if reached else 'more than '
            yield Row('experience map: closing a large loop, to the fixed point', '6,000',
                      f'{about}{cpp_ms:,.0f}', cpp_ms / 20.0, times_ms,
                      f'sweeps to within 1 %: {about}{sweeps:,}')  # fmt: skip


def sweeps_until(count: int, aim: float, most: int) -> tuple[int, bool]:
    """Return how many sweeps from link to link it takes until the links' error is that small."""
    graph = driven(count, ExperienceMapParameters(exp_loops=0))
    close(graph, count // 3)
    for sweeps in range(500, most + 1, 500):
        sweep(graph._poses, graph.link_ends, graph.link_shapes, graph.link_count, 0.5, 500)
        if link_errors_m(graph) <= aim:
            return sweeps, True
    return most, False


def settled_action(curve: Curve) -> Iterator[Row]:
    curve.cpp = {6_000: 2.5, 50_000: 22.0}
    for count in (1_000, 6_000, 20_000, 50_000):
        graph = driven(count, ExperienceMapParameters())
        close(graph, count // 3)
        graph.settle()
        times_ms = []
        for number in range(400):  # along the known lap; a new way now and then
            start_s = time.perf_counter()
            if number % 10 == 9:
                close(graph, len(graph), 'create')
                graph.current_id = count // 3 + number
            else:
                close(graph, graph.current_id + 1, 'set')
            times_ms.append((time.perf_counter() - start_s) * 1e3)
        curve.add('one action, median', count, times_ms)
        curve.add('one action, mean', count, [statistics.mean(times_ms)])
        if count == 50_000:
            note = f'mean {statistics.mean(times_ms):.2f}, worst {max(times_ms):.1f}'
            yield Row('one action in a settled map', '50,000', '22', 0.5, times_ms, note)


def route_rows(curve: Curve) -> Iterator[Row]:
    curve.cpp = {6_000: 29.0, 50_000: 2_678.0}
    for count in (1_000, 6_000, 50_000):
        times_ms = routes.route_ms(count, 60)
        curve.add('route', count, times_ms)
        replan_ms = routes.replan_ms(count, 500)
        curve.add('re-planning, an action, mean', count, [statistics.mean(replan_ms)])
        if count in routes.CPP_MS:
            target = {6_000: 1.0, 50_000: 10.0}[count]
            note = f'first after a change {routes.first_route_ms(count):.1f}'
            yield Row('route to a goal', f'{count:,}', f'{routes.CPP_MS[count]:,.0f}', target,
                      times_ms, note)  # fmt: skip
        if count == 50_000:
            yield Row('re-planning while driving, an action (mean)', '50,000', '2,678', 1.0,
                      [statistics.mean(replan_ms)], f'worst {max(replan_ms):.1f}')  # fmt: skip


# Visual odometry, starts


def visual_odometry(curve: Curve) -> Iterator[Row]:
    config, _ = load_config('stlucia')
    curve.cpp = {640 * 480: 0.072}
    rng = np.random.default_rng(0)
    for scale in (1, 2, 4):
        width, height = 640 // scale, 480 // scale
        coarse = rng.integers(0, 256, (height // 10, width // 10), dtype=np.uint8)
        image = coarse.repeat(10, 0).repeat(10, 1)
        images = [np.ascontiguousarray(np.roll(image, k, 1)) for k in range(8)]
        p = config.visual_odometry
        windows = {
            f'{name}_{axis}_{end}': getattr(p, f'{name}_{axis}_{end}') // scale
            for name in ('vrot_image', 'vtrans_image') for axis in 'xy' for end in ('min', 'max')
        }  # fmt: skip
        smaller = config.with_values(
            {f'visual_odometry.{name}': value for name, value in windows.items()}
        )
        odometry = VisualOdometry(smaller.visual_odometry)
        stamps = iter(range(10**9))
        times_ms = timed_ms(
            lambda o=odometry, i=images, s=stamps: o((n := next(s)) * 10**8, i[n % 8]), 2000
        )
        curve.add('one image', width * height, times_ms)
        if scale == 1:
            yield Row('visual odometry, grey', '640x480', '0.072', 0.05, times_ms,
                      'St Lucia windows')  # fmt: skip


def starts(repeats: int) -> Iterator[Row]:
    for node in NODES[:-1]:
        times_ms = [1e3 * s for s in ready_s(node, repeats)]
        yield Row(f'start of {node}, second time', 'to ready', '', 2000.0, times_ms)


def compile_s() -> tuple[float, float]:
    """Return how long a process takes to compile all, and to load what was compiled."""
    code = 'import time; s = time.perf_counter(); from ratslam_ros.core.warm_up import warm_up\n'
    code += 'warm_up(); print(time.perf_counter() - s)'
    took = []
    with tempfile.TemporaryDirectory() as folder:
        environment = {**os.environ, 'NUMBA_CACHE_DIR': folder, 'PYTHONPATH': str(ROOT)}
        for _ in range(2):
            out = subprocess.run([sys.executable, '-c', code], env=environment, check=True,
                                 capture_output=True, text=True).stdout  # fmt: skip
            took.append(float(out))
    return took[0], took[1]


def plot(curves: Iterable[Curve], path: Path) -> None:
    figure, axes = plt.subplots(2, 3, figsize=(14, 8), constrained_layout=True)
    for curve, ax in zip(curves, axes.flat, strict=True):
        for name, points in curve.ours.items():
            ax.loglog(list(points), list(points.values()), 'o-', label=name, markersize=4)
        if curve.cpp:
            sizes, cpp_ms = list(curve.cpp), list(curve.cpp.values())
            ax.loglog(sizes, cpp_ms, 'k--' if len(sizes) > 1 else 'k*', label='C++ -O3')
        ax.set(title=curve.title, xlabel=curve.axis, ylabel='ms')
        ax.grid(True, which='major', alpha=0.4)
        ax.xaxis.set_minor_formatter(NullFormatter())
        ax.legend(fontsize=7)
    path.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(path, dpi=90)


def main() -> None:
    parser = argparse.ArgumentParser(description='Cost of every step over its size.')
    parser.add_argument('--quick', action='store_true', help='no million templates, fewer sweeps')
    parser.add_argument('--data', type=Path, default=ROOT.parent / 'shared' / 'data')
    parser.add_argument('--out', type=Path, default=ROOT / 'results' / 'benchmarks')
    options = parser.parse_args()
    compiled_s, loaded_s = compile_s()
    warm_up()
    curves = [
        Curve('pose cells, one odometry step', 'cells along x and y'),
        Curve('local view, unknown view: the decision', 'templates'),
        Curve('experience map, one action', 'experiences'),
        Curve('experience map, closing a loop', 'experiences'),
        Curve('routes', 'experiences'),
        Curve('visual odometry', 'pixels of the image'),
    ]
    lines = [HEADER]
    yardstick = Yardstick()
    for part in (
        pose_cells(curves[0]), local_view(curves[1], options.quick, options.data),
        loop_closure(curves[3], options.quick), settled_action(curves[2]), route_rows(curves[4]),
        visual_odometry(curves[5]), starts(3 if options.quick else 5),
    ):  # fmt: skip
        for row in part:
            lines.append(row.text(yardstick.lap()))
            print(lines[-1], flush=True)
    plot(curves, options.out / 'performance.png')
    print(f'\ncompiling everything: {compiled_s:.1f} s, loading it: {loaded_s:.1f} s, apart from '
          f'what follows; {QUERIES} views of each kind; {options.out / "performance.png"}\n')
    print('\n'.join(lines))


if __name__ == '__main__':
    main()
