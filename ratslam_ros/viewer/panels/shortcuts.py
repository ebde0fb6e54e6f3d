# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Keyboard shortcuts, and the help that lists them."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from ratslam_ros.viewer.panels.desk import Desk
from ratslam_ros.viewer.panels.html import block, dim, strong, table

VISER_KEYS = (
    ('drag', 'turn the view'),
    ('right drag', 'move the view'),
    ('wheel', 'nearer, farther'),
    ('arrows', 'turn the view'),
    ('W A S D Q E', 'move the view'),
    ('click', 'select'),
    ('Ctrl K', 'search commands'),
)

SEEN = (
    'Dots are experiences: places that the robot has learned. Lines are links, ways driven '
    'between them. A loop closes when a view is recognised as that of an experience, and the map '
    'is corrected.'
)


@dataclass(frozen=True)
class Shortcut:
    """A key, and what it does."""

    key: str
    label: str
    act: Callable[[], None]
    modifier: str | None = None

    @property
    def keys(self) -> str:
        """The key as it is shown."""
        names = {'pageup': 'Page up', 'pagedown': 'Page down'}
        key = names.get(self.key, self.key.capitalize())
        return f'{self.modifier.capitalize()} {key}' if self.modifier else key


def add_shortcuts(desk: Desk, shortcuts: list[Shortcut]) -> list[Any]:
    """Register shortcuts as commands of the page, which can also be searched for."""
    handles = []
    for shortcut in shortcuts:
        key: Any = shortcut.key
        modifier: Any = shortcut.modifier
        command: Any = desk.gui.add_command(shortcut.label, hotkey=key, modifier=modifier)
        command.on_trigger(lambda _event, act=shortcut.act: desk.post(act))
        handles.append(command)
    return handles


def help_html(shortcuts: list[Shortcut]) -> str:
    """Return what one sees, and the keys."""
    return block(
        strong('What you see'), dim(SEEN), strong('Keys'),
        table((shortcut.keys, shortcut.label) for shortcut in shortcuts),
        strong('View'), table(VISER_KEYS),
    )
