# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Plots: the map, the matches over time, the error against the truth, and sessions of a map.

matplotlib is imported on first use and draws to memory, so that no display is needed. The same
folder gives identical files. The colours are those of Okabe and Ito, which colour-blind readers
can distinguish.
"""

from __future__ import annotations

import csv
import io
import json
import math
import re
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from ratslam_ros.errors import UnusableInput
from ratslam_ros.files.text import write_durably
from ratslam_ros.messages.json_schema import NS_PER_S
from ratslam_ros.results.evaluation import Evaluation, Transform2D, associate, fit
from ratslam_ros.results.map_json import read_map_json
from ratslam_ros.results.trajectory import Floats, Trajectory, read_tum, thinned
from ratslam_ros.results.writer import NEWEST_EXPERIENCES_COUNT, THRESHOLD_COLUMN

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from ratslam_ros.core.merging.merge import MergedMap

BLUE, VERMILLION, GREEN = '#0072B2', '#D55E00', '#009E73'
SEPARATE = '#CC79A7', '#E69F00', '#56B4E9', '#F0E442'
"""Colours of components that are not joined with the first one, in turn."""
SESSIONS = BLUE, VERMILLION, GREEN, *SEPARATE
"""Colours of the sessions of a merged map, in turn."""
BLACK, GREY, PALE_GREY = '#000000', '#777777', '#CFCFCF'

DOTS_PER_INCH = 120
MAX_POINT_COUNT = 100_000
"""Number of points to which longer recordings are thinned."""

UNKNOWN_SCALE = 'in units of visual odometry (scale unknown)'


def draw_all(folder: str | Path, truth: str | Path | Trajectory | None = None) -> list[Path]:
    """Draw map.png and matches.png of a results folder.

    Args:
        folder: the results folder.
        truth: the true trajectory, or its TUM file; None for none.

    Returns:
        The paths of the plots.

    Raises:
        UnusableInput: the folder or the truth cannot be used.
    """
    return [draw_map(folder, truth), draw_matches(folder)]


def draw_map(folder: str | Path, truth: str | Path | Trajectory | None = None,
             path: str | Path | None = None) -> Path:
    """Draw map.png: experiences and links over dead reckoning, in the frame of the map.

    The loop closures are those of frames.csv; without that file, the links over more than ten ids.

    Args:
        folder: the results folder.
        truth: the true trajectory, or its TUM file; None for none. It is aligned with
            trajectory_final.tum by rotation and translation, by least squares.
        path: the file; None for map.png in the folder.

    Returns:
        The path of the plot.

    Raises:
        UnusableInput: the folder or the truth cannot be used.
    """
    from matplotlib.collections import LineCollection

    folder = Path(folder)
    _, graph = read_map_json(folder / 'map.json')
    places_m, links = graph.poses[:, :2], graph.link_ends
    estimated = _read_if_present(folder / 'trajectory.tum')
    dead_reckoning = _read_if_present(folder / 'dead_reckoning.tum')
    is_closure = _closures(folder, links)

    figure = new_figure(8.0, 7.6)
    axes = figure.add_subplot()
    if dead_reckoning is not None:
        to_map = _alignment_of_starts(dead_reckoning, estimated)
        axes.plot(*to_map.apply(dead_reckoning.position_m).T, color=PALE_GREY, linewidth=1.0,
                  label='dead reckoning', zorder=1)
    if truth is not None:
        axes.plot(*_truth_on_map(folder, truth).T, color=GREEN, alpha=0.45, linewidth=5.0,
                  solid_joinstyle='round', label='truth', zorder=2)
    for label, colour, chosen in (
        ('experiences and links', BLUE, ~is_closure), ('loop closures', VERMILLION, is_closure),
    ):
        if chosen.any():
            axes.add_collection(LineCollection(list(places_m[links[chosen]]), colors=colour,
                                               linewidths=1.4, label=label,
                                               zorder=3 if colour == BLUE else 5))
    components = np.array(graph.components, np.int64)
    separate = sorted({*graph.components} - {0})
    # One entry of the legend for all: there are fewer colours, and it has room for few.
    names = f'component {separate[0]}' if len(separate) == 1 else f'{len(separate)} components'
    for number in sorted({*graph.components}):
        colour = BLUE if number == 0 else SEPARATE[(number - 1) % len(SEPARATE)]
        axes.plot(*places_m[components == number].T, linestyle='', color=colour, marker='o',
                  zorder=4,
                  markersize=3.0 if len(places_m) < 1000 else 1.5,
                  label=f'{names}, not joined' if separate[:1] == [number] else None)
    if len(places_m):
        last = places_m[graph.current_id]  # the newest one if there is none
        axes.plot(*places_m[0], linestyle='', marker='o', markersize=11, markerfacecolor='none',
                  markeredgewidth=2.0, color=BLACK, label='start', zorder=6)
        axes.plot(*last, linestyle='', marker='X', markersize=10, markeredgecolor='white',
                  color=BLACK, label='end', zorder=6)
    summary = _summary(folder)
    # Visual odometry does not measure the scale of the map.
    equal_axes(axes, UNKNOWN_SCALE if summary.get('visual_odometry') else '[m]')
    sizes = [counted(len(places_m), 'experience'), counted(len(links), 'link')]
    if 'loop_closures' in summary:
        sizes.append(counted(summary['loop_closures'], 'loop closure'))
    axes.set_title(', '.join(sizes), fontsize=11)
    add_legend_below(figure, axes)
    return save_figure(figure, path or folder / 'map.png')


def draw_matches(folder: str | Path) -> Path:
    """Draw matches.png: template ids and match errors over time, from frames.csv.

    Args:
        folder: the results folder. If frames.csv has no thresholds, that of config.yaml is drawn.

    Returns:
        The path of the plot.

    Raises:
        UnusableInput: frames.csv cannot be used.
    """
    folder = Path(folder)
    counts = [0, 0, 0]
    rows = thinned(_frames(folder / 'frames.csv', counts), MAX_POINT_COUNT)
    table = np.array(rows, dtype=np.float64).reshape(-1, 5)
    time_s, template_id, is_new, error, automatic = table.T
    new = (template_id >= 0) & (is_new == 1)
    recognised = (template_id >= 0) & (is_new == 0)
    compared = error >= 0.0  # The first view has no template to compare with.

    figure = new_figure(10.0, 6.4)
    ids, errors = figure.subplots(2, 1, sharex=True, height_ratios=(3, 2))
    for which, colour, label, size in ((recognised, BLUE, 'recognised', 2.5),
                                       (new, VERMILLION, 'new template', 3.5)):
        look = {'linestyle': '', 'marker': '.', 'color': colour, 'markersize': size}
        ids.plot(time_s[which], template_id[which], label=label, **look)
        errors.plot(time_s[which & compared], error[which & compared], **look)
    if np.isfinite(automatic).any():
        errors.plot(time_s, automatic, color=BLACK, linewidth=1.0, linestyle='--',
                    label=f'automatic threshold, at the end {automatic[-1]:.3g}')
        errors.legend(loc='upper right', fontsize=8)
    elif (threshold := _threshold_of(folder / 'config.yaml')) is not None:
        errors.axhline(threshold, color=BLACK, linewidth=1.0, linestyle='--',
                       label=f'threshold {threshold:g}')
        errors.legend(loc='upper right', fontsize=8)
    frames = sum(counts)
    share = f' ({100.0 * counts[0] / frames:.0f} %)' if frames else ''
    ids.set_title(f'{counted(frames, "frame")}: {counted(counts[1], "new template")}, '
                  f'{counts[0]} recognised{share}', fontsize=11)
    ids.set_ylabel('template')
    errors.set(xlabel='time [s]', ylabel='match error', ylim=(0.0, None))
    errors.margins(x=0.01)
    if frames:
        ids.legend(loc='upper left', fontsize=8, markerscale=3.0)
    return save_figure(figure, folder / 'matches.png')


def plot_evaluation(evaluation: Evaluation, path: str | Path) -> Path:
    """Draw the aligned trajectory over the truth, coloured by error, and the error over time.

    Raises:
        UnusableInput: the file cannot be written.
    """
    from matplotlib.collections import LineCollection

    stride = -(-len(evaluation.error_m) // 50_000)
    truth_m, aligned_m = evaluation.truth_m[::stride], evaluation.aligned_m[::stride]
    error_m = evaluation.error_m[::stride]
    time_s = (evaluation.stamp_ns[::stride] - evaluation.stamp_ns[0]) / NS_PER_S

    figure = new_figure(11.0, 5.0)
    plan, course = figure.subplots(1, 2)
    plan.plot(*truth_m.T, color=GREY, linewidth=1.0, label='truth', zorder=1)
    coloured = plan.add_collection(LineCollection(
        list(np.stack((aligned_m[:-1], aligned_m[1:]), axis=1)), array=error_m[1:],
        cmap='viridis', linewidth=1.8, label=f'trajectory, {evaluation.align}', zorder=2))
    figure.colorbar(coloured, ax=plan, label='error [m]', shrink=0.8)
    equal_axes(plan)
    plan.set_title(f'ATE {evaluation.ate.rmse:.3f} m rmse, {evaluation.ate.max:.3f} m max',
                   fontsize=10)
    plan.legend(loc='upper left', fontsize=8)

    course.plot(time_s, error_m, color=BLUE, linewidth=1.0)
    course.axhline(evaluation.ate.rmse, color=VERMILLION, linewidth=1.0, linestyle='--',
                   label=f'rmse {evaluation.ate.rmse:.3f} m')
    course.set(xlabel='time [s]', ylabel='error [m]', ylim=(0.0, None))
    course.margins(x=0.01)
    course.legend(loc='upper left', fontsize=8)
    return save_figure(figure, path)


def draw_merged(merged: MergedMap, path: Path) -> Path:
    """Draw the experiences in the colour of their session; those of several ones are ringed.

    Raises:
        UnusableInput: the file cannot be written.
    """
    from matplotlib.collections import LineCollection

    core = merged.states['experience_map']['core']
    at = core['poses'][:, :2]
    owners = np.zeros((len(at), len(merged.names)), np.bool_)
    for session, ids in enumerate(merged.experience_ids):
        owners[ids, session] = True
    figure = new_figure(8.0, 7.6)
    axes = figure.add_subplot()
    axes.add_collection(
        LineCollection(list(at[core['ends']]), colors=PALE_GREY, linewidths=0.8, zorder=1)
    )
    is_shared = owners.sum(axis=1) > 1
    axes.scatter(
        at[is_shared, 0], at[is_shared, 1], s=16.0, facecolors='none', edgecolors=BLACK,
        linewidths=0.4, zorder=3, label=f'in several sessions: {int(is_shared.sum())}',
    )
    first = owners.argmax(axis=1)
    for session, name in enumerate(merged.names):
        own = first == session
        axes.scatter(
            at[own, 0], at[own, 1], s=7.0, color=SESSIONS[session % len(SESSIONS)], linewidths=0.0,
            label=f'{name}: {int(owners[:, session].sum())}, {int(own.sum())} of them new',
            zorder=2,
        )
    axes.set_title('merged map: experiences by the session that contributed them')
    equal_axes(axes)
    add_legend_below(figure, axes, columns=2)
    return save_figure(figure, path)


def new_figure(width_in: float, height_in: float) -> Figure:
    """Return an empty figure, in inches, that is drawn to memory."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=(width_in, height_in), dpi=DOTS_PER_INCH, layout='constrained')
    FigureCanvasAgg(figure)
    return figure


def add_legend_below(figure: Figure, axes: Axes, columns: int = 8, fontsize: float = 8) -> None:
    """Add a legend below all axes, which are shrunk to leave room for it.

    matplotlib 3.6, the version of Ubuntu 24.04, does not have the location 'outside'.
    """
    handles, labels = axes.get_legend_handles_labels()
    if not handles:
        return
    figure.legend(handles, labels, loc='lower center', ncol=columns, fontsize=fontsize,
                  frameon=False)
    rows = -(-len(handles) // columns)
    height = (rows * 1.5 + 0.8) * fontsize / 72.0 / figure.get_figheight()
    engine = figure.get_layout_engine()
    assert engine is not None
    engine.set(rect=(0.0, height, 1.0, 1.0 - height))  # type: ignore[call-arg]


def save_figure(figure: Figure, path: str | Path) -> Path:
    """Write a PNG without date and program version, so that equal plots give equal files.

    Raises:
        UnusableInput: the file cannot be written.
    """
    content = io.BytesIO()
    figure.savefig(content, format='png', metadata={'Software': None})
    write_durably(path := Path(path), content.getvalue())
    return path


def equal_axes(axes: Axes, unit: str = '[m]') -> None:
    """Give both axes the same scale, labels with a unit, and a grid."""
    axes.autoscale_view()
    axes.set_aspect('equal', adjustable='datalim')
    axes.set(xlabel=f'x {unit}', ylabel=f'y {unit}')
    axes.grid(color='#EEEEEE', linewidth=0.8)
    axes.set_axisbelow(True)


def _closures(folder: Path, links: NDArray[np.int64]) -> NDArray[np.bool_]:
    """Return which links led to an experience that was not among the newest at that time.

    If the experience changes between two rows of frames.csv, and not to a new one, a link was
    created or traversed. Links that were never driven are recognitions.
    """
    path = folder / 'frames.csv'
    if not path.exists():
        return np.asarray(np.abs(links[:, 0] - links[:, 1]) > NEWEST_EXPERIENCES_COUNT)
    closures, driven = set(), set()
    last, count = -1, 0
    for *_, experience, _ in _rows(path):
        if experience >= count:
            count = experience + 1
        elif (
            -1 not in (last, experience)  # no experience yet, or none since an odometry gap
            and experience not in (last, *range(count - NEWEST_EXPERIENCES_COUNT, count))
        ):
            closures.add((last, experience))
        driven.add((last, experience))
        last = experience
    return np.array([
        (i, j) in closures or (i - j > NEWEST_EXPERIENCES_COUNT and (i, j) not in driven)
        for i, j in links.tolist()
    ], np.bool_)


def _rows(path: Path) -> Iterator[tuple[int, int, int, float, int, float]]:
    """Yield the used columns of each row; match_threshold is NaN if there is none."""
    columns = ('stamp_ns', 'template_id', 'is_new', 'match_error', 'experience_id')
    try:
        with path.open(encoding='utf-8', newline='') as file:
            reader = csv.DictReader(file)
            if not set(columns) <= set(reader.fieldnames or ()):
                raise UnusableInput(f'{path}: the first line has to name {", ".join(columns)}')
            for row in reader:
                stamp, template, new, error, experience = (row[column] for column in columns)
                yield (int(stamp), int(template), ('0', '1').index(new), float(error),
                       int(experience), float(row.get(THRESHOLD_COLUMN, math.nan)))
    except OSError as refusal:
        raise UnusableInput(f'{path}: {refusal.strerror or refusal}; give the folder that '
                            'ratslam replay wrote') from None
    except (ValueError, TypeError):
        raise UnusableInput(f'{path}, line {reader.line_num}: not a row of '
                            f'{", ".join(columns)}') from None


def _frames(
    path: Path, counts: list[int]
) -> Iterator[tuple[float, float, float, float, float]]:
    """Yield seconds since the first frame, template id, is_new, match error and threshold.

    The numbers of rows with recognised, new and no templates are added to `counts`.
    """
    first_ns = None
    for stamp_ns, template, new, error, _, threshold in _rows(path):
        first_ns = stamp_ns if first_ns is None else first_ns
        counts[new if template >= 0 else 2] += 1
        yield (stamp_ns - first_ns) / NS_PER_S, template, new, error, threshold


def _summary(folder: Path) -> dict[str, Any]:
    """Return the content of summary.json, empty if there is none."""
    try:
        summary = json.loads((folder / 'summary.json').read_text(encoding='utf-8'))
    except (OSError, ValueError):
        return {}
    return summary if isinstance(summary, dict) else {}


def _read_if_present(path: Path) -> Trajectory | None:
    has_poses = path.exists() and path.stat().st_size > 0  # Without odometry there are no poses.
    return read_tum(path, MAX_POINT_COUNT) if has_poses else None


def _alignment_of_starts(source: Trajectory, target: Trajectory | None) -> Transform2D:
    """Return the transform from the first pose of one trajectory to that of another."""
    if target is None:
        return Transform2D()
    turn_rad = float(target.heading_rad[0] - source.heading_rad[0])
    moved = Transform2D(heading_rad=turn_rad).apply(source.position_m[:1])[0]
    x_m, y_m = target.position_m[0] - moved
    return Transform2D(float(x_m), float(y_m), turn_rad)


def _truth_on_map(folder: Path, truth: str | Path | Trajectory) -> Floats:
    """Return the positions of the truth, (n, 2) in m, aligned with the final trajectory."""
    if not isinstance(truth, Trajectory):
        truth = read_tum(truth, MAX_POINT_COUNT)
    final = read_tum(folder / 'trajectory_final.tum', MAX_POINT_COUNT)
    of_final, of_truth = associate(final.stamp_ns, truth.stamp_ns, max_difference_s=0.5)
    if len(of_final) < 2:
        raise UnusableInput('the truth and the trajectory have no stamps in common; '
                            'convert both to the same clock')
    onto_map = fit(truth.position_m[of_truth], final.position_m[of_final])
    return onto_map.apply(truth.position_m)


def _threshold_of(config: Path) -> float | None:
    if not config.exists():
        return None
    found = re.search(r'^\s*vt_match_threshold:\s*([0-9.eE+-]+)', config.read_text('utf-8'), re.M)
    return float(found[1]) if found and float(found[1]) >= 0.0 else None


def counted(number: int, noun: str) -> str:
    """Return a number with a noun, in the plural unless it is 1."""
    return f'{number} {noun}' if number == 1 else f'{number} {noun}s'
