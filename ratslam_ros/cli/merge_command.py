# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""``ratslam map merge``: one map of the maps of several sessions or robots."""

from __future__ import annotations

import argparse
from pathlib import Path

from ratslam_ros.cli.options import DONE, Commands


def add_merge(commands: Commands) -> None:
    """Add ``ratslam map merge``."""
    merge = commands.add_parser(
        'merge', help='merge maps of several sessions or robots that share places'
    )
    merge.add_argument('maps', nargs='+', type=Path, metavar='MAP', help='map files')
    merge.add_argument(
        '-o', '--out', type=Path, required=True, metavar='FILE',
        help='the merged map; report and plot are written beside it (FILE.json, FILE.png)',
    )  # fmt: skip
    merge.add_argument('--force', action='store_true', help='replace an existing FILE')
    merge.set_defaults(run=_merge)


def _merge(options: argparse.Namespace) -> int:
    from ratslam_ros.offline.map_merging import merge_files

    print(merge_files(options.maps, options.out, options.force))
    return DONE
