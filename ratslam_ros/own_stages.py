# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Stages of the user by name, for commands."""

from __future__ import annotations

import runpy
from collections.abc import Iterable
from importlib import import_module

from ratslam_ros.errors import UnusableInput
from ratslam_ros.pipeline.stage import Stage


def own_stages(names: Iterable[str]) -> list[type[Stage]]:
    """Return the classes with names of the form FILE.py:CLASS or MODULE:CLASS.

    Raises:
        UnusableInput: there is no such class, or it is no stage.
    """
    found = []
    for name in names:
        source, _, kind = name.rpartition(':')
        try:
            known = (
                runpy.run_path(source) if source.endswith('.py') else vars(import_module(source))
            )
        except (OSError, ImportError, ValueError) as error:
            raise UnusableInput(
                f'--stage {name}: {error}; expected FILE.py:CLASS or MODULE:CLASS'
            ) from None
        stage = known.get(kind)
        if not isinstance(stage, type):
            raise UnusableInput(f'{source} has no class {kind!r}; expected a stage (--stage)')
        for needed in ('NAME', 'WRITES', 'readers', 'state', 'restore'):
            if not hasattr(stage, needed):
                raise UnusableInput(
                    f'{kind} has no {needed}; expected a class with the attributes of Stage in '
                    'ratslam_ros/pipeline/stage.py'
                )
        found.append(stage)
    return found
