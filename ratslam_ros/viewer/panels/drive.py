# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Drive: goals, places and the services of the nodes, with their answers."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from typing import Any

from ratslam_ros.history.records import StatusRecord
from ratslam_ros.history.run_state import RunState
from ratslam_ros.messages.goals import GoalStatus
from ratslam_ros.messages.json_schema import MalformedMessage, decode
from ratslam_ros.viewer.panels.desk import Desk, Request, offer, put
from ratslam_ros.viewer.panels.html import GREEN, LEVELS, RED, block, dim, mark, strong, table
from ratslam_ros.viewer.panels.selection import SelectionPanel

NO_PLACES = 'no places yet'

SHOWN_TASKS = 3
"""Largest number of queued goals, and of ended ones, that are shown."""

NOTHING = 'There is nothing to command here: this run offers no goals and no services.'


class DrivePanel:
    """Buttons for the robot, if the controls have one."""

    def __init__(self, desk: Desk, selection: SelectionPanel) -> None:
        self._desk, self._selection = desk, selection
        self.groups: dict[str, Any] = {}
        """Groups of buttons, by their labels."""
        self._switches: dict[str, Any] = {}
        self._has_robot = 'go_to' in desk.controls.actions
        if not self._has_robot:
            reason = getattr(desk.controls, 'reason', NOTHING)
            self.nothing = desk.gui.add_html(block(dim(reason)))
        self.status = desk.gui.add_html('')
        if self._has_robot:
            self._add_buttons()
        self.log = desk.gui.add_html('')
        self.diagnostics = desk.gui.add_html('')

    def _add_buttons(self) -> None:
        gui = self._desk.gui
        self.target = gui.add_html('')
        self.add_go_buttons('Selected')
        self.place = gui.add_dropdown('Place', (NO_PLACES,), hint='Named places of this map.')
        self._group(
            '', {
                'Go to place': lambda: self._go_to_place(False),
                'Then to place': lambda: self._go_to_place(True),
            },
            'Send the robot to the chosen place, or there after the goals already sent.',
        )
        self._group(
            'Goals', {'Cancel all goals': self.cancel},
            'The robot stops, and queued goals are dropped.',
        )
        self._switch('Explore', 'explore', 'Drive to unknown parts of the surroundings.')
        self.name = gui.add_text('Name', '', hint='Name for the place where the robot is now.')
        self._group('', {'Name this place': self._name_place}, 'Keep the name.')
        self._switch('Mapping', 'mapping', 'Off: the robot is localised, but learns nothing.')
        self._switch('Pause nodes', 'pause_nodes', 'While paused, nodes ignore their inputs.')
        self._group(
            'Robot', {'Relocate': lambda: self._request('relocate', 'relocate')},
            'Search for the place of the robot by its laser scans, for instance after it was '
            'carried.',
        )
        self._group(
            'Map', {
                'Save': lambda: self._request('save', 'save'),
                'Load': lambda: self._confirm('Load', LOAD_WARNING, 'load'),
                'Reset': lambda: self._confirm('Reset', RESET_WARNING, 'reset'),
            },
            'The memory of all nodes: write it to their folder, read it from there, or empty it.',
        )

    def add_go_buttons(self, label: str, order: float | None = None) -> None:
        """Add buttons that send the robot to what is selected, if there is a robot."""
        if self._has_robot:
            self._group(
                label, {GO_HERE: self.go_here, THEN_HERE: lambda: self.go_here(then=True)},
                'Send the robot to the selected point, or there after the goals already sent. (G)',
                order,
            )

    def update(self, state: RunState) -> None:
        """Show the goals, the answers and the diagnostics."""
        put(self.status, 'content', status_html(state.status))
        if self._has_robot:
            target = self._target()
            text = block(
                dim(CLICK_FIRST) if target is None
                else f'{strong("Selected")} x {target[0]:.2f} m, y {target[1]:.2f} m'
            )
            put(self.target, 'content', text)
            offer(self.place, tuple(self._desk.controls.places) or (NO_PLACES,))
            self._show_switches()
        put(self.log, 'content', log_html(self._desk.requests))
        put(self.diagnostics, 'content', diagnostics_html(self._desk.controls.diagnostics))

    def _target(self) -> tuple[float, float] | None:
        """Return the selected point on the map in m, None if there is none."""
        pick, poses = self._selection.pick, self._selection.poses
        if pick is None or pick.kind == 'closure':
            return None
        if pick.kind == 'experience':
            return tuple(poses[pick.id, :2].tolist()) if pick.id < len(poses) else None
        return float(pick.point[0]), float(pick.point[1])

    def _group(
        self, label: str, acts: Mapping[str, Callable[[], None]], hint: str,
        order: float | None = None,
    ) -> None:
        group = self._desk.gui.add_button_group(label, tuple(acts), hint=hint, order=order)
        self._desk.on_press(group, acts)
        self.groups[label or next(iter(acts))] = group

    def _switch(self, label: str, name: str, hint: str) -> None:
        """Add buttons for on and off; a mark shows which one holds, if it is known."""
        what = label.lower()
        group = self._desk.gui.add_button_group(label, (ON, OFF), hint=hint)
        self._desk.on_press(group, {
            prefix + text: lambda on=text == ON: self._request(  # type: ignore[misc]
                f'{what} {"on" if on else "off"}', name, on
            )
            for text in (ON, OFF) for prefix in ('', PRESENT)
        })
        self.groups[label] = self._switches[name] = group

    def _show_switches(self) -> None:
        known = self._desk.controls.switches
        for name, group in self._switches.items():
            offer(group, [
                PRESENT + text if known.get(name) == on else text
                for text, on in ((ON, True), (OFF, False))
            ])

    def _request(self, label: str, name: str, *values: Any) -> None:
        act = self._desk.controls.actions[name]
        self._desk.ask(label, lambda: act(*values))

    def _go_to_place(self, then: bool) -> None:
        name = self.place.value
        if name != NO_PLACES:
            self._request(f'{"then " if then else ""}go to {name}', 'go_to_place', name, then)

    def _name_place(self) -> None:
        name = self.name.value.strip()
        if name:
            self._request(f'name this place {name}', 'name_place', name)
        else:
            self._desk.refuse('name this place', 'type a name first')

    def _confirm(self, label: str, warning: str, name: str) -> None:
        """Ask for confirmation before something that cannot be undone."""
        gui = self._desk.gui
        modal = gui.add_modal(f'{label}?')
        with modal:
            gui.add_html(block(dim(warning)))
            group = gui.add_button_group('', (label, 'Keep as it is'))

        def confirmed() -> None:
            modal.close()
            self._request(label.lower(), name)

        self._desk.on_press(group, {label: confirmed, 'Keep as it is': modal.close})
        self.confirmation = group

    def go_here(self, then: bool = False) -> None:
        """Send the robot to the selected point, if there is a robot."""
        if not self._has_robot:
            return
        target = self._target()
        if target is None:
            self._desk.refuse('go here', CLICK_FIRST)
            return
        x_m, y_m = target
        label = f'{"then " if then else ""}go to x {x_m:.2f} m, y {y_m:.2f} m'
        self._request(label, 'go_to', x_m, y_m, then)

    def cancel(self) -> None:
        """Cancel all goals, if there is a robot."""
        if self._has_robot:
            self._request('cancel goals', 'cancel_goals')


CLICK_FIRST = 'Click a point on the map to select it.'
ON, OFF, PRESENT = 'On', 'Off', '● '
GO_HERE, THEN_HERE = 'Go here', 'Then here'
LOAD_WARNING = 'The present map is replaced by the saved one. What was not saved is lost.'
RESET_WARNING = 'All nodes forget everything they have learned. What was not saved is lost.'


def status_html(status: StatusRecord | None) -> str:
    """Return the goal, the queue and the last outcomes."""
    if status is None:
        return ''
    try:
        return block(strong('Goals'), table(_status_rows(decode(GoalStatus, status.payload))))
    except MalformedMessage as error:
        return block(dim(f'The status of the goals could not be read: {error}'))


def _status_rows(status: GoalStatus) -> list[tuple[str, str]]:
    rows = [('pose', status.localisation), ('status', status.status)]
    if status.explore:
        rows.append(('explore', 'on'))
    if status.reason:
        rows.append(('reason', status.reason))
    if status.goal is not None:
        rows.append(('goal', f'x {status.goal.x_m:.2f} m, y {status.goal.y_m:.2f} m'))
    if status.remaining_s is not None:
        rows.append(('remaining', f'{status.remaining_s:.0f} s'))
    tasks = [*status.queue[:SHOWN_TASKS], *status.outcomes[-SHOWN_TASKS:]]
    return rows + [(task.status, f'{task.goal} {task.reason}'.strip()) for task in tasks]


def log_html(requests: Iterable[Request]) -> str:
    """Return the last requests and their answers."""
    rows = []
    for request in requests:
        answer = request.answer
        if answer is None:
            rows.append(f'○ {strong(request.text)}: {dim("waiting for the answer")}')
            continue
        symbol = mark('●', GREEN) if answer.success else mark('■', RED)
        outcome = ('' if answer.success else 'refused: ') + (answer.message or 'done')
        rows.append(f'{symbol} {strong(request.text)}: {dim(outcome)}')
    return block(strong('Answers'), *rows) if rows else ''


def diagnostics_html(nodes: Mapping[str, tuple[str, str]]) -> str:
    """Return level and message of every node."""
    rows = []
    for name, (level, message) in sorted(nodes.items()):
        symbol, colour = LEVELS.get(level, LEVELS['ERROR'])
        rows.append(f'{mark(symbol, colour)} {strong(level)} {strong(name)}: {dim(message)}')
    return block(strong('Nodes'), *rows) if rows else ''
