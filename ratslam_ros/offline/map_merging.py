# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Implementation of ``ratslam map merge``: the merged map, its report and its plot."""

from __future__ import annotations

import json
from collections import Counter
from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

from ratslam_ros.core.merging.merge import MergedMap, merge_sessions
from ratslam_ros.core.merging.session import Session
from ratslam_ros.descriptors import encoder_of
from ratslam_ros.errors import UnusableInput
from ratslam_ros.files.config import stored_config, to_yaml
from ratslam_ros.files.text import write_durably
from ratslam_ros.maps import MapMeta, read_map
from ratslam_ros.maps.saving import locked, replace_map
from ratslam_ros.results.plots import draw_merged
from ratslam_ros.version import __version__


def merge_files(paths: Sequence[Path], out: Path, force: bool = False) -> str:
    """Merge maps into a new one, and write a report and a plot beside it.

    Args:
        paths: the maps.
        out: the merged map, FILE; the report is FILE.json, the plot FILE.png.
        force: whether an existing file is replaced.

    Returns:
        The report as text.

    Raises:
        UnusableInput: a map cannot be read or merged, or the file exists or cannot be written.
    """
    with locked(out, create_folder=True):  # It may be one of the maps.
        if out.exists() and not force:
            raise UnusableInput(f'{out} exists; give another name with -o, or add --force')
        names = Counter(path.name for path in paths)
        merged = merge_sessions([
            _session(path, path.name if names[path.name] == 1 else str(path), out)
            for path in paths
        ], encoder_of)
        meta = MapMeta(' + '.join(merged.names), __version__, to_yaml(merged.config))
        replace_map(out, merged.states, meta)
    report = out.with_name(f'{out.name}.json')
    content = report_of(merged)
    write_durably(report, json.dumps(content, indent=2) + '\n')
    plot = draw_merged(merged, out.with_name(f'{out.name}.png'))
    return '\n'.join([*report_lines(merged, content), f'{out}', f'{report}', f'{plot}'])


def _session(path: Path, name: str, out: Path) -> Session:
    """Read a map for merging, under a name that no other one has.

    Raises:
        UnusableInput: it cannot be read, or its configuration is unknown.
    """
    saved = read_map(path, owned=path.resolve() == out.resolve())  # it is locked then
    if not saved.meta.configuration:
        raise UnusableInput(
            f'{path} does not record its configuration, with which its views are encoded'
        )
    config, _ = stored_config(saved.meta.configuration, str(path))
    return Session(name, config, saved.states)


def report_of(merged: MergedMap) -> dict[str, Any]:
    """Return the report as JSON values."""
    core = merged.states['experience_map']['core']
    return {
        'schema_version': 1,
        'sessions': [
            {'name': name, 'templates': templates, 'experiences': experiences}
            for name, templates, experiences in zip(
                merged.names, merged.templates, merged.experiences, strict=True
            )
        ],
        'merged': {
            'templates': len(merged.states['local_view']['core']['templates']),
            'experiences': len(core['labels']), 'links': len(core['ends']),
            'components': merged.components,
        },
        'fused': {
            'templates': sum(merged.templates)
            - len(merged.states['local_view']['core']['templates']),
            'experiences': sum(merged.experiences) - len(core['labels']),
        },
        'joins': [asdict(join) for join in merged.joins],
    }


def report_lines(merged: MergedMap, report: dict[str, Any]) -> list[str]:
    """Return the report for a terminal."""
    lines = [f'{"session":32}{"templates":>11}{"experiences":>13}']
    for row in report['sessions']:
        lines.append(f'{row["name"]:32.32}{row["templates"]:11}{row["experiences"]:13}')
    total = report['merged']
    lines.append(f'{"merged":32}{total["templates"]:11}{total["experiences"]:13}')
    if len(merged.names) == 1:
        lines.append('all maps are equal: nothing had to be merged')
    for join in merged.joins:
        if join.refused:
            lines.append(f'{join.known} and {join.seen} are not joined: {join.refused}')
        else:
            lines.append(
                f'{join.known} and {join.seen} share {join.places} places, by {join.by} '
                f'({100.0 * join.share:.0f} % of {join.overlapping} overlapping ones recognised, '
                f'residual {join.residual_m:.2f} m)'
            )
    if total['components'] > 1:
        lines.append(
            f'{total["components"]} components remain: their relative poses are unknown until a '
            'robot is recognised in both'
        )
    return lines
