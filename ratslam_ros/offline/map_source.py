# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Maps to export: of a map file, a results folder, or map.json."""

from __future__ import annotations

import json
from dataclasses import dataclass, replace
from pathlib import Path

from ratslam_ros.core.mapping.experience_map import ExperienceMap
from ratslam_ros.core.mapping.scan_matching import ScanMatcher
from ratslam_ros.errors import UnusableInput
from ratslam_ros.maps import read_map
from ratslam_ros.messages.mapping import encode_map
from ratslam_ros.offline.map_upkeep import config_of_map, experience_map_of
from ratslam_ros.results.map_json import read_map_json

WITHOUT_RECOGNITIONS = (
    'this map.json of an earlier version does not contain which links are recognitions and where '
    'a robot was blocked, so all links count as driven ones; replay the recording again'
)


@dataclass(frozen=True)
class MapSource:
    """A map that was read.

    graph: the experience map. stamp_ns: stamp of its last view. scans: scans of its experiences,
    None if there are none. results: the results folder, None
    if the map is of none. notices: lines for the user.
    """

    graph: ExperienceMap
    stamp_ns: int
    scans: ScanMatcher | None = None
    results: Path | None = None
    notices: tuple[str, ...] = ()


def read_source(path: Path) -> MapSource:
    """Read a map.

    Args:
        path: a map file, a results folder, or map.json. Of the results of a replay with --map,
            the map file is read, which contains more.

    Raises:
        UnusableInput: there is no map, or it cannot be read.
    """
    if (path / 'map.json').is_file():
        return _of_map_file(path) or _of_json(path / 'map.json', path)
    if path.suffix == '.json' and path.is_file():
        return _of_json(path, None)
    return _of_saved(path)


def _of_map_file(results: Path) -> MapSource | None:
    """Read the map file that a replay with --map saved, if it still contains the same map."""
    try:
        summary = json.loads((results / 'summary.json').read_text(encoding='utf-8'))
        source = _of_saved(Path(summary['map']['file']))
        content = json.loads((results / 'map.json').read_text(encoding='utf-8'))
    except (OSError, ValueError, KeyError, TypeError, UnusableInput):
        return None  # without --map, moved, or damaged
    if json.loads(encode_map(source.stamp_ns, source.graph)) != content:
        return None
    return replace(source, results=results)


def _of_saved(path: Path) -> MapSource:
    saved = read_map(path)
    config, notices = config_of_map(saved)
    graph, stamp_ns = experience_map_of(saved, config)
    scans = None
    if 'scans' in saved.states['experience_map']:
        scans = ScanMatcher()
        scans.restore(saved.states['experience_map']['scans'])
    return MapSource(graph, stamp_ns, scans, notices=tuple(notices))


def _of_json(path: Path, results: Path | None) -> MapSource:
    content, graph = read_map_json(path)
    notices = (WITHOUT_RECOGNITIONS,) if content.view_spacing_m is None else ()
    return MapSource(graph, content.stamp.ns, results=results, notices=notices)
