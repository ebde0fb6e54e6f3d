# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Experience map of a merged map: poses, links, scans, landmarks and named places."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ratslam_ros.core.common.pose import Pose, composed
from ratslam_ros.core.common.state import State
from ratslam_ros.core.mapping.links import Links
from ratslam_ros.core.mapping.loop_closure_gate import LoopClosureGate
from ratslam_ros.core.mapping.place_landmarks import PlaceLandmarks, moved_landmark
from ratslam_ros.core.mapping.scan_matching import transformed
from ratslam_ros.core.merging.fusing import Fused
from ratslam_ros.core.merging.joint_map import JointMap
from ratslam_ros.core.pose_cells.map_action import NO_EXPERIENCE
from ratslam_ros.core.pose_cells.torus import Place


def merged_experience_map(
    joint: JointMap, fused: Fused, poses: Sequence[Pose], components: Sequence[int],
    labels: Sequence[tuple[int, Place]], links: Links,
) -> State:
    """Return the state of the stage: the graph, and what any of the sessions has beside it.

    Args:
        joint: the maps of all sessions.
        fused: the experiences that remain.
        poses: their poses.
        components: component of each.
        labels: template and place in the pose cells of each.
        links: the links between them.
    """
    state: State = {
        'core': _merged_graph(joint, fused, poses, components, labels, links),
        'goals': _merged_goals(joint, fused),
    }
    parts = [one.session.states['experience_map'] for one in joint.sessions]
    if any('scans' in part for part in parts):
        state['scans'] = _merged_scans(joint, fused)
    if any('relocator' in part for part in parts):
        state['relocator'] = _merged_relocator(joint, fused, poses)
    return state


def _merged_graph(
    joint: JointMap, fused: Fused, poses: Sequence[Pose], components: Sequence[int],
    labels: Sequence[tuple[int, Place]], links: Links,
) -> State:
    """Return the state of the experience map; arguments as for ``merged_experience_map``."""
    odometers_m = [one.graph.odometer_m for one in joint.sessions]
    created_m = []
    for number in fused.kept:
        session, own_id = joint.owner(number)
        before_m = sum(odometers_m[:session])
        created_m.append(before_m + joint.sessions[session].graph.created_at_m(own_id))
    unlearned = {
        (fused.id_of[start + source], fused.id_of[start + target])
        for start, one in zip(joint.starts, joint.sessions, strict=False)
        for source, target in one.graph.unlearned_ends.tolist()
    }
    count = 1 + max(components)
    state: State = {
        'poses': np.array(poses, np.float64).reshape(-1, 3),
        'labels': [[template, *place] for template, place in labels],
        **links.state(),
        'components': {'current': count, 'gaps': count, 'experiences': list(components)},
        'unlearned': np.array(
            sorted(ends for ends in unlearned if ends[0] != ends[1]), np.int64
        ).reshape(-1, 2),
        'current': NO_EXPERIENCE,
        'offset': [0.0, 0.0, 0.0],
        'duration_s': 0.0,
        'way_m': 0.0,
        'made_m': np.array(created_m, np.float64),
        'odometer_m': sum(odometers_m),
        'relaxation': [0, False, True, 0],
        'planning_work': 0,
        'jumps': LoopClosureGate().state(),
    }
    if joint.view_spacing_m > 0.0:
        state['view_spacing_m'] = joint.view_spacing_m
        state['odometry_noise'] = joint.noise.state()
        state['recognised_at_m'] = state['odometer_m']
    return state


def _merged_scans(joint: JointMap, fused: Fused) -> State:
    """Return the scans of the experiences, for ``ScanMatcher.restore``.

    An experience without a scan gets that of a duplicate.
    """
    scans = {}
    for number in (*fused.kept, *range(len(joint))):
        session, own_id = joint.owner(number)
        points = joint.sessions[session].scans.reference(own_id)
        if points is not None and fused.id_of[number] not in scans:
            if number != fused.kept[fused.id_of[number]]:
                placed = transformed(points.astype(np.float64), fused.offset_of[number])
                points = placed.astype(np.float32)
            scans[fused.id_of[number]] = points
    ordered = [scans[new_id] for new_id in sorted(scans)]
    return {
        'ids': np.array(sorted(scans), np.int64),
        'sizes': np.array([len(points) for points in ordered], np.int64),
        'points': np.concatenate(ordered) if ordered else np.empty((0, 2), np.float32),
    }


def _merged_relocator(joint: JointMap, fused: Fused, poses: Sequence[Pose]) -> State:
    """Return the landmarks, for ``Relocator.restore``; those of several sessions are counted."""
    table = np.array(poses, np.float64).reshape(-1, 3)
    landmarks = PlaceLandmarks()
    misplaced = set()
    for start, session in zip(joint.starts, joint.sessions, strict=False):
        misplaced |= {fused.id_of[start + one] for one in session.misplaced}
        state = session.landmarks.state()
        for owner, shape, visits in zip(
            state['owners'].tolist(), state['shapes'].tolist(), state['visits'].tolist(),
            strict=True,
        ):
            at = start + owner
            moved = moved_landmark(fused.offset_of[at], shape)
            landmarks.add_counted(fused.id_of[at], moved, visits, table)
    counts = {'requested': 0, 'found': 0, 'ambiguous': 0, 'rejected': 0}
    return {'landmarks': landmarks.state(), 'misplaced': sorted(misplaced), 'counts': counts}


def _merged_goals(joint: JointMap, fused: Fused) -> State:
    """Return the named places; a name that another session has used gets a number."""
    named: dict[str, list[str | int | float]] = {}
    for number, session in enumerate(joint.sessions):
        goals = session.session.states['experience_map'].get('goals', {'named': []})
        for name, own_id, *offset in goals['named']:
            at = joint.starts[number] + own_id
            pose = composed(fused.offset_of[at], Pose(*offset)) if own_id >= 0 else Pose(*offset)
            place = [fused.id_of[at] if own_id >= 0 else NO_EXPERIENCE, *pose]
            unused, count = name, 1
            while unused in named and named[unused][1:] != place:
                count += 1
                unused = f'{name}_{count}'
            named[unused] = [unused, *place]
    return {'named': list(named.values())}
