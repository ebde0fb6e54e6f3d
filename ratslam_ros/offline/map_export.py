# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Export of the experience map to formats of other programs (docs/maps.md, "Export")."""

from __future__ import annotations

import json
import math
import tempfile
from dataclasses import dataclass, replace
from pathlib import Path
from xml.sax.saxutils import escape

import numpy as np
from numpy.typing import NDArray

from ratslam_ros.core.mapping.experience_map import ExperienceMap
from ratslam_ros.core.mapping.link_learning import TIMED_OUT
from ratslam_ros.core.mapping.link_weights import link_weights
from ratslam_ros.core.mapping.occupancy_grid import OccupancyGrid
from ratslam_ros.core.mapping.scan_matching import ScanMatcher
from ratslam_ros.core.navigation.server_graph import MAX_IDS, server_graph
from ratslam_ros.errors import UnusableInput
from ratslam_ros.files.text import write_durably
from ratslam_ros.maps import read_map
from ratslam_ros.messages.mapping import encode_map
from ratslam_ros.messages.route_graph import encode_route_graph
from ratslam_ros.offline.map_upkeep import config_of_map, experience_map_of
from ratslam_ros.results.map_json import read_map_json
from ratslam_ros.results.plots import draw_map
from ratslam_ros.results.trajectory import tum_line

TEXT_FORMATS = ('json', 'graphml', 'tum', 'g2o', 'geojson')

WITHOUT_RECOGNITIONS = (
    'this map.json of an earlier version does not contain which links are recognitions and where '
    'a robot was blocked, so all links count as driven ones; replay the recording again'
)

OCCUPIED, FREE = 0.65, 0.25
"""Probabilities above and below which the map server takes a cell to be occupied and free."""


@dataclass(frozen=True)
class MapSource:
    """A map that was read.

    files: what it was read from. graph: the experience map. stamp_ns: stamp of its last view.
    scans: scans of its experiences, None if there are none. results: the results folder, None if
    the map is of none. notices: lines for the user.
    """

    files: tuple[Path, ...]
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
        path = results / 'map.json'
        content = json.loads(path.read_text(encoding='utf-8'))
    except (OSError, ValueError, KeyError, TypeError, UnusableInput):
        return None  # without --map, moved, or damaged
    if json.loads(encode_map(source.stamp_ns, source.graph)) != content:
        return None
    return replace(source, files=(*source.files, path), results=results)


def _of_saved(path: Path) -> MapSource:
    saved = read_map(path)
    config, notices = config_of_map(saved)
    graph, stamp_ns = experience_map_of(saved, config)
    scans = None
    if 'scans' in saved.states['experience_map']:
        scans = ScanMatcher()
        scans.restore(saved.states['experience_map']['scans'])
    return MapSource((path,), graph, stamp_ns, scans, notices=tuple(notices))


def _of_json(path: Path, results: Path | None) -> MapSource:
    content, graph = read_map_json(path)
    notices = (WITHOUT_RECOGNITIONS,) if content.view_spacing_m is None else ()
    return MapSource((path,), graph, content.stamp.ns, results=results, notices=notices)


def exported(
    experience_map: ExperienceMap, stamp_ns: int, form: str, spacing_m: float = 0.0
) -> tuple[str, list[str]]:
    """Return the text of a map in another format, and notices for the user.

    Args:
        experience_map: the map.
        stamp_ns: stamp of its last view.
        form: one of ``TEXT_FORMATS``.
        spacing_m: least distance of the nodes for geojson; 0 keeps all.

    Raises:
        UnusableInput: the map has no place, or does not fit the format.
    """
    if not len(experience_map):
        raise UnusableInput('the map has no place yet: nothing to export')
    if form == 'geojson':
        return _route_graph(experience_map, spacing_m)
    if form == 'json':
        return encode_map(stamp_ns, experience_map), []
    return {'graphml': _graphml, 'tum': _tum, 'g2o': _g2o}[form](experience_map), []


def write_picture(source: MapSource, path: Path) -> tuple[Path, ...]:
    """Write a PNG of a map: the plot map.png of a run, without dead reckoning if there is none.

    Returns:
        The file.

    Raises:
        UnusableInput: the file cannot be written.
    """
    if source.results is not None:
        return (draw_map(source.results, path=path),)
    with tempfile.TemporaryDirectory() as folder:
        text = encode_map(source.stamp_ns, source.graph)
        (Path(folder) / 'map.json').write_text(text, encoding='utf-8')
        return (draw_map(folder, path=path),)


def write_grid(source: MapSource, path: Path) -> tuple[Path, ...]:
    """Write the scans as an occupancy grid for the map server of Nav2: a PGM file and its YAML.

    Returns:
        Both files.

    Raises:
        UnusableInput: the map has no scans, or a file cannot be written.
    """
    description = path.with_suffix('.yaml')
    if description == path:
        raise UnusableInput(f'{path} is the YAML file: expected a name that ends in .pgm')
    grid = OccupancyGrid()
    if source.scans is not None:
        while grid.update(source.graph, source.scans, len(source.graph)):
            pass
    if grid.is_empty:
        raise UnusableInput(
            'the map has no scans, of which a grid is drawn: map with scans, ratslam replay '
            'RECORDING --map FILE --set experience_map.exp_align_scans=true, and export FILE'
        )
    *_, picture = grid.picture()
    percent = picture.percent[::-1]  # the first row of an image is the highest one
    grey = np.select([percent < 0, percent >= 100 * OCCUPIED, percent <= 100 * FREE],
                     [205, 0, 254], 205).astype(np.uint8)
    rows, columns = grey.shape
    write_durably(path, b'P5\n%d %d\n255\n' % (columns, rows) + grey.tobytes())
    text = (
        f'image: {path.name}\nmode: trinary\nresolution: {picture.cell_m!r}\n'
        f'origin: [{picture.x_m!r}, {picture.y_m!r}, 0.0]\nnegate: 0\n'
        f'occupied_thresh: {OCCUPIED}\nfree_thresh: {FREE}\n'
    )
    write_durably(description, text)
    return path, description


def _route_graph(experience_map: ExperienceMap, spacing_m: float) -> tuple[str, list[str]]:
    """Return the graph for the Nav2 route server as GeoJSON, and notices for the user.

    Of a map with several components, whose relative poses are unknown, only the largest one is
    used.

    Args:
        experience_map: the map.
        spacing_m: least distance between two nodes along the links. 0 keeps all places.

    Raises:
        UnusableInput: the graph has no edge, or more nodes and edges than the server has ids.
    """
    links = experience_map.link_table
    graph = server_graph(
        experience_map.poses, experience_map.components, links.ends, links.shapes[:, 0],
        links.durations_s, links.failures[:, TIMED_OUT], spacing_m,
    )
    if not graph.edges:
        raise UnusableInput(
            f'the graph has {len(graph.nodes)} nodes and no edge, and the route server refuses a '
            'graph without edges: '
            f'{"choose a smaller --spacing" if spacing_m > 0.0 else "map more"}'
        )
    count = graph.feature_count
    if count > MAX_IDS:
        share = 2.0 * count / MAX_IDS
        mean_m = sum(edge.length_m for edge in graph.edges.values()) / len(graph.edges)
        raise UnusableInput(
            f'{len(graph.nodes)} nodes and {len(graph.edges)} edges need {count} ids; the route '
            f'server has {MAX_IDS}: thin the graph with --spacing, for example '
            f'{max(share * max(mean_m, spacing_m), 0.1):.1f}'
        )
    notices = []
    if graph.left_out:
        parts = 'another part' if graph.others == 1 else f'{graph.others} other parts'
        notices.append(
            f'{graph.left_out} places are left out: they are in {parts} of the map, whose '
            'position relative to the exported one is unknown'
        )
    return encode_route_graph(graph, experience_map.frame_id), notices


def _graphml(experience_map: ExperienceMap) -> str:
    """Return a directed graph with the poses of the places, and lengths and times of the links."""
    components = experience_map.components
    nodes = [
        (f'<node id="{one.id}">', {
            'x_m': one.pose.x_m, 'y_m': one.pose.y_m, 'heading_rad': one.pose.heading_rad,
            'template_id': one.template_id, 'component': components[one.id],
        }) for one in experience_map.experiences()
    ]
    edges = [
        (f'<edge source="{link.source_id}" target="{link.target_id}">', {
            'distance_m': link.distance_m, 'heading_rad': link.heading_rad,
            'facing_rad': link.facing_rad, 'duration_s': link.duration_s,
            'behaviour': link.behaviour, 'count': link.count, 'recognised': link.recognised,
        }) for link in experience_map.links()
    ]
    kinds = {float: 'double', int: 'long', bool: 'boolean', str: 'string'}
    keys: list[str] = ['<key id="frame_id" for="graph" attr.name="frame_id" attr.type="string"/>']
    items: list[str] = []
    for of, elements in (('node', nodes), ('edge', edges)):
        for name, value in elements[0][1].items() if elements else ():
            keys.append(f'<key id="{of}_{name}" for="{of}" attr.name="{name}" '
                        f'attr.type="{kinds[type(value)]}"/>')
        for opening, values in elements:
            data = ''.join(
                f'<data key="{of}_{name}">{escape(_xml(value))}</data>'
                for name, value in values.items()
            )
            items.append(f'{opening}{data}</{of}>')
    lines = [
        '<?xml version="1.0" encoding="utf-8"?>',
        '<graphml xmlns="http://graphml.graphdrawing.org/xmlns">', *keys,
        '<graph edgedefault="directed">',
        f'<data key="frame_id">{escape(experience_map.frame_id)}</data>',
        *items, '</graph>', '</graphml>',
    ]
    return '\n'.join(lines) + '\n'


def _xml(value: object) -> str:
    return str(value).lower() if isinstance(value, bool) else str(value)


def _tum(experience_map: ExperienceMap) -> str:
    """Return the poses of the places as a TUM trajectory, with the id as time in seconds."""
    lines = ['# id x y z qx qy qz qw: places of a map; the first column is the id of the place\n']
    lines += [
        tum_line(one.id * 1_000_000_000, one.pose) for one in experience_map.experiences()
    ]
    return ''.join(lines)


def _g2o(experience_map: ExperienceMap) -> str:
    """Return the pose graph with the information matrices of its links.

    The first place of every component is fixed, because the links do not determine its pose.
    """
    lines = [
        f'VERTEX_SE2 {number} {" ".join(map(repr, pose))}'
        for number, pose in enumerate(experience_map.poses.tolist())
    ]
    first: dict[int, int] = {}
    for number, component in enumerate(experience_map.components):
        first.setdefault(component, number)
    lines += [f'FIX {number}' for number in first.values()]
    for link, (position, heading) in zip(
        experience_map.links(), information(experience_map).tolist(), strict=True
    ):
        pose = ' '.join(map(repr, link.relative_pose))
        lines.append(
            f'EDGE_SE2 {link.source_id} {link.target_id} {pose} '
            f'{position!r} 0.0 0.0 {position!r} 0.0 {heading!r}'
        )
    return '\n'.join(lines) + '\n'


def information(experience_map: ExperienceMap) -> NDArray[np.float64]:
    """Return the inverse variances of all links: position in 1/m^2 and heading in 1/rad^2.

    The variances are those of core/mapping/link_weights.py. They are in view spacings, which are
    taken from the map, or else from the median length of its links.

    Returns:
        (links, 2).
    """
    links = experience_map.link_table
    spacing_m = experience_map.view_spacing_m
    if spacing_m <= 0.0:
        lengths_m = links.shapes[:, 0]
        driven_m = lengths_m[lengths_m > 0.0]
        spacing_m = float(np.median(driven_m)) if len(driven_m) else 1.0
    result = link_weights(
        links.shapes, links.recognised, links.shares, spacing_m,
        experience_map.optimiser.noise.std, experience_map.optimiser.noise.std_rad,
    )
    assert math.isfinite(float(result.sum()))
    return result
