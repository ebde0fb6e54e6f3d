# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""``ratslam warm-up``: compile all inner loops before they are needed."""

from __future__ import annotations

import argparse

from ratslam_ros.cli.options import Commands
from ratslam_ros.errors import DONE


def add_warm_up(commands: Commands) -> None:
    """Add ``ratslam warm-up``."""
    from ratslam_ros.offline.compile_all import GROUPS

    command = commands.add_parser(
        'warm-up', help='compile the inner loops once, so that later starts are quick')
    command.add_argument('groups', nargs='*', metavar='GROUP',
                         help=f'{", ".join(GROUPS)} (default: all)')
    command.set_defaults(run=_warm_up)


def _warm_up(options: argparse.Namespace) -> int:
    from ratslam_ros.offline.compile_all import compile_all

    print(compile_all(options.groups, print))
    return DONE
