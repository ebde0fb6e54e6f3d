# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Relocation by a laser: detect that the robot is not where the map has it, and find its place.

Views prove a relocation slowly, because single views are ambiguous. Scans contradict a wrong pose
at once: they do not fit those that were stored around it. Then the landmarks of the scans since
the contradiction began are matched with those of the map, without a prior. Candidates are aligned
with the stored scans. One is proven if all scans since then agree with it, and with no other
candidate nor the present pose. Not in the papers.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Callable
from typing import Any, Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ratslam_ros.core.common.angles import wrap
from ratslam_ros.core.common.pose import Pose, composed, inverse
from ratslam_ros.core.common.rows import listed
from ratslam_ros.core.common.saved import MAX_COUNT, Field, Saved, count
from ratslam_ros.core.common.state import State
from ratslam_ros.core.landmarks.features import BAR_SIZE
from ratslam_ros.core.landmarks.place_search import RelocalisationParameters
from ratslam_ros.core.landmarks.relocalisation import KnownFeatures, relocalise
from ratslam_ros.core.mapping.experience_map import ExperienceMap
from ratslam_ros.core.mapping.keyframes import Keyframe, landmarks_of, seen_landmarks
from ratslam_ros.core.mapping.map_update import MapUpdate
from ratslam_ros.core.mapping.place_landmarks import PlaceLandmarks, features_of
from ratslam_ros.core.mapping.place_scans import KNOWN_SHARE, Agreement, PlaceScans, is_proven
from ratslam_ros.core.mapping.scan_match import TURN_M_PER_RAD, VIEW_SD_M
from ratslam_ros.core.mapping.scan_matching import Observed, ScanMatcher
from ratslam_ros.core.pose_cells.map_action import NO_EXPERIENCE, MapAction
from ratslam_ros.core.pose_cells.map_relocation import MapRelocation
from ratslam_ros.core.vision.local_view import NO_TEMPLATE

KEYFRAME_M, KEYFRAME_RAD = 0.1, math.radians(15.0)
"""Motion between two keyframes: the scans that are compared and searched."""

MAX_KEYFRAME_COUNT, COMPARED_COUNT = 50, 12
"""Largest number of keyframes of a search, which is 5 m or two turns on the spot, and of those
that a candidate is compared with."""

SEARCH_INTERVAL = 3
"""Number of keyframes between two searches."""

RECENT_M = 1.5
"""Distance driven for which keyframes are kept while nothing is searched, for which a new
experience is not compared with the scans, as it would confirm any pose, and after which a
contradiction that nothing has refuted makes the robot lost."""

CONTRADICTING_SHARE, CONTRADICTING_COUNT = 0.6, 4
"""Share of matching beams below which a keyframe contradicts a pose, and number of such keyframes
that make the robot lost. At wrong places of a floor with corridors, the share is 0.05 to 0.75 with
a median of 0.2."""

DOUBTFUL_SHARE = 0.75
"""Share of matching beams of another candidate above which a place is ambiguous."""

LEAST_EVIDENCE_M = 1.0
"""Least distance after which a place is proven; turns count as ``TURN_M_PER_RAD`` says. After
0.3 m, one of 20 places that scans confirmed was wrong; after 1 m, none."""

PAIRS_COUNT = 3
"""Smallest number of landmarks that are matched."""

WHEN_LOST = RelocalisationParameters(
    pairs=PAIRS_COUNT, sample=2, error=0.02, share=0.3, unmapped=0.001
)
"""Search if the pose is certainly wrong. Doubtful candidates are wanted, as the scans decide."""

WHEN_DOUBTED = RelocalisationParameters()
"""Search if views contradict the pose. The robot may be in an unmapped region that resembles a
mapped one, so the landmarks have to prove the place by themselves."""

PRIOR_SD_M = 0.2
"""Standard deviation of the positions of candidates before their scans are aligned."""

TARGET_M = 0.8
"""Largest distance of the robot from the experience that it is relocated to."""

SAME_PLACE_M, SAME_PLACE_RAD = 0.5, 0.35
"""Two poses closer than this are one place."""

MAX_LOST_M = 40.0
"""Distance after which a lost robot is taken to be in an unmapped region."""

Outcome = Literal['found', 'here', 'ambiguous', 'rejected', 'not here', 'too little']


class Relocation(NamedTuple):
    """Result of a search.

    ``outcome``: `found`: the robot was relocated to ``experience_id``; `here`: the scans confirm
    the present pose; `ambiguous`: places look alike; `rejected`: scans or views contradict the
    candidates; `not here`: no place has the landmarks; `too little`: not enough was seen.
    ``reason``: in one line.
    """

    outcome: Outcome
    reason: str
    experience_id: int = NO_EXPERIENCE


def _are_tables(columns: int) -> Callable[[Any, State], bool]:
    return lambda tables, _: all(
        one.ndim == 2 and one.shape[1] == columns and one.dtype == np.float64 for one in tables
    )


class Relocator(Saved):
    """Landmarks of the map's experiences, recent scans, and the search for a lost robot."""

    SAVED = (
        Field('landmarks', 'landmarks', PlaceLandmarks),
        Field('misplaced', '', 'i8', ('',), 0, 'experiences',
              save=lambda own: sorted(own._misplaced | own._doubted)),
        Field('counts', 'counts', dict, save=dict, load=dict, fits=(
            'counts', lambda counts, _: all(isinstance(number, int) for number in counts.values())
        )),
        Field('present/misplaced', '_misplaced', 'i8', ('',), 0, 'experiences',
              save=sorted, load=lambda ids: set(ids.tolist())),
        Field('present/doubted', '_doubted', 'i8', ('',), 0, 'experiences',
              save=sorted, load=lambda ids: set(ids.tolist())),
        count('present/restarts', '_restarts'),
        Field('present/odometry', '', float, ('frames', 4),
              save=lambda own: [(*frame.odometry, frame.odometer_m) for frame in own._keyframes]),
        Field('present/points', '', list, fits=('arrays of points', _are_tables(2)),
              save=lambda own: [frame.points.copy() for frame in own._keyframes]),
        Field('present/landmarks', '', list,
              fits=('arrays of landmarks', _are_tables(BAR_SIZE)),
              save=lambda own: [frame.landmarks.copy() for frame in own._keyframes]),
        Field('present/views', '_views', float, ('', 6),
              save=lambda views: [(*odometry, *claimed) for odometry, claimed in views],
              make=lambda *view: (Pose(*view[:3]), Pose(*view[3:]))),
        Field('present/created', '', 'i8', ('created',), 0, 'experiences',
              save=lambda own: list(own._created)),
        Field('present/created_at_m', '', 'f8', ('created',), 0.0,
              save=lambda own: list(own._created.values())),
        Field('present/lost_m', '_lost_m', nullable=True),
        Field('present/counts', '_relocations _agreeing _contradicting _doubt_count _searched',
              int, (5,), 0, MAX_COUNT),
        Field('present/lengths_m', '_doubt_m _evidence_m', float, (2,)),
        Field('present/relocated_to', '_relocated_to', int, (), NO_EXPERIENCE, 'experiences'),
        Field('present/known', '', 'f8', ('', BAR_SIZE), -math.inf, nullable=True,
              save=lambda own: None if own._known is None else own._known[0]),
    )

    def __init__(self, experience_map: ExperienceMap, scan_matcher: ScanMatcher) -> None:
        self._map, self._matcher = experience_map, scan_matcher
        self._scans = PlaceScans(experience_map, scan_matcher)
        experience_map.on_pruned.append(self._on_pruned)
        self.landmarks = PlaceLandmarks()
        self.counts = {'requested': 0, 'found': 0, 'ambiguous': 0, 'rejected': 0}
        """Number of searches, and of their outcomes."""
        self._misplaced: set[int] = set()
        """Experiences created while the robot was lost: they lie in the wrong place."""
        self._known: tuple[NDArray[np.float64], KnownFeatures] | None = None
        self._restart()

    def _restart(self) -> None:
        """Discard what depends on the robot's path."""
        self._restarts = self._matcher.restarts
        self._keyframes: deque[Keyframe] = deque()
        self._views: deque[tuple[Pose, Pose]] = deque(maxlen=8)
        self._created: dict[int, float] = {}
        self._doubted: set[int] = set()
        self._lost_m: float | None = None
        self._relocations = 0
        self._agreeing = self._contradicting = self._doubt_count = self._searched = 0
        self._doubt_m = 0.0
        self._evidence_m = 0.0
        self._relocated_to = NO_EXPERIENCE

    @property
    def is_lost(self) -> bool:
        """Whether the scans contradict the present pose."""
        return self._lost_m is not None

    @property
    def confirms(self) -> bool:
        """Whether the last scans agree with those that were stored around the present pose."""
        return self._agreeing >= CONTRADICTING_COUNT

    def _restored(self, state: State) -> None:
        if 'present' not in state:  # merged
            self._misplaced = set(listed(state['misplaced']))
            self._restart()
            return
        present = state['present']
        self._keyframes.extend(
            Keyframe(Pose(*odometry), odometer_m, points, landmarks)
            for (*odometry, odometer_m), points, landmarks in zip(
                present['odometry'], present['points'], present['landmarks'], strict=True
            )
        )
        created, at_m = present['created'].tolist(), present['created_at_m'].tolist()
        self._created = dict(zip(created, at_m, strict=True))
        if present['known'] is not None:
            self._use_known(present['known'])

    def step(
        self, stamp_ns: int, action: MapAction, update: MapUpdate
    ) -> MapRelocation | None:
        """Process the scan at an action that the map has just executed.

        Args:
            stamp_ns: stamp of the action.
            action: the action.
            update: its result.

        Returns:
            Where the robot was relocated; None if it was not.
        """
        if self._matcher.restarts != self._restarts:
            self._restart()
        observed = self._matcher.observed(stamp_ns)
        if action.template_id != NO_TEMPLATE:
            is_new = action.action == 'create' and self._map.current_id == action.target_id
            if is_new:
                self._misplaced.discard(action.target_id)
                self._created[action.target_id] = self._map.odometer_m
                if self.is_lost:
                    self._doubted.add(action.target_id)
            if observed is not None:
                self._record_view(action, observed.odometry)
                self._observe(observed, is_new)
        number, self._relocated_to = self._relocated_to, NO_EXPERIENCE
        offset = None if number == NO_EXPERIENCE else self._map.seen_from(number)
        if offset is None:
            return None
        return MapRelocation(number, self._map.labels[number][0], offset)

    def _observe(self, observed: Observed, is_new: bool) -> None:
        """Process a scan: learn its landmarks, compare it with the map, and search."""
        odometry, odometer_m = observed.odometry, self._map.odometer_m
        moved_m = math.inf
        if self._keyframes:
            last = self._keyframes[-1].odometry
            away_m = math.dist(last[:2], odometry[:2])
            turned_rad = abs(wrap(odometry.heading_rad - last.heading_rad))
            if away_m >= KEYFRAME_M or turned_rad >= KEYFRAME_RAD:
                moved_m = away_m + TURN_M_PER_RAD * turned_rad
            elif is_new:
                moved_m = 0.0
            else:
                return
        landmarks = landmarks_of(observed)
        if is_new and not self.is_lost and self._contradicting == 0:
            self.landmarks.add(
                self._map.current_id, self._map.offset, landmarks, self._map.poses
            )
        if moved_m == 0.0:
            return
        if moved_m < math.inf:
            self._evidence_m += moved_m
        self._keyframes.append(Keyframe(odometry, odometer_m, observed.points, landmarks))
        self._compare()
        self._discard_old()
        if self._is_searching:
            self._searched += 1
            if self._searched % SEARCH_INTERVAL == 0:
                self.search()

    def _record_view(self, action: MapAction, odometry: Pose) -> None:
        """Record where a recognised view places the robot."""
        if action.action not in ('link', 'set') or (
            action.target_id in self._doubted or action.target_id in self._misplaced
        ):
            return
        if self._views and math.dist(self._views[-1][0][:2], odometry[:2]) < KEYFRAME_M:
            self._views.pop()
        claimed = composed(self._map.pose_of(action.target_id), action.relative_pose)
        self._views.append((odometry, claimed))

    def _on_pruned(self, experience_id: int, stand_in_id: int, pose: Pose) -> None:
        self.landmarks.hand_over(experience_id, stand_in_id, pose)
        self._misplaced.discard(experience_id)
        self._doubted.discard(experience_id)
        self._created.pop(experience_id, None)

    # Doubt

    @property
    def _is_searching(self) -> bool:
        gate = self._map.gate
        is_doubted = gate.rejecting or gate.accepts_next or self._is_apart
        return self.is_lost or (is_doubted and self._agreeing == 0)

    @property
    def _is_apart(self) -> bool:
        """Whether the robot is in a component that began after a gap of the odometry."""
        return self._map.component_of(NO_EXPERIENCE) != 0

    def _compare(self) -> None:
        """Compare the newest keyframe with what is expected at the robot's pose on the map."""
        graph, scans = self._map, self._scans
        kept_m = graph.odometer_m - RECENT_M
        if self._contradicting:
            self._doubt_count += 1
            kept_m = min(kept_m, self._doubt_m)
        self._created = {i: at_m for i, at_m in self._created.items() if at_m > kept_m}
        scans.component = graph.component_of(NO_EXPERIENCE)
        scans.excluded = self._misplaced | self._doubted
        if not self.is_lost:
            scans.excluded = scans.excluded | self._created.keys()
        pose, points = graph.pose, self._keyframes[-1].points
        agreement = scans.agreement([pose], [points])
        was_agreeing, self._agreeing = self._agreeing, 0
        if is_proven(agreement):
            self._contradicting, self._agreeing = 0, was_agreeing + 1
            if self.confirms:
                self._end()
        elif agreement.known_share >= KNOWN_SHARE and agreement.share < CONTRADICTING_SHARE:
            if scans.aligned(pose, points, VIEW_SD_M) is not None:
                self._contradicting = 0  # the map has drifted
            elif self._contradicting:
                self._contradicting += 1
            else:
                self._contradicting = self._doubt_count = 1
                self._doubt_m = self._keyframes[-1].odometer_m
        if self._contradicting and not self.is_lost and (
            self._contradicting >= CONTRADICTING_COUNT
            or graph.odometer_m - self._doubt_m > RECENT_M
        ):
            self._begin()

    def _begin(self) -> None:
        """Treat the robot as lost since the first contradicting keyframe."""
        while len(self._keyframes) > self._doubt_count:
            self._keyframes.popleft()
        since_m = self._lost_m = self._doubt_m
        self._doubted = {i for i, at_m in self._created.items() if at_m >= since_m}
        self.landmarks.remove_owned(self._doubted)
        self._relocations = self._map.gate.relocation_count
        self._views.clear()
        self._searched = 0
        self._evidence_m = 0.0

    def _end(self) -> None:
        """Treat the pose on the map as right."""
        if self.is_lost and self._map.gate.relocation_count > self._relocations:
            self._misplaced |= self._doubted
        self._doubted = set()
        self._lost_m = self._known = None

    def _discard_old(self) -> None:
        frames, odometer_m = self._keyframes, self._map.odometer_m
        is_kept = self._is_searching or self._contradicting > 0
        while len(frames) > MAX_KEYFRAME_COUNT or (
            not is_kept and frames[0].odometer_m < odometer_m - RECENT_M
        ):
            frames.popleft()
        if self._lost_m is not None and odometer_m - self._lost_m > MAX_LOST_M:
            self._end()

    # Search

    def search(self, is_lost: bool = False) -> Relocation:
        """Search for the robot's place, and relocate it if a place is proven.

        Args:
            is_lost: whether the present pose is certainly wrong, even if the scans do not
                contradict it.
        """
        self.counts['requested'] += 1
        result = self._search(is_lost or self.is_lost or self._map.gate.accepts_next)
        if result.outcome in self.counts:
            self.counts[result.outcome] += 1
        return result

    def _search(self, is_lost: bool) -> Relocation:
        graph, scans = self._map, self._scans
        if not self._keyframes:
            return Relocation('too little', 'there is no scan yet')
        scans.component = 0
        scans.excluded = self._misplaced | self._doubted
        here = None
        if not self._is_apart:
            here = self._checked(graph.pose, VIEW_SD_M)
            if here is not None and is_proven(here[1]):
                self._end()
                graph.gate.accepts_next = False
                return Relocation('here', 'the scans confirm the present pose', graph.current_id)
        seen = seen_landmarks(self._keyframes, self._map.odometer_m)
        if len(seen) < PAIRS_COUNT:
            return Relocation(
                'too little', f'{len(seen)} landmarks were seen twice in the last metres; '
                f'expected at least {PAIRS_COUNT}: drive on',
            )
        if self._evidence_m < LEAST_EVIDENCE_M:
            return Relocation('too little', 'the robot has hardly moved: drive on')
        parameters = WHEN_LOST if is_lost else WHEN_DOUBTED
        places = relocalise(
            seen, self._known_features(), parameters, self.counts['requested']
        ).places
        if not places:
            return Relocation('not here', 'no place of the map has the observed landmarks')
        proven: list[tuple[Pose, Agreement]] = []
        doubtful = int(here is not None and here[1].share >= DOUBTFUL_SHARE)
        for place in places:
            found = self._checked(place.pose, PRIOR_SD_M)
            if found is None or any(_is_same_place(found[0], other) for other, _ in proven):
                continue
            if is_proven(found[1]):
                proven.append(found)
            elif found[1].share >= DOUBTFUL_SHARE:
                doubtful += 1
        if not proven:
            return Relocation('rejected', f'the scans contradict all {len(places)} candidates')
        if len(proven) + doubtful > 1:
            return Relocation('ambiguous', f'{len(proven) + doubtful} places look alike')
        return self._offer(*proven[0])

    def _checked(self, pose: Pose, sd_m: float) -> tuple[Pose, Agreement] | None:
        """Align the newest keyframe at a pose, and compare all keyframes with the stored scans."""
        found = self._scans.aligned(pose, self._keyframes[-1].points, sd_m)
        if found is None:
            return None
        frames = list(self._keyframes)
        frames = frames[:: -(-len(frames) // COMPARED_COUNT)]
        to_now = inverse(self._keyframes[-1].odometry)
        poses = [composed(found[0], composed(to_now, frame.odometry)) for frame in frames]
        return found[0], self._scans.agreement(poses, [frame.points for frame in frames])

    def _offer(self, pose: Pose, agreement: Agreement) -> Relocation:
        """Offer a proven pose to the loop-closure gate."""
        graph = self._map
        target = self._scans.nearest(pose, TARGET_M)
        if target is None:
            return Relocation('not here', f'no experience is within {TARGET_M} m of the place')
        now = self._keyframes[-1].odometry
        views = [composed(claim, composed(inverse(at), now)) for at, claim in self._views]
        offset = composed(inverse(graph.pose_of(target)), pose)
        if not graph.relocate(target, offset, views):
            return Relocation('rejected', 'recognised views contradict the place')
        self._misplaced |= self._doubted
        self._end()
        self._contradicting = 0
        self._agreeing = CONTRADICTING_COUNT
        self._keyframes.clear()
        self._created.clear()
        self._relocated_to = target
        return Relocation(
            'found', f'{agreement.share:.0%} of the scans agree with experience {target}', target
        )

    def _known_features(self) -> KnownFeatures:
        """Return the map's landmarks, whose index is kept while they do not move."""
        graph, component = self._map, self._scans.component
        excluded = set(self._scans.excluded)
        if graph.component_count > 1 or self._is_apart:
            excluded.update(i for i, of in enumerate(graph.components) if of != component)
        placed = self.landmarks.on_map(graph.poses, excluded)
        if self._known is None or not _are_close(placed, self._known[0]):
            return self._use_known(placed)
        return self._known[1]

    def _use_known(self, placed: NDArray[np.float64]) -> KnownFeatures:
        self._known = placed, KnownFeatures(features_of(placed))
        return self._known[1]


def _are_close(a: NDArray[np.float64], b: NDArray[np.float64]) -> bool:
    return a.shape == b.shape and float(np.abs(a[:, :2] - b[:, :2]).max(initial=0.0)) < 0.02


def _is_same_place(a: Pose, b: Pose) -> bool:
    return (
        math.dist(a[:2], b[:2]) < SAME_PLACE_M
        and abs(wrap(a.heading_rad - b.heading_rad)) < SAME_PLACE_RAD
    )
