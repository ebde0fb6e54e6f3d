# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Views of several sessions: their common match threshold, and matches between two sessions."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ratslam_ros.core.common.state import State
from ratslam_ros.core.config.additions import uses_odometry
from ratslam_ros.core.merging.session import SessionMap
from ratslam_ros.core.vision.look_alikes import MAX_VIEW_COUNT, LookAlikes
from ratslam_ros.core.vision.match_threshold import MAX_SAMPLE_COUNT, MatchThreshold
from ratslam_ros.core.vision.template_memory import TemplateMemory

LAST_PLACE = 4
"""Column of the table of look-alikes before which a row describes a place; the last of those
columns is the number of odometry gaps before."""


class TemplatePair(NamedTuple):
    """A template of one session that shows the same view as one of another session.

    ``seen``, ``known``: templates. ``relative_rad``: heading at which the former was learned minus
    that of the latter. ``sad``: their sum of absolute differences.
    """

    seen: int
    known: int
    relative_rad: float
    sad: int


def match_views(
    known: SessionMap, seen: SessionMap, threshold: MatchThreshold
) -> list[TemplatePair]:
    """Return the best match of each template of one session among those of another one.

    Matching and threshold are those of the local view, with the parameters of ``known``.
    """
    matches = []
    for template_id in sorted(seen.local_view.template_ids.tolist()):
        view = seen.local_view.template(template_id)
        best = known.local_view.best_match(view, threshold.limit)
        if best is not None:
            relative_rad = known.local_view.relative_rad(best.offset)
            matches.append(TemplatePair(template_id, best.template_id, relative_rad, best.sad))
    return matches


def common_threshold(sessions: Sequence[SessionMap]) -> MatchThreshold:
    """Return the match threshold of a memory with the templates of all sessions.

    An automatic threshold follows from the measurements of all of them.

    Args:
        sessions: sessions with the same encoding; parameters are those of the first.
    """
    first = sessions[0]
    parameters, layout = first.config.local_view, first.encoder.layout
    full_sum = TemplateMemory(layout).full_sum
    threshold = MatchThreshold(parameters, full_sum, layout.typical)
    if threshold.is_automatic:
        threshold.restore(merged_samples(sessions))
        if uses_odometry(parameters):
            look_alikes = LookAlikes(layout)
            look_alikes.restore(merged_look_alikes(sessions, lambda _number, _template: None))
            threshold.use_ratio(look_alikes.ratio)
    return threshold


def merged_samples(sessions: Sequence[SessionMap]) -> State:
    """Return the differences between unrelated views, for ``MatchThreshold.restore``."""
    samples = [
        one.view_state['threshold']['samples'] for one in sessions if 'threshold' in one.view_state
    ]
    return {'samples': _thinned(samples, MAX_SAMPLE_COUNT, np.int64)}


def merged_look_alikes(
    sessions: Sequence[SessionMap], template_of: Callable[[int, int], int | None]
) -> State:
    """Return the similarity of views of different places, for ``LookAlikes.restore``.

    Odometry compares places of one session only.

    Args:
        sessions: the sessions.
        template_of: function of the number of a session and a template that returns the template
            in the merged memory; None if it is not learned there first.
    """
    states = [
        one.view_state['look_alikes'] if 'look_alikes' in one.view_state
        else LookAlikes(sessions[0].encoder.layout).state()
        for one in sessions
    ]
    tables, views, places = [], [], {}
    part = 0.0
    for number, state in enumerate(states):
        table, now = state['samples'].copy(), state['now']
        table[:, LAST_PLACE - 1] += part
        tables.append(table)
        views.append(state['views'])
        for template_id, row in zip(state['template_ids'], state['templates'], strict=True):
            merged = template_of(number, int(template_id))
            if merged is not None:
                places[merged] = [*row[: LAST_PLACE - 1].tolist(), row[LAST_PLACE - 1] + part]
        part += float(now[LAST_PLACE]) + 1.0
    table = _thinned(tables, MAX_VIEW_COUNT - 1, np.float64)
    now = states[0]['now'].copy()
    now[:LAST_PLACE] = 0.0
    now[LAST_PLACE] = part
    if len(table):
        now[LAST_PLACE - 1] = table[-1, 2]
    return {
        'views': _thinned(views, MAX_VIEW_COUNT - 1, np.uint8),
        'samples': table,
        'differences': _thinned([s['differences'] for s in states], MAX_SAMPLE_COUNT, np.int64),
        'template_ids': np.array(list(places), np.int64),
        'templates': np.array(list(places.values()), np.float64).reshape(-1, LAST_PLACE),
        'now': now,
    }


def merged_freshness(
    states: Sequence[State | None], item_of: Callable[[int, int], int | None],
    items: Sequence[int],
) -> State | None:
    """Return the freshness of merged items; the time since an observation stays the same.

    Args:
        states: freshness of each session; None if it has none.
        item_of: function of the number of a session and an item that returns the merged item;
            None if it is not known any more.
        items: all merged items.

    Returns:
        None if a session has none, so that all items are new.
    """
    known: list[State] = [state for state in states if state is not None]
    if len(known) < len(states):
        return None
    now_ns = max(int(state['now_ns']) for state in known)
    found: dict[int, tuple[int, int, int]] = {}
    for number, state in enumerate(known):
        for item, observed_ns, visits, fades in zip(
            state['items'].tolist(), state['observed_ns'].tolist(), state['visits'].tolist(),
            state['fades'].tolist(), strict=True,
        ):
            merged = item_of(number, item)
            if merged is None:
                continue
            seen_ns = int(observed_ns) + now_ns - int(state['now_ns'])
            before_ns, visits_before, faded = found.get(merged, (seen_ns, 0, fades))
            found[merged] = max(before_ns, seen_ns), visits_before + visits, min(faded, fades)
    rows = [found[item] for item in items]
    return {
        'draws': sum(int(state['draws']) for state in known), 'now_ns': now_ns,
        'stamp_ns': max(int(state['stamp_ns']) for state in known),
        'forced': sum(int(state['forced']) for state in known),
        'items': np.array(items, np.int64),
        'observed_ns': np.array([row[0] for row in rows], np.int64),
        'visits': np.array([row[1] for row in rows], np.int64),
        'fades': np.array([row[2] for row in rows], np.uint8),
    }


def merged_local_view(
    sessions: Sequence[SessionMap], templates: Mapping[tuple[int, int], int],
    learned: Sequence[tuple[int, int]],
) -> State:
    """Return the state of a local view with the templates of all sessions.

    Args:
        sessions: sessions with the same encoding.
        templates: number of a session and its template -> merged template.
        learned: number of the session and template of each merged template, by its id.
    """
    first = sessions[0]
    views = [sessions[number].local_view.template(template) for number, template in learned]
    size = first.encoder.layout.height, first.encoder.layout.width
    state: State = {
        'templates': np.stack(views) if views else np.empty((0, *size), np.uint8),
    }
    if 'descriptor' in first.view_state:
        state['descriptor'] = first.view_state['descriptor']
    if 'threshold' in first.view_state:
        state['threshold'] = merged_samples(sessions)
    if 'look_alikes' in first.view_state:
        origin = {pair: template for template, pair in enumerate(learned)}
        state['look_alikes'] = merged_look_alikes(
            sessions, lambda number, template: origin.get((number, template))
        )
    freshness = merged_freshness(
        [one.view_state.get('freshness') for one in sessions],
        lambda number, template: templates[number, template], range(len(learned)),
    )
    if freshness is not None:
        state['freshness'] = freshness
    return state


def _thinned(parts: Sequence[NDArray[Any]], most: int, dtype: Any) -> NDArray[Any]:
    """Return the rows of all parts, or ``most`` evenly spaced ones of them."""
    if not parts:
        return np.zeros(0, dtype)
    rows = np.concatenate(parts)
    if len(rows) <= most:
        return rows
    return rows[np.arange(most) * len(rows) // most]
