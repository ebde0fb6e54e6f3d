# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Parameters: inputs that are generated from the declarations in core/config."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from ratslam_ros.core.config import SECTIONS, SHARED, Config, ParameterInfo, Value
from ratslam_ros.errors import UnusableParameter
from ratslam_ros.history.run_state import RunState
from ratslam_ros.viewer.panels.desk import Desk, assign
from ratslam_ros.viewer.panels.html import ORANGE, RED, block, dim, mark, strong, table
from ratslam_ros.viewer.run_source import Answer

ALL, CHANGED = 'all sections', 'changed'

MOST_SHOWN = 40
"""Largest number of inputs at once; a search narrows them down."""

NOTHING = 'This run has no parameters that can be changed.'
LIVE_HINT = 'Changes take effect at once. Hover over a name to read what it does.'
REPLAY_HINT = (
    'Change values and run the replay again with them. Hover over a name to read what it does.'
)


class ParametersPanel:
    """A searchable list of inputs, and what was changed."""

    def __init__(self, desk: Desk) -> None:
        self._desk, gui = desk, desk.gui
        self.inputs: dict[str, Any] = {}
        """The inputs that are shown, by ``section.name``."""
        self.changed: dict[str, object] = {}
        """Values before the changes that the shown run does not have yet, or that were made."""
        self._values = dict(desk.controls.parameters)
        self.replays = 'run_again' in desk.controls.actions
        """Whether changes take effect when the recording is replayed again."""
        if not self._values or 'set_parameter' not in desk.controls.actions:
            gui.add_html(block(dim(NOTHING)))
            self._values = {}
            return
        sections = [s for s in SECTIONS if any(key.startswith(f'{s}.') for key in self._values)]
        gui.add_html(block(dim(REPLAY_HINT if self.replays else LIVE_HINT)))
        self.section = gui.add_dropdown(
            'Section', (*sections, ALL, CHANGED), hint='Part of RatSLAM that they belong to.'
        )
        self.search = gui.add_text(
            'Search', '', hint='Part of a name or of the description, in all sections.'
        )
        self.again = gui.add_button(
            'Run again with the changes', visible=self.replays, disabled=True,
            hint='Replay the recording again with the changed parameters.',
        )  # fmt: skip
        self.text = gui.add_html('')
        self.folder = gui.add_folder(None)
        self.reset_all = gui.add_button(
            'Take back all changes', visible=False, color='gray',
            hint='Set all changed parameters to the values they had when the page was opened.',
        )  # fmt: skip
        desk.on_change(self.section, lambda _: self._list())
        desk.on_change(self.search, lambda _: self._list())
        desk.on_click(self.again, self._run_again)
        desk.on_click(self.reset_all, self._take_back)
        self._list()
        self._tell('')

    def update(self, state: RunState) -> None:
        """Show values that have been changed elsewhere."""
        if not self._values:
            return
        values = self._desk.controls.parameters
        if values != self._values:
            self._values = dict(values)
            for key, handle in self.inputs.items():
                assign(handle, values[key])

    def set(self, key: str, value: object) -> None:
        """Validate a value and send it; a shared parameter is set in both of its sections."""
        value = _typed(key, value)
        keys = [key]
        name = key.partition('.')[2]
        if name in SHARED:
            keys = [k for k in self._values if k.partition('.')[2] == name]
        try:
            checked({**self._values, **dict.fromkeys(keys, value)})
        except UnusableParameter as error:
            self._tell(str(error))
            self._restore(key)
            return
        self._tell('')
        for k in keys:
            self._send(k, value)

    def _send(self, key: str, value: object) -> None:
        before = self._values[key]
        if value == before:
            return

        def answered(answer: Answer) -> None:
            if answer.success:
                self._values[key] = value
                if self.changed.setdefault(key, before) == value:
                    del self.changed[key]
                self._tell('')
            else:
                self._tell(answer.message)
            self._restore(key)

        call = self._desk.controls.set_parameter
        self._desk.ask(f'{key} = {value}', lambda: call(key, value), answered)

    def _restore(self, key: str) -> None:
        """Show the value that holds."""
        if key in self.inputs:
            assign(self.inputs[key], self._values[key])

    def _run_again(self) -> None:
        def answered(answer: Answer) -> None:
            if answer.success:
                self.changed.clear()
            self._tell('' if answer.success else answer.message)

        self._desk.ask('run again', self._desk.controls.run_again, answered)

    def _take_back(self) -> None:
        for key, value in list(self.changed.items()):
            self._send(key, value)

    def _tell(self, problem: str) -> None:
        """Show what was changed, and what was wrong with the last value."""
        parts = [f'{mark("■", RED)} {strong(problem)}'] if problem else []
        if self.changed:
            rows = [
                (key, f'{before} → {self._values[key]}') for key, before in self.changed.items()
            ]
            parts += [f'{mark("◆", ORANGE)} {strong(f"{len(rows)} changed")}', table(rows)]
        self.text.content = block(*parts) if parts else ''
        self.again.disabled = not self.changed
        self.reset_all.visible = bool(self.changed)

    def _list(self) -> None:
        """Show the inputs of the chosen section, or those that the search finds."""
        for handle in self.inputs.values():
            handle.remove()
        self.inputs.clear()
        for child in list(self.folder._children.values()):
            child.remove()
        keys = found(self._values, self.section.value, self.search.value, self.changed)
        with self.folder:
            for key in keys[:MOST_SHOWN]:
                self._add(key)
            if len(keys) > MOST_SHOWN:
                more = f'and {len(keys) - MOST_SHOWN} more: search for a part of the name'
                self._desk.gui.add_html(block(dim(more)))
            if not keys:
                self._desk.gui.add_html(block(dim('no parameter found')))

    def _add(self, key: str) -> None:
        gui = self._desk.gui
        value: Any = self._values[key]
        section, _, name = key.partition('.')
        info, default = declaration(key)
        one_section = self.section.value == section and not self.search.value
        # Names may be broken at underscores, because the column of labels is narrow.
        label = (name if one_section else key).replace('_', '_\u200b')
        hint = hint_text(info, default)
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
            )  # fmt: skip
        self.inputs[key] = handle
        self._desk.on_change(handle, lambda new: self.set(key, new))


def declaration(key: str) -> tuple[ParameterInfo, Value]:
    """Return the metadata and the default of a parameter, given as ``section.name``."""
    section, _, name = key.partition('.')
    for known, info, default in SECTIONS[section].parameters():
        if known == name:
            return info, default
    raise KeyError(key)


def checked(values: Mapping[str, object]) -> Config:
    """Return the configuration with these values.

    Raises:
        UnusableParameter: a value is not valid, or not together with the others.
    """
    return Config().with_values({k: v for k, v in values.items() if isinstance(v, Value)})


def found(
    values: Mapping[str, object], section: str, search: str, changed: Mapping[str, object]
) -> list[str]:
    """Return the parameters that a section has, or that a search finds in all of them."""
    words = search.lower().split()
    if words:
        return [
            key for key in values
            if all(word in f'{key} {declaration(key)[0].effect}'.lower() for word in words)
        ]  # fmt: skip
    if section == CHANGED:
        return [key for key in values if key in changed]
    return [key for key in values if section in (ALL, key.partition('.')[0])]


def hint_text(info: ParameterInfo, default: Value) -> str:
    """Return what a parameter does, its unit, range and default, and when to change it."""
    parts = [info.effect]
    if info.unit:
        parts.append(f'Unit: {info.unit}.')
    if not isinstance(default, (bool, str)):
        parts.append(f'Range: {info.range_text}.')
    parts.append(f'Default: {default}.')
    if info.raise_if:
        verb = 'Turn on' if isinstance(default, bool) else 'Raise'
        parts.append(info.raise_if if isinstance(default, str) else f'{verb} if {info.raise_if}.')
    if info.lower_if:
        verb = 'Leave off' if isinstance(default, bool) else 'Lower'
        parts.append(info.lower_if if isinstance(default, str) else f'{verb} if {info.lower_if}.')
    return ' '.join(parts)


def _typed(key: str, value: object) -> object:
    """Return a value with the type of the parameter; pages send 1 for 1.0."""
    default = declaration(key)[1]
    if isinstance(default, float) and isinstance(value, int):
        return float(value)
    return value


def _step(info: ParameterInfo) -> float:
    """Return the step of the arrows of an input: a thousandth of the range, at most 0.1."""
    return max(min(0.1, (info.high - info.low) / 1000), 1e-4)
