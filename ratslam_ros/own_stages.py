# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Stages of the user by name, for commands."""

from __future__ import annotations

import argparse
import runpy
import sys
from collections.abc import Iterable
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING

from ratslam_ros.errors import UnusableInput

if TYPE_CHECKING:
    from ratslam_ros.pipeline.stage import Stage


def add_stage(parser: argparse.ArgumentParser) -> None:
    """Add the option that names stages of the user."""
    parser.add_argument('--stage', action='append', default=[], dest='own_stages',
                        metavar='FILE.py:CLASS',
                        help='a stage of your own, in place of the one with its name or beside '
                             'all; also MODULE:CLASS; may be repeated')


def own_stages(names: Iterable[str]) -> list[type[Stage]]:
    """Return the classes with names of the form FILE.py:CLASS or MODULE:CLASS.

    A file may import modules of its folder, as a script.

    Raises:
        UnusableInput: there is no such class, or it is no stage.
    """
    found = []
    for name in names:
        source, _, kind = name.rpartition(':')
        if source.endswith('.py') and not Path(source).is_file():
            raise UnusableInput(f'--stage {source}: No such file; check its path')
        try:
            if source.endswith('.py'):
                sys.path.insert(0, str(Path(source).resolve().parent))
                known = runpy.run_path(source)
            else:
                known = vars(import_module(source))
        except Exception as error:  # The file can contain anything.
            raise UnusableInput(
                f'--stage {name} cannot be imported ({type(error).__name__}: {error}); expected '
                'FILE.py:CLASS or MODULE:CLASS'
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
