# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Configuration files: presets, ROS 2 parameter YAML, and INI files of OpenRatSLAM."""

from __future__ import annotations

import configparser
import json
import os
import sys
from collections.abc import Collection, Iterator, Mapping
from pathlib import Path
from typing import Any

import yaml

from ratslam_ros.core.config import (
    DECLARATIONS,
    SECTIONS,
    SHARED,
    Config,
    Value,
    declared,
    removal,
    section_of,
    stored_values,
)
from ratslam_ros.errors import RatslamError, UnusableInput, UnusableParameter
from ratslam_ros.limits import MAX_CONFIG_BYTES, load_yaml, read_limited

PACKAGE = 'ratslam_ros'
DEFAULT, ORIGINAL, EXTENDED = 'default', 'openratslam', 'extended'
"""Names of the presets with the values of ``Config()``, with those of OpenRatSLAM, and with those
and our first additions."""
RENAMED = {'auto': DEFAULT}
"""Former names of presets."""
BASE = 'base'
"""Key with which a file names the preset whose values it changes."""
UNNAMED = (
    f'{ORIGINAL} is assumed as base, because none is named: unset parameters have the values of '
    f'that preset; add the line "/**: {{ros__parameters: {{base: {ORIGINAL}}}}}", or '
    f'{BASE}: {DEFAULT}'
)
"""Notice about a file without a base that sets only some parameters."""

SUBSECTION_OF = {
    'pose_cells': 'goal_memory', 'experience_map': 'goal_recall',
}
"""Sections that the node of another section reads; in YAML they are nested below that node."""


def preset_folders() -> list[Path]:
    """Return the existing preset folders.

    They are those of a checkout, of the prefix that the package is installed in, of the Python
    environment, and of ROS workspaces. The package is in PREFIX/lib/python3.12/site-packages, or
    in fewer folders below PREFIX.
    """
    parent = Path(__file__).resolve().parents[2]
    prefixes = [
        *map(str, [parent, *parent.parents[:3]]), sys.prefix,
        *os.environ.get('AMENT_PREFIX_PATH', '').split(os.pathsep),
    ]
    shares = [Path(prefix) / 'share' / PACKAGE / 'config' for prefix in prefixes if prefix]
    return [
        folder
        for folder in dict.fromkeys([parent / 'config', *shares])
        if (folder / 'default.yaml').is_file()
    ]


def presets() -> dict[str, Path]:
    """Return the file of each preset by name; the first preset folder has priority."""
    return {
        path.stem: path
        for folder in reversed(preset_folders())
        for path in sorted(folder.glob('*.yaml'))
    }


def load_config(source: str | None) -> tuple[Config, list[str]]:
    """Read a configuration.

    Args:
        source: name of a preset, a YAML file, or an INI file of OpenRatSLAM; None: the defaults.

    Returns:
        The configuration, and notices about unused entries of the file and a missing base.

    Raises:
        UnusableInput: there is no such preset or file, or it has neither format.
        UnusableParameter: a parameter is unknown or out of range.
    """
    if source is None:
        return Config(), []
    path = Path(source)
    if not path.is_file():
        if source in RENAMED:
            return load_config(RENAMED[source])[0], [
                f'the preset {source} is called {RENAMED[source]} now'
            ]
        path = _preset(source)
    try:
        text = read_limited(path, MAX_CONFIG_BYTES, 'a configuration').decode('utf-8-sig')
    except (OSError, UnicodeDecodeError) as error:
        raise UnusableInput(f'{path}: {error}; expected a YAML or INI text file') from None
    try:
        if path.suffix.lower() in ('.yaml', '.yml'):
            config, notices = _from_yaml(text)
            return config, [f'{path}: {notice}' for notice in notices]
        return _from_ini(text)
    except (UnusableInput, UnusableParameter) as error:
        raise type(error)(f'{path}: {error}') from None
    except (yaml.YAMLError, configparser.Error, ValueError) as error:
        raise UnusableInput(f'{path} cannot be read: {str(error)[:200]}') from None


def preset_config(name: Value) -> Config:
    """Return the values of a preset.

    Raises:
        UnusableInput: there is no such preset.
    """
    return Config() if name == DEFAULT else load_config(str(_preset(str(name))))[0]


def is_empty(path: str) -> bool:
    """Return whether a parameter file of nodes sets no parameters, apart from use_sim_time."""
    try:
        text = read_limited(Path(path), MAX_CONFIG_BYTES, 'a configuration').decode()
        return not list(_yaml_values(text))
    except (OSError, UnicodeDecodeError, ValueError, yaml.YAMLError, RatslamError):
        return False  # rcl has read it and may accept more


def stored_config(text: str, where: str) -> tuple[Config, list[str]]:
    """Return a configuration that ``to_yaml`` of this or another version has written.

    It may consist of some sections only, which nodes have written.

    Args:
        text: the configuration.
        where: what contains it, for the messages.

    Returns:
        The configuration; notices about parameters that this version does not have, and about
        sections that contradict each other.

    Raises:
        UnusableInput: the text is no configuration.
        UnusableParameter: a value is out of range.
    """
    try:
        values = dict(_yaml_values(text))
    except (yaml.YAMLError, UnusableInput, UnusableParameter):
        raise UnusableInput(f'{where}: the stored configuration is damaged') from None
    used, notices = stored_values(values)
    # Here, parameters that an earlier version did not have are as that version behaved.
    config = preset_config(EXTENDED).with_values(used)
    return config, [f'{where}: {notice}' for notice in notices]


def _preset(name: str) -> Path:
    available = presets()
    if name not in available:
        raise UnusableInput(
            f'no such file or preset: {name!r}; the presets are '
            f'{", ".join(sorted(available)) or "not installed"}'
        )
    return available[name]


def parse_setting(text: str) -> tuple[str, Value]:
    """Parse ``section.name=value``.

    Returns:
        Key and typed value.

    Raises:
        UnusableParameter: there is no ``=``.
    """
    key, equals, value = text.partition('=')
    if not equals:
        raise UnusableParameter(f'--set {text}: expected section.name=value')
    return key.strip(), _scalar(value)


def to_yaml(config: Config, sections: Collection[str] = tuple(SECTIONS)) -> str:
    """Format a configuration, or its shared and some other sections, as a ROS 2 parameter file."""
    lines: list[str] = []
    for section, values in config.values().items():
        if section in sections or section in SHARED:
            _add_heading(lines, section)
            for name, value in values.items():
                lines.append(f'{_indent(section)}{name}: {_written(value)}\n')
    return ''.join(lines)


def combined_yaml(earlier: str, later: str) -> str:
    """Return a configuration with the sections of two; those of the second one hold.

    Args:
        earlier: what ``to_yaml`` of this or another version has written, or ''.
        later: what ``to_yaml`` of this version has written, or ''.

    Raises:
        UnusableInput: the first one is damaged.
        UnusableParameter: a value is out of range.
    """
    config, _ = stored_config(earlier, 'the earlier session')
    newer = dict(_yaml_values(later))
    keys = [*_yaml_values(earlier), *newer.items()]
    present = {target.partition('.')[0] for key, _ in keys for target in declared(key)}
    return to_yaml(config.with_values(newer), present) if present else ''


def _add_heading(lines: list[str], section: str) -> None:
    """Add the lines above the values of a section; shared ones are set for all nodes, together."""
    heading = f'/**/{section}:\n  ros__parameters:\n'
    if section in SHARED:
        heading = '/**:\n  ros__parameters:\n'
    elif section in SUBSECTION_OF.values():
        heading = f'    {section}:\n'
    if heading not in lines:
        lines.append(heading)


def _indent(section: str) -> str:
    return '      ' if section in SUBSECTION_OF.values() else '    '


def _written(value: Value) -> str:
    if isinstance(value, bool):
        return 'true' if value else 'false'
    if isinstance(value, float) and 'e' in repr(value) and '.' not in repr(value):
        return repr(value).replace('e', '.0e')  # YAML 1.1 reads 2e-05 as text.
    return json.dumps(value) if isinstance(value, str) and not value.isalpha() else str(value)


def _scalar(text: str) -> Value:
    """Parse one value, including numbers that YAML 1.1 reads as text, such as 2e-5."""
    text = text.strip()
    if text.lower() in ('true', 'false'):
        return text.lower() == 'true'
    for kind in (int, float):
        try:
            return kind(text)
        except ValueError:
            continue
    return text


def _typed(value: Any) -> Any:
    """Convert numbers that YAML read as text."""
    return _scalar(value) if isinstance(value, str) else value


def _from_yaml(text: str) -> tuple[Config, list[str]]:
    given = dict(_yaml_values(text))
    values = {name: value for name, value in given.items() if removal(name) is None}
    notices = _removal_notices(given.keys() - values.keys())
    if BASE in values:
        return preset_config(values.pop(BASE)).with_values(values), notices
    targets = {target for key in values for target in declared(key)}
    if not values or targets == DECLARATIONS.keys():
        return Config().with_values(values), notices
    return preset_config(ORIGINAL).with_values(values), [*notices, UNNAMED]


def _removal_notices(keys: Collection[str]) -> list[str]:
    """Return a line for each group of removed parameters about which the same is to be done."""
    groups: dict[str, list[str]] = {}
    for key in sorted(keys):
        groups.setdefault(str(removal(key)), []).append(key)
    return [f'{", ".join(names)}: {text}' for text, names in groups.items()]


def _yaml_values(text: str) -> Iterator[tuple[str, Value]]:
    document = load_yaml(text, yaml.SafeLoader)
    if document is None:
        return
    if not isinstance(document, Mapping):
        raise UnusableInput('expected sections such as local_view: with parameters below them')
    for key, section in document.items():
        name = str(key).rstrip('/').rsplit('/', 1)[-1]
        if isinstance(section, Mapping) and 'ros__parameters' in section:
            section = section['ros__parameters']
        if section is None:
            continue
        if not isinstance(section, Mapping):
            raise UnusableParameter(f'{name} is {section!r:.40}; expected parameters below it')
        for item, value in section.items():
            if isinstance(value, Mapping):
                for inner, inner_value in value.items():
                    yield f'{item}.{inner}', _typed(inner_value)
            elif str(item) == 'use_sim_time':
                continue
            elif name == '**':
                yield from _for_all(str(item), value)
            else:
                yield f'{name}.{item}', _typed(value)


def _for_all(name: str, value: Any) -> Iterator[tuple[str, Value]]:
    """Yield a parameter for all nodes, once for each section that has it."""
    if name == BASE:
        yield BASE, value
        return
    found = [section for section in SECTIONS if declared(f'{section}.{name}')]
    if section_of(name) in SHARED:
        found = found[:1]
    for key in [f'{section}.{name}' for section in found] or [name]:
        yield key, _typed(value)


def _from_ini(text: str) -> tuple[Config, list[str]]:
    """Read an INI file of OpenRatSLAM, in which the section of a parameter is ignored."""
    parser = configparser.ConfigParser(
        interpolation=None, strict=False, inline_comment_prefixes=('#', ';'), delimiters=('=',)
    )
    parser.optionxform = str  # type: ignore[assignment,method-assign]
    parser.read_string('[general]\n' + text)
    values: dict[str, Value] = {}
    unused, removed = [], []
    for section in parser.sections():
        for name, value in parser.items(section):
            target = section_of(name)
            if target is None and removal(name) is not None:
                removed.append(name)
            elif target is None:
                unused.append(f'{section}.{name}')
            else:
                values[f'{target}.{name}'] = _scalar(value)
    if not values:
        raise UnusableInput(
            'no line sets a parameter of RatSLAM; expected YAML, or name=value lines as in '
            'configurations of OpenRatSLAM'
        )
    notices = [f'unused entries of the configuration: {", ".join(unused)}'] if unused else []
    return preset_config(ORIGINAL).with_values(values), [*_removal_notices(removed), *notices]
