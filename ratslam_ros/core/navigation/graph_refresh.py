# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""When the graph of a route server must be replaced, and which of its edges must be closed.

The server identifies nodes and edges by numbers, and remembers closed edges by their numbers even
if the graph is replaced. A number must therefore not pass to another edge while it is closed.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ratslam_ros.core.mapping.map_changes import LinkRows, MapMirror
from ratslam_ros.core.navigation.server_graph import (
    LEAST_LENGTH_M,
    MAX_IDS,
    ServerGraph,
    server_graph,
)

CHANGE_RATIO = 0.1
"""Change that requires a new graph: of a position, relative to the spacing of the nodes; of the
time of an edge, relative to that time. Edges are straight: in a bend of 90 degrees over one
spacing, they are 0.19 spacings beside the driven way. Smaller displacements are within this error
of the graph itself. At constant speed, they change the time of an edge, which is about as long as
the spacing, by the same ratio."""

DETOUR_RATIO = 2.0
"""Length of the longest way that replaces a lost one, relative to the edge. Longer ones lead past
other nodes, through which the route server finds them by itself."""

Key = tuple[int, ...]
Ends = tuple[int, int]


class StableIds:
    """Numbers that stay with their keys.

    A key keeps its number, even while it is not used, until all numbers have been given away. New
    keys then get the numbers of the keys that have not been used for longest.
    """

    def __init__(self, count: int = MAX_IDS) -> None:
        self._count = count
        self._next = 0
        self._ids: dict[Key, int] = {}
        """Number of each key, least recently used first."""

    def assign(self, keys: Sequence[Key]) -> list[int]:
        """Return the number of each key.

        Args:
            keys: all keys in use, each once.

        Raises:
            ValueError: there are fewer numbers than keys; nothing is changed.
        """
        if len(keys) > self._count:
            raise ValueError(f'{len(keys)} keys for {self._count} numbers')
        used = {key: self._ids.pop(key) for key in keys if key in self._ids}
        oldest = iter(list(self._ids))
        for key in keys:
            if key in used:
                continue
            if self._next < self._count:
                used[key] = self._next
                self._next += 1
            else:
                used[key] = self._ids.pop(next(oldest))
        self._ids.update(used)
        return [used[key] for key in keys]


@dataclass(frozen=True, slots=True)
class NumberedGraph:
    """A graph with the ids of its nodes and edges.

    Attributes:
        graph: the graph.
        node_ids, edge_ids: the ids.
        template_ids: (n,) template of every experience of the map. An experience with another one
            has been replaced, and is another place.
    """

    graph: ServerGraph
    node_ids: dict[int, int]
    edge_ids: dict[Ends, int]
    template_ids: NDArray[np.int64]

    def difference(self, newer: NumberedGraph, spacing_m: float) -> str:
        """Return why a newer graph must replace this one, '' if it need not.

        Args:
            newer: the graph of the map as it is now, with ids of the same ``StableIds``.
            spacing_m: spacing of the nodes.
        """
        old, new = set(self.edge_ids.items()), set(newer.edge_ids.items())
        if old != new:
            return f'{len(new - old)} edges are new, {len(old - new)} are gone'
        row_of = {node: row for row, node in enumerate(self.graph.nodes)}
        rows = [row_of[node] for node in newer.graph.nodes]
        moved_m = np.hypot(*(newer.graph.poses[:, :2] - self.graph.poses[rows, :2]).T).max()
        if moved_m > CHANGE_RATIO * spacing_m:
            return f'nodes have moved by up to {moved_m:.2f} m'
        for ends, edge in self.graph.edges.items():
            now = newer.graph.edges[ends]
            change_s = abs(now.time_s - edge.time_s)
            if now.failures != edge.failures or change_s > CHANGE_RATIO * edge.time_s:
                return 'times or failed attempts have changed'
        return ''

    def lost_edges(self, known: MapMirror, spacing_m: float) -> set[int]:
        """Return the ids of the edges that cannot be driven any more.

        An edge is lost if a link or place on its way is not on the map any more, and no other way
        of similar length connects its ends.

        Args:
            known: the map as it is now.
            spacing_m: spacing of the nodes.
        """
        template_ids = known.template_ids

        def is_same(experience: int) -> bool:
            return experience < len(known) and bool(
                template_ids[experience] == self.template_ids[experience]
            )

        def is_linked(a: int, b: int) -> bool:
            return known.link_row(a, b) is not None or known.link_row(b, a) is not None

        broken = [
            ends for ends, edge in self.graph.edges.items()
            if not all(map(is_same, edge.way))
            or not all(map(is_linked, edge.way, edge.way[1:]))
        ]
        possible = [ends for ends in broken if is_same(ends[0]) and is_same(ends[1])]
        limits_m = [
            DETOUR_RATIO * max(self.graph.edges[ends].length_m, spacing_m) for ends in possible
        ]
        replaced = _connected(known, possible, limits_m)
        return {self.edge_ids[ends] for ends in broken if ends not in replaced}


def _connected(known: MapMirror, ends: Sequence[Ends], limits_m: Sequence[float]) -> set[Ends]:
    """Return those of some pairs of experiences that links connect within a length each."""
    if not ends:
        return set()
    from scipy.sparse import csr_array
    from scipy.sparse.csgraph import dijkstra

    pairs = known.links.ends
    steps_m = np.hypot(*(known.poses[pairs[:, 0], :2] - known.poses[pairs[:, 1], :2]).T)
    lengths_m = np.maximum(steps_m, LEAST_LENGTH_M)
    links = pairs.astype(np.int32)
    graph = csr_array((lengths_m, (links[:, 0], links[:, 1])), shape=(len(known),) * 2)
    found = set()
    for (source, target), limit_m in zip(ends, limits_m, strict=True):
        reached = dijkstra(graph, directed=False, indices=source, limit=limit_m)
        if np.isfinite(reached[target]):
            found.add((source, target))
    return found


def time_outs(links: LinkRows) -> NDArray[np.int64]:
    """Return the number of time-outs in front of each link, as far as its confidence shows it.

    This inverts ``link_confidences``: the changes of a map do not contain the number. It is exact
    while the attempts of a link are few. Recognitions, which are not driven, have none.
    """
    names = {name: number for number, name in enumerate(dict.fromkeys(['', *links.behaviours]))}
    behaviours = np.array([names[name] for name in links.behaviours], np.int64)
    groups = links.ends[:, 0] * len(names) + behaviours
    totals = np.bincount(groups, links.counts)[groups]
    attempts = links.counts / np.maximum(links.confidences, 1e-3)
    failed = np.rint(attempts - np.where(behaviours > 0, totals, links.counts))
    return np.where(links.recognised, 0, np.maximum(failed, 0)).astype(np.int64)


class GraphNumbering:
    """Builds graphs of a map whose nodes and ids change as little as possible."""

    def __init__(self, spacing_m: float) -> None:
        """Start without a graph; ``spacing_m``: least distance of two nodes along the links."""
        self._spacing_m = spacing_m
        self._ids = StableIds()
        self._last: NumberedGraph | None = None

    def graph(self, known: MapMirror) -> NumberedGraph:
        """Return the graph of a map.

        The id of a node belongs to its experience and template, the id of an edge to those of its
        two nodes. Nodes of the last graph are kept if they still exist.

        Raises:
            ValueError: the graph has more nodes and edges than there are ids.
        """
        links, last = known.links, self._last
        template_ids = known.template_ids.copy()
        preferred = [] if last is None else [
            node for node in last.graph.nodes
            if node < len(template_ids) and template_ids[node] == last.template_ids[node]
        ]
        graph = server_graph(
            known.poses, known.components.tolist(), links.ends, links.shapes[:, 0],
            links.durations_s, time_outs(links), self._spacing_m, preferred,
        )
        places = {node: (node, int(template_ids[node])) for node in graph.nodes}
        edges = sorted(graph.edges)
        node_keys: list[Key] = list(places.values())
        edge_keys: list[Key] = [places[a] + places[b] for a, b in edges]
        ids = self._ids.assign(node_keys + edge_keys)
        node_count = len(node_keys)
        self._last = NumberedGraph(
            graph, dict(zip(graph.nodes, ids[:node_count], strict=True)),
            dict(zip(edges, ids[node_count:], strict=True)), template_ids,
        )
        return self._last
