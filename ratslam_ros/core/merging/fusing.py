# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Fusing: remove what several sessions learned of the same place, so that a map grows with places.

A template is a duplicate if it matches one of an earlier session, and both were learned within two
view spacings on the merged map. An experience is a duplicate if its template is one, and if the
pose cells would take the robot there to be at an experience of an earlier session: it is closer
than ``exp_delta_pc_threshold``. An experience that differs in one of them stays: it is a place
between the known ones, or another view of a known one, and each of them can be recognised.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from ratslam_ros.core.common.angles import wrap
from ratslam_ros.core.common.pose import Pose, composed, inverse
from ratslam_ros.core.mapping.links import Link
from ratslam_ros.core.merging.consistency import wrapped
from ratslam_ros.core.merging.joining import Joiner
from ratslam_ros.core.merging.joint_map import JointMap, is_same_place

Reals = NDArray[np.float64]

AT_ITSELF = Pose(0.0, 0.0, 0.0)
"""Offset of an experience that is no duplicate."""


@dataclass(frozen=True)
class Fused:
    """The experiences and templates that remain.

    Attributes:
        kept: number on the joint map of each remaining experience, by its new id.
        id_of: new id of each experience of the joint map: of itself, or of the one it equals.
        offset_of: pose of each experience of the joint map in the frame of that experience.
        templates: number of a session and its template -> merged template.
        learned: number of the session and template of each merged template, by its id.
        links: links of the remaining experiences, by their new ids.
    """

    kept: tuple[int, ...]
    id_of: tuple[int, ...]
    offset_of: tuple[Pose, ...]
    templates: dict[tuple[int, int], int]
    learned: tuple[tuple[int, int], ...]
    links: tuple[Link, ...]


def fuse(joint: JointMap, joiner: Joiner) -> Fused:
    """Find the duplicates, and connect the remaining experiences.

    Args:
        joint: the maps of all sessions.
        joiner: the joins, and the poses of all experiences with them.
    """
    duplicates = _duplicate_templates(joint, joiner)
    templates: dict[tuple[int, int], int] = {}
    learned: list[tuple[int, int]] = []
    for number, session in enumerate(joint.sessions):
        if session.encoding != joint.sessions[0].encoding:
            continue
        for template_id in sorted(session.local_view.template_ids.tolist()):
            key = number, template_id
            if key in duplicates:
                templates[key] = templates[duplicates[key]]
            else:
                templates[key] = len(learned)
                learned.append(key)
    stand_in = _stand_ins(joint, joiner, duplicates)
    kept = tuple(number for number, one in enumerate(stand_in) if number == one)
    new_id = {number: one for one, number in enumerate(kept)}
    id_of = tuple(new_id[one] for one in stand_in)
    poses = [Pose(*row) for row in joiner.poses.tolist()]
    offsets = tuple(
        AT_ITSELF if one == number else composed(inverse(poses[one]), poses[number])
        for number, one in enumerate(stand_in)
    )
    links: dict[tuple[int, int], Link] = {}
    joined = [joint.join_link(one) for join in joiner.joins for one in join.correspondences]
    for link in [*joint.links, *joined]:
        moved = _moved(link, id_of, offsets)
        ends = moved.source_id, moved.target_id
        if ends[0] != ends[1]:
            links[ends] = _combined(links[ends], moved) if ends in links else moved
    return Fused(kept, id_of, offsets, templates, tuple(learned), tuple(links.values()))


def _duplicate_templates(
    joint: JointMap, joiner: Joiner
) -> dict[tuple[int, int], tuple[int, int]]:
    """Return the templates that match one of an earlier session at the same place.

    Session and template -> the earliest session with a match, and its template.
    """
    poses: dict[tuple[int, int], list[tuple[int, Pose]]] = {}
    for number, session in enumerate(joint.sessions):
        for template, experience, offset in session.anchors:
            at = joint.starts[number] + experience
            pose = composed(Pose(*joiner.poses[at].tolist()), offset)
            cluster = joiner.cluster_of[int(joint.part_of[at])]
            poses.setdefault((number, template), []).append((cluster, pose))
    spacing_m = joint.sessions[0].spacing_m
    duplicates: dict[tuple[int, int], tuple[int, int]] = {}
    for known, seen in itertools.combinations(range(len(joint.sessions)), 2):
        if not joiner.are_joined(known, seen):
            continue
        for pair in joiner.pairs_of(known, seen):
            key = seen, pair.seen
            if key not in duplicates and any(
                cluster == other and is_same_place(pose, there, pair.relative_rad, spacing_m)
                for cluster, pose in poses.get((known, pair.known), ())
                for other, there in poses.get(key, ())
            ):
                duplicates[key] = known, pair.known
    return duplicates


def template_of(joint: JointMap, number: int) -> tuple[int, int]:
    """Return the session and template of an experience."""
    session, own_id = joint.owner(number)
    return session, int(joint.sessions[session].templates[own_id])


def _stand_ins(
    joint: JointMap, joiner: Joiner, duplicates: dict[tuple[int, int], tuple[int, int]]
) -> list[int]:
    """Return for each experience the one of an earlier session that it equals, or itself."""
    lengths, torus = joint.sessions[0].lengths, joint.sessions[0].torus
    limit, planes_per_cell = lengths.delta
    scale = planes_per_cell / lengths.cell_m
    cluster_of = np.array(joiner.cluster_of)[joint.part_of]
    poses = joiner.poses
    stand_in = list(range(len(joint)))
    is_kept = np.ones(len(joint), np.bool_)
    for number in range(joint.starts[1], len(joint)):
        if template_of(joint, number) not in duplicates:
            continue
        earlier = joint.starts[int(joint.session_of[number])]
        candidates = np.flatnonzero(
            is_kept[:earlier] & (cluster_of[:earlier] == cluster_of[number])
        )
        x_m, y_m, heading_rad = poses[number].tolist()
        there = poses[candidates]
        turned = wrapped(there[:, 2] - heading_rad)
        x, y, theta = (
            (there[:, 0] - x_m) * scale, (there[:, 1] - y_m) * scale,
            turned * torus.planes_per_rad,
        )
        squared = x * x + y * y + theta * theta
        if len(candidates) and squared.min() < limit * limit:
            stand_in[number] = int(candidates[squared.argmin()])
            is_kept[number] = False
    return stand_in


def _moved(link: Link, id_of: Sequence[int], offsets: Sequence[Pose]) -> Link:
    """Return a link of the joint map between the experiences that its ends equal."""
    relative = composed(
        composed(offsets[link.source_id], link.relative_pose), inverse(offsets[link.target_id])
    )
    source, target = id_of[link.source_id], id_of[link.target_id]
    if offsets[link.source_id] is AT_ITSELF and offsets[link.target_id] is AT_ITSELF:
        return replace(link, source_id=source, target_id=target)
    return _shaped(replace(link, source_id=source, target_id=target), relative)


def _combined(first: Link, again: Link) -> Link:
    """Return one link of two, each weighted by how often it was driven.

    A driven link is more precise than a recognition.
    """
    if first.recognised != again.recognised:
        return again if first.recognised else first
    share = again.count / (first.count + again.count)
    a, b = first.relative_pose, again.relative_pose
    pose = Pose(
        a.x_m + share * (b.x_m - a.x_m), a.y_m + share * (b.y_m - a.y_m),
        wrap(a.heading_rad + share * wrap(b.heading_rad - a.heading_rad)),
    )
    duration_s = first.duration_s + share * (again.duration_s - first.duration_s)
    return _shaped(
        replace(
            first, duration_s=duration_s, count=first.count + again.count,
            behaviour=first.behaviour or again.behaviour,
        ),
        pose,
    )


def _shaped(link: Link, relative: Pose) -> Link:
    x_m, y_m, turn_rad = relative
    return replace(
        link, distance_m=math.hypot(x_m, y_m), heading_rad=math.atan2(y_m, x_m),
        facing_rad=wrap(turn_rad),
    )
