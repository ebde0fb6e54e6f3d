# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Modules that the stand-in provides in place of those of ROS, created on import."""

from __future__ import annotations

import sys
from collections.abc import Sequence
from importlib import import_module
from importlib.abc import Loader, MetaPathFinder
from importlib.machinery import ModuleSpec
from types import ModuleType
from typing import Any

from rclpy_standin import definitions, types

_PACKAGE = 'rclpy_standin'

PROVIDED: dict[str, dict[str, Sequence[str]]] = {
    'rclpy': {
        'api': (
            'create_node', 'init', 'ok', 'shutdown', 'spin', 'spin_once',
            'spin_until_future_complete', 'try_shutdown',
        ),
        'context': ('Context', 'get_default_context', 'SignalHandlerOptions'),
        'node': ('Node',),
        'task': ('Future',),
    },
    'rclpy.clock': {'clock': ('Clock', 'ClockType', 'ROSClock')},
    'rclpy.context': {'context': ('Context',)},
    'rclpy.duration': {'clock': ('Duration',)},
    'rclpy.event_handler': {'events': ()},
    'rclpy.exceptions': {'exceptions': ()},
    'rclpy.executors': {'executors': ('ExternalShutdownException', 'SingleThreadedExecutor')},
    'rclpy.logging': {'logging': ('get_logger',)},
    'rclpy.node': {'node': ('Node',)},
    'rclpy.parameter': {'parameters': ('Parameter', 'parameter_value_to_python')},
    'rclpy.qos': {'qos': ()},
    'rclpy.serialization': {'api': ('deserialize_message', 'serialize_message')},
    'rclpy.signals': {'context': ('SignalHandlerOptions',)},
    'rclpy.time': {'clock': ('Time',)},
    'rclpy.utilities': {'api': ('remove_ros_args',)},
    'rosidl_runtime_py': {
        'introspection': ('message_to_yaml', 'set_message_fields'),
    },
    'rosidl_runtime_py.utilities': {'api': ('get_message', 'get_service')},
}
"""Provided modules: names by source module; an empty sequence stands for all public names."""


class NotProvided(NotImplementedError, ImportError):  # noqa: N818
    """A module of rclpy that the stand-in does not provide."""


class Finder(MetaPathFinder, Loader):
    """Finder of rclpy, rosidl_runtime_py and message packages, last in ``sys.meta_path``."""

    def find_spec(
        self, fullname: str, path: Any = None, target: ModuleType | None = None
    ) -> ModuleSpec | None:
        """Return the spec of a module; None if the stand-in is not responsible for it.

        Raises:
            NotProvided: the stand-in lacks this module of rclpy.
        """
        top, _, rest = fullname.partition('.')
        is_package = False
        if top in ('rclpy', 'rosidl_runtime_py'):
            if fullname not in PROVIDED:
                raise NotProvided(
                    f'{fullname} is not part of the stand-in for rclpy; install ROS 2 to use it'
                )
            is_package = not rest
        elif top in definitions.packages() and rest in ('', 'msg', 'srv'):
            is_package = not rest
        else:
            return None
        return ModuleSpec(fullname, self, is_package=is_package)

    def create_module(self, spec: ModuleSpec) -> ModuleType:
        """Create an empty module."""
        return _Module(spec.name, 'Provided by the stand-in for rclpy.')

    def exec_module(self, module: ModuleType) -> None:
        """Fill a module with its names; message classes are created on first access."""
        for part, names in PROVIDED.get(module.__name__, {}).items():
            source = import_module(f'{_PACKAGE}.{part}')
            public = names or [
                name
                for name, value in vars(source).items()
                if not name.startswith('_') and _is_own(value, source)
            ]
            for name in public:
                setattr(module, name, getattr(source, name))


class _Module(ModuleType):
    """A module that creates message classes on first access."""

    def __getattr__(self, name: str) -> Any:
        package, _, kind = self.__name__.partition('.')
        if f'{self.__name__}.{name}' in PROVIDED:
            return import_module(f'{self.__name__}.{name}')
        if not name.startswith('__') and package in definitions.packages():
            create = types.service_class if kind == 'srv' else types.message_class
            if kind and name in definitions.names_in(package, kind):
                created = create(f'{package}/{kind}/{name}')
                setattr(self, name, created)
                return created
        raise AttributeError(
            f'module {self.__name__!r} of the stand-in for rclpy has no attribute {name!r}'
        )

    def __dir__(self) -> list[str]:
        package, _, kind = self.__name__.partition('.')
        classes = definitions.names_in(package, kind) if kind in ('msg', 'srv') else []
        return sorted({*vars(self), *classes})


def _is_own(value: Any, source: ModuleType) -> bool:
    """Return whether a module defines a value itself, rather than importing it."""
    return not isinstance(value, ModuleType) and getattr(value, '__module__', source.__name__) in (
        source.__name__,
        None,
    )


def install_finder() -> None:
    """Make the modules importable; further calls do nothing."""
    if not any(isinstance(finder, Finder) for finder in sys.meta_path):
        sys.meta_path.append(Finder())
