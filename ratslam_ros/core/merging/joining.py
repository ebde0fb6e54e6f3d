# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Joining: decide which parts of the sessions share places, and place them in one frame."""

from __future__ import annotations

import cmath
import itertools
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
from numpy.typing import NDArray

from ratslam_ros.core.common.pose import Pose, composed, inverse
from ratslam_ros.core.mapping.link_weights import MAX_DRIFT, VIEW_STD, VIEW_STD_RAD, reach_m
from ratslam_ros.core.mapping.loop_closure_gate import REQUIRED_COUNT
from ratslam_ros.core.merging.consistency import best_hypothesis, distinct_places, wrapped
from ratslam_ros.core.merging.joint_map import (
    FREE_ROTATION_RAD,
    Correspondence,
    JointMap,
    relative,
    residual,
)
from ratslam_ros.core.merging.scan_places import has_scans, measured, scan_correspondences
from ratslam_ros.core.merging.view_memory import TemplatePair
from ratslam_ros.core.vision.look_alikes import LOOK_ALIKE_RATE

Reals = NDArray[np.float64]
Ints = NDArray[np.int64]
PairsOf = Callable[[int, int], Sequence[TemplatePair]]

MIN_SHARE = 10.0 * LOOK_ALIKE_RATE
"""Smallest share of the overlapping places that are recognised. Two floors with the same plan and
some equal walls have up to 0.08, two visits of one place 0.3 to 0.98."""

SCAN_PLACES = 3
"""Number of different places that scans have to prove if views cannot be compared."""

GATED_DRIFT = 0.05
"""Largest error of a relative pose on a map with gated closures, in m per m of path; on others it
is MAX_DRIFT."""

A_COPY = 1
"""Number of places that suffice if one part has exact copies of half of the other's views: cameras
do not take the same image twice."""

UNMOVED = Pose(0.0, 0.0, 0.0)


@dataclass(frozen=True)
class Join:
    """Whether two parts share places.

    Attributes:
        known, seen: the parts.
        refused: why they are not joined; '' if they are.
        correspondences: pairs of experiences at shared places, empty if refused.
        transform: pose of the frame of the seen part in that of the known part.
        matched: number of matches of views or scans between the parts.
        place_count: number of different shared places, a view spacing apart.
        overlapping: number of places of the seen part that lie on the known part.
        share: share of these that are recognised.
        by: what the shared places were recognised by.
    """

    known: int
    seen: int
    refused: str = ''
    correspondences: tuple[Correspondence, ...] = ()
    transform: Pose = UNMOVED
    matched: int = 0
    place_count: int = 0
    overlapping: int = 0
    share: float = 0.0
    by: str = 'views'


class Joiner:
    """Compares the parts of a joint map, and places those that share places in one frame."""

    def __init__(self, joint: JointMap, pairs_of: PairsOf) -> None:
        """Prepare the comparison.

        Args:
            joint: the maps of all sessions.
            pairs_of: function of the numbers of two sessions that returns the matching templates;
                empty if their views cannot be compared.
        """
        self._joint, self.pairs_of = joint, pairs_of
        self.joins: list[Join] = []
        """Result for each pair of parts that have a match, the most certain first."""
        self.poses: Reals = joint.poses.copy()
        """(n, 3) poses of all experiences, relaxed; only those of one cluster are in one frame."""
        self.cluster_of: list[int] = list(range(len(joint.parts)))
        """Cluster of each part: the lowest of the parts that are joined with it."""

    def run(self) -> None:
        """Compare all parts and join them."""
        pairs = itertools.combinations(range(len(self._joint.parts)), 2)
        found = [self.compared(known, seen) for known, seen in pairs]
        found = [one for one in found if one.matched > 0]
        found.sort(key=lambda one: (one.refused != '', -one.place_count, one.known, one.seen))
        while True:
            self._place([one for one in found if not one.refused])
            accepted = [one for one in found if not one.refused]
            kept = [self._kept(one) for one in accepted]
            worst = min(
                (pair for pair in zip(accepted, kept, strict=True)
                 if 2 * len(pair[1].correspondences) < len(pair[0].correspondences)),
                key=lambda pair: len(pair[1].correspondences) / len(pair[0].correspondences),
                default=None,
            )
            if worst is None:
                break
            one = worst[0]
            reason = 'it contradicts more certain joins'
            found[found.index(one)] = replace(one, refused=reason, correspondences=())
        self.joins = kept + [one for one in found if one.refused]

    def are_joined(self, known: int, seen: int) -> bool:
        """Return whether parts of two sessions are in one frame."""
        clusters: list[set[int]] = [
            {self.cluster_of[part] for part, (owner, _) in enumerate(self._joint.parts)
             if owner == number}
            for number in (known, seen)
        ]
        return not clusters[0].isdisjoint(clusters[1])

    def compared(self, known: int, seen: int) -> Join:
        """Decide whether two parts share places: by views, and if they do not suffice by scans."""
        joint = self._joint
        numbers = joint.parts[known][0], joint.parts[seen][0]
        if numbers[0] == numbers[1]:
            return Join(known, seen)
        spacing_m = max(joint.sessions[number].spacing_m for number in numbers)
        views, required = self._by_views(known, seen)
        by_views = Join(known, seen, matched=len(views))
        if spacing_m <= 0.0:
            return replace(by_views, refused='the map is too small to have a view spacing')
        by_views = self._tested(by_views, views, views, required, spacing_m)
        if not by_views.refused:
            return by_views
        scans = scan_correspondences(joint, known, seen)
        if len(scans) == 0:
            return by_views
        by_scans = Join(known, seen, matched=len(scans), by='scans')
        by_scans = self._tested(by_scans, scans, [*scans, *views], SCAN_PLACES, spacing_m)
        return by_views if by_scans.refused and views else by_scans

    def _by_views(self, known: int, seen: int) -> tuple[list[Correspondence], int]:
        """Return the matches of views between two parts, and how many places have to agree."""
        joint = self._joint
        (number, component), (other, other_component) = joint.parts[known], joint.parts[seen]
        first, second = joint.sessions[number].first, joint.sessions[other].first
        pairs = [
            pair for pair in self.pairs_of(number, other)
            if (pair.known, component) in first and (pair.seen, other_component) in second
        ]
        views = joint.sessions[0].config.pose_cells.pc_vt_agree_views
        required = max(REQUIRED_COUNT, math.ceil(views))
        copies = sum(pair.sad == 0 for pair in pairs)
        if 2 * copies >= min(len(self._places(known)), len(self._places(seen))):
            required = A_COPY  # One session continued the map of the other.
        return [
            Correspondence(
                first[pair.known, component] + joint.starts[number],
                second[pair.seen, other_component] + joint.starts[other],
                Pose(0.0, 0.0, pair.relative_rad),
            )
            for pair in pairs
        ], required

    def _tested(
        self, join: Join, evidence: Sequence[Correspondence],
        correspondences: Sequence[Correspondence], required: int, spacing_m: float,
    ) -> Join:
        """Decide whether correspondences prove that two parts share places.

        Args:
            join: the parts.
            evidence: correspondences of one kind.
            correspondences: all that are used if the parts are joined.
            required: number of different places that have to agree.
            spacing_m: view spacing.
        """
        joint = self._joint
        drift = GATED_DRIFT if joint.parameters.exp_gate_closures else MAX_DRIFT
        places = self._places(join.known)
        hypothesis = best_hypothesis(joint, evidence, spacing_m, drift, places)
        count = 0 if hypothesis is None else hypothesis.place_count
        join = replace(join, place_count=count)
        if hypothesis is None or count < required:
            return replace(
                join, refused=f'{count} places agree, but at least {required} are required'
            )
        if hypothesis.is_by_chance and required > A_COPY:
            return replace(join, refused=f'{count} places agree, which is likely by chance')
        supporting = hypothesis.supporting
        if join.by == 'views':
            found = measured(joint, supporting)
            if 2 * found.fits < found.tried:
                return replace(join, refused=(
                    f'the scans fit at only {found.fits} of {found.tried} places that look alike'
                ))
            supporting = found.best()
        return self._checked(join, supporting, correspondences, spacing_m)

    def _checked(
        self, join: Join, supporting: Sequence[Correspondence],
        correspondences: Sequence[Correspondence], spacing_m: float,
    ) -> Join:
        """Relax the two parts together, and test how many of the overlapping places match."""
        joint = self._joint
        transform = _fit(joint.poses, supporting, spacing_m)
        poses = joint.poses.copy()
        members = joint.members(join.seen)
        _move(poses, members, transform)
        among = np.concatenate([joint.members(join.known), members])
        poses = joint.relaxed(poses, supporting, among)
        agreeing = [one for one in correspondences if self._agrees(poses, one, spacing_m)]
        links = tuple(one for one in agreeing if one.by_scan) + measured(
            joint, [
                one._replace(pose=relative(poses, one)) if has_scans(joint, one) else one
                for one in agreeing if not one.by_scan
            ],
        ).best()
        overlap = self._overlap(poses, join, spacing_m)
        recognised = {one.seen for one in agreeing if one.same_view} & overlap
        elsewhere = {
            one.seen for one in correspondences if one.same_view and one.seen in overlap
        } - recognised
        join = replace(
            join, overlapping=len(overlap), share=len(recognised) / max(len(overlap), 1),
            place_count=distinct_places(poses, [one.seen for one in agreeing], spacing_m),
            transform=transform,
        )
        if not self._is_comparable(join):
            return replace(join, share=1.0, correspondences=links)
        if len(elsewhere) > len(recognised):
            return replace(join, refused=(
                f'{len(recognised)} views are recognised at the same place, and {len(elsewhere)} '
                'elsewhere'
            ))
        if join.share < MIN_SHARE:
            return replace(join, refused=(
                f'{100.0 * join.share:.0f} % of the {len(overlap)} places that would be shared '
                f'are recognised, but at least {100.0 * MIN_SHARE:.0f} % are required'
            ))
        return replace(join, correspondences=links)

    def _is_comparable(self, join: Join) -> bool:
        """Return whether the views of two parts are encoded in the same way."""
        sessions = [self._joint.sessions[self._joint.parts[i][0]] for i in (join.known, join.seen)]
        return sessions[0].encoding == sessions[1].encoding

    def _overlap(self, poses: Reals, join: Join, spacing_m: float) -> set[int]:
        """Return the places of the seen part that lie at a place of the known part."""
        known = poses[self._places(join.known)]
        overlap = set()
        for number in self._places(join.seen).tolist():
            x_m, y_m, heading_rad = poses[number].tolist()
            turned = wrapped(known[:, 2] - heading_rad)
            near = np.hypot(known[:, 0] - x_m, known[:, 1] - y_m) <= spacing_m
            if np.any(near & (np.abs(turned) <= FREE_ROTATION_RAD)):
                overlap.add(number)
        return overlap

    def _places(self, part: int) -> Ints:
        """Return the experiences of a part at which templates were learned."""
        number, component = self._joint.parts[part]
        first = self._joint.sessions[number].first
        start = self._joint.starts[number]
        return np.array(
            sorted(one + start for (_, at), one in first.items() if at == component), np.int64
        )

    def _agrees(self, poses: Reals, one: Correspondence, spacing_m: float) -> bool:
        away_m, turned_rad = residual(poses, one)
        return away_m <= reach_m(0.0, 0.0, spacing_m) and turned_rad <= FREE_ROTATION_RAD

    def _kept(self, join: Join) -> Join:
        """Return a join without the correspondences that the whole map contradicts."""
        numbers = (self._joint.parts[part][0] for part in (join.known, join.seen))
        spacing_m = max(self._joint.sessions[number].spacing_m for number in numbers)
        agrees = partial(self._agrees, self.poses, spacing_m=spacing_m)
        return replace(join, correspondences=tuple(filter(agrees, join.correspondences)))

    def _place(self, joins: Sequence[Join]) -> None:
        """Place the parts in the frame of the first part that they are joined with, and relax."""
        joint = self._joint
        frames = [UNMOVED] * len(joint.parts)
        cluster = list(range(len(joint.parts)))
        for join in joins:
            here, there = cluster[join.known], cluster[join.seen]
            if here == there:
                continue
            moved, into = max(here, there), min(here, there)
            known = composed(frames[join.known], join.transform)
            change = composed(known, inverse(frames[join.seen]))
            if moved == here:
                change = inverse(change)
            for part, at in enumerate(cluster):
                if at == moved:
                    frames[part] = composed(change, frames[part])
                    cluster[part] = into
        poses = joint.poses.copy()
        for part, frame in enumerate(frames):
            if frame != UNMOVED:
                _move(poses, joint.members(part), frame)
        correspondences = [one for join in joins for one in join.correspondences]
        joined = [part for part, at in enumerate(cluster) if cluster.count(at) > 1]
        if joined:
            among = np.flatnonzero(np.isin(joint.part_of, joined))
            poses = joint.relaxed(poses, correspondences, among)
        self.poses, self.cluster_of = poses, cluster


def _move(poses: Reals, members: Ints, transform: Pose) -> None:
    for number in members.tolist():
        poses[number] = composed(transform, Pose(*poses[number].tolist()))


def _fit(poses: Reals, correspondences: Sequence[Correspondence], spacing_m: float) -> Pose:
    """Return the transform of the seen part that fits positions and headings best.

    Umeyama's method in the plane; headings count as much as their standard deviation justifies.
    """
    source, target, turns = [], [], 0j
    for one in correspondences:
        known, seen = Pose(*poses[one.known].tolist()), Pose(*poses[one.seen].tolist())
        there = composed(known, one.pose)
        source.append(complex(seen.x_m, seen.y_m))
        target.append(complex(there.x_m, there.y_m))
        turns += cmath.exp(1j * (there.heading_rad - seen.heading_rad))
    count = len(source)
    centre, goal = sum(source) / count, sum(target) / count
    product = sum(
        (a - centre).conjugate() * (b - goal) for a, b in zip(source, target, strict=True)
    )
    heading_rad = cmath.phase(product + (VIEW_STD / VIEW_STD_RAD * spacing_m) ** 2 * turns)
    moved = goal - cmath.exp(1j * heading_rad) * centre
    return Pose(moved.real, moved.imag, heading_rad)
