# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Declaration and checking of node parameters, from the dataclasses of core/config."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from itertools import pairwise
from typing import Any, TypeVar

from rcl_interfaces.msg import (
    FloatingPointRange,
    IntegerRange,
    ParameterDescriptor,
    SetParametersResult,
)
from rclpy.node import Node
from rclpy.parameter import Parameter

from ratslam_ros.core.config import (
    DECLARATIONS,
    SHARED,
    Config,
    ParameterInfo,
    Section,
    Value,
    removal,
    section_of,
)
from ratslam_ros.errors import UnusableParameter
from ratslam_ros.files.config import BASE, ORIGINAL, UNNAMED, is_empty, preset_config
from ratslam_ros.limits import is_below

AnySection = TypeVar('AnySection', bound=Section)

ROS_PREFIXES = ('use_sim_time', 'start_type_description_service', 'qos_overrides')
"""Prefixes of the parameters that ROS declares on every node."""


def initial_config(arguments: Sequence[str]) -> Config:
    """Return the values of parameters that are not given, if no base is named.

    Args:
        arguments: command line of the node.

    Raises:
        UnusableInput: the presets are not installed.
    """
    files = [path for flag, path in pairwise(arguments) if flag == '--params-file']
    return Config() if all(map(is_empty, files)) else preset_config(ORIGINAL)


class NodeParameters:
    """The parameters of a node: the shared ones, and those of its section and of its parts.

    The node must be created with ``automatically_declare_parameters_from_overrides``, or given
    parameters that are unknown could not be detected.
    """

    def __init__(
        self, node: Node, initial: Config, sections: Sequence[str], parts: Sequence[str],
        before_set: Callable[[], object], changed: Callable[[], None],
    ) -> None:
        """Read all parameters that the node was given.

        Args:
            node: the node; its name may be remapped.
            initial: values of parameters that are not given, if no base is named.
            sections: sections whose parameters are declared by their plain names: the shared
                ones, and last that of the node.
            parts: sections whose parameters are declared as ``part.name``.
            before_set: called before parameters are set while the node runs.
            changed: called when parameters were set.

        Raises:
            UnusableParameter: a given parameter is unknown, of the wrong type or out of range.
        """
        self._node = node
        self._section = sections[-1]
        self._keys = {
            name if section in sections else key: key
            for key in DECLARATIONS for section, _, name in [key.partition('.')]
            if section in (*sections, *parts)
        }
        self.config = self.first = self._given(initial)
        """All parameters: the present ones, and those with which the node was started."""
        self._before_set, self._changed = before_set, changed

    def share(self, values: Mapping[str, Value]) -> None:
        """Take shared values that other nodes of the process were given."""
        self.config = self.first = self.config.with_values(values)

    def declare(self) -> None:
        """Declare all parameters, when the values do not change before the start any more."""
        values = self.config.flat()
        for name, key in self._keys.items():
            _declare(self._node, name, values[key], *DECLARATIONS[key])
        self._node.add_on_set_parameters_callback(self._set)

    def _given(self, initial: Config) -> Config:
        """Apply the command line and parameter files to the base."""
        values: dict[str, Value] = {}
        others: dict[str, Value] = {}
        node, base = self._node, None
        for name, value in _taken(node).items():
            if name in self._keys:
                values[self._keys[name]] = value
                continue
            key = name if '.' in name else f'{self._section}.{name}'
            advice, of = removal(key), section_of(name.rpartition('.')[2])
            if name == BASE:
                base = value
            elif advice is not None:
                node.get_logger().info(f'{name}: {advice}')
            elif of in (None, self._section):  # an alias, or unknown
                others[key] = value
            elif of not in SHARED:
                # One file may hold the parameters of all nodes below /**; each node takes its own.
                node.get_logger().info(f'{name} is a parameter of {of}; not used here')
        own = {key for key in self._keys.values() if key.partition('.')[0] not in SHARED}
        self.shared = {key: value for key, value in values.items() if key not in own}
        """Values that the node was given for shared parameters, by ``section.name``."""
        if base is not None:
            initial = preset_config(base)
        elif initial != Config() and not own <= values.keys():
            node.get_logger().info(UNNAMED)
        return initial.with_values(others | values)  # parameters take priority over their aliases

    def named(self, values: Mapping[str, Value]) -> list[Parameter]:
        """Return values given by ``section.name`` as parameters of the node; skip unknown ones."""
        names = {key: name for name, key in self._keys.items()}
        return [Parameter(names[key], value=values[key]) for key in values if key in names]

    def _set(self, parameters: list[Parameter]) -> SetParametersResult:
        """Check and set parameters that may change while the node runs."""
        self._before_set()
        values: dict[str, Any] = {
            self._keys[p.name]: p.value for p in parameters if p.name in self._keys
        }
        folder, given = values.get('memory.memory_folder'), self.first.memory.memory_folder
        if folder is not None and not is_below(str(folder), given):
            # Everyone who reaches the node could have it write and read elsewhere.
            return SetParametersResult(successful=False, reason=(
                f'memory_folder is {folder!r:.100}; expected a folder below {given}, with '
                'which the node was started'
            ))
        try:
            config = self.config.with_values(values)
            self.first.check_change(config)
        except UnusableParameter as error:
            return SetParametersResult(successful=False, reason=str(error))
        self.config = config
        self._changed()
        return SetParametersResult(successful=True)


def declare(node: Node, kind: type[AnySection]) -> AnySection:
    """Declare a section outside of the configuration; return it with the given values.

    The node must be created with ``automatically_declare_parameters_from_overrides``.

    Raises:
        UnusableParameter: a given parameter is unknown, of the wrong type or out of range.
    """
    known = {name: (info, default) for name, info, default in kind.parameters()}
    given: dict[str, Any] = {}
    for name, value in _taken(node).items():
        if name in known:
            given[name] = value
        elif name != BASE and section_of(name.rpartition('.')[2]) is None:
            raise UnusableParameter(
                f'{node.get_name()} has no parameter {name!r}; expected one of {", ".join(known)}'
            )
    section = kind(**given)
    for name, (info, default) in known.items():
        _declare(node, name, getattr(section, name), info, default)
    return section


def _taken(node: Node) -> dict[str, Any]:
    """Return the parameters that a node was given, which are not declared any more."""
    given = {
        name: item.value for name, item in sorted(node.get_parameters_by_prefix('').items())
        if not name.startswith(ROS_PREFIXES)
    }
    for name in given:
        node.undeclare_parameter(name)
    return given


def _declare(node: Node, name: str, value: Value, info: ParameterInfo, default: Value) -> None:
    descriptor = ParameterDescriptor(
        description=info.effect + (f' Unit: {info.unit}.' if info.unit else ''),
        read_only=info.runtime == 'no',
    )
    if info.choices:
        descriptor.additional_constraints = f'one of {", ".join(info.choices)}'
    elif isinstance(default, float):
        descriptor.floating_point_range = [
            FloatingPointRange(from_value=float(info.lowest), to_value=float(info.high), step=0.0)
        ]
    elif isinstance(default, int) and not isinstance(default, bool):
        descriptor.integer_range = [
            IntegerRange(from_value=int(info.lowest), to_value=int(info.high), step=1)
        ]
    node.declare_parameter(name, value, descriptor, ignore_override=True)
