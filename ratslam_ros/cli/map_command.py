# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""``ratslam map``: inspect, check, export, merge, prune and compact map files."""

from __future__ import annotations

import argparse
import json
import sys
from functools import partial
from pathlib import Path

from ratslam_ros.cli.options import Commands, positive, positive_number
from ratslam_ros.console import print_notices
from ratslam_ros.errors import DONE, UnusableInput
from ratslam_ros.own_stages import add_stage, own_stages

DAMAGED = 1
"""Exit code of ``map check`` if it finds a problem."""

FORMATS = ('json', 'graphml', 'tum', 'g2o', 'geojson', 'png', 'pgm')


def add_map(commands: Commands) -> None:
    """Add ``ratslam map`` with its own commands."""
    parser = commands.add_parser(
        'map', help='inspect, check, export, merge and maintain map files'
    )
    actions = parser.add_subparsers(title='commands', metavar='COMMAND', required=True)
    info = actions.add_parser('info', help='print what a map contains')
    _add_file(info)
    info.add_argument('--json', action='store_true', help='print JSON')
    info.add_argument('--parameters', action='store_true',
                      help='print the configuration as YAML instead, for --config')
    info.set_defaults(run=_info)
    check = actions.add_parser('check', help='check a map; the exit code is 1 if it is damaged')
    _add_file(check)
    add_stage(check)
    check.set_defaults(run=_check)
    export = actions.add_parser('export', help='write a map in the format of another program')
    export.add_argument('file', type=Path, metavar='MAP',
                        help='a map file, a results folder, or map.json')
    export.add_argument('--format', choices=FORMATS,
                        help='json, graphml, tum, g2o, geojson for the Nav2 route server, png, or '
                             'pgm with YAML for the map server (default: by the name of the file)')
    export.add_argument('-o', '--out', type=Path, metavar='FILE',
                        help='file (default: print text, as with -)')
    export.add_argument('--spacing', type=positive, default=0.0, metavar='M',
                        help='with geojson: least distance between two nodes (default: keep all)')
    export.set_defaults(run=_export)
    merge = actions.add_parser(
        'merge', help='merge maps of several sessions or robots that share places'
    )
    merge.add_argument('maps', nargs='+', type=Path, metavar='MAP', help='map files')
    merge.add_argument(
        '-o', '--out', type=Path, required=True, metavar='FILE',
        help='the merged map; report and plot are written beside it (FILE.json, FILE.png)',
    )
    merge.add_argument('--force', action='store_true', help='replace an existing FILE')
    merge.set_defaults(run=_merge)
    prune = actions.add_parser(
        'prune', help='reduce a map to a number of places; the map before stays as FILE.bak'
    )
    _add_file(prune)
    prune.add_argument('--max-experiences', type=positive_number, required=True, metavar='N',
                       help='number of places that stay')
    prune.set_defaults(run=_prune)
    drop_log = actions.add_parser(
        'drop-log', help='remove the logs that live nodes have kept beside a map (keep_log)'
    )
    _add_file(drop_log)
    drop_log.set_defaults(run=partial(_maintain, 'drop_log'))
    compact = actions.add_parser(
        'compact', help='rewrite a map without unused space; the map before stays as FILE.bak'
    )
    _add_file(compact)
    compact.set_defaults(run=partial(_maintain, 'compact'))


def _add_file(parser: argparse.ArgumentParser) -> None:
    parser.add_argument('file', type=Path, metavar='FILE', help='the map')


def _info(options: argparse.Namespace) -> int:
    from ratslam_ros.maps import read_map
    from ratslam_ros.offline.map_upkeep import info_text, map_info

    if options.parameters:
        print(read_map(options.file).meta.configuration, end='')
        return DONE
    info = map_info(options.file)
    print(json.dumps(info, indent=2) if options.json else info_text(info))
    return DONE


def _check(options: argparse.Namespace) -> int:
    from ratslam_ros.offline.map_upkeep import problems

    found, notices = problems(options.file, own_stages(options.own_stages))
    print_notices(notices)
    for line in found:
        print(line)
    if found:
        return DAMAGED
    print(f'{options.file}: no problem found')
    return DONE


def _export(options: argparse.Namespace) -> int:
    from ratslam_ros.files.text import check_output, write_durably
    from ratslam_ros.offline import map_export

    out = None if options.out == Path('-') else options.out
    form = options.format
    if form is None:
        form = '' if out is None else out.suffix.removeprefix('.').lower()
        if form not in FORMATS:
            raise UnusableInput(f'give the format: --format {"|".join(FORMATS)}')
    if options.spacing and form != 'geojson':
        raise UnusableInput('--spacing thins the graph for the route server: use it with geojson')
    source = map_export.read_source(options.file)
    if out is not None:
        check_output(out, *source.files)
    if form not in map_export.TEXT_FORMATS:
        if out is None:
            raise UnusableInput(f'{form} is not text that can be printed: give --out FILE.{form}')
        write = map_export.write_grid if form == 'pgm' else map_export.write_picture
        for file in write(source, out):
            print(file)
        return DONE
    text, more = map_export.exported(source.graph, source.stamp_ns, form, options.spacing)
    print_notices((*(source.notices if form not in ('json', 'tum') else ()), *more))
    if out is None:
        sys.stdout.write(text)
    else:
        write_durably(out, text)
        print(out)
    return DONE


def _merge(options: argparse.Namespace) -> int:
    from ratslam_ros.offline.map_merging import merge_files

    print(merge_files(options.maps, options.out, options.force))
    return DONE


def _prune(options: argparse.Namespace) -> int:
    from ratslam_ros.offline.map_pruning import prune

    print(prune(options.file, options.max_experiences))
    return DONE


def _maintain(task: str, options: argparse.Namespace) -> int:
    from ratslam_ros.offline import map_upkeep

    print(getattr(map_upkeep, task)(options.file))
    return DONE
