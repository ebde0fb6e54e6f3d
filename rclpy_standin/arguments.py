# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""ROS command lines: --ros-args with remapping rules, parameters and logging options."""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from functools import cache
from pathlib import Path
from typing import Any

from rclpy_standin import names
from rclpy_standin.exceptions import (
    NameValidationException,
    RCLInvalidROSArgsError,
    UnknownROSArgsError,
)
from rclpy_standin.logging import LoggingSeverity

START, END = '--ros-args', '--'
_SWITCHES = re.compile(r'--(enable|disable)-(rosout|stdout|external-lib)-logs')
_VALUED = {
    '-r': 'remap', '--remap': 'remap', '-p': 'parameter', '--param': 'parameter',
    '--params-file': 'file', '--log-level': 'level', '-e': 'ignored', '--enclave': 'ignored',
    '--log-config-file': 'ignored', '--log-file-name': 'ignored',
}


@dataclass(frozen=True)
class Remap:
    """A remapping rule."""

    node: str
    """Name of the node that the rule applies to; empty for all nodes."""
    match: str
    """Name of a topic or service, or __node or __ns."""
    replacement: str


@dataclass
class Arguments:
    """Parsed ROS arguments."""

    remaps: list[Remap] = field(default_factory=list)
    parameters: list[tuple[str, dict[str, Any]]] = field(default_factory=list)
    """Node name pattern and values by parameter name; later entries take precedence."""
    levels: list[tuple[str, LoggingSeverity]] = field(default_factory=list)
    to_stderr: bool = True
    to_rosout: bool = True


def remove_ros_args(args: Sequence[str]) -> list[str]:
    """Return a command line without the arguments between --ros-args and --."""
    kept, inside = [], False
    for word in args:
        if word == START:
            inside = True
        elif inside and word == END:
            inside = False
        elif not inside:
            kept.append(word)
    return kept


def parse(args: Sequence[str]) -> Arguments:
    """Parse the ROS arguments of a command line.

    Raises:
        UnknownROSArgsError: an argument after --ros-args is unknown.
        RCLInvalidROSArgsError: an argument is malformed.
    """
    parsed = Arguments()
    words = iter(_ros_words(args))
    unknown = []
    for word in words:
        if word in _VALUED:
            value = next(words, None)
            if value is None:
                raise RCLInvalidROSArgsError(f'{word}: expected a value after it')
            _add_option(parsed, _VALUED[word], value, word)
        elif switch := _SWITCHES.fullmatch(word):
            enabled = switch[1] == 'enable'
            if switch[2] == 'stdout':
                parsed.to_stderr = enabled
            elif switch[2] == 'rosout':
                parsed.to_rosout = enabled
        else:
            unknown.append(word)
    if unknown:
        raise UnknownROSArgsError(f'Found unknown ROS arguments: {", ".join(unknown)}')
    return parsed


def _ros_words(args: Sequence[str]) -> Iterator[str]:
    inside = False
    for word in args:
        if word == START:
            inside = True
        elif inside and word == END:
            inside = False
        elif inside:
            yield word


def _add_option(parsed: Arguments, option: str, value: str, word: str) -> None:
    if option == 'file':
        parsed.parameters += parameter_file(value)
        return
    if option == 'level':
        logger, has_name, level = value.rpartition(':=')
        try:
            severity = LoggingSeverity[level.upper()]
        except KeyError:
            raise RCLInvalidROSArgsError(
                f'{word} {value}: expected debug, info, warn, error or fatal'
            ) from None
        parsed.levels.append((logger if has_name else '', severity))
        return
    if option == 'ignored':
        return
    match, is_rule, replacement = value.partition(':=')
    node, _, match = match.rpartition(':')
    if not is_rule or not match:
        raise RCLInvalidROSArgsError(f'{word} {value}: expected name:=value')
    if option == 'parameter':
        pattern = '/**' if not node else node if node.startswith('/') else f'/{node}'
        parsed.parameters.append((pattern, {match: parse_value(replacement)}))
        return
    match = '__node' if match == '__name' else match
    try:
        if match == '__node':
            names.check_node_name(replacement)
        elif match == '__ns':
            names.check_namespace(replacement)
    except NameValidationException as error:
        raise RCLInvalidROSArgsError(f'{word} {value}: {error}') from None
    parsed.remaps.append(Remap(node, match, replacement))


# Names


class Names:
    """Name and namespace of one node after remapping, and its resolved topic names."""

    def __init__(self, node: str, namespace: str, arguments: Sequence[Arguments]) -> None:
        """Apply the remapping rules; the first matching rule of ``arguments`` is used."""
        names.check_node_name(node)
        namespace = names.full_namespace(namespace)
        self._rules = [rule for parsed in arguments for rule in parsed.remaps]
        self._original_node = node
        self.node = self._find_replacement('__node', node) or node
        self.namespace = self._find_replacement('__ns', node) or namespace
        self.full = names.join(self.namespace, self.node)

    def resolve(self, name: str, is_service: bool = False) -> str:
        """Return the full name of a topic or service after remapping."""
        full = names.expand(name, self.node, self.namespace, is_service)
        for rule in self._rules:
            if rule.match in ('__node', '__ns'):
                continue
            if rule.node and rule.node not in (self._original_node, self.node):
                continue
            if names.expand(rule.match, self.node, self.namespace, is_service) == full:
                return names.expand(rule.replacement, self.node, self.namespace, is_service)
        return full

    def _find_replacement(self, match: str, node: str) -> str | None:
        for rule in self._rules:
            if rule.match == match and rule.node in ('', node):
                return rule.replacement
        return None


# Parameters


def overrides(full_name: str, arguments: Sequence[Arguments]) -> dict[str, Any]:
    """Return the parameter values for a node; later arguments take precedence.

    Args:
        full_name: fully qualified name of the node.
        arguments: parsed command lines.
    """
    values: dict[str, Any] = {}
    for parsed in arguments:
        for pattern, matching in parsed.parameters:
            if _matches(pattern, full_name):
                values |= matching
    return values


def _matches(pattern: str, name: str) -> bool:
    parts = re.split(r'(/\*\*|/\*)', pattern)
    regex = ''.join({'/**': r'(/\w+)*', '/*': r'/\w+'}.get(p, re.escape(p)) for p in parts)
    return re.fullmatch(regex, name) is not None


def parameter_file(path: str | Path) -> list[tuple[str, dict[str, Any]]]:
    """Read a YAML parameter file.

    Returns:
        Pairs of a node name pattern and the values by parameter name.

    Raises:
        RCLInvalidROSArgsError: the file cannot be read, or is not a parameter file.
    """
    import yaml

    try:
        tree = yaml.load(Path(path).read_text(encoding='utf-8'), _loader())
    except (OSError, UnicodeError, yaml.YAMLError, ValueError) as error:
        reason = ' '.join(str(error).split())
        raise RCLInvalidROSArgsError(f'--params-file {path}: {reason}') from None
    if tree is None:
        return []
    try:
        return list(_nodes('', tree))
    except ValueError as error:
        raise RCLInvalidROSArgsError(f'--params-file {path}: {error}') from None


def _nodes(name: str, tree: Any) -> Iterator[tuple[str, dict[str, Any]]]:
    if not isinstance(tree, dict):
        raise ValueError(f'{name or "the file"}: expected nodes, each with ros__parameters')
    for key, below in tree.items():
        if key == 'ros__parameters':
            if below is not None and not isinstance(below, dict):
                raise ValueError(f'{name}: expected parameters below ros__parameters')
            yield name or '/**', dict(_flat('', below or {}))
        else:
            yield from _nodes(f'{name}/{str(key).strip("/")}', below)


def _flat(prefix: str, tree: dict[Any, Any]) -> Iterator[tuple[str, Any]]:
    for key, value in tree.items():
        if isinstance(value, dict):
            yield from _flat(f'{prefix}{key}.', value)
        else:
            yield f'{prefix}{key}', _checked(f'{prefix}{key}', value)


def parse_value(text: str) -> Any:
    """Parse a parameter value written as YAML.

    Raises:
        RCLInvalidROSArgsError: the text is no YAML, or parameters cannot hold the value.
    """
    import yaml

    try:
        return _checked(text, yaml.load(text, _loader()))
    except (yaml.YAMLError, ValueError) as error:
        raise RCLInvalidROSArgsError(' '.join(str(error).split())) from None


def _checked(name: str, value: Any) -> Any:
    if value is None:
        return ''
    if isinstance(value, dict):
        raise ValueError(f'{name}: expected a value or a list of values of one type')
    if isinstance(value, list):
        kinds = {type(item) for item in value}
        if kinds == {int, float}:
            return [float(item) for item in value]
        if len(kinds) > 1 or kinds & {dict, list, type(None)}:
            raise ValueError(f'{name}: expected a list of values of one type')
    return value


@cache
def _loader() -> Any:
    """Return a YAML loader with the scalar types of ROS: no dates and no sexagesimal numbers."""
    import yaml

    class Loader(yaml.SafeLoader):
        pass

    Loader.yaml_implicit_resolvers = {}
    for tag, regex in (
        ('bool', r'[yY]|[nN]|(?:yes|Yes|YES|no|No|NO|true|True|TRUE|false|False|FALSE|on|On|ON'
                 r'|off|Off|OFF)'),
        ('int', r'[-+]?(?:0x[0-9a-fA-F]+|0[0-7]*|[1-9][0-9]*)'),
        ('float', r'[-+]?(?:[0-9]+\.?[0-9]*|\.[0-9]+)(?:[eE][-+]?[0-9]+)?|[-+]?\.(?:inf|Inf|INF)'
                  r'|\.(?:nan|NaN|NAN)'),
        ('null', r'~|null|Null|NULL|'),
    ):
        Loader.add_implicit_resolver(
            f'tag:yaml.org,2002:{tag}', re.compile(f'^(?:{regex})$'), None
        )
    Loader.add_constructor(
        'tag:yaml.org,2002:bool', lambda _, node: node.value[:2].lower() in ('y', 'ye', 'tr', 'on')
    )
    return Loader
