# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Additions to the published algorithm, whose modules are imported only if they are selected.

The module of a published algorithm works without them. An addition derives from a class of it and
overrides some of its methods. It takes the place of that class where an instance is created:
``AGREEMENT.instead_of(EqualWeights, parameters)(...)``. core/config/additions.py lists all.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from importlib import import_module
from typing import Any, TypeVar

Published = TypeVar('Published')


@dataclass(frozen=True)
class Addition:
    """A class beside the published algorithm.

    Attributes:
        module: its module, below ``ratslam_ros.core``.
        name: the class.
        section: the section of the parameters that select it.
        is_selected: whether parameters of this section select it.
    """

    module: str
    name: str
    section: str
    is_selected: Callable[[Any], bool]

    def load(self) -> Any:
        """Import the module, and return the class."""
        return getattr(import_module(f'ratslam_ros.core.{self.module}'), self.name)

    def instead_of(self, published: type[Published], parameters: Any) -> type[Published]:
        """Return the class that derives from a published one if it is selected, or the latter."""
        chosen: type[Published] = self.load() if self.is_selected(parameters) else published
        return chosen

    def of(self, parameters: Any, *arguments: Any) -> Any:
        """Return an instance if the parameters select the addition, otherwise None."""
        return self.load()(*arguments) if self.is_selected(parameters) else None
