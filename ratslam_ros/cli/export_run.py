# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""``ratslam view --export``: a run as a single HTML file."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import TYPE_CHECKING

from ratslam_ros.cli.options import positive
from ratslam_ros.console import print_notices
from ratslam_ros.errors import DONE, UnusableInput

if TYPE_CHECKING:
    from ratslam_ros.viewer.run_source import RunSource

def add_export_options(parser: argparse.ArgumentParser) -> None:
    """Add the options of the export."""
    parser.add_argument('--export', type=Path, metavar='FILE.html',
                        help='instead of showing the run, write a page that plays it; the page '
                             'needs neither Python nor a network')
    parser.add_argument('--export-duration', type=positive, default=30.0, metavar='S',
                        help='time that the exported page plays, in s (default: 30)')
    parser.add_argument('--export-dark', action='store_true', help='export with the dark theme')


def check_export(path: Path) -> None:
    """Raise if no file can be written there, so that it is reported before a replay.

    Raises:
        UnusableInput: the name is none of a page, or the folder does not exist.
    """
    if path.suffix.lower() not in ('.html', '.htm'):
        raise UnusableInput(f'--export {path}: expected the name of a page, FILE.html')
    if path.is_dir() or not path.absolute().parent.is_dir():
        raise UnusableInput(f'--export {path}: expected a file in a folder that exists')


def export_run(run: RunSource, options: argparse.Namespace) -> int:
    """Write the page and print what has been written; return the exit code.

    Raises:
        UnusableInput: the file cannot be written, or there is nothing to show.
    """
    from ratslam_ros.viewer.export import export_html

    if not run.end_ns:
        raise UnusableInput(f'{options.recording} has no moment that can be shown: export nothing')
    try:
        done = export_html(
            run, options.export, duration_s=options.export_duration, dark=options.export_dark
        )
    except OSError as error:
        raise UnusableInput(
            f'--export {options.export}: {error.strerror}; choose another file'
        ) from error
    print_notices(run.notices)
    moments = 'one moment' if done.frames == 1 else f'{done.frames} moments'
    print(f'{options.export}: {moments}, {done.size / 1e6:.1f} MB')
    return DONE
