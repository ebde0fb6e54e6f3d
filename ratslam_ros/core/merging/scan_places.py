# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Shared places by scans: measure those that views show, and find others by landmarks.

Finding a place is what a lost robot does: the landmarks around an experience of one map are
matched with all landmarks of the other one by joint compatibility, without a prior, and the scans
have to agree with those that are stored there. People who were there contradict some beams, so a
single place is only likely; several that are consistent with each other are proven.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ratslam_ros.core.common.pose import Pose, composed, inverse
from ratslam_ros.core.landmarks.relocalisation import KnownFeatures, relocalise
from ratslam_ros.core.mapping.icp import align
from ratslam_ros.core.mapping.place_landmarks import features_of, moved_landmark
from ratslam_ros.core.mapping.place_scans import KNOWN_SHARE, PlaceScans
from ratslam_ros.core.mapping.relocator import (
    COMPARED_COUNT,
    DOUBTFUL_SHARE,
    LEAST_EVIDENCE_M,
    PAIRS_COUNT,
    PRIOR_SD_M,
    TARGET_M,
    WHEN_DOUBTED,
)
from ratslam_ros.core.mapping.scan_match import VIEW_SD_M
from ratslam_ros.core.mapping.scan_matching import CONFIRMING_SD_M, MAX_RANGE_M
from ratslam_ros.core.merging.joint_map import Correspondence, JointMap

Reals = NDArray[np.float64]

QUERY_SPACING_M = 2.0
"""Distance between places that are looked for on the other map: a quarter of the range of a scan,
so that the landmarks of the next one are partly others."""

LEAST_PRECISE = 6
"""Number of places measured in every direction that suffice to join two maps: as many as views
that have to agree."""

MAX_QUERY_COUNT = 50
"""Number of places that are looked for; of more, evenly spaced ones."""


class Measured(NamedTuple):
    """Correspondences that scans do not contradict.

    ``precise``: measured by scans in every direction. ``loose``: not measured along a direction,
    such as the axis of a bare corridor, or there are no scans. ``fits``, ``tried``: numbers of
    alignments that fit and that were tried.
    """

    precise: tuple[Correspondence, ...]
    loose: tuple[Correspondence, ...]
    fits: int
    tried: int

    def best(self) -> tuple[Correspondence, ...]:
        """Return the precise ones, and all if they are few.

        Along a corridor, the others are off by up to half a metre, and all links of a map with
        scans have the same weight.
        """
        return self.precise if len(self.precise) >= LEAST_PRECISE else self.precise + self.loose


def has_scans(joint: JointMap, one: Correspondence) -> bool:
    """Return whether both experiences have scans."""
    return _scan(joint, one.known) is not None and _scan(joint, one.seen) is not None


def measured(joint: JointMap, correspondences: Sequence[Correspondence]) -> Measured:
    """Align the scans of experiences whose views match; their poses are the priors."""
    precise: list[Correspondence] = []
    loose: list[Correspondence] = []
    fits = tried = 0
    for one in correspondences:
        known, seen = _scan(joint, one.known), _scan(joint, one.seen)
        if known is None or seen is None:
            loose.append(one)
            continue
        tried += 1
        found = align(known, seen.astype(np.float64), one.pose, VIEW_SD_M)
        if found is not None:
            fits += 1
            is_precise = found.unconstrained_m2 < CONFIRMING_SD_M**2
            aligned = one._replace(pose=found.pose, by_scan=True)
            (precise if is_precise else loose).append(aligned)
    return Measured(tuple(precise), tuple(loose), fits, tried)


def scan_correspondences(joint: JointMap, known: int, seen: int) -> list[Correspondence]:
    """Find places of one part on another one by landmarks and scans.

    Args:
        joint: the maps of all sessions.
        known, seen: the parts.
    """
    number, component = joint.parts[known]
    session = joint.sessions[number]
    landmarks = _landmarks(joint, known)
    if len(landmarks) < PAIRS_COUNT or len(_landmarks(joint, seen)) < PAIRS_COUNT:
        return []
    features = KnownFeatures(features_of(landmarks))
    places = PlaceScans(session.graph, session.scans)
    places.component, places.excluded = component, session.misplaced
    found = []
    for at in _queries(joint, seen):
        pose = _located(joint, at, _landmarks(joint, seen), features, places)
        target = None if pose is None else places.nearest(pose, TARGET_M)
        if pose is not None and target is not None:
            there = target + joint.starts[number]
            offset = composed(inverse(joint.pose_of(there)), pose)
            found.append(Correspondence(there, at, offset, same_view=False, by_scan=True))
    return found


def _queries(joint: JointMap, part: int) -> list[int]:
    """Return experiences of a part with scans, evenly spaced over its places."""
    kept: list[int] = []
    for at in _with_scans(joint, part):
        pose = joint.pose_of(at)
        if all(math.dist(pose[:2], joint.pose_of(one)[:2]) >= QUERY_SPACING_M for one in kept):
            kept.append(at)
    return kept[:: -(-len(kept) // MAX_QUERY_COUNT)] if kept else []


def _located(
    joint: JointMap, at: int, landmarks: Reals, features: KnownFeatures, places: PlaceScans
) -> Pose | None:
    """Return the pose of an experience on the map of another part, None if it is unclear."""
    own = joint.pose_of(at)
    to_frame = inverse(own)
    seen = np.array([moved_landmark(to_frame, shape) for shape in landmarks.tolist()])
    seen = seen[np.hypot(seen[:, 0], seen[:, 1]) < MAX_RANGE_M]
    if len(seen) < PAIRS_COUNT:
        return None
    candidates = relocalise(features_of(seen), features, WHEN_DOUBTED, seed=0).places
    away_m = {
        one: math.dist(joint.pose_of(one)[:2], own[:2])
        for one in _with_scans(joint, int(joint.part_of[at]))
    }
    around = sorted(
        (one for one in away_m if away_m[one] <= LEAST_EVIDENCE_M), key=away_m.__getitem__
    )[:COMPARED_COUNT]
    scans = [scan.astype(np.float64) for one in around if (scan := _scan(joint, one)) is not None]
    likely = []
    for candidate in candidates:
        to_there = composed(candidate.pose, to_frame)
        for one, points in zip(around, scans, strict=True):
            there = joint.pose_of(one)
            aligned = places.aligned(composed(to_there, there), points, PRIOR_SD_M)
            if aligned is not None:
                break
        else:
            continue
        pose = composed(aligned[0], composed(inverse(there), own))
        to_there = composed(pose, to_frame)
        poses = [composed(to_there, joint.pose_of(one)) for one in around]
        agreement = places.agreement(poses, scans)
        if agreement.share >= DOUBTFUL_SHARE and agreement.known_share >= KNOWN_SHARE:
            likely.append(pose)
    return likely[0] if len(likely) == 1 else None


def _with_scans(joint: JointMap, part: int) -> list[int]:
    """Return the experiences of a part that have scans, and lie where the robot was."""
    number, _ = joint.parts[part]
    misplaced = joint.sessions[number].misplaced
    return [
        at for at in joint.members(part).tolist()
        if at - joint.starts[number] not in misplaced and _scan(joint, at) is not None
    ]


def _landmarks(joint: JointMap, part: int) -> Reals:
    """Return the (n, 4) landmarks of a part, on the map of its session."""
    number, component = joint.parts[part]
    session = joint.sessions[number]
    others = np.flatnonzero(session.components != component).tolist()
    return session.landmarks.on_map(session.poses, {*others, *session.misplaced})


def _scan(joint: JointMap, number: int) -> NDArray[np.float32] | None:
    session, own_id = joint.owner(number)
    return joint.sessions[session].scans.reference(own_id)
