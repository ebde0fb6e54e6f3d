# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Changes of the experience map, for programs that follow it without reading it whole."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ratslam_ros.core.common.rows import require_shapes, with_capacity
from ratslam_ros.core.mapping.experience_map import ExperienceMap
from ratslam_ros.core.mapping.graph import ExperienceGraph
from ratslam_ros.core.mapping.link_learning import link_confidences
from ratslam_ros.core.pose_cells.map_action import NO_EXPERIENCE

Ids = NDArray[np.int64]
Reals = NDArray[np.float64]

ROUNDING = 1000.0
"""Lengths, angles, durations and confidences are rounded to 1/1000 of their unit: 1 mm and 1 mrad
are far below the accuracy of a map and the resolution of a screen, and short as text."""

MAX_ROWS = 1_000_000
"""Largest number of experiences of a map, and of rows of a change, that receivers and readers
accept, because they allocate memory for all of them. More links follow in further changes."""

POSE_TOLERANCES = np.array([1e-3, 1e-3, 1e-3, 0.0, 0.0])
"""Changes of x and y in m, heading in rad, template and component above which an experience is
sent again. Those of the pose are the least that rounding can represent."""

LINK_TOLERANCES = np.array([1e-3, 1e-3, 1e-3, 1e-2, 1e-2, 0.0, 0.0, 0.0])
"""Changes of distance in m, heading and facing in rad, duration in s, confidence, count,
recognition and behaviour above which a link is sent again. Durations and confidences are shown as
text and colours with two digits."""


NOT_RECEIVED = {'template_ids': -1, 'poses': math.nan, 'components': 0}
"""Values of an experience in a mirror that has not received it yet."""


def _no_ids() -> Ids:
    return np.empty(0, np.int64)


@dataclass(frozen=True, slots=True)
class ExperienceRows:
    """Experiences that are new, have moved or have been replaced; a row for each.

    Attributes:
        ids: (n,) ids.
        template_ids: (n,) templates.
        poses: (n, 3) x, y in m and heading in rad on the map.
        components: (n,) components of the map; all are 0 unless the odometry had gaps.
    """

    ids: Ids = field(default_factory=_no_ids)
    template_ids: Ids = field(default_factory=_no_ids)
    poses: Reals = field(default_factory=lambda: np.empty((0, 3)))
    components: Ids = field(default_factory=_no_ids)

    def __post_init__(self) -> None:
        n = len(self.ids)
        require_shapes(self, ids=(n,), template_ids=(n,), poses=(n, 3), components=(n,))

    def __len__(self) -> int:
        return len(self.ids)


@dataclass(frozen=True, slots=True)
class LinkRows:
    """Links that are new or have changed; a row for each.

    Attributes:
        ends: (n, 2) source and target.
        shapes: (n, 3) distance in m, heading and facing in rad, see ``Link``.
        durations_s: (n,) duration in s.
        confidences: (n,) confidence, from 0 to 1.
        counts: (n,) number of times that the transition was made.
        recognised: (n,) whether a recognised view determines the link, and not odometry alone.
        behaviours: name of the behaviour of each, '' if unknown.
    """

    ends: Ids = field(default_factory=lambda: np.empty((0, 2), np.int64))
    shapes: Reals = field(default_factory=lambda: np.empty((0, 3)))
    durations_s: Reals = field(default_factory=lambda: np.empty(0))
    confidences: Reals = field(default_factory=lambda: np.empty(0))
    counts: Ids = field(default_factory=_no_ids)
    recognised: NDArray[np.bool_] = field(default_factory=lambda: np.empty(0, np.bool_))
    behaviours: Sequence[str] = ()

    def __post_init__(self) -> None:
        n = len(self.behaviours)
        require_shapes(
            self, ends=(n, 2), shapes=(n, 3), durations_s=(n,), confidences=(n,), counts=(n,),
            recognised=(n,),
        )

    def __len__(self) -> int:
        return len(self.ends)


@dataclass(frozen=True, slots=True)
class MapChange:
    """What has changed on the map since the last change.

    Attributes:
        stamp_ns: stamp of the last applied action.
        experience_count: number of experiences that the map has; ids are below it.
        current_id: the current experience, -1 if there is none.
        is_restart: whether everything known before is void.
        experiences, links: what is new or different.
        removed_links: (n, 2) source and target of deleted links.
        pending: number of experiences and links that differ but are not included yet.
    """

    stamp_ns: int
    experience_count: int
    current_id: int
    is_restart: bool = False
    experiences: ExperienceRows = field(default_factory=ExperienceRows)
    links: LinkRows = field(default_factory=LinkRows)
    removed_links: Ids = field(default_factory=lambda: np.empty((0, 2), np.int64))
    pending: int = 0

    def __post_init__(self) -> None:
        require_shapes(self, removed_links=(len(self.removed_links), 2))
        if not -1 <= self.current_id < self.experience_count:
            raise ValueError(
                f'a map of {self.experience_count} experiences has the current id '
                f'{self.current_id}'
            )
        for ids in (self.experiences.ids, self.links.ends):
            if ids.size and not 0 <= ids.min() <= ids.max() < self.experience_count:
                raise ValueError(
                    f'a map of {self.experience_count} experiences has the ids {ids.min()} to '
                    f'{ids.max()}'
                )

    def __len__(self) -> int:
        return len(self.experiences) + len(self.links) + len(self.removed_links)


class MapMirror:
    """The map as the changes describe it.

    Links keep their row until they are removed; a free row has the ends -1, and is used again.
    """

    def __init__(self) -> None:
        self.version = 0
        """Counter that grows with every change."""
        self.restarts = 0
        """Number of times that everything known became void."""
        self.current_id = NO_EXPERIENCE
        """The current experience, -1 if there is none."""
        self.pending = 0
        """Number of experiences and links that are known to differ."""
        self._clear()

    def _clear(self) -> None:
        self._count = 0
        # Columns with spare rows, named like the fields of ``ExperienceRows`` and ``LinkRows``.
        self._experiences: dict[str, NDArray[Any]] = {
            'template_ids': np.empty(0, np.int64), 'poses': np.empty((0, 3)),
            'components': np.empty(0, np.int64),
        }
        self._links: dict[str, Any] = {
            'ends': np.empty((0, 2), np.int64), 'shapes': np.empty((0, 3)),
            'durations_s': np.empty(0), 'confidences': np.empty(0),
            'counts': np.empty(0, np.int64), 'recognised': np.empty(0, np.bool_),
            'behaviours': np.empty(0, np.object_),
        }
        self._rows: dict[tuple[int, ...], int] = {}
        self._free: list[int] = []

    def __len__(self) -> int:
        return self._count

    @property
    def template_ids(self) -> Ids:
        """(n,) template of every experience, -1 if it has not been received yet."""
        return self._experiences['template_ids'][: self._count]

    @property
    def poses(self) -> Reals:
        """(n, 3) pose of every experience; not finite if it has not been received yet."""
        return self._experiences['poses'][: self._count]

    @property
    def components(self) -> Ids:
        """(n,) component of every experience."""
        return self._experiences['components'][: self._count]

    @property
    def link_count(self) -> int:
        """Number of links."""
        return len(self._rows)

    @property
    def link_rows(self) -> LinkRows:
        """All rows of links, free ones included; views that the next change may alter."""
        n = len(self._rows) + len(self._free)
        return LinkRows(**{name: rows[:n] for name, rows in self._links.items()})

    @property
    def links(self) -> LinkRows:
        """All links, without free rows; a copy."""
        used = np.flatnonzero(self.link_rows.ends[:, 0] >= 0)
        return LinkRows(**{name: rows[used] for name, rows in self._links.items()})

    def link_row(self, source_id: int, target_id: int) -> int | None:
        """Return the row of a link, None if there is no such link."""
        return self._rows.get((source_id, target_id))

    def apply(self, change: MapChange) -> None:
        """Apply a change; changes must be applied in order and without gaps."""
        self.version += 1
        if change.is_restart:
            self._clear()
            self.restarts += 1
        self.current_id, self.pending = change.current_id, change.pending
        self._resize(change.experience_count)
        for name, rows in self._experiences.items():
            rows[change.experiences.ids] = getattr(change.experiences, name)
        for ends in change.removed_links.tolist():
            row = self._rows.pop(tuple(ends), None)
            if row is not None:
                self._links['ends'][row] = -1
                self._free.append(row)
        if len(change.links):
            self._set_links(change.links)

    def _resize(self, count: int) -> None:
        for name, rows in self._experiences.items():
            if count > len(rows):
                rows = self._experiences[name] = with_capacity(rows, 2 * count)
            rows[self._count : count] = NOT_RECEIVED[name]
        self._count = count

    def _set_links(self, links: LinkRows) -> None:
        at = []
        for source, target in links.ends.tolist():
            row = self._rows.get((source, target))
            if row is None:
                row = self._free.pop() if self._free else len(self._rows)
                self._rows[source, target] = row
            at.append(row)
        for name, rows in self._links.items():
            if len(self._rows) > len(rows):
                rows = self._links[name] = with_capacity(rows, 2 * len(self._rows))
            rows[at] = getattr(links, name)


class SentRows:
    """Rows of numbers: as they are now, as they were sent, and which of them differ.

    The arrays are ordered (column, row), as comparing whole columns is several times faster.
    """

    def __init__(self, tolerances: Reals, rounded: int) -> None:
        """Start without rows.

        Args:
            tolerances: (k,) largest difference of each column that is not sent.
            rounded: number of the first columns, which are rounded when they are sent.
        """
        self._tolerances, self._rounded = tolerances[:, None], rounded
        # Arrays with room for more rows: allocating megabytes takes longer than comparing them.
        self._all = np.empty((3, len(tolerances), 0))
        self._differs: NDArray[np.bool_] = np.empty(0, np.bool_)
        self._next = 0
        self.pending = 0
        """Number of rows that differ from what was sent."""

    def __len__(self) -> int:
        return len(self._differs)

    @property
    def was_sent(self) -> NDArray[np.bool_]:
        """(n,) whether a row was ever sent."""
        return ~np.isnan(self._sent[0])

    @property
    def _sent(self) -> Reals:
        return self._all[1, :, : len(self)]

    @property
    def _now(self) -> Reals:
        return self._all[0, :, : len(self)]

    def resize(self, count: int, expected: int) -> Reals:
        """Append rows; return the present numbers, (k, n), to be changed before ``compare``.

        Args:
            count: number of rows, at least as many as before.
            expected: number of rows that will soon be needed.
        """
        known = len(self)
        if count > self._all.shape[2]:
            grown = np.empty((*self._all.shape[:2], max(64, expected + expected // 4)))
            grown[:, :, :known] = self._all[:, :, :known]
            self._all = grown
        if count > known:
            self._all[1, :, known:count] = np.nan
            self._differs = np.append(self._differs, np.ones(count - known, np.bool_))
        return self._now

    def compare(self) -> None:
        """Compare the present numbers with those that were sent."""
        difference = self._all[2, :, : len(self)]
        np.subtract(self._now, self._sent, out=difference)
        np.abs(difference, out=difference)
        is_close = difference <= self._tolerances  # False for NaN
        self._differs = np.logical_not(is_close.all(axis=0))
        self.pending = int(np.count_nonzero(self._differs))

    def keep(self, kept: NDArray[np.bool_]) -> None:
        """Delete all rows but those marked."""
        count = int(np.count_nonzero(kept))
        self._all[:2, :, :count] = self._all[:2, :, : len(kept)][:, :, kept]
        self._differs = self._differs[kept]
        self.pending = int(np.count_nonzero(self._differs))

    def take(self, limit: int) -> tuple[Ids, Reals]:
        """Return at most ``limit`` rows that differ, and record that they are sent.

        Returns:
            (n,) rows, and (k, n) their numbers as they are sent.
        """
        rows = np.flatnonzero(self._differs)
        if len(rows) > limit:
            is_new = np.isnan(self._sent[0, rows])
            moved = rows[~is_new]
            at = int(np.searchsorted(moved, self._next))
            rows = np.concatenate([rows[is_new], moved[at:], moved[:at]])[:limit]
            if len(rows) > np.count_nonzero(is_new):
                self._next = int(rows[-1]) + 1
        values = self._now[:, rows]
        values[: self._rounded] = np.rint(values[: self._rounded] * ROUNDING) / ROUNDING
        self._sent[:, rows] = values
        self._differs[rows] = False
        self.pending -= len(rows)
        return rows, values


class MapChangeTracker:
    """Compares a map with what was sent of it, and returns the next change.

    A restart forgets what was sent, so that the whole map follows in ordinary changes of limited
    size. Late receivers, lost changes and loop closures, which move every pose, need nothing else.
    """

    def __init__(self) -> None:
        self._map: ExperienceMap | None = None
        self._begin()

    def restart(self) -> None:
        """Forget what was sent: the next change starts with an empty map."""
        self._map = None

    def next_change(
        self, experience_map: ExperienceMap, stamp_ns: int, limit: int = MAX_ROWS
    ) -> MapChange:
        """Return what has changed since the last call and is not sent yet.

        Experiences and links that were never sent come first, then the others in turn, so that
        none waits for ever while all poses keep moving. Another map than before restarts.

        Args:
            experience_map: the map.
            stamp_ns: stamp of the last applied action.
            limit: largest number of experiences and links in the change, at least 2.
        """
        is_restart = experience_map is not self._map
        if is_restart:
            self._map = experience_map
            self._begin()
        unseen = self._compare_experiences(experience_map, limit)
        unseen += self._compare_links(experience_map, limit)
        removed = self._removed[:limit]
        del self._removed[:limit]
        left = limit - len(removed)
        # Half of the room is for links, or experiences that move all the time would displace them.
        ids, sent = self._experiences.take(left - min(self._links.pending, left // 2))
        template_ids, components = sent[3:].astype(np.int64)
        experiences = ExperienceRows(
            ids, template_ids, np.ascontiguousarray(sent[:3].T), components
        )
        rows, sent = self._links.take(left - len(ids))
        names = experience_map.link_table.behaviour_names
        links = LinkRows(
            self._ends[rows], np.ascontiguousarray(sent[:3].T), sent[3], sent[4],
            sent[5].astype(np.int64), sent[6] > 0.0,
            tuple(names[number] for number in sent[7].astype(np.int64).tolist()),
        )
        return MapChange(
            stamp_ns, len(experience_map), experience_map.current_id, is_restart, experiences,
            links, np.array(removed, np.int64).reshape(-1, 2),
            unseen + self._experiences.pending + self._links.pending + len(self._removed),
        )

    def changes(self, experience_map: ExperienceMap, stamp_ns: int) -> Iterator[MapChange]:
        """Yield all that is not sent yet; see ``next_change``."""
        pending = 1
        while pending:
            change = self.next_change(experience_map, stamp_ns)
            pending = change.pending
            yield change

    def _begin(self) -> None:
        self._experiences = SentRows(POSE_TOLERANCES, rounded=3)
        self._links = SentRows(LINK_TOLERANCES, rounded=5)
        self._removed: list[tuple[int, int]] = []
        self._labels_version: tuple[int, ...] = ()
        self._ends = np.empty((0, 2), np.int64)
        self._serials = np.empty(0, np.int64)
        self._links_version = -1
        self._deletions = 0

    def _compare_experiences(self, graph: ExperienceGraph, limit: int) -> int:
        """Compare the experiences; return the number of those that were not looked at.

        A change contains no more than ``limit`` of them, so that many more are looked at in each
        call. A restart on a large map thus takes no longer than any other change.
        """
        count = min(len(graph), len(self._experiences) + limit)
        now, poses = self._experiences.resize(count, len(graph)), graph.poses[:count].T
        version = count, graph.replacement_count, graph.merge_count
        if version != self._labels_version:
            self._labels_version = version
            now[3], now[4] = graph.template_ids[:count], graph.components[:count]
        elif np.array_equal(poses, now[:3]):
            return len(graph) - count
        now[:3] = poses
        self._experiences.compare()
        return len(graph) - count

    def _compare_links(self, graph: ExperienceGraph, limit: int) -> int:
        """Compare the links; return the number of those that were not looked at."""
        links = graph.link_table
        if links.deletion_count != self._deletions:
            self._deletions = links.deletion_count
            self._delete(links.serials)
        known = len(self._serials)
        count = min(len(links), known + limit)
        now = self._links.resize(count, len(links))
        confidences = link_confidences(links)[:count] * links.shares[:count]
        if (links.version, count) == (self._links_version, known) and (
            np.array_equal(confidences, now[4])
        ):
            return len(links) - count
        self._links_version = links.version
        self._serials = links.serials[:count].copy()
        self._ends = links.ends[:count].copy()
        now[:3] = links.shapes[:count].T
        now[3], now[4] = links.durations_s[:count], confidences
        now[5], now[6] = links.counts[:count], links.recognised[:count]
        now[7] = links.behaviours[:count]
        self._links.compare()
        return len(links) - count

    def _delete(self, serials: Ids) -> None:
        """Delete the rows of links that do not exist any more; ``serials``: of those that do."""
        kept = np.isin(self._serials, serials, assume_unique=True)
        gone = self._ends[~kept & self._links.was_sent].tolist()
        self._removed.extend((source, target) for source, target in gone)
        self._links.keep(kept)
        self._serials, self._ends = self._serials[kept], self._ends[kept]
