# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Live graph of a route server: ids, the decision to replace the graph, lost edges."""

from __future__ import annotations

import math
from copy import deepcopy
from functools import partial
from itertools import pairwise

import graphs
import numpy as np
import pytest
from graphs import arrive, drive, go, new_map

from ratslam_ros.core.common.odometry import Motion
from ratslam_ros.core.common.pose import Pose
from ratslam_ros.core.mapping.experience_map import ExperienceMap
from ratslam_ros.core.mapping.link_learning import TIMED_OUT
from ratslam_ros.core.mapping.map_changes import MapChange, MapChangeTracker, MapMirror
from ratslam_ros.core.navigation.graph_refresh import (
    GraphNumbering,
    NumberedGraph,
    StableIds,
    time_outs,
)

STEP = Motion(2.0, 1.0, 0.0)
corridor = partial(graphs.corridor, exp_loops=0)


class Followed:
    """A map, and the mirror that follows it."""

    def __init__(self, experience_map: ExperienceMap) -> None:
        self.map = experience_map
        self._tracker = MapChangeTracker()
        self._mirror = MapMirror()

    def mirror(self) -> MapMirror:
        self._mirror.apply(self._tracker.next_change(self.map, 0))
        return self._mirror


def ring(count: int = 12) -> ExperienceMap:
    """Return a closed square of places 1 m apart."""
    graph = new_map(exp_loops=0)
    arrive(graph, 0)
    for number in range(1, count):
        turn = math.pi / 2 if number % 3 == 1 and number > 1 else 0.0
        go(graph, number, Motion(0.0, 0.0, turn), STEP)
    go(graph, 0, Motion(0.0, 0.0, math.pi / 2), STEP)
    return graph


def block(graph: ExperienceMap, x_m: float, times: int) -> int:
    """Fail to drive on at x; return the number of links that were unlearned."""
    return sum(graph.unlearn_blocked('left', 0.0, Pose(x_m, 0.0, 0.0)) for _ in range(times))


def without(mirror: MapMirror, ends: tuple[int, int]) -> MapMirror:
    """Return a mirror without a link."""
    fresh = deepcopy(mirror)
    fresh.apply(MapChange(0, len(mirror), mirror.current_id, removed_links=np.array([ends])))
    return fresh


# Ids


def test_ids_stay_with_their_keys() -> None:
    ids = StableIds(4)
    assert ids.assign([(1,), (2,), (1, 2)]) == [0, 1, 2]
    assert ids.assign([(1, 2), (1,)]) == [2, 0]
    assert ids.assign([(3,), (2,)]) == [3, 1]  # 1 was kept while it was not used


def test_only_the_longest_unused_id_is_given_away() -> None:
    ids = StableIds(3)
    assert ids.assign([(1,), (2,), (3,)]) == [0, 1, 2]
    ids.assign([(1,), (3,)])
    ids.assign([(3,)])
    assert ids.assign([(3,), (4,)]) == [2, 1]
    assert ids.assign([(3,), (4,), (5,)]) == [2, 1, 0]


def test_too_many_keys_are_refused_without_change() -> None:
    ids = StableIds(2)
    ids.assign([(1,), (2,)])
    with pytest.raises(ValueError, match='3 keys for 2 numbers'):
        ids.assign([(3,), (4,), (5,)])
    assert ids.assign([(2,), (1,)]) == [1, 0]


def test_ids_of_a_growing_map_are_stable_and_unique() -> None:
    rng = np.random.default_rng(3)
    followed, numbering = Followed(corridor(2)), GraphNumbering(2.0)
    seen: dict[tuple[int, int], int] = {}
    for _ in range(12):
        for _ in range(8):
            turn = float(rng.uniform(-1.0, 1.0))
            drive(followed.map, Motion(2.0, float(rng.uniform(0.3, 1.5)), turn))
            new = len(followed.map)
            arrive(followed.map, new if rng.uniform() < 0.8 else int(rng.integers(new)))
        graph = numbering.graph(followed.mirror())
        ids = [*graph.node_ids.values(), *graph.edge_ids.values()]
        assert len(set(ids)) == len(ids)
        for ends, number in graph.edge_ids.items():
            assert seen.setdefault(ends, number) == number
    assert len(seen) > 40


def test_replaced_experience_gets_another_id() -> None:
    followed, numbering = Followed(corridor(9)), GraphNumbering(1.0)
    before = numbering.graph(followed.mirror())
    mirror = followed.mirror()
    mirror.template_ids[4] = 999
    after = numbering.graph(mirror)
    changed = {node for node in before.node_ids if before.node_ids[node] != after.node_ids[node]}
    assert changed == {4}
    differing = {ends for ends, n in before.edge_ids.items() if after.edge_ids[ends] != n}
    assert differing == {(3, 4), (4, 3), (4, 5), (5, 4)}


# When to replace the graph


def graphs_around(change: str, amount: float) -> tuple[NumberedGraph, NumberedGraph]:
    followed, numbering = Followed(corridor(9)), GraphNumbering(1.0)
    mirror = followed.mirror()
    before = numbering.graph(mirror)
    if change == 'move':
        mirror.poses[5, 1] += amount
    else:
        mirror.link_rows.durations_s[5] *= 1.0 + amount
    return before, numbering.graph(mirror)


@pytest.mark.parametrize(
    ('change', 'amount', 'reason'),
    [
        ('move', 0.0, ''), ('move', 0.09, ''), ('move', 0.11, 'moved by up to 0.11 m'),
        ('slow', 0.09, ''), ('slow', 0.11, 'times'), ('slow', -0.11, 'times'),
    ],
)
def test_graph_is_replaced_after_noticeable_changes(
    change: str, amount: float, reason: str
) -> None:
    before, after = graphs_around(change, amount)
    found = before.difference(after, 1.0)
    assert (found != '', reason in found) == (reason != '', True)


def test_graph_is_replaced_when_edges_change() -> None:
    followed, numbering = Followed(corridor(9)), GraphNumbering(1.0)
    before = numbering.graph(followed.mirror())
    go(followed.map, 9, STEP)
    after = numbering.graph(followed.mirror())
    assert before.difference(after, 1.0) == '2 edges are new, 0 are gone'
    assert after.difference(before, 1.0) == '0 edges are new, 2 are gone'


def test_nodes_are_kept_while_the_map_grows() -> None:
    followed, numbering = Followed(corridor(30)), GraphNumbering(4.0)
    before = numbering.graph(followed.mirror())
    go(followed.map, 30, STEP)
    after = numbering.graph(followed.mirror())
    assert set(before.graph.nodes) <= set(after.graph.nodes)
    assert before.edge_ids.items() <= after.edge_ids.items()
    # Of preferred nodes that have come too close, one is dropped.
    followed.mirror().poses[:, 0] *= 0.4
    assert len(numbering.graph(followed.mirror()).graph.nodes) < len(after.graph.nodes)


# Lost edges


def test_unlearned_link_closes_the_edges_over_it() -> None:
    followed, numbering = Followed(corridor(9, 'left')), GraphNumbering(3.0)
    graph = numbering.graph(followed.mirror())
    assert graph.lost_edges(followed.mirror(), 3.0) == set()
    assert block(followed.map, 3.6, 1) == 0  # one failed attempt does not suffice
    assert graph.lost_edges(followed.mirror(), 3.0) == set()
    assert block(followed.map, 3.6, 9) > 0
    left = {tuple(ends) for ends in followed.map.link_ends.tolist()}
    gone = {(n, n + 1) for n in range(8)} - left
    assert 1 <= len(gone) <= 2
    over = {
        graph.edge_ids[ends] for ends, edge in graph.graph.edges.items()
        if any({pair, pair[::-1]} & gone for pair in pairwise(edge.way))
    }
    assert len(over) >= 2  # both directions
    assert graph.lost_edges(followed.mirror(), 3.0) == over


def test_edge_with_another_short_way_stays_open() -> None:
    followed = Followed(corridor(9))
    mirror = followed.mirror()
    graph = GraphNumbering(3.0).graph(mirror)
    through = {
        number for ends, number in graph.edge_ids.items()
        if {4, 5} <= set(graph.graph.edges[ends].way)
    }
    assert len(through) == 2
    assert graph.lost_edges(without(mirror, (4, 5)), 3.0) == through
    go(followed.map, 3, Motion(2.0, -5.0, 0.0))
    go(followed.map, 5, Motion(2.0, 2.0, 0.0))  # by a link from 3 to 5
    assert graph.lost_edges(without(followed.mirror(), (4, 5)), 3.0) == set()


def test_long_detour_does_not_keep_an_edge_open() -> None:
    mirror = Followed(ring()).mirror()
    graph = GraphNumbering(1.0).graph(mirror)
    lost = graph.lost_edges(without(mirror, (5, 6)), 1.0)
    assert lost == {graph.edge_ids[5, 6], graph.edge_ids[6, 5]}


def test_edges_of_an_empty_map_are_lost() -> None:
    followed = Followed(corridor(9))
    graph = GraphNumbering(1.0).graph(followed.mirror())
    assert graph.lost_edges(MapMirror(), 1.0) == set(graph.edge_ids.values())


def test_replaced_place_loses_its_edges() -> None:
    followed = Followed(corridor(9))
    graph = GraphNumbering(2.0).graph(followed.mirror())
    mirror = followed.mirror()
    [through] = [edge for edge in graph.graph.edges.values() if edge.way[:3] == (2, 3, 4)]
    mirror.template_ids[3] = 999
    lost = graph.lost_edges(mirror, 2.0)
    # The links are still there, and lead past it: only an edge that ends there would be lost.
    assert graph.edge_ids[through.way[0], through.way[-1]] not in lost
    mirror.template_ids[4] = 999
    assert graph.edge_ids[through.way[0], through.way[-1]] in graph.lost_edges(mirror, 2.0)


def test_time_outs_are_recovered_from_the_confidences() -> None:
    graph = corridor(9, 'left')
    followed = Followed(graph)
    followed.mirror()
    for times in (1, 2):
        block(graph, 3.6, 1)
        mirror = followed.mirror()
        rows = mirror.link_rows
        found = {
            tuple(ends): count
            for ends, count in zip(rows.ends.tolist(), time_outs(rows).tolist(), strict=True)
            if ends[0] >= 0
        }
        links = graph.link_table
        expected = links.failures[:, TIMED_OUT].tolist()
        if len(links) < 8:
            break  # unlearned
        assert max(expected) == times
        assert list(found.values()) == expected
