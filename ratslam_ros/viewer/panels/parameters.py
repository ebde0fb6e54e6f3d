# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Parameters: inputs that are generated from the declarations in core/config."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from ratslam_ros.core.config import DECLARATIONS, SECTIONS, Config, ParameterInfo, Value
from ratslam_ros.errors import UnusableParameter
from ratslam_ros.history.run_state import RunState
from ratslam_ros.viewer.panels.desk import Desk, assign
from ratslam_ros.viewer.panels.html import ORANGE, RED, block, dim, mark, strong, table
from ratslam_ros.viewer.run_source import Answer, Controls

ALL = 'all sections'
FIRST = 'local_view'
"""Section shown first: its threshold is what users change most."""

DISCARD, DEFAULTS = 'Discard', 'Defaults'

EDITED = '◆'
"""Mark of an edited parameter."""

DECIMALS = 6
"""Number of decimals that can be typed."""

MOST_SHOWN = 40
"""Largest number of inputs at once; a search narrows them down."""

NOTHING = (
    'This run has no parameters that can be changed. Those of a replay ("ratslam view RECORDING") '
    'and of live nodes ("ratslam launch --view") can.'
)
LIVE_HINT = 'Change values and apply them together. Hover over a name to read what it does.'
REPLAY_HINT = (
    'Change values and replay the recording again with them. Hover over a name to read what it '
    'does.'
)


class ParametersPanel:
    """A searchable list of inputs.

    Edits are kept until they are applied together: pages send every keystroke, and values may be
    valid only with each other.
    """

    def __init__(self, desk: Desk) -> None:
        self._desk, gui = desk, desk.gui
        self.inputs: dict[str, Any] = {}
        """The inputs that are shown, by ``section.name``."""
        self.edits: dict[str, object] = {}
        """Values that have not been applied yet, by ``section.name``."""
        self._values = dict(desk.controls.parameters)
        self._replays = 'run_again' in desk.controls.actions
        if not self._values or 'set_parameter' not in desk.controls.actions:
            gui.add_html(block(dim(NOTHING)))
            self._values = {}
            return
        sections = [s for s in SECTIONS if any(key.startswith(f'{s}.') for key in self._values)]
        gui.add_html(block(dim(REPLAY_HINT if self._replays else LIVE_HINT)))
        self.section = gui.add_dropdown(
            'Section',
            (*sections, ALL),
            hint='Part of RatSLAM that they belong to.',
            initial_value=FIRST if FIRST in sections else sections[0],
        )
        self.search = gui.add_text(
            'Search', '', hint='Part of a name or of the description, in all sections.'
        )
        self.apply = gui.add_button(
            'Run again with the changes' if self._replays else 'Apply the changes', disabled=True,
            hint=REPLAY_HINT if self._replays else LIVE_HINT,
        )
        self.buttons = gui.add_button_group(
            'Inputs', (DISCARD, DEFAULTS),
            hint='Discard the changes, or set all parameters listed below to their defaults.',
        )
        self.text = gui.add_html('')
        self._place = gui.add_folder(None)
        with self._place:
            self._listed = gui.add_folder(None)
        desk.on_change(self.section, lambda _: self._list())
        desk.on_change(self.search, lambda _: self._list())
        desk.on_click(self.apply, self._apply)
        desk.on_press(self.buttons, {DISCARD: self._discard, DEFAULTS: self._set_defaults})
        self._list()

    def update(self, state: RunState) -> None:
        """Show values that have been changed elsewhere."""
        if self._values and self._desk.controls.parameters != self._values:
            self._read()

    def edit(self, key: str, value: object) -> None:
        """Change a value."""
        self.edits[key] = _typed(key, value)
        self._show()

    def _apply(self) -> None:
        edits, controls = dict(self.edits), self._desk.controls

        def answered(answer: Answer) -> None:
            for key, value in edits.items():
                if answer.success and self.edits.get(key) == value:
                    del self.edits[key]
            self._read('' if answer.success else answer.message)

        request = ', '.join(f'{key} = {value}' for key, value in edits.items())
        self._desk.ask(request, lambda: send(controls, edits, self._replays), answered)

    def _discard(self) -> None:
        self.edits.clear()
        self._show()

    def _set_defaults(self) -> None:
        for key in self.inputs:
            self.edits[key] = DECLARATIONS[key][1]
        self._show()

    def _read(self, refusal: str = '') -> None:
        self._values = dict(self._desk.controls.parameters)
        self._show(refusal)

    def _show(self, refusal: str = '') -> None:
        """Show the values and edits, and what is wrong with them."""
        self.edits = {k: v for k, v in self.edits.items() if v != self._values[k]}
        for key, handle in self.inputs.items():
            assign(handle, self.edits.get(key, self._values[key]))
            handle.label = self._label(key)
        problem = problem_of({**self._values, **self.edits})
        parts = [f'{mark("■", RED)} {strong(text)}' for text in (refusal, problem) if text]
        if self.edits:
            rows = [(k, f'{self._values[k]} → {value}') for k, value in self.edits.items()]
            parts += [f'{mark(EDITED, ORANGE)} {strong("not applied yet")}', table(rows)]
        self.text.content = block(*parts) if parts else ''
        self.apply.disabled = not self.edits or bool(problem)

    def _list(self) -> None:
        """Show the inputs of the chosen section, or those that the search finds."""
        self._listed.remove()
        self.inputs.clear()
        keys = found(self._values, self.section.value, self.search.value)
        with self._place:
            self._listed = self._desk.gui.add_folder(None)
        with self._listed:
            for key in keys[:MOST_SHOWN]:
                self._add(key)
            if len(keys) > MOST_SHOWN:
                more = f'and {len(keys) - MOST_SHOWN} more: search for a part of the name'
                self._desk.gui.add_html(block(dim(more)))
            if not keys:
                self._desk.gui.add_html(block(dim('no parameter found')))
        self._show()

    def _add(self, key: str) -> None:
        gui, (info, default) = self._desk.gui, DECLARATIONS[key]
        value: Any = self.edits.get(key, self._values[key])
        label, hint = self._label(key), hint_text(info, default)
        handle: Any
        if isinstance(default, bool):
            handle = gui.add_checkbox(label, bool(value), hint=hint)
        elif info.choices:
            handle = gui.add_dropdown(label, info.choices, initial_value=str(value), hint=hint)
        elif isinstance(default, str):
            handle = gui.add_text(label, str(value), hint=hint)
        else:
            kind = type(default)
            handle = gui.add_number(
                label, kind(value), min=kind(info.lowest), max=kind(info.high), hint=hint,
                step=1 if kind is int else _step(info),
            )
            if kind is float:
                handle.precision = DECIMALS
        self.inputs[key] = handle
        self._desk.on_change(handle, lambda new: self.edit(key, new))

    def _label(self, key: str) -> str:
        """Return the name of a parameter, marked if it was edited."""
        section, _, name = key.partition('.')
        if self.section.value != section or self.search.value:
            name = key
        # Names may be broken at underscores, because the column of labels is narrow.
        name = name.replace('_', '_\u200b')
        return f'{EDITED} {name}' if key in self.edits else name


def send(controls: Controls, edits: Mapping[str, object], run_again: bool) -> Answer:
    """Set parameters, and replay again if asked.

    Some values are valid only after others have been set, so those that are refused are sent
    again as long as others are accepted.
    """
    left, set_parameter = dict(edits), controls.actions['set_parameter']
    while left:
        answers = {key: set_parameter(key, value) for key, value in left.items()}
        refused = {key: answer.message for key, answer in answers.items() if not answer.success}
        if len(refused) == len(left):
            return Answer(False, '; '.join(refused.values()))
        left = {key: left[key] for key in refused}
    if run_again:
        return controls.actions['run_again']()
    return Answer(True, ', '.join(f'{key} is {value}' for key, value in edits.items()))


def problem_of(values: Mapping[str, object]) -> str:
    """Return why values are not valid, or not together; '' if they are."""
    try:
        Config().with_values({k: v for k, v in values.items() if isinstance(v, Value)})
    except UnusableParameter as error:
        return str(error)
    return ''


def found(values: Mapping[str, object], section: str, search: str) -> list[str]:
    """Return the parameters that a section has, or that a search finds in all of them."""
    words = search.lower().split()
    if words:
        return [
            key for key in values
            if all(word in f'{key} {DECLARATIONS[key][0].effect}'.lower() for word in words)
        ]
    return [key for key in values if section in (ALL, key.partition('.')[0])]


def hint_text(info: ParameterInfo, default: Value) -> str:
    """Return what a parameter does, its unit, range and default, and when to change it."""
    parts = [info.effect]
    if info.unit:
        parts.append(f'Unit: {info.unit}.')
    if not isinstance(default, (bool, str)):
        parts.append(f'Range: {info.range_text}.')
    parts.append(f'Default: {default}.')
    verbs = ('Turn on', 'Turn off') if isinstance(default, bool) else ('Raise', 'Lower')
    for verb, reason in zip(verbs, (info.raise_if, info.lower_if), strict=True):
        if reason:
            parts.append(reason if isinstance(default, str) else f'{verb} if {reason}.')
    return ' '.join(parts)


def _typed(key: str, value: object) -> object:
    """Return a value with the type of the parameter; pages send 1 for 1.0."""
    default = DECLARATIONS[key][1]
    if isinstance(default, float) and isinstance(value, int):
        return float(value)
    return value


def _step(info: ParameterInfo) -> float:
    """Return the step of the arrows of an input: a thousandth of the range, at most 0.1."""
    return max(min(0.1, (info.high - info.low) / 1000), 1e-4)
