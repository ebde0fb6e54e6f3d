# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Selection: what is known of a clicked experience or loop closure."""

from __future__ import annotations

import math
from html import escape
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ratslam_ros.core.common.angles import wrap
from ratslam_ros.history.records import ViewRecord
from ratslam_ros.history.run_state import NS_PER_S, RunState
from ratslam_ros.viewer.panels.desk import Desk, assign, offer
from ratslam_ros.viewer.panels.html import (
    GREEN,
    ORANGE,
    RED,
    block,
    dim,
    mark,
    pictures,
    strong,
    table,
)
from ratslam_ros.viewer.panels.texts import (
    agreement_text,
    claimed_id,
    closure_text,
    joins,
    time_text,
    told_apart,
    verdict,
)
from ratslam_ros.viewer.scene import Pick

HINT = 'Click an experience, a loop closure or the ground on the map, or choose above.'

LISTED = 50
"""Largest number of visits and of closures that are listed, the last ones."""

SHOWN_LINKS = 8
"""Largest number of links of an experience that are shown."""

REFRESH_EVERY = 10
"""Number of updates between two looks at the run: 1 Hz suffices for lists."""


class SelectionPanel:
    """The selected thing, and lists of what can be selected."""

    def __init__(self, desk: Desk) -> None:
        self._desk, gui = desk, desk.gui
        self.pick: Pick | None = None
        """What was clicked; None if nothing is selected."""
        self.closure: ViewRecord | None = None
        """The selected loop closure."""
        self._state = RunState()
        self.list = gui.add_dropdown(
            'Loop closures', (NONE_YET,),
            hint='The last loop closures up to the shown moment, and those that were rejected. '
            'Choose one to see both images and why it was decided so.',
        )
        self.text = gui.add_html(block(dim(HINT)))
        self.details = gui.add_html('', visible=False)
        self.visits = gui.add_dropdown(
            'Visits', (NO_VISIT,), visible=False, hint='Times of its visits: choose one to see it.'
        )
        self.images = gui.add_html('', visible=False)
        self.jump = gui.add_button(
            'Go to this moment', visible=False, hint='Show the run as it was then.'
        )
        self.clear_button = gui.add_button(
            'Clear selection', visible=False, color='gray', hint='Select nothing. (X)'
        )
        self._visits: dict[str, ViewRecord] = {}
        self._closures: dict[str, ViewRecord] = {}
        self._next_refresh, self._listed_ns = 0, -1
        self._listed_visits = -1, 0
        desk.on_change(self.visits, self._go_to_visit)
        desk.on_change(self.list, self._choose_listed)
        desk.on_click(self.jump, self._go_to_closure)
        desk.on_click(self.clear_button, self.clear)

        @desk.server.scene.on_click()
        def clicked(event: Any) -> None:
            desk.post(lambda: self.click(event.ray_origin, event.ray_direction))

    def update(self, state: RunState) -> None:
        """Follow the run: visits, links and closures up to the shown moment."""
        self._state = state
        if self._desk.updates >= self._next_refresh:
            self._next_refresh = self._desk.updates + REFRESH_EVERY
            self._list_closures()
            if self.pick is not None and self.pick.kind == 'experience':
                self._show_experience(self.pick.id)

    def click(self, origin: Any, direction: Any) -> None:
        """Select what a ray hits."""
        self.choose(self._desk.scene.pick(origin, direction, self._state))

    def choose(self, pick: Pick | None) -> None:
        """Select an experience, a closure or a point on the ground; None selects nothing."""
        self.clear()
        self.pick = pick
        self._desk.scene.select(pick)
        if pick is None:
            return
        self.clear_button.visible = True
        if pick.kind == 'experience':
            self._show_experience(pick.id)
            self._show_first_view(pick.id)
        elif pick.kind == 'closure':
            self._show_link(*pick.ends)
        else:
            x_m, y_m = pick.point[:2]
            self.text.content = block(strong('Ground'), f'x {x_m:.2f} m, y {y_m:.2f} m')

    def clear(self) -> None:
        """Select nothing."""
        self._listed_ns, self._listed_visits = -1, (-1, 0)
        self.pick = self.closure = None
        self._desk.scene.select(None)
        self.text.content = block(dim(HINT))
        assign(self.list, self.list.options[0])
        for handle in self.images, self.details, self.visits, self.jump, self.clear_button:
            handle.visible = False

    @property
    def poses(self) -> NDArray[np.float64]:
        """(n, 3) poses of the experiences at the shown moment."""
        return self._state.map.poses

    def _cursor_ns(self) -> int:
        return self._desk.playback.cursor_ns

    def _time(self, stamp_ns: int) -> str:
        return time_text((stamp_ns - self._desk.playback.begin_ns) / NS_PER_S, 2)

    def _show_experience(self, number: int) -> None:
        graph, known = self._state.map, self._state.visits
        if number >= len(graph):
            self.text.content = block(
                strong(f'Experience {number}'), dim('not created yet at the shown moment')
            )
            self.details.visible = self.visits.visible = False
            return
        x_m, y_m, heading_rad = graph.poses[number].tolist()
        rows = [
            ('pose', f'x {x_m:.2f} m, y {y_m:.2f} m, heading {math.degrees(heading_rad):.0f}°'),
            ('template', f'{graph.template_ids[number]}'),
        ]
        if number < len(known) and known.counts[number]:
            rows.append(('created', self._time(int(known.created_ns[number]))))
            rows.append(('visits', f'{known.counts[number]}'))
            rows.append(('last visit', self._time(int(known.visited_ns[number]))))
            if known.errors[number] >= 0:
                rows.append(('match error', f'{known.errors[number]:.4f} at the last visit'))
        self.text.content = block(strong(f'Experience {number}'), table(rows))
        self._show_links(number)
        count = int(known.counts[number]) if number < len(known) else 0
        if (number, count) != self._listed_visits:
            self._listed_visits = number, count
            visits = self._desk.playback.source.visits(number, self._cursor_ns())[-LISTED:]
            self._visits = {self._time(view.stamp_ns): view for view in reversed(visits)}
            offer(self.visits, (NO_VISIT, *self._visits))
        self.visits.visible = bool(self._visits)

    def _show_first_view(self, number: int) -> None:
        source = self._desk.playback.source
        first = source.visits(number, self._cursor_ns())[:1]
        if first:
            stamp_ns = first[0].stamp_ns
            self.images.content = block(
                pictures([(source.image_at(stamp_ns), f'first seen at {self._time(stamp_ns)}')])
            )
        self.images.visible = bool(first)

    def _show_links(self, number: int) -> None:
        links = self._state.map.link_rows
        rows = np.flatnonzero((links.ends == number).any(axis=1)).tolist()
        lines = []
        for row in rows[:SHOWN_LINKS]:
            source, target = links.ends[row].tolist()
            lines.append((
                f'→ {target}' if source == number else f'← {source}',
                f'{links.shapes[row, 0]:.2f} m', f'{links.durations_s[row]:.1f} s',
                f'{links.confidences[row]:.0%}', f'{links.counts[row]}',
                'recognised' if links.recognised[row] else links.behaviours[row] or 'driven',
            ))
        more = len(rows) - SHOWN_LINKS
        head = 'link', 'length', 'time', 'conf.', 'uses', 'kind'
        self.details.content = block(
            strong(f'{len(rows)} links'), table(lines, head) if lines else '',
            dim(f'and {more} more') if more > 0 else '',
        )
        self.details.visible = True

    def _show_link(self, source_id: int, target_id: int) -> None:
        """Show the loop closure that made a link."""
        source, until_ns = self._desk.playback.source, self._cursor_ns()
        views = [*source.visits(target_id, until_ns), *self._state.closures]
        found = [view for view in views if joins(view, (source_id, target_id))]
        if found:
            # The first transition made the link; a rejected one made none.
            self._show_closure(min(found, key=lambda view: (bool(view.reason), view.stamp_ns)))
            return
        self.text.content = block(
            strong(f'Link between experiences {source_id} and {target_id}'),
            dim('The view that closed this loop is not in the history.'),
        )

    def _show_closure(self, view: ViewRecord) -> None:
        source, target = self._desk.playback.source, claimed_id(view)
        self.closure = view
        outcome = verdict(view)
        symbol, colour, why = VERDICTS[outcome]
        said = f'{mark(symbol, colour)} {strong(outcome)}: {escape(view.reason or why)}'
        self.text.content = block(strong(f'Loop closure {view.source_id} → {target}'), said)
        first = source.visits(target, view.stamp_ns)[:1]
        learned_ns = first[0].stamp_ns if first else None
        self.images.content = block(
            pictures([
                (source.image_at(view.stamp_ns), f'closing view, {self._time(view.stamp_ns)}'),
                (source.image_at(learned_ns), f'learned view, {self._time(learned_ns)}')
                if learned_ns is not None else (None, 'learned view: unknown'),
            ])
        )
        rows = [
            ('template', f'{view.template_id}'),
            ('match error', f'{view.error:.4f}' if view.error >= 0 else 'not computed'),
            ('threshold', f'{view.threshold:.4f}'),
            ('agreement', agreement_text(view, source.required_views)),
            *self._displacement(view, target),
        ]
        self.details.content = block(table(rows))
        for handle in self.images, self.details, self.jump, self.clear_button:
            handle.visible = True

    def _displacement(self, view: ViewRecord, target: int) -> list[tuple[str, str]]:
        """Return by how much the closure would move the robot on the map of that moment."""
        before = self._desk.playback.source.seek(view.stamp_ns - 1)
        if before.pose is None or not 0 <= target < len(before.map):
            return []
        x_m, y_m, heading_rad = before.map.poses[target].tolist()
        at = before.pose.pose
        turn = wrap(heading_rad + view.relative_rad - at.heading_rad)
        moved_m = math.hypot(x_m - at.x_m, y_m - at.y_m)
        return [('displacement', f'{moved_m:.2f} m and {abs(math.degrees(turn)):.0f}° on the map')]

    def _list_closures(self) -> None:
        playback = self._desk.playback
        if playback.cursor_ns == self._listed_ns:
            return
        self._listed_ns = playback.cursor_ns
        views = told_apart(self._state.closures)[-LISTED:]
        self._closures = {closure_text(view, playback.begin_ns): view for view in reversed(views)}
        offer(self.list, (NO_CLOSURE if views else NONE_YET, *self._closures))

    def _choose_listed(self, text: str) -> None:
        view = self._closures.get(text)
        if view is not None:
            self.clear()
            assign(self.list, text)
            self._desk.scene.select(
                Pick('closure', (0.0, 0.0, 0.0), ends=(view.source_id, claimed_id(view)))
            )
            self._show_closure(view)

    def _go_to_visit(self, text: str) -> None:
        view = self._visits.get(text)
        if view is not None:
            self._desk.playback.pause()
            self._desk.playback.seek(view.stamp_ns)
            assign(self.visits, NO_VISIT)

    def _go_to_closure(self) -> None:
        if self.closure is not None:
            self._desk.playback.pause()
            self._desk.playback.seek(self.closure.stamp_ns)


VERDICTS = {
    'closed': ('●', GREEN, 'enough recognitions agree with it'),
    'relocated': ('●', GREEN, 'laser scans have proven where the robot is'),
    'weak': ('▲', ORANGE, 'too few recognitions agree with it yet, so the robot is not moved'),
    'rejected': ('■', RED, ''),
}
"""Symbol, colour and reason of every verdict; rejected views have their own reasons."""

NO_VISIT = 'choose a time'
NO_CLOSURE, NONE_YET = 'choose one', 'none'
