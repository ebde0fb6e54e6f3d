# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Exports of maps, read back without the code that wrote them."""

from __future__ import annotations

import json
import math
import os
from collections import Counter
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import numpy as np
import pytest
from graphs import arrive, drive, go, new_map

from ratslam_ros.core.common.odometry import Motion
from ratslam_ros.core.common.pose import Pose, composed, inverse
from ratslam_ros.core.mapping.experience_map import ExperienceMap
from ratslam_ros.core.mapping.map_changes import MapChangeTracker, MapMirror
from ratslam_ros.core.navigation.graph_refresh import GraphNumbering
from ratslam_ros.core.pose_cells.map_action import MapAction
from ratslam_ros.core.pose_cells.torus import Place
from ratslam_ros.errors import UnusableInput
from ratslam_ros.files.text import write_durably
from ratslam_ros.messages.mapping import encode_map
from ratslam_ros.messages.route_graph import encode_route_graph
from ratslam_ros.offline import map_export
from ratslam_ros.offline.map_export import TEXT_FORMATS, exported, information, read_source
from ratslam_ros.results.trajectory import read_tum


def loop_with_tail() -> ExperienceMap:
    """Return a square loop of 16 places 1 m apart, and a dead end of 3 places at its start."""
    graph = new_map(exp_loops=0)
    arrive(graph, 0)
    for number in range(1, 16):
        turn = math.pi / 2 if number % 4 == 1 and number > 1 else 0.0
        go(graph, number, Motion(0.0, 0.0, turn), Motion(2.0, 1.0, 0.0), relative_rad=0.0)
    go(graph, 0, Motion(2.0, 1.0, 0.0))
    for number in (16, 17, 18):
        go(graph, number, Motion(3.0, 1.0, 0.0))
    return graph


def route_server_graph(text: str) -> tuple[dict[int, Any], dict[int, Any]]:
    """Read nodes and edges by the rules of the route server; fail where it would."""
    exact: list[str] = []
    content = json.loads(text, parse_float=lambda digits: exact.append(digits) or float(digits))
    assert content['type'] == 'FeatureCollection'
    assert all('.' in digits for digits in exact)
    nodes, edges, ids = {}, {}, []
    for feature in content['features']:
        assert feature['type'] == 'Feature'
        properties = feature['properties']
        ids.append(properties['id'])
        kind, coordinates = feature['geometry']['type'], feature['geometry']['coordinates']
        if kind == 'Point':
            assert [type(value) for value in coordinates] == [float, float]
            nodes[properties['id']] = properties | {'at': tuple(coordinates)}
        else:
            assert kind == 'LineString'
            edges[properties['id']] = properties | {'line': coordinates}
    assert nodes
    assert edges
    assert len(set(ids)) == len(ids)
    assert 0 <= min(ids) <= max(ids) < 65_536
    for edge in edges.values():
        assert edge['startid'] in nodes
        assert edge['endid'] in nodes
        assert all(type(edge['metadata'][key]) is float for key in ('abs_time_taken', 'penalty'))
        ends = [list(nodes[edge[key]]['at']) for key in ('startid', 'endid')]
        assert edge['line'] == ends
    return nodes, edges


def test_geojson_has_two_directed_edges_per_link() -> None:
    graph = loop_with_tail()
    text, notices = exported(graph, 0, 'geojson')
    nodes, edges = route_server_graph(text)
    assert notices == []
    assert {node: value['at'] for node, value in nodes.items()} == {
        i: (pytest.approx(x, abs=6e-4), pytest.approx(y, abs=6e-4))
        for i, (x, y, _) in enumerate(graph.poses.tolist())
    }
    assert {value['frame'] for value in nodes.values()} == {'map'}
    pairs = Counter((edge['startid'], edge['endid']) for edge in edges.values())
    driven = {(link.source_id, link.target_id) for link in graph.links()}
    assert pairs == Counter(driven | {(b, a) for a, b in driven})
    times = {edge['metadata']['abs_time_taken'] for edge in edges.values()}
    assert times == {2.0, 3.0}


def test_geojson_edge_has_time_of_its_own_direction() -> None:
    graph = new_map(exp_loops=0)
    arrive(graph, 0)
    go(graph, 1, Motion(2.0, 1.0, 0.0))
    go(graph, 0, Motion(5.0, -1.0, 0.0))
    _, edges = route_server_graph(exported(graph, 0, 'geojson')[0])
    found = {
        (edge['startid'], edge['endid']): edge['metadata']['abs_time_taken']
        for edge in edges.values()
    }
    assert found == {(0, 1): 2.0, (1, 0): 5.0}


def test_geojson_penalty_counts_time_outs() -> None:
    graph = new_map(exp_loops=0)
    arrive(graph, 0)
    go(graph, 1, Motion(2.0, 1.0, 0.0), behaviour='left_wall')
    go(graph, 2, Motion(2.0, 1.0, 0.0), behaviour='left_wall')
    graph.unlearn_blocked('left_wall', 0.0, Pose(0.9, 0.0, 0.0))
    _, edges = route_server_graph(exported(graph, 0, 'geojson')[0])
    found = {
        (edge['startid'], edge['endid']): edge['metadata']['penalty'] for edge in edges.values()
    }
    assert found[0, 1] + found[1, 2] == 1.0
    assert found[0, 1] == found[1, 0]


def test_thinned_geojson_keeps_junctions_spacing_and_times() -> None:
    graph = loop_with_tail()
    nodes, edges = route_server_graph(exported(graph, 0, 'geojson', 3.0)[0])
    places = {value['metadata']['experience_id'] for value in nodes.values()}
    assert 0 in places  # the junction
    assert 18 in places  # the end of the dead end
    assert len(nodes) < 8
    lengths = [edge['metadata']['length_m'] for edge in edges.values()]
    assert min(lengths) >= 3.0
    networkx = pytest.importorskip('networkx')
    routes = networkx.DiGraph()
    for edge in edges.values():
        routes.add_edge(edge['startid'], edge['endid'], s=edge['metadata']['abs_time_taken'])
    assert networkx.is_strongly_connected(routes)
    assert all(routes.has_edge(b, a) for a, b in routes.edges)
    of_place = {value['metadata']['experience_id']: node for node, value in nodes.items()}
    assert networkx.shortest_path_length(routes, of_place[0], of_place[18], 's') == 9.0
    around = [routes.edges[a, b]['s'] for a, b in routes.edges if of_place[18] not in (a, b)]
    assert sum(around) == 2 * 16 * 2.0  # the loop is closed, in both directions


def test_graph_of_a_followed_map_is_that_of_the_export() -> None:
    graph, mirror = loop_with_tail(), MapMirror()
    mirror.apply(MapChangeTracker().next_change(graph, 0))
    numbering = GraphNumbering(3.0)
    live = numbering.graph(mirror)
    text = encode_route_graph(live.graph, 'map', live.node_ids, live.edge_ids)
    assert text == exported(graph, 0, 'geojson', 3.0)[0]
    go(graph, 19, Motion(3.0, 4.0, 0.0))
    mirror.apply(MapChangeTracker().next_change(graph, 0))
    grown = numbering.graph(mirror)
    text = encode_route_graph(grown.graph, 'map', grown.node_ids, grown.edge_ids)
    nodes, edges = route_server_graph(text)
    assert len(nodes) == len(live.node_ids) + 1
    assert set(live.edge_ids.values()) <= set(edges)


def test_thinned_geojson_of_random_maps_stays_connected() -> None:
    networkx = pytest.importorskip('networkx')
    rng = np.random.default_rng(4)
    for _ in range(20):
        graph = new_map(exp_loops=0)
        arrive(graph, 0)
        for _ in range(60):
            drive(graph, Motion(float(rng.uniform(0.5, 3.0)), float(rng.uniform(0.0, 2.0)), 0.3))
            is_new = rng.uniform() < 0.6
            arrive(graph, len(graph) if is_new else int(rng.integers(len(graph))))
        spacing_m = float(rng.uniform(0.5, 3.0))
        nodes, edges = route_server_graph(exported(graph, 0, 'geojson', spacing_m)[0])
        routes = networkx.DiGraph((edge['startid'], edge['endid']) for edge in edges.values())
        assert len(routes) == len(nodes) < len(graph)
        assert networkx.is_strongly_connected(routes)


def test_geojson_without_edges_is_refused() -> None:
    graph = new_map()
    with pytest.raises(UnusableInput, match='no place yet'):
        exported(graph, 0, 'geojson')
    arrive(graph, 0)
    with pytest.raises(UnusableInput, match='no edge'):
        exported(graph, 0, 'geojson')
    with pytest.raises(UnusableInput, match='smaller --spacing'):
        exported(loop_with_tail(), 0, 'geojson', 1000.0)


def test_geojson_of_too_large_map_names_a_spacing_that_fits(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    assert map_export.MAX_IDS == 65_536
    monkeypatch.setattr(map_export, 'MAX_IDS', 150)
    graph = new_map(exp_loops=0)
    arrive(graph, 0)
    for number in range(1, 60):
        go(graph, number, Motion(1.0, 0.5, 0.0))
    with pytest.raises(UnusableInput, match='60 nodes and 118 edges need 178 ids') as error:
        exported(graph, 0, 'geojson')
    spacing_m = float(str(error.value).rsplit(' ', 1)[1])
    nodes, edges = route_server_graph(exported(graph, 0, 'geojson', spacing_m)[0])
    assert 30 < len(nodes) + len(edges) < 150


def test_geojson_exports_the_largest_component_and_reports_the_others() -> None:
    graph = loop_with_tail()
    drive(graph, Motion(5.0, 0.0, 0.0, is_known=False))
    for number in (19, 20):
        arrive(graph, number)
        drive(graph, Motion(1.0, 1.0, 0.0))
    text, notices = exported(graph, 0, 'geojson')
    nodes, _ = route_server_graph(text)
    assert len(nodes) == 19
    assert notices == [
        '2 places are left out: they are in another part of the map, whose position relative to '
        'the exported one is unknown'
    ]


def test_grid_with_the_name_of_its_description_is_refused(tmp_path: Path) -> None:
    source = map_export.MapSource((), loop_with_tail(), 0)
    with pytest.raises(UnusableInput, match=r'expected a name that ends in \.pgm'):
        map_export.write_grid(source, tmp_path / 'grid.yaml')


def test_json_export_equals_the_map_of_a_replay() -> None:
    graph = loop_with_tail()
    assert exported(graph, 5_000_000_000, 'json')[0] == encode_map(5_000_000_000, graph)


def test_graphml_contains_lengths_and_times() -> None:
    graph = loop_with_tail()
    root = ElementTree.fromstring(exported(graph, 0, 'graphml')[0])
    space = '{http://graphml.graphdrawing.org/xmlns}'
    names = {key.get('id'): key.get('attr.name') for key in root.iter(f'{space}key')}
    edges = {}
    for edge in root.iter(f'{space}edge'):
        values = {names[one.get('key')]: one.text for one in edge.iter(f'{space}data')}
        ends = int(edge.get('source', '')), int(edge.get('target', ''))
        edges[ends] = float(values['distance_m'] or ''), float(values['duration_s'] or '')
    assert edges == {
        (link.source_id, link.target_id): (link.distance_m, link.duration_s)
        for link in graph.links()
    }
    assert len(list(root.iter(f'{space}node'))) == len(graph)
    assert root.find(f'{space}graph').get('edgedefault') == 'directed'  # type: ignore[union-attr]


def test_tum_export_is_read_as_trajectory(tmp_path: Path) -> None:
    graph = loop_with_tail()
    write_durably(tmp_path / 'map.tum', exported(graph, 0, 'tum')[0])
    trajectory = read_tum(tmp_path / 'map.tum')
    assert (trajectory.stamp_ns == np.arange(len(graph)) * 1_000_000_000).all()
    assert np.allclose(trajectory.position_m, graph.poses[:, :2], atol=1e-8)


def test_g2o_export_has_consistent_edges_and_information() -> None:
    graph = loop_with_tail()
    go(graph, 19, Motion(5.0, 0.0, 0.0, is_known=False))
    lines = [line.split() for line in exported(graph, 0, 'g2o')[0].splitlines()]
    poses = {int(i): Pose(*map(float, rest)) for kind, i, *rest in lines if kind == 'VERTEX_SE2'}
    assert len(poses) == len(graph)
    assert [line for line in lines if line[0] == 'FIX'] == [['FIX', '0'], ['FIX', '19']]
    edges = [line[1:] for line in lines if line[0] == 'EDGE_SE2']
    assert len(edges) == graph.link_count
    for i, j, *rest in edges:
        relative, matrix = list(map(float, rest[:3])), list(map(float, rest[3:]))
        expected = composed(inverse(poses[int(i)]), poses[int(j)])
        assert relative[:2] == pytest.approx(expected[:2], abs=1e-9)
        assert matrix[1] == matrix[2] == matrix[4] == 0.0
        assert matrix[0] == matrix[3] > 0.0
        assert matrix[5] > 0.0


def test_information_of_longer_odometry_is_smaller() -> None:
    graph = new_map(exp_loops=0)
    arrive(graph, 0)
    for number, length_m in ((1, 1.0), (2, 1.0), (3, 4.0)):
        go(graph, number, Motion(1.0, length_m, 0.0))
    values = information(graph)
    # Standard deviations after one view spacing, here 1 m: 0.2 m; of zero lengths: 0.02 m. Half
    # of these numbers are those of the heading in rad.
    for row, length_m in ((0, 1.0), (2, 4.0)):
        variance = length_m * 0.2**2 + 0.02**2
        assert values[row] == pytest.approx([1.0 / variance, 4.0 / variance])


@pytest.mark.parametrize('form', TEXT_FORMATS)
def test_export_of_map_json_has_recognitions_and_time_outs(form: str, tmp_path: Path) -> None:
    graph = new_map()
    for number in range(12):
        drive(graph, Motion(2.0, 1.0, 0.0))
        action = MapAction(
            'create', number - 1, number, number, 0.0, Place(0.0, 0.0, 0.0),
            recognised_id=number - 5, agreement=1.0, view_spacing_m=3.0,
        ) if number > 8 else MapAction(
            'create', number - 1, number, number, 0.0, Place(0.0, 0.0, 0.0),
        )
        graph.apply(action, 'left_wall')
        graph.settle()
    graph.unlearn_blocked('left_wall', 0.0, Pose(0.9, 0.0, 0.0))
    links = graph.link_table
    assert links.recognised.sum() == 3
    assert links.shares.min() < 1.0 <= links.failures.sum()
    (tmp_path / 'map.json').write_text(encode_map(5, graph))
    source = read_source(tmp_path / 'map.json')
    assert exported(source.graph, source.stamp_ns, form) == exported(graph, 5, form)
    assert source.notices == ()


def test_map_json_without_recognitions_gives_a_notice(tmp_path: Path) -> None:
    content = json.loads(encode_map(5, loop_with_tail()))
    del content['view_spacing_m']  # as in earlier versions
    (tmp_path / 'map.json').write_text(json.dumps(content))
    [notice] = read_source(tmp_path).notices
    assert 'all links count as driven ones' in notice


@pytest.mark.parametrize('name', ['missing/map.json', 'file/map.json', 'loop/map.json', 'a' * 255])
def test_export_to_unusable_path_is_one_line(name: str, tmp_path: Path) -> None:
    (tmp_path / 'file').touch()
    (tmp_path / 'loop').symlink_to('loop')
    with pytest.raises(UnusableInput, match='cannot be written'):
        write_durably(tmp_path / name, '')
    assert {path.name for path in tmp_path.iterdir()} == {'file', 'loop'}


def test_export_through_a_link_keeps_it(tmp_path: Path) -> None:
    link = tmp_path / 'link'
    link.symlink_to('map.json')
    write_durably(link, 'first')
    write_durably(link, 'second')
    assert link.is_symlink() and (tmp_path / 'map.json').read_text() == 'second'


@pytest.mark.parametrize(('kind', 'problem'), [
    ('pipe', 'a device or a pipe'), ('device', 'a device or a pipe'), ('folder', 'a folder'),
])
def test_output_that_is_no_regular_file_is_refused(
    kind: str, problem: str, tmp_path: Path
) -> None:
    path = tmp_path / 'out'
    if kind == 'pipe':
        os.mkfifo(path)
    elif kind == 'device':
        path.symlink_to('/dev/null')
    else:
        path.mkdir()
    with pytest.raises(UnusableInput, match=f'out cannot be written: it is {problem}'):
        write_durably(path, '')
    assert [*tmp_path.iterdir()] == [path] and not path.is_file()
