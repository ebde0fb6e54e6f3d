# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Relocation by a laser: detect that the robot is not where the map has it, and find its place.

Views prove a relocation slowly, because single views are ambiguous. Scans contradict a wrong pose
at once: they do not fit those that were stored around it. Then the landmarks of the scans since
the contradiction began are matched with those of the map, without a prior. Candidates are aligned
with the stored scans, and one is proven if the scans since then agree with it, and with no other
candidate. Not in the papers.
"""

from __future__ import annotations

import itertools
import math
from collections import deque
from collections.abc import Collection, Iterator, Sequence
from dataclasses import dataclass
from typing import Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ratslam_ros.core.common.angles import wrap
from ratslam_ros.core.common.pose import Pose, composed, inverse
from ratslam_ros.core.common.state import State
from ratslam_ros.core.config.line_extraction import LineExtractionParameters
from ratslam_ros.core.config.relocalisation import RelocalisationParameters
from ratslam_ros.core.landmarks.features import BAR_SIZE, Features
from ratslam_ros.core.landmarks.line_extraction import extract_landmarks
from ratslam_ros.core.landmarks.relocalisation import KnownFeatures, relocalise
from ratslam_ros.core.mapping.experience_map import ExperienceMap, MapUpdate
from ratslam_ros.core.mapping.icp import align
from ratslam_ros.core.mapping.place_landmarks import (
    DIRECTION_SD_RAD,
    LENGTH_SD_M,
    POSITION_SD_M,
    PlaceLandmarks,
    features_of,
    moved_landmark,
    nearest_same,
)
from ratslam_ros.core.mapping.scan_agreement import NO_BEAMS, Agreement, PlaceGrid
from ratslam_ros.core.mapping.scan_matching import (
    DRIFT_M2_PER_M,
    MAX_RANGE_M,
    VIEW_SD_M,
    Observed,
    ScanMatcher,
    transformed,
)
from ratslam_ros.core.pose_cells.map_action import NO_EXPERIENCE, MapAction
from ratslam_ros.core.vision.local_view import NO_TEMPLATE

KEYFRAME_M, KEYFRAME_RAD = 0.15, math.radians(15.0)
"""Motion of the robot between two keyframes: scans that are compared and searched."""

MAX_KEYFRAME_COUNT = 40
"""Largest number of keyframes of a search: 6 m, or two turns on the spot."""

RECENT_M = 1.5
"""Distance driven for which keyframes are kept while nothing is searched, and for which a new
experience is not compared with the scans: it would confirm any pose."""

AROUND_M, AROUND_COUNT = 2.5, 8
"""Distance and number of the experiences whose scans are expected at a place."""

SPREAD_M, SPREAD_RAD = 0.4, 0.5
"""Two of these experiences differ by one of these at least."""

VISIT_M, VISIT_COUNT = 30.0, 3
"""Distance driven between two visits to a place, and number of visits that are distinguished."""

KNOWN_SHARE = 0.5
"""Share of the beams that must end where the stored scans saw something for them to count."""

CONTRADICTING_SHARE, CONTRADICTING_COUNT = 0.6, 4
"""Share of matching beams below which a keyframe contradicts the place, and number of consecutive
keyframes after which the robot is lost. At wrong places of a floor with corridors the share is 0.05
to 0.75 with a median of 0.2, at the right one 0.9 to 1."""

PROVEN_SHARE, DOUBTFUL_SHARE = 0.9, 0.75
"""Share of matching beams that proves a candidate, and above which another candidate makes it
ambiguous."""

COMPARED_COUNT = 12
"""Largest number of keyframes that a candidate is compared with."""

TURN_M_PER_RAD, LEAST_EVIDENCE_M = 0.3, 1.0
"""Distance that turning by one rad counts as, and least distance after which a place is proven."""

PAIRS_COUNT = 3
"""Smallest number of landmarks that are matched."""

SEARCH = RelocalisationParameters(reloc_pairs=PAIRS_COUNT, reloc_sample=2, reloc_error=0.02, reloc_unmapped=0.001,
    reloc_share=0.3,
)
"""The scans decide, so that candidates may be doubtful."""

EXTRACTION = LineExtractionParameters(le_max_range_m=MAX_RANGE_M, le_min_length_m=0.25)
"""Corners of short walls count: a person is taken for a landmark once, but not twice."""

PRIOR_SD_M = 0.2
"""Standard deviation of the candidates' positions before their scans are aligned."""

TARGET_M = 0.8
"""Largest distance of the robot from the experience that it is relocated to."""

SAME_PLACE_M, SAME_PLACE_RAD = 0.5, 0.35
"""Two poses closer than this are one place."""

GIVE_UP_M = 40.0
"""Distance after which a lost robot that finds no place is taken to be in an unmapped region."""

Outcome = Literal['found', 'ambiguous', 'rejected', 'not here', 'too little', 'here']


class Relocation(NamedTuple):
    """Result of a search.

    ``outcome``: `found`: the robot was relocated to ``experience_id``, at ``offset`` in its frame;
    `here`: the scans confirm the present pose; `rejected`: views, or the scans, contradict all
    candidates; `too little`: not enough was seen. ``reason``: in one line.
    """

    outcome: Outcome
    reason: str
    experience_id: int = -1
    offset: Pose = Pose(0.0, 0.0, 0.0)


@dataclass(slots=True)
class _Keyframe:
    """A scan of the last metres: pose by odometry, points and landmarks in the robot's frame."""

    odometry: Pose
    odometer_m: float
    points: NDArray[np.float64]
    landmarks: NDArray[np.float64]


class Relocator:
    """Landmarks of the map's experiences, recent scans, and the search for a lost robot."""

    def __init__(self, experience_map: ExperienceMap, scan_matcher: ScanMatcher) -> None:
        self._map, self._matcher = experience_map, scan_matcher
        experience_map.on_pruned.append(self._on_pruned)
        self.landmarks = PlaceLandmarks()
        self.ghosts: set[int] = set()
        """Experiences created while the robot was lost: they lie in the wrong place."""
        self.counts = {'requested': 0, 'found': 0, 'ambiguous': 0, 'rejected': 0}
        """Number of searches, and of their outcomes."""
        self._known: tuple[NDArray[np.float64], KnownFeatures, frozenset[int]] | None = None
        self._restarts = scan_matcher.restarts
        self._restart()

    def _restart(self) -> None:
        self._keyframes: deque[_Keyframe] = deque()
        self._contradicting = 0
        self._agreeing = 0
        self._lost_m: float | None = None
        self._relocations = 0
        self._created: dict[int, float] = {}
        self._doubted: set[int] = set()
        self._views: deque[tuple[Pose, Pose]] = deque(maxlen=8)
        self._searched = 0
        self._evidence = 0.0

    @property
    def is_lost(self) -> bool:
        """Whether the scans contradict the present pose."""
        return self._lost_m is not None

    def state(self) -> State:
        """Return the landmarks and counts, for ``restore``; recent scans are not included."""
        return {
            'landmarks': self.landmarks.state(),
            'ghosts': sorted(self.ghosts | self._doubted),
            'counts': self.counts.copy(),
        }

    def restore(self, state: State) -> None:
        """Restore what ``state`` returned."""
        self.landmarks.restore(state['landmarks'])
        self.ghosts = set(state['ghosts'])
        self.counts = dict(state['counts'])
        self._restart()

    def step(self, stamp_ns: int, action: MapAction, update: MapUpdate) -> Relocation | None:
        """Process the scan at an action that the map has just executed.

        Args:
            stamp_ns: stamp of the action.
            action: the action.
            update: its result.

        Returns:
            The result of a search; None if there was none.
        """
        if self._matcher.restarts != self._restarts:
            self._restarts = self._matcher.restarts
            self._restart()
        if action.template_id == NO_TEMPLATE:
            return None
        observed = self._matcher.observed(stamp_ns)
        is_created = action.action == 'create' and self._map.current_id == action.target_id
        if is_created:
            self.ghosts.discard(action.target_id)
            self._created[action.target_id] = self._map.odometer_m
            if self.is_lost:
                self._doubted.add(action.target_id)
        if observed is None:
            return None
        points, odometry = observed.points, observed.odometry
        self._record_view(action, update, odometry)
        last = self._keyframes[-1].odometry if self._keyframes else None
        is_keyframe = last is None or (
            math.dist(last[:2], odometry[:2]) >= KEYFRAME_M
            or abs(wrap(odometry.heading_rad - last.heading_rad)) >= KEYFRAME_RAD
        )
        if not is_keyframe and not is_created:
            return None
        seen = _corners(observed)
        if is_created and not self.is_lost and self._contradicting == 0:
            self.landmarks.add(
                action.target_id, self._map.offset, seen, self._map.poses
            )
        if not is_keyframe:
            return None
        if last is not None:
            self._evidence += math.dist(last[:2], odometry[:2]) + TURN_M_PER_RAD * abs(
                wrap(odometry.heading_rad - last.heading_rad)
            )
        self._keyframes.append(_Keyframe(odometry, self._map.odometer_m, points, seen))
        self._judge()
        self._trim()
        if self._is_searching():
            self._searched += 1
            if self._searched % 2 == 0:
                return self.search(odometry)
        return None

    def _record_view(self, action: MapAction, update: MapUpdate, odometry: Pose) -> None:
        """Record where a recognised view places the robot."""
        if action.action not in ('link', 'set') or action.target_id in self._doubted | self.ghosts:
            return
        if self._views and math.dist(self._views[-1][0][:2], odometry[:2]) < KEYFRAME_M:
            self._views.pop()
        claimed = composed(self._map.pose_of(action.target_id), action.relative_pose)
        self._views.append((odometry, claimed))

    def _on_pruned(self, experience_id: int, stand_in_id: int, pose: Pose) -> None:
        self.landmarks.hand_over(experience_id, stand_in_id, pose)
        self.ghosts.discard(experience_id)
        self._doubted.discard(experience_id)
        self._created.pop(experience_id, None)

    # Doubt

    def _judge(self) -> None:
        """Compare the newest keyframe with what is expected at the robot's pose on the map."""
        odometer_m, pose = self._map.odometer_m, self._map.pose
        if self._lost_m is None:
            recent_m = odometer_m - RECENT_M
            self._created = {i: at for i, at in self._created.items() if at > recent_m}
        excluded = self.ghosts | self._doubted | (
            set() if self.is_lost else set(self._created)
        )
        agreement = self._agreement_at(pose, excluded, [self._keyframes[-1]])
        if agreement.known_share < KNOWN_SHARE:
            return
        if agreement.share >= PROVEN_SHARE:
            self._contradicting = 0
            self._agreeing += 1
            if self._agreeing >= CONTRADICTING_COUNT:
                self._end()
            return
        if agreement.share >= CONTRADICTING_SHARE:
            return
        self._agreeing = 0
        if self._aligned(pose, excluded, VIEW_SD_M) is not None:
            self._contradicting = 0  # the map has drifted
            return
        self._contradicting += 1
        if not self.is_lost and self._contradicting >= CONTRADICTING_COUNT:
            self._begin()

    def _begin(self) -> None:
        """Treat the robot as lost since the first of the contradicting keyframes."""
        while len(self._keyframes) > self._contradicting:
            self._keyframes.popleft()
        since_m = self._lost_m = self._keyframes[0].odometer_m
        self._doubted = {i for i, at in self._created.items() if at >= since_m}
        self.landmarks.remove_owned(self._doubted)
        self._views.clear()
        self._evidence = 0.0
        self._relocations = self._map.gate.relocation_count
        self._searched = 0

    def _end(self) -> None:
        """The scans agree with the present pose."""
        if self._lost_m is not None and self._map.gate.relocation_count > self._relocations:
            self.ghosts |= self._doubted
        self._doubted = set()
        self._lost_m = None
        self._known = None

    def _trim(self) -> None:
        frames = self._keyframes
        while len(frames) > MAX_KEYFRAME_COUNT or (
            not self._is_searching() and frames[0].odometer_m < self._map.odometer_m - RECENT_M
        ):
            frames.popleft()
        if self._lost_m is not None and self._map.odometer_m - self._lost_m > GIVE_UP_M:
            self._end()

    def _is_searching(self) -> bool:
        gate = self._map.gate
        return self.is_lost or (
            (gate.rejecting or gate.accepts_next) and self._agreeing == 0
        )

    # Search

    def search(self, odometry: Pose | None = None) -> Relocation:
        """Search for the robot's place now, and relocate it if a place is proven."""
        self.counts['requested'] += 1
        result = self._search()
        if result.outcome in self.counts:
            self.counts[result.outcome] += 1
        return result

    def _search(self) -> Relocation:
        excluded = self.ghosts | self._doubted
        here = self._checked(self._map.pose, excluded, VIEW_SD_M)
        if here is not None and here[1].share >= PROVEN_SHARE:
            self._end()
            return Relocation(
                'here', 'the scans confirm the present pose', self._map.current_id,
                self._map.offset,
            )  # fmt: skip
        seen = self._seen()
        if len(seen) < PAIRS_COUNT:
            return Relocation(
                'too little', f'{len(seen)} landmarks were seen twice in the last metres; expected '
                f'at least {PAIRS_COUNT}: drive on',
            )  # fmt: skip
        if self._evidence < LEAST_EVIDENCE_M:
            return Relocation('too little', 'the robot has hardly moved: drive on')
        places = relocalise(
            seen, self._known_features(excluded), SEARCH, self.counts['requested']
        ).places
        proven: list[tuple[Pose, Agreement]] = []
        doubtful = 0 if here is None else int(here[1].share >= DOUBTFUL_SHARE)
        for place in places:
            found = self._checked(place.pose, excluded)
            if found is None or any(_is_same_place(found[0], other) for other, _ in proven):
                continue
            if found[1].share >= PROVEN_SHARE and found[1].known_share >= KNOWN_SHARE:
                proven.append(found)
            elif found[1].share >= DOUBTFUL_SHARE:
                doubtful += 1
        if not places:
            return Relocation('not here', 'no place of the map has the observed landmarks')
        if not proven:
            return Relocation('rejected', f'the scans contradict {len(places)} candidates')
        if len(proven) > 1 or doubtful:
            return Relocation('ambiguous', f'{len(proven) + doubtful} places look alike')
        return self._offer(*proven[0], excluded)

    def _offer(self, pose: Pose, agreement: Agreement, excluded: Collection[int]) -> Relocation:
        graph = self._map
        target = self._nearest(pose, excluded)
        if target is None:
            return Relocation('not here', 'no experience is near the place')
        now = self._keyframes[-1].odometry
        views = [
            composed(claim, composed(inverse(there), now)) for there, claim in self._views
        ]
        offset = composed(inverse(graph.pose_of(target)), pose)
        if not graph.relocate(target, offset, views):
            return Relocation('rejected', 'views contradict the place')
        self._matcher.relocated()
        self.ghosts |= self._doubted
        self._relocations = -1
        self._end()
        self._contradicting = self._agreeing = 0
        self._keyframes.clear()
        self._created.clear()
        return Relocation(
            'found', f'experience {target}: {agreement.share:.0%} of the scans agree', target,
            offset,
        )  # fmt: skip

    def _seen(self) -> Features:
        """Return the landmarks of the keyframes in the robot's frame."""
        now, odometer_m = self._keyframes[-1].odometry, self._map.odometer_m
        means = np.empty((0, BAR_SIZE))
        counts: list[int] = []
        last_m: list[float] = []
        for frame in self._keyframes:
            to_now = composed(inverse(now), frame.odometry)
            for row in frame.landmarks.tolist():
                shape = moved_landmark(to_now, tuple(row))
                k = nearest_same(means, shape)
                if k < 0:
                    means = np.concatenate([means, [shape]])
                    counts.append(1)
                    last_m.append(frame.odometer_m)
                    continue
                counts[k] += 1
                last_m[k] = frame.odometer_m
                change = np.array(shape) - means[k]
                change[2] = wrap(float(change[2]))
                means[k] += change / counts[k]
        kept = [k for k, count in enumerate(counts) if count >= 2]
        variances = np.tile(
            np.array([POSITION_SD_M, POSITION_SD_M, DIRECTION_SD_RAD, LENGTH_SD_M]) ** 2,
            (len(kept), 1),
        )
        for row, k in enumerate(kept):
            variances[row, :2] += DRIFT_M2_PER_M * (odometer_m - last_m[k])
        return features_of(means[kept], variances)

    def _known_features(self, excluded: Collection[int]) -> KnownFeatures:
        """Return the map's landmarks; the index is kept until the map moves."""
        poses = self._map.poses
        left_out = frozenset(excluded)
        known = self._known
        if known is None or len(known[0]) > len(poses) or known[2] != left_out or (
            np.abs(known[0] - poses[: len(known[0])]).max(initial=0.0) > 0.02
        ):
            known = poses, KnownFeatures(self.landmarks.features(poses, left_out)), left_out
            self._known = known
        return known[1]

    def _aligned(
        self, pose: Pose, excluded: Collection[int], sd_m: float
    ) -> tuple[Pose, Agreement] | None:
        """Align the newest keyframe with the stored scans around a pose.

        Returns:
            The pose, and the agreement of the keyframe there; None if no alignment is proven.
        """
        frame = self._keyframes[-1]
        for around in self._visits([pose], excluded):
            origin = self._map.pose_of(around[0])
            reference = np.concatenate([
                transformed(scan, composed(inverse(origin), at)) for at, scan in self._scans(around)
            ])
            found = align(reference, frame.points, composed(inverse(origin), pose), sd_m)
            if found is None:
                continue
            at = composed(origin, found.pose)
            agreement = PlaceGrid(self._scans(around), at.x_m, at.y_m).agreement(frame.points, at)
            if agreement.share >= PROVEN_SHARE and agreement.known_share >= KNOWN_SHARE:
                return at, agreement
        return None

    def _checked(
        self, pose: Pose, excluded: Collection[int], sd_m: float = PRIOR_SD_M
    ) -> tuple[Pose, Agreement] | None:
        """Align a candidate with the stored scans, and compare it with the keyframes."""
        found = self._aligned(pose, excluded, sd_m)
        if found is None:
            return None
        frames = list(self._keyframes)
        step = -(-len(frames) // COMPARED_COUNT)
        return found[0], self._agreement_at(found[0], excluded, frames[::-1][::step][::-1])

    def _agreement_at(
        self, pose: Pose, excluded: Collection[int], frames: Sequence[_Keyframe]
    ) -> Agreement:
        """Compare keyframes with the stored scans if the robot is at a pose now.

        Of the visits to the place, the one that agrees best counts: their scans differ by the
        drift of the map.
        """
        now = frames[-1].odometry
        poses = [composed(pose, composed(inverse(now), frame.odometry)) for frame in frames]
        best = NO_BEAMS
        for around in self._visits([poses[-1], poses[len(poses) // 2], poses[0]], excluded):
            grid = PlaceGrid(self._scans(around), pose.x_m, pose.y_m)
            total = NO_BEAMS
            for frame, at in zip(frames, poses, strict=True):
                total = total.plus(grid.agreement(frame.points, at))
            if total.known_share < KNOWN_SHARE:
                if best == NO_BEAMS:
                    best = total
            elif best.known_share < KNOWN_SHARE or total.share > best.share:
                best = total
            if best.share >= PROVEN_SHARE and best.known_share >= KNOWN_SHARE:
                break
        return best

    # Stored scans

    def _scans(
        self, experience_ids: Sequence[int]
    ) -> list[tuple[Pose, NDArray[np.float32]]]:
        return [
            (self._map.pose_of(i), scan) for i in experience_ids
            if (scan := self._matcher.reference(i)) is not None
        ]  # fmt: skip

    def _visits(
        self, poses: Sequence[Pose], excluded: Collection[int]
    ) -> Iterator[list[int]]:
        """Return the experiences around poses: all of them, then those of each visit."""
        graph = self._map
        near = [
            i for pose in poses for i in self._by_distance(pose, AROUND_M)
            if i not in excluded and self._matcher.reference(i) is not None
        ]  # fmt: skip
        near = list(dict.fromkeys(near))
        if not near:
            return
        most = AROUND_COUNT * len(set(poses))
        yield self._spread(near, most)
        by_time = sorted(near, key=graph.created_at_m)
        visits: list[list[int]] = [[]]
        for i in by_time:
            if visits[-1] and graph.created_at_m(i) - graph.created_at_m(visits[-1][-1]) > VISIT_M:
                visits.append([])
            visits[-1].append(i)
        if len(visits) > 1:
            rank = {i: n for n, i in enumerate(near)}
            visits.sort(key=lambda visit: min(rank[i] for i in visit))
            for visit in visits[:VISIT_COUNT]:
                yield self._spread(sorted(visit, key=rank.__getitem__), most)

    def _spread(self, experience_ids: Sequence[int], most: int) -> list[int]:
        """Return the first experiences of a list, without those close to others before them."""
        chosen: list[int] = []
        poses: list[Pose] = []
        for i in experience_ids:
            pose = self._map.pose_of(i)
            if all(
                math.dist(pose[:2], other[:2]) > SPREAD_M
                or abs(wrap(pose.heading_rad - other.heading_rad)) > SPREAD_RAD
                for other in poses
            ):
                chosen.append(i)
                poses.append(pose)
                if len(chosen) == most:
                    break
        return chosen

    def _nearest(self, pose: Pose, excluded: Collection[int]) -> int | None:
        """Return the nearest experience within ``TARGET_M`` of a pose."""
        return next((i for i in self._by_distance(pose, TARGET_M) if i not in excluded), None)

    def _by_distance(self, pose: Pose, most_m: float) -> list[int]:
        """Return the experiences near a pose in the robot's component, the nearest first."""
        graph = self._map
        poses = graph.poses
        away_m = np.hypot(poses[:, 0] - pose.x_m, poses[:, 1] - pose.y_m)
        near = np.flatnonzero(away_m < most_m)
        order: list[int] = near[np.argsort(away_m[near], kind='stable')].tolist()
        here = graph.component_of(NO_EXPERIENCE)
        return [i for i in order if graph.component_of(i) == here]


def _corners(observed: Observed) -> NDArray[np.float64]:
    """Return the corners and the ends of walls in a scan, (n, 4), as for ``PlaceLandmarks.add``.

    Whole walls are left out, because they repeat their ends.
    """
    found = extract_landmarks(observed.scan, EXTRACTION).without_walls
    rows = np.full((len(found), BAR_SIZE), math.nan)
    for row, (start, end) in zip(rows, itertools.pairwise(found.offsets.tolist()), strict=True):
        row[: end - start] = found.values[start:end]
        row[:] = moved_landmark(observed.scan_pose, tuple(row.tolist()))
    return rows


def _is_same_place(a: Pose, b: Pose) -> bool:
    return (
        math.dist(a[:2], b[:2]) < SAME_PLACE_M
        and abs(wrap(a.heading_rad - b.heading_rad)) < SAME_PLACE_RAD
    )
