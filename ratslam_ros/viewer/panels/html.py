# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Small pieces of HTML; every text is escaped, because names and messages come from outside."""

from __future__ import annotations

import base64
from collections.abc import Iterable, Sequence
from html import escape

Colour = tuple[int, int, int]

GREEN, ORANGE, RED, BLUE = (0, 158, 115), (230, 159, 0), (213, 94, 0), (0, 114, 178)
"""Colours of the palette of Okabe and Ito, which colour-blind people can tell apart."""

LEVELS = {'OK': ('●', GREEN), 'WARN': ('▲', ORANGE), 'ERROR': ('■', RED)}
"""Symbol and colour of the levels of diagnostics."""


def block(*parts: str) -> str:
    """Return lines of HTML as a block with the margins of viser's other elements."""
    lines = ''.join(f'<div>{part}</div>' for part in parts if part)
    return f'<div style="padding:0 .75em .5em;font-size:.8em;line-height:1.45">{lines}</div>'


def strong(text: str) -> str:
    """Return a text in bold letters."""
    return f'<b>{escape(text)}</b>'


def dim(text: str) -> str:
    """Return a text that stands back."""
    return f'<span style="opacity:.65">{escape(text)}</span>'


def css(colour: Colour) -> str:
    """Return a colour as CSS."""
    return 'rgb({:d},{:d},{:d})'.format(*colour)


def mark(symbol: str, colour: Colour) -> str:
    """Return a coloured symbol."""
    return f'<span style="color:{css(colour)}">{escape(symbol)}</span>'


def table(rows: Iterable[Sequence[str]], head: Sequence[str] = ()) -> str:
    """Return a table of texts."""
    cell = 'style="text-align:left;vertical-align:top;padding:0 .8em 0 0;font-weight:{}"'
    lines = [''.join(f'<th {cell.format(600)}>{escape(text)}</th>' for text in head)]
    lines += [
        ''.join(f'<td {cell.format(400)}>{escape(text)}</td>' for text in row) for row in rows
    ]
    body = ''.join(f'<tr>{line}</tr>' for line in lines if line)
    return f'<table style="border-collapse:collapse">{body}</table>' if body else ''


def legend(entries: Iterable[tuple[Colour, str]]) -> str:
    """Return a legend: a coloured square and a text for each entry."""
    return ''.join(f'<div>{mark("■", colour)} {escape(text)}</div>' for colour, text in entries)


def pictures(jpegs: Sequence[tuple[bytes | None, str]]) -> str:
    """Return one or two pictures side by side, each with a text below."""
    width = '50%' if len(jpegs) > 1 else '70%'
    cells = []
    for jpeg, text in jpegs:
        picture = '<div style="opacity:.65;padding:1em 0">no image</div>'
        if jpeg:
            code = base64.b64encode(jpeg).decode('ascii')
            picture = f'<img style="width:100%;display:block" src="data:image/jpeg;base64,{code}">'
        cells.append(f'<div style="width:{width}">{picture}{dim(text)}</div>')
    return f'<div style="display:flex;gap:.4em">{"".join(cells)}</div>'
