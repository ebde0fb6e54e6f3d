# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Command lines as ROS understands them: --ros-args with names, parameters and logging."""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from functools import cache
from pathlib import Path
from typing import Any

from ratslam_ros.standalone import names
from ratslam_ros.standalone.exceptions import (
    NameValidationException,
    RCLInvalidROSArgsError,
    UnknownROSArgsError,
)
from ratslam_ros.standalone.logging import LoggingSeverity, get_logging_severity_from_string

START, END = '--ros-args', '--'
_SWITCHES = re.compile(r'--(enable|disable)-(rosout|stdout|external-lib)-logs')
_VALUED = {
    '-r': 'remap', '--remap': 'remap', '-p': 'parameter', '--param': 'parameter',
    '--params-file': 'file', '--log-level': 'level', '-e': 'ignored', '--enclave': 'ignored',
    '--log-config-file': 'ignored', '--log-file-name': 'ignored',
}  # fmt: skip


@dataclass(frozen=True)
class Remap:
    """A rule for names; ``node`` is empty where it is for all."""

    node: str
    kind: str
    """topic, service, '' for both, or __node and __ns."""
    before: str
    after: str


@dataclass
class Arguments:
    """What a command line asks of nodes."""

    remaps: list[Remap] = field(default_factory=list)
    parameters: list[tuple[str, dict[str, Any]]] = field(default_factory=list)
    """Values by name, and the pattern of the nodes that they are for; later ones count."""
    levels: list[tuple[str, LoggingSeverity]] = field(default_factory=list)
    to_stderr: bool = True
    to_rosout: bool = True


def remove_ros_args(args: Sequence[str]) -> list[str]:
    """Return a command line without what is between --ros-args and --."""
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
    """Return what a command line asks for.

    Raises:
        UnknownROSArgsError: arguments after --ros-args that are unknown.
        RCLInvalidROSArgsError: arguments that are malformed.
    """
    found = Arguments()
    words = iter(_ros_words(args))
    unknown = []
    for word in words:
        if word in _VALUED:
            value = next(words, None)
            if value is None:
                raise RCLInvalidROSArgsError(f'{word}: expected a value after it')
            _take(found, _VALUED[word], value, word)
        elif switch := _SWITCHES.fullmatch(word):
            on = switch[1] == 'enable'
            if switch[2] == 'stdout':
                found.to_stderr = on
            elif switch[2] == 'rosout':
                found.to_rosout = on
        else:
            unknown.append(word)
    if unknown:
        raise UnknownROSArgsError(f'Found unknown ROS arguments: {", ".join(unknown)}')
    return found


def _ros_words(args: Sequence[str]) -> Iterator[str]:
    inside = False
    for word in args:
        if word == START:
            inside = True
        elif inside and word == END:
            inside = False
        elif inside:
            yield word


def _take(found: Arguments, what: str, value: str, word: str) -> None:
    if what == 'file':
        found.parameters += parameter_file(value)
        return
    if what == 'level':
        logger, has_name, level = value.rpartition(':=')
        try:
            severity = get_logging_severity_from_string(level)
        except RuntimeError:
            raise RCLInvalidROSArgsError(
                f'{word} {value}: expected debug, info, warn, error or fatal'
            ) from None
        found.levels.append((logger if has_name else '', severity))
        return
    if what == 'ignored':
        return
    before, is_rule, after = value.partition(':=')
    node, _, before = before.rpartition(':') if '://' not in before else ('', '', before)
    if not is_rule or not before:
        raise RCLInvalidROSArgsError(f'{word} {value}: expected name:=value')
    if what == 'parameter':
        pattern = '/**' if not node else node if node.startswith('/') else f'/{node}'
        found.parameters.append((pattern, {before: parse_value(after)}))
        return
    kind = ''
    for scheme in ('topic', 'service'):
        if before.startswith(f'ros{scheme}://'):
            kind, before = scheme, before.partition('://')[2]
    if before in ('__node', '__name'):
        kind = '__node'
    elif before == '__ns':
        kind = '__ns'
    try:
        if kind == '__node':
            names.check_node_name(after)
        elif kind == '__ns':
            names.check_namespace(after)
    except NameValidationException as error:
        raise RCLInvalidROSArgsError(f'{word} {value}: {error}') from None
    found.remaps.append(Remap(node, kind, before, after))


# Names


class Names:
    """The names of one node, remapped."""

    def __init__(self, node: str, namespace: str, arguments: Sequence[Arguments]) -> None:
        """Apply what the command line says; of several ``arguments`` the first ones count."""
        names.check_node_name(node)
        namespace = names.full_namespace(namespace)
        self._rules = [rule for given in arguments for rule in given.remaps]
        self.given = node
        self.node = self._first('__node', node) or node
        self.namespace = self._first('__ns', node) or namespace
        self.full = names.join(self.namespace, self.node)

    def resolve(self, name: str, is_service: bool = False, only_expand: bool = False) -> str:
        """Return the full name of a topic or service, remapped unless told otherwise."""
        full = names.expand(name, self.node, self.namespace, is_service)
        for rule in self._rules if not only_expand else ():
            wanted = '' if not rule.kind else rule.kind
            if wanted not in ('', 'service' if is_service else 'topic'):
                continue
            if rule.node and rule.node not in (self.given, self.node):
                continue
            if names.expand(rule.before, self.node, self.namespace, is_service) == full:
                return names.expand(rule.after, self.node, self.namespace, is_service)
        return full

    def _first(self, kind: str, node: str) -> str | None:
        for rule in self._rules:
            if rule.kind == kind and rule.node in ('', node):
                return rule.after
        return None


# Parameters


def overrides(full_name: str, arguments: Sequence[Arguments]) -> dict[str, Any]:
    """Return the parameters for a node, given by its full name; later arguments count."""
    values: dict[str, Any] = {}
    for given in arguments:
        for pattern, found in given.parameters:
            if _matches(pattern, full_name):
                values |= found
    return values


def _matches(pattern: str, name: str) -> bool:
    parts = re.split(r'(/\*\*|/\*)', pattern)
    regex = ''.join({'/**': r'(/\w+)*', '/*': r'/\w+'}.get(p, re.escape(p)) for p in parts)
    return re.fullmatch(regex, name) is not None


def parameter_file(path: str | Path) -> list[tuple[str, dict[str, Any]]]:
    """Return the parameters in a YAML file, by the pattern of the nodes they are for.

    Raises:
        RCLInvalidROSArgsError: it cannot be read, or is no such file.
    """
    import yaml

    try:
        tree = yaml.load(Path(path).read_text(encoding='utf-8'), _loader())
    except (OSError, UnicodeError, yaml.YAMLError, ValueError) as error:
        told = ' '.join(str(error).split())
        raise RCLInvalidROSArgsError(f'--params-file {path}: {told}') from None
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
    """Return the value that YAML text stands for.

    Raises:
        RCLInvalidROSArgsError: no parameter can have such a value.
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
    """Return a YAML loader that types plain words as ROS does, which knows no dates or 1:30."""
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
    ):  # fmt: skip
        Loader.add_implicit_resolver(
            f'tag:yaml.org,2002:{tag}', re.compile(f'^(?:{regex})$'), None
        )
    Loader.add_constructor(
        'tag:yaml.org,2002:bool', lambda _, node: node.value[:2].lower() in ('y', 'ye', 'tr', 'on')
    )
    return Loader
