# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Write config/default.yaml and the generated parts of pages.

These are the entries of docs/parameters.md, the drawing in docs/architecture.md, and the JSON
payloads in docs/topics.md and docs/results.md.

    python tools/write_docs.py            write them
    python tools/write_docs.py --check    check whether they are up to date
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from functools import cache
from pathlib import Path

from payload_docs import with_payloads
from stage_drawing import with_drawing

from ratslam_ros.core.config import (
    AUTOMATIC,
    REMOVED,
    SECTIONS,
    Config,
    ParameterInfo,
    Section,
    Value,
)
from ratslam_ros.files.config import to_yaml
from ratslam_ros.viewer.config import ViewerParameters
from ratslam_simulator.config import SimulatorParameters

ROOT = Path(__file__).resolve().parents[1]
BEGIN, END = '<!-- {}, by `make docs`; do not edit. -->\n', '<!-- End. -->\n'


def with_parameters(page: str) -> str:
    """Return docs/parameters.md with the present entries and table of removed parameters."""
    for title, text in (('Parameters', _entries()), ('Removed parameters', _removed())):
        begin = BEGIN.format(title)
        before, rest = page.split(begin)
        _, after = rest.split(END, 1)
        page = f'{before}{begin}{text}{END}{after}'
    return page


def _entries() -> str:
    """Return effect, default, range and tuning of each parameter."""
    parts = []
    sections: dict[str, type[Section]] = {
        **SECTIONS, 'simulator': SimulatorParameters, 'viewer': ViewerParameters
    }
    for section, cls in sections.items():
        parts.append(f'\n## {section}\n\n{cls.__doc__}\n')
        for name, info, default in cls.parameters():
            parts.append(_entry(name, info, default))
    return ''.join([*parts, '\n'])


def _removed() -> str:
    """Return the table of removed parameters, grouped by what to do about them."""
    groups: dict[str, list[str]] = {}
    for name, text in REMOVED.items():
        groups.setdefault(text, []).append(name)
    rows = (f'| {", ".join(sorted(names))} | {text} |\n' for text, names in groups.items())
    return ''.join(['\n| parameters | each |\n| --- | --- |\n', *rows, '\n'])


PARTS = {
    Path('docs/parameters.md'): with_parameters,
    Path('docs/architecture.md'): with_drawing,
    Path('docs/topics.md'): with_payloads,
    Path('docs/results.md'): with_payloads,
}
"""Pages with generated parts, and what writes these."""

_PAGES = {path: ROOT / path for path in PARTS}


def documented_yaml() -> str:
    """Return the text of config/default.yaml: each parameter with default, unit and effect."""
    parts = [
        '# Every parameter with its default, unit and effect. Generated from '
        'ratslam_ros/core/config/\n# by `make docs`; do not edit.\n'
    ]
    written = iter(to_yaml(Config()).splitlines())
    for cls in SECTIONS.values():
        parts.append('\n')
        for name, info, _ in cls.parameters():
            while not (line := next(written)).lstrip().startswith(f'{name}: '):
                parts.append(f'{line}\n')  # headings
            indent = line[: len(line) - len(line.lstrip())]
            unit = f'  # {info.unit}' if info.unit else ''
            parts.append(f'{indent}# {info.effect}\n{line}{unit}\n')
    return ''.join(parts)


@cache
def documents() -> dict[Path, str]:
    """Return the generated files, relative to the root of the repository, and their contents."""
    return {
        Path('config/default.yaml'): documented_yaml(),
        **{path: write(_PAGES[path].read_text('utf-8')) for path, write in PARTS.items()},
    }


def main(arguments: Sequence[str] | None = None) -> int:
    """Write the files, or check them; return 1 if a checked one is out of date."""
    parser = argparse.ArgumentParser(
        description='Write config/default.yaml and the generated parts of pages.',
    )
    parser.add_argument('--check', action='store_true', help='write nothing; 1 if out of date')
    options = parser.parse_args(arguments)
    outdated = [path for path, text in documents().items() if _read(ROOT / path) != text]
    for path in outdated:
        if options.check:
            print(f'{path} is out of date: run "make docs"', file=sys.stderr)
        else:
            (ROOT / path).parent.mkdir(exist_ok=True)
            (ROOT / path).write_text(documents()[path], encoding='utf-8', newline='\n')
            print(f'{path} written')
    return int(options.check and bool(outdated))


def _entry(name: str, info: ParameterInfo, default: Value) -> str:
    lines = [f'\n### {name}\n', info.effect, '']
    facts = [f'default `{_shown(default)}`']
    if info.choices:
        facts.append('one of ' + ', '.join(f'`{choice}`' for choice in info.choices))
    elif isinstance(default, str):
        facts.append('any name')
    elif not isinstance(default, bool):
        automatic = f', or `{AUTOMATIC}` (automatic)' if info.automatic else ''
        facts.append(f'from {_shown(info.low)} to {_shown(info.high)}{automatic}')
    if info.unit:
        facts.append(f'unit: {info.unit}')
    lines.append('- ' + '; '.join(facts))
    if info.runtime != 'no':
        lines.append(f'- can be set while the node runs, with effect {_WHEN[info.runtime]}')
    change, back = ('`true`', '`false`') if isinstance(default, bool) else ('raise', 'lower')
    if isinstance(default, str):
        lines += [f'- {advice}' for advice in (info.raise_if, info.lower_if) if advice]
    else:
        if info.raise_if:
            lines.append(f'- {change} if {info.raise_if}')
        if info.lower_if:
            lines.append(f'- {back} if {info.lower_if}')
    return '\n'.join(lines) + '\n'


_WHEN = {'at once': 'at once', 'at next message': 'from the next message on'}


def _shown(value: Value) -> str:
    if isinstance(value, bool):
        return 'true' if value else 'false'
    if isinstance(value, float):
        return f'{value:g}' if value < 1e6 else f'{value:.0f}'
    return str(value)


def _read(path: Path) -> str | None:
    return path.read_text(encoding='utf-8') if path.is_file() else None


if __name__ == '__main__':
    sys.exit(main())
