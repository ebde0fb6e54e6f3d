# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Drive: goals, places and the services of the nodes, with their answers."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from typing import Any

from ratslam_ros.history.records import StatusRecord
from ratslam_ros.history.run_state import RunState
from ratslam_ros.messages.goals import decode_status
from ratslam_ros.messages.json_schema import MalformedMessage
from ratslam_ros.viewer.panels.desk import Desk, Request, offer
from ratslam_ros.viewer.panels.html import GREEN, LEVELS, RED, block, dim, mark, strong, table
from ratslam_ros.viewer.panels.selection import SelectionPanel
from ratslam_ros.viewer.run_source import Answer

NO_PLACES = 'no places yet'

NOTHING = 'There is nothing to command here: this run offers no goals and no services.'


class DrivePanel:
    """Buttons for what the controls offer."""

    def __init__(self, desk: Desk, selection: SelectionPanel) -> None:
        self._desk, self._selection = desk, selection
        self._status: StatusRecord | None = None
        actions, gui = desk.controls.actions, desk.gui
        self.buttons: dict[str, Any] = {}
        """The buttons and inputs, by their labels."""
        if not actions - {'set_parameter', 'run_again'}:
            reason = getattr(desk.controls, 'reason', NOTHING)
            self.nothing = gui.add_html(block(dim(reason)))
        self.status = gui.add_html('')
        self._add_goals()
        self._add_places()
        self._add_nodes()
        self.log = gui.add_html('')
        self.diagnostics = gui.add_html('')

    def update(self, state: RunState) -> None:
        """Show the goals, the answers and the diagnostics."""
        if state.status is not self._status:
            self._status = state.status
            self.status.content = status_html(state.status)
        target = self._target()
        for label in GO_HERE, THEN_HERE:
            if label in self.buttons:
                self.buttons[label].disabled = target is None
        if 'Place' in self.buttons:
            offer(self.buttons['Place'], tuple(self._desk.controls.places) or (NO_PLACES,))
        self.log.content = log_html(self._desk.requests)
        self.diagnostics.content = diagnostics_html(self._desk.controls.diagnostics)

    def _target(self) -> tuple[float, float] | None:
        """Return the selected point on the map in m, None if there is none."""
        pick, poses = self._selection.pick, self._selection.poses
        if pick is None or pick.kind == 'closure':
            return None
        if pick.kind == 'experience':
            return tuple(poses[pick.id, :2].tolist()) if pick.id < len(poses) else None
        return float(pick.point[0]), float(pick.point[1])

    def _button(self, label: str, act: Callable[[], None], hint: str, **more: Any) -> None:
        button = self._desk.gui.add_button(label, hint=hint, **more)
        self._desk.on_click(button, act)
        self.buttons[label] = button

    def _request(self, label: str, name: str, *values: Any) -> None:
        call = getattr(self._desk.controls, name)
        self._desk.ask(label, lambda: call(*values))

    def _go(self, then: bool) -> None:
        target = self._target()
        if target is not None:
            x_m, y_m = target
            label = f'{"then " if then else ""}go to x {x_m:.2f} m, y {y_m:.2f} m'
            self._request(label, 'go_to', x_m, y_m, then)

    def _add_goals(self) -> None:
        actions = self._desk.controls.actions
        if not actions & {'go_to', 'cancel_goals', 'explore'}:
            return
        with self._desk.gui.add_folder('Goals'):
            if 'go_to' in actions:
                self._button(
                    GO_HERE, lambda: self._go(False), disabled=True,
                    hint='Send the robot to the selected point: click the map first. (G)',
                )  # fmt: skip
                self._button(
                    THEN_HERE, lambda: self._go(True), disabled=True,
                    hint='Queue the selected point after the goals already sent.',
                )  # fmt: skip
            if 'cancel_goals' in actions:
                self._button(
                    'Cancel all goals', lambda: self._request('cancel goals', 'cancel_goals'),
                    hint='The robot stops; queued goals are dropped. (C)', color='red',
                )  # fmt: skip
            if 'explore' in actions:
                self._switch(
                    'Explore', 'explore', 'Drive to unknown parts of the surroundings by itself.'
                )

    def _add_places(self) -> None:
        actions, gui = self._desk.controls.actions, self._desk.gui
        if not actions & {'go_to_place', 'name_place'}:
            return
        with gui.add_folder('Places'):
            if 'go_to_place' in actions:
                self.buttons['Place'] = gui.add_dropdown(
                    'Place', (NO_PLACES,), hint='Named places of this map.'
                )
                self._button('Go to place', lambda: self._go_to_place(False), 'Send the robot.')
                self._button(
                    'Then to place', lambda: self._go_to_place(True),
                    hint='Queue this place after the goals already sent.',
                )  # fmt: skip
            if 'name_place' in actions:
                self.buttons['Name'] = gui.add_text(
                    'Name', '', hint='Name for the place where the robot is now.'
                )
                self._button('Name this place', self._name_place, 'Name where the robot is now.')

    def _add_nodes(self) -> None:
        actions = self._desk.controls.actions
        if not actions & {'mapping', 'pause_nodes', 'save', 'load', 'reset'}:
            return
        with self._desk.gui.add_folder('Map and nodes'):
            if 'mapping' in actions:
                self._switch(
                    'Mapping', 'mapping', 'Off: the robot is localised, but learns nothing.'
                )
            if 'pause_nodes' in actions:
                self._switch(
                    'Pause nodes', 'pause_nodes', 'While paused, all nodes ignore their inputs.'
                )
            if 'save' in actions:
                self._button('Save map', lambda: self._request('save', 'save'), SAVE_HINT)
            if 'load' in actions:
                self._button(
                    'Load map', lambda: self._confirm('Load map', LOAD_WARNING, 'load'),
                    'Replace the map by the saved one.',
                )  # fmt: skip
            if 'reset' in actions:
                self._button(
                    'Reset map', lambda: self._confirm('Reset map', RESET_WARNING, 'reset'),
                    'Forget everything.', color='red',
                )  # fmt: skip

    def _switch(self, label: str, name: str, hint: str) -> None:
        """Add buttons for on and off; the run does not report which one holds."""
        group = self._desk.gui.add_button_group(label, ('On', 'Off'), hint=hint)
        self.buttons[label] = group

        def pressed(_event: object) -> None:
            on = group.value == 'On'
            text = f'{label.lower()} {group.value.lower()}'
            self._desk.post(lambda: self._request(text, name, on))

        group.on_click(pressed)

    def _go_to_place(self, then: bool) -> None:
        name = self.buttons['Place'].value
        if name != NO_PLACES:
            self._request(f'{"then " if then else ""}go to {name}', 'go_to_place', name, then)

    def _name_place(self) -> None:
        name = self.buttons['Name'].value.strip()
        if name:
            self._request(f'name this place {name}', 'name_place', name)
        else:
            answer = Answer(False, 'No name given: type one above the button.')
            self._desk.ask('name this place', lambda: answer)

    def _confirm(self, label: str, warning: str, name: str) -> None:
        """Ask for confirmation before something that cannot be undone."""
        gui = self._desk.gui
        modal = gui.add_modal(label)
        with modal:
            gui.add_html(block(dim(warning)))
            self._button(f'{label} now', lambda: confirmed(True), warning, color='red')
            self._button('Keep as it is', lambda: confirmed(False), 'Change nothing.')

        def confirmed(yes: bool) -> None:
            modal.close()
            if yes:
                self._request(label.lower(), name)

    def go_here(self) -> None:
        """Send the robot to the selected point, if that is offered."""
        if 'go_to' in self._desk.controls.actions:
            self._go(False)

    def cancel(self) -> None:
        """Cancel all goals, if that is offered."""
        if 'cancel_goals' in self._desk.controls.actions:
            self._request('cancel goals', 'cancel_goals')


GO_HERE, THEN_HERE = 'Go here', 'Then here'
SAVE_HINT = 'Write the memory of all nodes to their folder.'
LOAD_WARNING = 'The present map is replaced by the saved one. What was not saved is lost.'
RESET_WARNING = 'All nodes forget everything they have learned. What was not saved is lost.'


def status_html(status: StatusRecord | None) -> str:
    """Return the goal, the queue and the last outcomes."""
    if status is None:
        return ''
    try:
        fields = decode_status(status.payload)
    except MalformedMessage as error:
        return block(dim(str(error)))
    goal, remaining_s = fields.get('goal'), fields.get('remaining_s')
    rows = [('status', fields['status'])]
    if fields['reason']:
        rows.append(('reason', fields['reason']))
    if goal:
        rows.append(('goal', f'x {goal["x_m"]:.2f} m, y {goal["y_m"]:.2f} m'))
    if remaining_s is not None:
        rows.append(('remaining', f'{remaining_s:.0f} s'))
    rows += [(f'{task["status"]}', str(task['goal'])) for task in fields['queue'][:4]]
    rows += [
        (f'{task["status"]}', f'{task["goal"]} {task["reason"]}'.strip())
        for task in fields['outcomes'][-3:]
    ]
    return block(strong('Goals'), table(rows))


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
