# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Colours of experiences and links by a property, and the legend that explains them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ratslam_ros.core.mapping.map_changes import LinkRows, MapMirror
from ratslam_ros.history.run_state import NS_PER_S, RunState
from ratslam_ros.viewer.scene.palette import LEVELS, Bytes, Rgb, Theme, scale_colours, scaled

Reals = NDArray[np.float64]

COLOURINGS = (
    'plain', 'age', 'visits', 'match error', 'confidence', 'behaviour', 'travel time',
)

CLOSURE_IDS = 10
"""Difference of ids above which a link counts as loop closure, as in the plots of a replay."""

LEGEND_STEPS = 5
"""Number of colours of a scale that the legend shows."""

SHORTEST_S = 1e-3
"""Least duration of a link: SciPy takes an entry of 0 for a link that does not exist."""

Legend = list[tuple[Rgb, str]]


@dataclass(frozen=True, slots=True)
class Colours:
    """(n, 3) colours of the experiences, (rows, 3) of the rows of links, and their legend."""

    experiences: Bytes
    links: Bytes
    legend: Legend


def is_closure(rows: LinkRows) -> NDArray[np.bool_]:
    """Return (rows,) whether a link closes a loop."""
    far: NDArray[np.bool_] = np.abs(rows.ends[:, 0] - rows.ends[:, 1]) > CLOSURE_IDS
    return far & (rows.ends[:, 0] >= 0)


def map_colours(name: str, state: RunState, theme: Theme) -> Colours:
    """Return the colours of a map.

    Args:
        name: one of ``COLOURINGS``.
        state: the state to colour.
        theme: colours for the background.

    Raises:
        ValueError: if there is no such colouring.
    """
    rows, n = state.map.link_rows, len(state.map)
    links = _plain_links(rows, theme)
    experiences = np.tile(np.array(theme.experience, np.uint8), (n, 1))
    if name == 'plain':
        apart = _other_components(state)
        experiences[apart] = theme.unknown
        legend: Legend = [(theme.experience, 'experience'), *_links_legend(theme)]
        if apart.any():
            legend.append((theme.unknown, 'experience that is not connected to the robot yet'))
        return Colours(experiences, links, legend)
    if name == 'confidence':
        links = scaled(rows.confidences, 0.0, 1.0, theme)
        experiences[:] = theme.unknown
        return Colours(experiences, links, _scale(theme, 1.0, 'confidence of a link', '{:.2f}'))
    if name == 'behaviour':
        return _behaviours(rows, experiences, theme)
    values, title, unit, least = _values(name, state)
    top = _top(values, least)
    return Colours(
        scaled(values, 0.0, top, theme), links,
        [*_scale(theme, top, title, unit, log=name == 'visits'), *_links_legend(theme)],
    )


def _values(name: str, state: RunState) -> tuple[Reals, str, str, float]:
    """Return values of the experiences, title and format of their scale, and its least end."""
    visits, values = state.visits, np.full(len(state.map), np.nan)
    m = min(len(values), len(visits))
    created_ns, counts, errors = visits.created_ns[:m], visits.counts[:m], visits.errors[:m]
    if name == 'age':
        ages_s = (state.stamp_ns - created_ns) / NS_PER_S
        values[:m] = np.where(created_ns > 0, ages_s, np.nan)
        return values, 'time since it was created', '{:.0f} s', 1.0
    if name == 'visits':
        values[:m] = np.where(counts > 0, np.log2(np.maximum(counts, 1)), np.nan)
        return values, 'visits', '{:.0f}', 1.0
    if name == 'match error':
        is_known = (errors >= 0) & (visits.visited_ns[:m] > 0)
        values[:m] = np.where(is_known, errors, np.nan)
        threshold = state.view.threshold if state.view is not None else 0.0
        return values, 'match error at the last visit', '{:.3f}', threshold
    if name == 'travel time':
        return travel_times(state.map), 'travel time from the robot', '{:.0f} s', 1.0
    raise ValueError(f'no such colouring: {name}; expected one of {", ".join(COLOURINGS)}')


def travel_times(graph: MapMirror) -> Reals:
    """Return (n,) times in s from the current experience; infinite if there is no way.

    Links count in both directions, as the map shows which places are far, not which way to take.
    """
    from scipy.sparse import csr_array
    from scipy.sparse.csgraph import dijkstra

    n = len(graph)
    if not 0 <= graph.current_id < n:
        return np.full(n, np.inf)
    rows = graph.link_rows
    used = rows.ends[:, 0] >= 0
    ends, durations_s = rows.ends[used], np.maximum(rows.durations_s[used], SHORTEST_S)
    # Both links of a pair of experiences are kept apart: entries of one place would be added.
    pairs, first = np.unique(ends, axis=0, return_index=True)
    pairs = pairs.astype(np.int32)  # SciPy before 1.15 requires 32-bit indices
    matrix = csr_array((durations_s[first], (pairs[:, 0], pairs[:, 1])), shape=(n, n))
    times_s: Reals = dijkstra(matrix, directed=False, indices=graph.current_id)
    return times_s


def _top(values: Reals, least: float) -> float:
    """Return an upper end of a scale that changes rarely: the next of 1, 2, 5, 10, 20, 50..."""
    finite = values[np.isfinite(values)]
    top = max(float(finite.max()) if len(finite) else 0.0, least, 1e-9)
    power = 10.0 ** np.floor(np.log10(top))
    return float(next(power * step for step in (1, 2, 5, 10) if power * step >= top * 0.999999))


def _plain_links(rows: LinkRows, theme: Theme) -> Bytes:
    colours = np.tile(np.array(theme.driven, np.uint8), (len(rows), 1))
    colours[rows.recognised] = theme.recognised
    colours[is_closure(rows)] = theme.closure
    return colours


def _behaviours(rows: LinkRows, experiences: Bytes, theme: Theme) -> Colours:
    names = sorted({name for name in rows.behaviours if name})
    # Colours for values without an order; the first one stands for 'none'.
    palette = (
        theme.driven, theme.closure, theme.recognised, theme.truth, theme.goal, theme.robot,
        theme.dead_reckoning,
    )
    # More behaviours than colours would have to share one, so the rest is one group.
    shown = {name: palette[1 + k] for k, name in enumerate(names[: len(palette) - 2])}
    rest = palette[-1]
    table = {'': palette[0]} | {name: shown.get(name, rest) for name in names}
    links = np.array([table[name] for name in rows.behaviours], np.uint8).reshape(-1, 3)
    experiences[:] = theme.unknown
    legend: Legend = [(colour, name.replace('_', ' ')) for name, colour in shown.items()]
    if len(names) > len(shown):
        legend.append((rest, 'other behaviours'))
    return Colours(experiences, links, [*legend, (palette[0], 'no behaviour reported')])


def _other_components(state: RunState) -> NDArray[np.bool_]:
    components, current = state.map.components, state.map.current_id
    if not 0 <= current < len(components):
        return np.zeros(len(components), np.bool_)
    apart: NDArray[np.bool_] = components != components[current]
    return apart


def _links_legend(theme: Theme) -> Legend:
    return [
        (theme.driven, 'link: driven'),
        (theme.recognised, 'link: recent view recognised'),
        (theme.closure, 'link: loop closure'),
    ]


def _scale(theme: Theme, top: float, title: str, text: str, log: bool = False) -> Legend:
    values = np.exp2(np.arange(round(top) + 1.0)) if log else np.linspace(0.0, top, LEGEND_STEPS)
    colours = scale_colours(theme)[np.linspace(0, LEVELS - 1, len(values)).astype(int)]
    texts = [text.format(value) for value in values]
    texts[0] = f'{texts[0]} {title}'
    legend = [((r, g, b), shown) for (r, g, b), shown in zip(colours.tolist(), texts, strict=True)]
    return [*legend, (theme.unknown, 'unknown')]
