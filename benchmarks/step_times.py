# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Time of every step over its size, compared with OpenRatSLAM.

    python benchmarks/step_times.py [--quick] [--data ../shared/data] [--out results/benchmarks]

The script prints a table of medians, with 10th and 90th percentiles, of calls in one warm process
on one thread, and draws the curves into performance.png. Compilation is timed separately. The C++
times are those of OpenRatSLAM's core: -O3, one thread, a comparable machine. Times that were
extrapolated to other sizes are marked with ~.

The speed of shared machines varies. The column "scaled" is the time at the speed of the machine of
the C++ times. The ratio of speeds is measured before and after each row by a reference computation
that is the same in both programs: 20 sweeps over the links of 6,000 experiences in the order of
OpenRatSLAM (2.5 ms there).
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
from dataclasses import dataclass, field, replace
from pathlib import Path

import matplotlib
import numpy as np
import route_planning_time as routes
from node_start import NODES, ready_s
from numpy.typing import NDArray
from simulated_town import resident_mb
from template_views import QUERIES, Kind, kinds

from ratslam_ros.core.common.odometry import Motion
from ratslam_ros.core.config import ExperienceMapParameters
from ratslam_ros.core.landmarks.features import Observations
from ratslam_ros.core.landmarks.stochastic_map import StochasticMap
from ratslam_ros.core.mapping.experience_map import ExperienceMap
from ratslam_ros.core.mapping.relaxation import sweep
from ratslam_ros.core.pose_cells.map_action import MapAction
from ratslam_ros.core.pose_cells.pose_cells import PoseCells
from ratslam_ros.core.pose_cells.torus import Place
from ratslam_ros.core.vision.built_in import built_in_encoder
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
    """One row of the table.

    Attributes:
        step: name of the step.
        size: size of the problem.
        cpp: time of OpenRatSLAM in ms, as text.
        target: target for the median, in ms.
        times_ms: measured times in ms.
        note: text of the last column.
    """

    step: str
    size: str
    cpp: str
    target: float
    times_ms: list[float]
    note: str = ''

    def text(self, slowdown: float) -> str:
        """Return the row as Markdown.

        ``slowdown``: time of the reference computation relative to the machine of the C++ times.
        """
        median = statistics.median(self.times_ms)
        low, high = np.percentile(self.times_ms, [10, 90])
        met = 'yes' if median <= self.target else 'no'
        if met == 'no' and median <= self.target * slowdown:
            met = 'scaled'
        return (
            f'| {self.step} | {self.size} | {self.cpp} | {self.target:.4g} | {median:.3f} | '
            f'{low:.3f} to {high:.3f} | {median / slowdown:.3f} | {met} | {self.note} |'
        )


HEADER = (
    '| step | size | C++ -O3, ms | target, ms | median, ms | 10 to 90 % | scaled, ms | met | |\n'
    '| --- | --- | --- | --- | --- | --- | --- | --- | --- |'
)


class ReferenceTimer:
    """Slowdown of this machine relative to the one of the C++ times."""

    def __init__(self) -> None:
        graph = driven(6_000, ExperienceMapParameters(exp_loops=0))
        self._arrays = graph._poses.values, graph.link_ends, graph.link_table.shapes
        self._before = self._now()

    def lap(self) -> float:
        """Return the mean slowdown since the last call: of its value then and its value now."""
        before, self._before = self._before, self._now()
        return (before + self._before) / 2.0

    def _now(self) -> float:
        return statistics.median(timed_ms(lambda: sweep(*self._arrays, 0.5, 20), 21)) / 2.5


@dataclass
class Curve:
    """Time over size for one panel of the picture.

    Attributes:
        title: title of the panel.
        axis: label of the x axis.
        measured: median times in ms by size, for each curve.
        cpp: times of OpenRatSLAM in ms, by size.
    """

    title: str
    axis: str
    measured: dict[str, dict[float, float]] = field(default_factory=dict)
    cpp: dict[float, float] = field(default_factory=dict)

    def add(self, name: str, size: float, times_ms: list[float]) -> None:
        """Add the median of some times at a size."""
        self.measured.setdefault(name, {})[size] = statistics.median(times_ms)


def timed_ms(step: Callable[[], object], repeats: int) -> list[float]:
    """Return the times of repeated calls after one call that is not timed, in ms."""
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
    """Measure odometry steps of one and of three packets, for several extents."""
    curve.cpp = {11: 0.22, 30: 0.63, 64: 3.3, 106: 5.7}
    targets = {11: None, 30: 0.08, 64: None, 106: 0.1, 300: None, 1000: 0.15}
    cpp = {30: '0.63', 106: '5.7'}
    for side, target in targets.items():
        before_mb = resident_mb()
        original = load_config('extended')[0].pose_cells
        cells = PoseCells(replace(original, pc_dim_x=side, pc_dim_y=side))
        for _ in range(50):
            cells.integrate(MOTION)
        times_ms = timed_ms(lambda cells=cells: cells.integrate(MOTION), 1000)
        curve.add('one packet', side, times_ms)
        active = sum(int((p.cells > 0).sum()) for p in cells._packets)
        note = f'{active} active cells, {resident_mb() - before_mb:.0f} MB'
        if target is not None:
            yield Row('pose cells, one odometry step, one packet', f'{side}x{side}x36',
                      cpp.get(side, 'none'), target, times_ms, note)
        if side >= 106:
            one = statistics.median(times_ms)
            three = three_packets_ms(cells)
            curve.add('three packets', side, three)
            if side == 1000:
                ratio = statistics.median(three) / one
                yield Row('the same, three packets', f'{side}x{side}x36', 'none', 3.0 * one, three,
                          f'{ratio:.2f} times one packet')


def three_packets_ms(cells: PoseCells) -> list[float]:
    """Return the times of steps with three separate packets, in ms."""
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
    """Return a memory with all templates of a kind."""
    memory = TemplateMemory(
        built_in_encoder(replace(kind.parameters, vt_panoramic=panoramic)).layout
    )
    for view in kind.templates:
        memory.append(view)
    return memory


def search_ms(
    memory: TemplateMemory, views: Iterable[NDArray[np.uint8]], limit: int | None
) -> list[float]:
    """Return the search times of all views but the first, which is not timed, in ms.

    ``limit``: largest SAD of a match, None for the exact minimum.
    """
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
    """Measure searches for all kinds of views; the rows are those of the slowest kind."""
    count = 20_000
    both = kinds(count, data)
    all_kinds = [kind for kind in both if not kind.gradients]
    found: dict[str, list[tuple[list[float], str]]] = {}
    by_kind = []
    for kind in all_kinds:
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
            found.setdefault(name, []).append((times_ms, f'slowest kind: {kind.name}'))
        by_kind.append(f'{kind.name}: ' + ', '.join(
            f'{name} {statistics.median(t):.2f}' for name, t in times.items()))
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
    for name, row in lines.items():
        yield Row(*row, *slowest(found[name]))
    decision_ms = statistics.median(slowest(found['decision'])[0])
    yield from gradients([kind for kind in both if kind.gradients], decision_ms)
    if not quick:
        yield from a_million(curve, all_kinds)


def gradients(gradient_kinds: list[Kind], intensity_ms: float) -> Iterator[Row]:
    """Measure the decision for views of gradients; the row is that of the slowest kind."""
    found = []
    for kind in gradient_kinds:
        memory = filled(kind)
        limit = math.floor(kind.parameters.vt_match_threshold * memory.full_sum)
        times_ms = search_ms(memory, kind.unknown, limit)
        ratio = statistics.median(times_ms) / intensity_ms
        found.append((times_ms, f'slowest kind: {kind.name}; {ratio:.2f} times intensity'))
    yield Row('gradients: the decision', '20,000', 'none', 1.5, *slowest(found))


def slowest(found: Iterable[tuple[list[float], str]]) -> tuple[list[float], str]:
    """Return the times, and what belongs to them, that have the largest median."""
    return max(found, key=lambda one: statistics.median(one[0]))


def a_million(curve: Curve, all_kinds: list[Kind]) -> Iterator[Row]:
    """Measure searches among 1,000,000 templates: shifted and brightened copies of each kind."""
    found = []
    for kind in all_kinds:
        before_mb = resident_mb()
        memory = TemplateMemory(built_in_encoder(kind.parameters).layout)
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
        note = f'slowest kind: {kind.name}; memory {memory.nbytes / 6e8:.2f} times the templates'
        found.append((times_ms, note))
        del memory
    yield Row('the decision', '1,000,000', '~2,700', 60.0, *slowest(found))


# Experience map


def driven(count: int, parameters: ExperienceMapParameters) -> ExperienceMap:
    """Return the map of three laps of a circle, with odometry drift and no loop closures."""
    rng = np.random.default_rng(5)
    graph = ExperienceMap(parameters)
    source = -1
    for target in range(count):
        graph.integrate(Motion(1.0, 1.0, 6 * math.pi / count + rng.normal(0.0, 0.003) + 1e-5))
        graph.apply(MapAction('create', source, target, target, 0.0, NOWHERE))
        source = target
    return graph


def close(graph: ExperienceMap, target: int, kind: str = 'link') -> None:
    """Drive 1 m and apply one action."""
    graph.integrate(Motion(1.0, 1.0, 0.002))
    graph.apply(MapAction(kind, graph.current_id, target, target, 0.0, NOWHERE))  # type: ignore[arg-type]


def link_errors_m(graph: ExperienceMap) -> float:
    """Return the root of the summed squared position errors of all links, in m."""
    ends, shapes, poses = graph.link_ends, graph.link_table.shapes, graph.poses
    direction = poses[ends[:, 0], 2] + shapes[:, 1]
    error = poses[ends[:, 1], :2] - poses[ends[:, 0], :2]
    error -= shapes[:, :1] * np.stack([np.cos(direction), np.sin(direction)], 1)
    return float(np.sqrt((error**2).sum()))


def loop_closure(curve: Curve, quick: bool) -> Iterator[Row]:
    """Measure the action that closes a large loop."""
    for count in (1_000, 6_000) if quick else (1_000, 6_000, 50_000):
        times_ms = []
        for _ in range(3 if count > 6_000 else 7):
            graph = driven(count, ExperienceMapParameters())
            start_s = time.perf_counter()
            close(graph, count // 3)  # two laps before
            times_ms.append((time.perf_counter() - start_s) * 1e3)
        solved_m = link_errors_m(graph)
        curve.add('closing a loop', count, times_ms)
        if count == 6_000:
            sweeps, reached = sweeps_until(count, 1.01 * solved_m, 3_000 if quick else 40_000)
            cpp_ms = sweeps * 0.125
            prefix = '' if reached else 'more than '
            yield Row('experience map: closing a large loop', '6,000',
                      f'{prefix}{cpp_ms:,.0f}', cpp_ms / 20.0, times_ms,
                      f'sweeps to within 1 %: {prefix}{sweeps:,}')


def sweeps_until(count: int, target_m: float, max_sweeps: int) -> tuple[int, bool]:
    """Return the number of sweeps until the link errors reach a target, and whether they do."""
    graph = driven(count, ExperienceMapParameters(exp_loops=0))
    close(graph, count // 3)
    for sweeps in range(500, max_sweeps + 1, 500):
        sweep(graph._poses.values, graph.link_ends, graph.link_table.shapes, 0.5, 500)
        if link_errors_m(graph) <= target_m:
            return sweeps, True
    return max_sweeps, False


def settled_action(curve: Curve) -> Iterator[Row]:
    """Measure single actions in a map that has converged."""
    curve.cpp = {6_000: 2.5, 50_000: 22.0}
    for count in (1_000, 6_000, 20_000, 50_000):
        graph = driven(count, ExperienceMapParameters())
        close(graph, count // 3)
        graph.settle()
        times_ms = []
        for number in range(400):  # along the known lap, with a new experience now and then
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
    """Measure route planning, and replanning during a drive."""
    curve.cpp = {6_000: 29.0, 50_000: 2_678.0}
    for count in (1_000, 6_000, 50_000):
        times_ms = routes.route_ms(count, 60)
        curve.add('route', count, times_ms)
        replan_ms = routes.replan_ms(count, 500)
        curve.add('replanning per action, mean', count, [statistics.mean(replan_ms)])
        if count in routes.CPP_MS:
            target = {6_000: 1.0, 50_000: 10.0}[count]
            note = f'first after a change {routes.first_route_ms(count):.1f}'
            yield Row('route to a goal', f'{count:,}', f'{routes.CPP_MS[count]:,.0f}', target,
                      times_ms, note)
        if count == 50_000:
            yield Row('replanning while driving, per action (mean)', '50,000', '2,678', 1.0,
                      [statistics.mean(replan_ms)], f'worst {max(replan_ms):.1f}')


# Stochastic map


def stochastic_map() -> Iterator[Row]:
    """Measure the observation of one known bar, for two sizes of the map."""
    for count, target in ((80, 0.2), (500, 5.0)):
        rng = np.random.default_rng(0)
        built = StochasticMap()
        values = np.column_stack((
            rng.uniform(1.0, 10.0, count), rng.uniform(-3.0, 3.0, count),
            rng.uniform(-3.0, 3.0, count), rng.uniform(0.0, 2.0, count),
        ))
        names = np.arange(count)
        built.observe(Observations(values, names))
        single = [Observations(values[k : k + 1], names[k : k + 1]) for k in names]
        order = iter(rng.integers(count, size=10**6).tolist())
        times_ms = timed_ms(lambda b=built, s=single, o=order: b.observe(s[next(o)]), 300)
        yield Row('stochastic map of bars: one observation', str(count), 'none', target, times_ms,
                  f'{4 * count + 3} values')


# Visual odometry, start-up, compilation


def visual_odometry(curve: Curve) -> Iterator[Row]:
    """Measure visual odometry for several image sizes."""
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
        }
        smaller = config.with_values(
            {f'visual_odometry.{name}': value for name, value in windows.items()}
        )
        odometry = VisualOdometry(smaller.visual_odometry)
        stamps = iter(range(10**9))
        times_ms = timed_ms(
            lambda o=odometry, i=images, s=stamps: o.estimate((n := next(s)) * 10**8, i[n % 8]),
            2000,
        )
        curve.add('one image', width * height, times_ms)
        if scale == 1:
            yield Row('visual odometry, grey', '640x480', '0.072', 0.05, times_ms,
                      'St Lucia windows')


def starts(repeats: int) -> Iterator[Row]:
    """Measure the start-up of each node with compiled functions in the cache."""
    for node in NODES[:-1]:
        times_ms = [1e3 * s for s in ready_s(node, repeats)]
        yield Row(f'start of {node}, compiled', 'to ready', '', 2000.0, times_ms)


def compile_s() -> tuple[float, float]:
    """Return the times to compile all functions, and to load the compiled ones, in s."""
    code = 'import time; s = time.perf_counter(); from ratslam_ros.core.warm_up import warm_up\n'
    code += 'warm_up(); print(time.perf_counter() - s)'
    took = []
    with tempfile.TemporaryDirectory() as folder:
        environment = {**os.environ, 'NUMBA_CACHE_DIR': folder, 'PYTHONPATH': str(ROOT)}
        for _ in range(2):
            out = subprocess.run([sys.executable, '-c', code], env=environment, check=True,
                                 capture_output=True, text=True).stdout
            took.append(float(out))
    return took[0], took[1]


def plot(curves: Iterable[Curve], path: Path) -> None:
    """Draw one panel per step, with the legend beside it."""
    figure, axes = plt.subplots(2, 3, figsize=(18, 8), constrained_layout=True)
    for curve, ax in zip(curves, axes.flat, strict=True):
        for name, points in curve.measured.items():
            ax.loglog(list(points), list(points.values()), 'o-', label=name, markersize=4)
        if curve.cpp:
            sizes, cpp_ms = list(curve.cpp), list(curve.cpp.values())
            ax.loglog(sizes, cpp_ms, 'k--' if len(sizes) > 1 else 'k*', label='C++ -O3')
        ax.set(title=curve.title, xlabel=curve.axis, ylabel='ms')
        ax.grid(True, which='major', alpha=0.4)
        ax.xaxis.set_minor_formatter(NullFormatter())
        ax.legend(fontsize=8, loc='upper left', bbox_to_anchor=(1.0, 1.0))
    path.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(path, dpi=90)


def main() -> None:
    parser = argparse.ArgumentParser(description='Time of every step over its size.')
    parser.add_argument('--quick', action='store_true',
                        help='without the million templates, and with fewer sweeps')
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
    reference = ReferenceTimer()
    for part in (
        pose_cells(curves[0]), local_view(curves[1], options.quick, options.data),
        loop_closure(curves[3], options.quick), settled_action(curves[2]), route_rows(curves[4]),
        stochastic_map(), visual_odometry(curves[5]), starts(3 if options.quick else 5),
    ):
        for row in part:
            lines.append(row.text(reference.lap()))
            print(lines[-1], flush=True)
    plot(curves, options.out / 'performance.png')
    print(f'\ncompiling all functions: {compiled_s:.1f} s, loading them: {loaded_s:.1f} s, not '
          f'included below; {QUERIES} views of each kind; {options.out / "performance.png"}\n')
    print('\n'.join(lines))


if __name__ == '__main__':
    main()
