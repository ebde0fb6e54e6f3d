# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""A run in words: times, matches, decisions and loop closures."""

from __future__ import annotations

import math
from collections.abc import Sequence
from datetime import UTC, datetime

from ratslam_ros.history.records import CellsRecord, MatchRecord, ViewRecord
from ratslam_ros.history.run_state import NS_PER_S
from ratslam_ros.viewer.playback import Playback

LISTED_NS = 2 * NS_PER_S
"""Least time between listed closures; along a known way every view may close a loop."""

CALENDAR_NS = 10**9 * NS_PER_S
"""Stamps from here on (September 2001) are calendar time; others count from an arbitrary zero."""


def time_text(seconds: float, decimals: int = 1) -> str:
    """Return a time of the run as minutes and seconds, with hours if there are any."""
    unit = 10**decimals
    ticks = round(max(seconds, 0.0) * unit)
    minutes, rest = divmod(ticks, 60 * unit)
    width = 2 + (decimals + 1 if decimals else 0)
    text = f'{rest / unit:0{width}.{decimals}f}'
    if minutes < 60:
        return f'{minutes}:{text}'
    return f'{minutes // 60}:{minutes % 60:02d}:{text}'


def stamp_text(stamp_ns: int) -> str:
    """Return a stamp as date and time if it is calendar time, else in s."""
    if stamp_ns < CALENDAR_NS:
        return f'stamp {stamp_ns / NS_PER_S:.2f} s'
    moment = datetime.fromtimestamp(stamp_ns / NS_PER_S, UTC)
    return f'{moment:%Y-%m-%d %H:%M:%S}.{stamp_ns % NS_PER_S // 10**8} UTC'


def playback_text(playback: Playback) -> tuple[str, str]:
    """Return a symbol and words for what the cursor does."""
    if not playback.end_ns:
        return '○', 'waiting for the first data'
    if playback.following:
        return '●', 'live: following the newest data'
    if playback.playing:
        return '▶', f'playing at {playback.speed:g}×'
    if playback.at_end:
        return '■', 'paused at the end' if playback.is_growing else 'end of the run'
    return '❚❚', 'paused'


def match_text(view: ViewRecord) -> str:
    """Return how a view was matched."""
    if view.template_id < 0:
        return 'view too uniform to be compared'
    if view.is_new:
        found = f'new template {view.template_id}'
        if view.error < 0:
            return f'{found}: no known view is near enough'
        if view.error < view.threshold:  # similar views at different places
            return f'{found}: error {view.error:.4f} of {view.threshold:.4f}, but no certain match'
        return f'{found}: best error {view.error:.4f} exceeds {view.threshold:.4f}'
    if view.error < 0:
        return f'template {view.template_id} matched'
    return f'template {view.template_id} matched: error {view.error:.4f} of {view.threshold:.4f}'


def match_picture_text(match: MatchRecord, shown_ns: int) -> str:
    """Return what a picture of a match shows; pictures are recorded less often than views."""
    shift = match.shift_px
    side = 'right' if shift > 0 else 'left'
    moved = f'shifted {abs(shift)} px to the {side}' if shift else 'no shift'
    height, width = match.view.shape
    ago_s = (shown_ns - match.stamp_ns) / NS_PER_S
    before = f' {ago_s:.1f} s before' if ago_s >= 0.05 else ''
    return f'template {match.template_id}{before}: {moved}; as compared, {width} × {height} px'


def decision_text(view: ViewRecord, required_views: float | None = None) -> str:
    """Return what the pose cells and the map made of a view; see ``agreement_text``."""
    target = view.target_id
    if view.relocated_to >= 0:
        return f'relocated to experience {view.relocated_to} by laser scans'
    if view.reason:
        return f'rejected: loop closure to experience {claimed_id(view)} {view.reason}'
    recognised = ''
    if view.recognised_id >= 0:
        agreement = agreement_text(view, required_views)
        recognised = f'recognised experience {view.recognised_id} ({agreement}); '
    decision = {
        'create': f'experience {target} created',
        'link': f'experience {target} linked',
        'set': f'moved to experience {target}',
        'none': f'stays at experience {target}' if target >= 0 else 'no experience yet',
    }[view.action]
    return recognised + decision


def agreement_text(view: ViewRecord, required_views: float | None) -> str:
    """Return how many views agree with a recognition.

    Args:
        view: the view that was recognised.
        required_views: number of views that must agree, 0 for none, None if it is unknown.
    """
    if required_views is None:
        return f'agreement {view.agreement:.0%}'
    if required_views == 0.0:
        return 'no agreement required'
    agreeing = math.ceil(view.agreement * required_views - 1e-9)
    return f'{agreeing} of {required_views:g} views agree'


def claimed_id(view: ViewRecord) -> int:
    """Return the experience that a view was recognised as, accepted or not."""
    return view.recognised_id if view.recognised_id >= 0 else view.target_id


def joins(view: ViewRecord, ends: tuple[int, int]) -> bool:
    """Return whether a view recognises one of two experiences at the other one."""
    claimed = claimed_id(view)
    return {claimed, view.source_id} == set(ends) or {claimed, view.target_id} == set(ends)


def verdict(view: ViewRecord) -> str:
    """Return what became of a recognition: rejected, weak, relocated or closed."""
    if view.reason:
        return 'rejected'
    if view.relocated_to >= 0:
        return 'relocated'
    # Without a required number of recognitions, the agreement is 0.
    return 'closed' if view.action in ('link', 'set') or view.agreement >= 1.0 else 'weak'


def told_apart(closures: Sequence[ViewRecord]) -> list[ViewRecord]:
    """Return the closures to list: of those with one verdict, one every LISTED_NS."""
    kept: list[ViewRecord] = []
    for view in closures:
        if (
            not kept
            or verdict(view) != verdict(kept[-1])
            or view.stamp_ns - kept[-1].stamp_ns >= LISTED_NS
        ):
            kept.append(view)
    return kept


def closure_text(view: ViewRecord, begin_ns: int) -> str:
    """Return a loop closure in one line that distinguishes it from all others."""
    when = time_text((view.stamp_ns - begin_ns) / NS_PER_S, 2)
    return f'{when}  {view.source_id} → {claimed_id(view)}  {verdict(view)}'


def cells_text(cells: CellsRecord) -> list[tuple[str, str]]:
    """Return rows of a table: what the activity of the pose cells is like."""
    x, y, theta = cells.dims
    rows = [
        ('size', f'{x} × {y} × {theta} cells (x, y, heading)'),
        ('energy', f'{float(cells.activity.sum()):.3f} in {len(cells.cells)} active cells'),
    ]
    if len(cells.packets):
        order = cells.packets[:, 3].argsort()[::-1]
        total = float(cells.packets[:, 3].sum()) or 1.0
        at_x, at_y, at_theta, most = cells.packets[order[0]].tolist()
        heading = math.degrees(at_theta / theta * math.tau)
        rows += [
            ('packets', f'{len(order)}; the largest has {most / total:.0%} of the energy'),
            ('peak', f'x {at_x:.1f}, y {at_y:.1f} cells, heading {heading:.0f}°'),
        ]
    if len(cells.injections):
        rows.append(
            ('injected', f'{float(cells.injections[:, 3].sum()):.3f} by the last view; '
             f'places: {len(cells.injections)}')
        )
    return rows
