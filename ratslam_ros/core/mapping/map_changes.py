# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Changes of the experience map, for programs that follow it without reading it whole."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from itertools import compress
from operator import is_not

import numpy as np
from numpy.typing import NDArray

from ratslam_ros.core.mapping.experience_map import ExperienceMap
from ratslam_ros.core.mapping.graph import ExperienceGraph
from ratslam_ros.core.mapping.link_learning import TIMED_OUT, link_confidences
from ratslam_ros.core.mapping.sent_rows import SentRows
from ratslam_ros.core.pose_cells.map_action import NO_EXPERIENCE

Ids = NDArray[np.int64]
Reals = NDArray[np.float64]

UNLIMITED = 2**31
"""Limit of a change that no map reaches."""

POSE_TOLERANCES = np.array([1e-3, 1e-3, 1e-3, 0.0, 0.0])
"""Changes of x and y in m, heading in rad, template and component above which an experience is
sent again. Those of the pose are the least that rounding can represent."""

LINK_TOLERANCES = np.array([1e-3, 1e-3, 1e-3, 1e-2, 1e-2, 0.0, 0.0, 0.0])
"""Changes of distance in m, heading and facing in rad, duration in s, confidence, count,
recognition and behaviour above which a link is sent again. Durations and confidences are shown as
text and colours with two digits."""


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
        recognised: (n,) whether the source was recognised as the place of the target.
        behaviours: name of the behaviour of each, '' if unknown.
    """

    ends: Ids = field(default_factory=lambda: np.empty((0, 2), np.int64))
    shapes: Reals = field(default_factory=lambda: np.empty((0, 3)))
    durations_s: Reals = field(default_factory=lambda: np.empty(0))
    confidences: Reals = field(default_factory=lambda: np.empty(0))
    counts: Ids = field(default_factory=_no_ids)
    recognised: NDArray[np.bool_] = field(default_factory=lambda: np.empty(0, np.bool_))
    behaviours: tuple[str, ...] = ()

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

    def __len__(self) -> int:
        return len(self.experiences) + len(self.links) + len(self.removed_links)


class MapMirror:
    """The map as the changes describe it.

    Links keep their row until they are removed; a free row has the ends -1, and is used again.
    ``experience_versions`` and ``link_versions`` tell what has changed since a ``version``.
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
        self._template_ids = np.empty(0, np.int64)
        self._poses = np.empty((0, 3))
        self._components = np.empty(0, np.int64)
        self._versions = np.empty(0, np.int64)
        self._rows: dict[tuple[int, int], int] = {}
        self._free: list[int] = []
        self._link_count = 0
        self._links = LinkRows()
        self._behaviours: list[str] = []
        self._link_versions = np.empty(0, np.int64)

    def __len__(self) -> int:
        return self._count

    @property
    def template_ids(self) -> Ids:
        """(n,) template of every experience, -1 if it has not been received yet."""
        return self._template_ids[: self._count]

    @property
    def poses(self) -> Reals:
        """(n, 3) pose of every experience; not finite if it has not been received yet."""
        return self._poses[: self._count]

    @property
    def components(self) -> Ids:
        """(n,) component of every experience."""
        return self._components[: self._count]

    @property
    def experience_versions(self) -> Ids:
        """(n,) value of ``version`` at the last change of every experience."""
        return self._versions[: self._count]

    @property
    def link_count(self) -> int:
        """Number of links."""
        return len(self._rows)

    @property
    def link_rows(self) -> LinkRows:
        """All rows of links, free ones included; views that the next change may alter."""
        n, rows = self._link_count, self._links
        return LinkRows(
            rows.ends[:n], rows.shapes[:n], rows.durations_s[:n], rows.confidences[:n],
            rows.counts[:n], rows.recognised[:n], tuple(self._behaviours),
        )

    @property
    def link_versions(self) -> Ids:
        """(rows,) value of ``version`` at the last change of every row of links."""
        return self._link_versions[: self._link_count]

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
        rows = change.experiences
        self._template_ids[rows.ids] = rows.template_ids
        self._poses[rows.ids] = rows.poses
        self._components[rows.ids] = rows.components
        self._versions[rows.ids] = self.version
        for source, target in change.removed_links.tolist():
            row = self._rows.pop((source, target), None)
            if row is not None:
                self._links.ends[row] = -1
                self._link_versions[row] = self.version
                self._free.append(row)
        self._set_links(change.links)

    def complete(self, stamp_ns: int) -> MapChange:
        """Return the change that makes an empty mirror equal to this one."""
        used = np.flatnonzero(self._links.ends[: self._link_count, 0] >= 0)
        every = self.link_rows
        return MapChange(
            stamp_ns, self._count, self.current_id, True,
            ExperienceRows(
                np.arange(self._count), self.template_ids.copy(), self.poses.copy(),
                self.components.copy(),
            ),
            LinkRows(
                every.ends[used], every.shapes[used], every.durations_s[used],
                every.confidences[used], every.counts[used], every.recognised[used],
                tuple(every.behaviours[row] for row in used.tolist()),
            ),
            pending=self.pending,
        )

    def _resize(self, count: int) -> None:
        room = len(self._template_ids)
        if count > room:
            more = max(count, 2 * room) - room
            self._template_ids = np.append(self._template_ids, np.full(more, -1))
            self._poses = np.append(self._poses, np.full((more, 3), np.nan), axis=0)
            self._components = np.append(self._components, np.zeros(more, np.int64))
            self._versions = np.append(self._versions, np.full(more, self.version))
        self._count = count

    def _set_links(self, links: LinkRows) -> None:
        if not len(links):
            return
        keys = [*zip(*links.ends.T.tolist(), strict=True)]
        new = [ends for ends in dict.fromkeys(keys) if ends not in self._rows]
        first = self._link_count
        self._add_rows(max(len(new) - len(self._free), 0))
        free = self._free[len(self._free) - min(len(self._free), len(new)) :][::-1]
        del self._free[len(self._free) - len(free) :]
        self._rows.update(zip(new, [*free, *range(first, self._link_count)], strict=True))
        row_list = [self._rows[ends] for ends in keys]
        for row, behaviour in zip(row_list, links.behaviours, strict=True):
            self._behaviours[row] = behaviour
        rows = np.array(row_list)
        mine = self._links
        mine.ends[rows], mine.shapes[rows] = links.ends, links.shapes
        mine.durations_s[rows], mine.confidences[rows] = links.durations_s, links.confidences
        mine.counts[rows], mine.recognised[rows] = links.counts, links.recognised
        self._link_versions[rows] = self.version

    def _add_rows(self, count: int) -> None:
        need, room = self._link_count + count, len(self._links.ends)
        if need > room:
            more = max(64, room, need - room)
            old = self._links
            self._links = LinkRows(
                np.append(old.ends, np.full((more, 2), -1), axis=0),
                np.append(old.shapes, np.zeros((more, 3)), axis=0),
                np.append(old.durations_s, np.zeros(more)),
                np.append(old.confidences, np.zeros(more)),
                np.append(old.counts, np.zeros(more, np.int64)),
                np.append(old.recognised, np.zeros(more, np.bool_)),
            )
            self._link_versions = np.append(self._link_versions, np.zeros(more, np.int64))
        self._link_count = need
        self._behaviours += [''] * count


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
        self, experience_map: ExperienceMap, stamp_ns: int, limit: int = UNLIMITED
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
        rows = self._experiences.take(left - min(self._links.pending, left // 2))
        experiences = self._experience_rows(rows)
        links = self._link_rows(experience_map, self._links.take(left - len(rows)))
        return MapChange(
            stamp_ns, len(experience_map), experience_map.current_id, is_restart, experiences,
            links, np.array(removed, np.int64).reshape(-1, 2),
            unseen + self._experiences.pending + self._links.pending + len(self._removed),
        )

    def _begin(self) -> None:
        self._experiences = SentRows(POSE_TOLERANCES, rounded=3)
        self._links = SentRows(LINK_TOLERANCES, rounded=5)
        self._removed: list[tuple[int, int]] = []
        self._labels: list[object] = []
        self._replacements = self._merges = 0
        self._ends = np.empty((0, 2), np.int64)
        self._serials = np.empty(0, np.int64)
        self._notes: list[tuple[str, int]] = []
        self._behaviours = {'': 0}
        self._links_version = -1
        self._deletions = 0
        self._time_outs = np.empty(0, np.int64)
        self._shares = np.empty(0)

    def _compare_experiences(self, graph: ExperienceGraph, limit: int) -> int:
        """Compare the experiences; return the number of those that were not looked at.

        A change contains no more than ``limit`` of them, so that many more are looked at in each
        call. A restart on a large map thus takes no longer than any other change.
        """
        known = len(self._labels)
        count = min(len(graph), known + limit)
        labels, poses = graph.labels, graph.poses[:count].T
        now = self._experiences.resize(count, len(graph))
        has_changed = count > known or not np.array_equal(poses, now[:3])
        for row in range(known, count):
            now[3, row], now[4, row] = labels[row][0], graph.component_of(row)
        self._labels.extend(labels[known:count])
        if graph.replacement_count != self._replacements or graph.merge_count != self._merges:
            self._replacements, self._merges = graph.replacement_count, graph.merge_count
            has_changed = True
            for row in _differing(labels, self._labels):
                self._labels[row], now[3, row] = labels[row], labels[row][0]
            now[4] = graph.components[:count]
        if has_changed:
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
        time_outs, shares = links.failures[:count, TIMED_OUT], links.shares[:count]
        is_same = links.version == self._links_version
        if is_same and count == known and (
            np.array_equal(time_outs, self._time_outs) and np.array_equal(shares, self._shares)
        ):
            return len(links) - count
        self._links_version = links.version
        self._time_outs, self._shares = time_outs.copy(), shares.copy()
        changed = [] if is_same else _differing(links.notes, self._notes)
        if count > known:
            changed += range(known, count)
            self._serials = np.append(self._serials, links.serials[known:count])
            self._ends = np.append(self._ends, links.ends[known:count], axis=0)
            self._notes.extend(links.notes[known:count])
        now = self._links.resize(count, len(links))
        for row in changed:
            self._notes[row] = behaviour, number = links.notes[row]
            code = self._behaviours.setdefault(behaviour, len(self._behaviours))
            now[5, row], now[7, row] = number, code
        now[:3] = links.shapes[:count].T
        now[3] = links.durations_s[:count]
        now[4] = link_confidences(self._ends[:, 0], now[7].astype(np.int64), now[5], time_outs)
        now[4] *= shares
        now[6] = links.recognised[:count]
        self._links.compare()
        return len(links) - count

    def _delete(self, serials: Ids) -> None:
        """Delete the rows of links that do not exist any more; ``serials``: of those that do."""
        kept = np.isin(self._serials, serials, assume_unique=True)
        gone = self._ends[~kept & self._links.was_sent].tolist()
        self._removed.extend((source, target) for source, target in gone)
        self._links.keep(kept)
        self._serials, self._ends = self._serials[kept], self._ends[kept]
        self._notes = list(compress(self._notes, kept.tolist()))

    def _experience_rows(self, rows: Ids) -> ExperienceRows:
        if not len(rows):
            return ExperienceRows()
        sent = self._experiences.sent(rows)
        template_ids, components = sent[3:].astype(np.int64)
        return ExperienceRows(rows, template_ids, np.ascontiguousarray(sent[:3].T), components)

    def _link_rows(self, graph: ExperienceGraph, rows: Ids) -> LinkRows:
        if not len(rows):
            return LinkRows()
        sent = self._links.sent(rows)
        return LinkRows(
            self._ends[rows], np.ascontiguousarray(sent[:3].T), sent[3], sent[4],
            sent[5].astype(np.int64), sent[6] > 0.0,
            tuple(self._notes[row][0] for row in rows.tolist()),
        )


def _differing(now: Sequence[object], before: Sequence[object]) -> list[int]:
    """Return the rows at which two lists, of which the first may be longer, differ."""
    return np.flatnonzero(
        np.fromiter(map(is_not, now, before), np.bool_, len(before))
    ).tolist()
