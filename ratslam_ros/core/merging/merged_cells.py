# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Pose cells of a merged map.

The sessions have different coordinates on the torus, cells of different sizes, and the drift of
their odometry. On the merged map, the poses of all experiences are known relative to each other.
Every experience and every association is therefore placed anew: its place in the pose cells is
its pose on the map, in cells. Path integration measures the same distances, so a robot that drives
from one place to another moves the activity from the place of the one to that of the other. An
association keeps its offset from the experience of its template.

The robot is nowhere on a merged map: there is no current experience, and it is in a component of
its own, as after a gap of the odometry, until views or scans recognise it.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ratslam_ros.core.common.pose import Pose, composed
from ratslam_ros.core.common.rows import listed
from ratslam_ros.core.common.state import State
from ratslam_ros.core.config.additions import CALIBRATION
from ratslam_ros.core.merging.fusing import Fused
from ratslam_ros.core.merging.joint_map import JointMap
from ratslam_ros.core.merging.view_memory import merged_freshness
from ratslam_ros.core.pose_cells.map_action import NO_EXPERIENCE
from ratslam_ros.core.pose_cells.pose_cells import PoseCells
from ratslam_ros.core.pose_cells.pruning import DistanceGraph
from ratslam_ros.core.pose_cells.torus import Place, Unwrapped
from ratslam_ros.core.pose_cells.visual_evidence import NEWEST_TEMPLATES_COUNT

OF_ROBOT = (
    'dims', 'packets', 'agreement', 'messages', 'last_template', 'since_current', 'present',
)
"""Items of the state that describe the robot, and not what was learned."""


class MergedCells:
    """Pose cells of a merged map."""

    def __init__(
        self, joint: JointMap, fused: Fused, poses: Sequence[Pose], components: Sequence[int],
        template_of: Sequence[int],
    ) -> None:
        """Place all experiences in the pose cells.

        Args:
            joint: the maps of all sessions.
            fused: the experiences that remain.
            poses: their poses on the merged map.
            components: component of each.
            template_of: merged template of each.
        """
        self._joint, self._fused, self._poses = joint, fused, poses
        self._components, self._template_of = components, template_of
        first = joint.sessions[0]
        self._p, self._config = first.config.pose_cells, first.config
        self._torus, self._lengths = first.torus, first.lengths
        self.places = [self._placed(pose)[0] for pose in poses]
        """Place of each experience, which identifies it."""

    def state(self) -> State:
        """Return the state of the pose cells."""
        new = PoseCells(self._p, self._config.inputs, self._config.memory).state()
        saved: State = {key: new[key] for key in OF_ROBOT}
        memories, positions, numbers = self._associations()
        count = 1 + max(self._components)
        saved.update({
            'memories': memories,
            'unrolled': {
                **{key: new['unrolled'][key] for key in ('peak', 'here')},
                'memories': positions,
                'experiences': [list(self._placed(pose)[1]) for pose in self._poses],
            },
            'experiences': [
                [template, *place]
                for template, place in zip(self._template_of, self.places, strict=True)
            ],
            'transitions': self._transitions(),
            'visits': self._visits(),
            'gaps': self._gaps(),
            'current': NO_EXPERIENCE,
            'stepped': True,
            'components': {
                'current': count, 'gaps': count, 'memories': numbers,
                'alive': list(range(count + 1)),
                # None of the templates is new: the robot may be near any of them.
                'made': len(memories) + NEWEST_TEMPLATES_COUNT,
                'experiences': list(self._components),
                'places': [list(place) for place in self.places],
            },
        })
        if self._lengths.is_automatic:
            self._lengths.interrupt()
            saved['lengths'] = self._lengths.state()
        if 'calibration' in self._joint.sessions[0].cell_state:
            calibration = CALIBRATION.load()(self._config.inputs.turn_correction)
            calibration.restore(self._joint.sessions[0].cell_state['calibration'])
            calibration.restart()
            saved['calibration'] = calibration.state()
        freshness = merged_freshness(
            [one.cell_state.get('freshness') for one in self._joint.sessions], self._new_id,
            range(len(self._poses)),
        )
        if freshness is not None:
            saved['freshness'] = freshness
        return saved

    def _placed(self, pose: Pose) -> tuple[Place, Unwrapped]:
        """Return the place of a pose on the map, and its unwrapped position."""
        cell_m, torus = self._lengths.cell_m, self._torus
        unwrapped = pose.x_m / cell_m, pose.y_m / cell_m
        theta = pose.heading_rad * torus.planes_per_rad % torus.n_theta
        return torus.wrapped(unwrapped, theta), unwrapped

    def _new_id(self, number: int, cell_id: int) -> int | None:
        """Return the merged experience of one in the pose cells of a session, if it is known."""
        map_id = self._joint.sessions[number].map_ids.get(cell_id)
        return None if map_id is None else self._fused.id_of[self._joint.starts[number] + map_id]

    def _associations(self) -> tuple[list[list[float]], list[list[float]], list[int]]:
        """Return the places of templates: for `memories`, unwrapped, and their components."""
        found: dict[tuple[int, int], tuple[Place, Unwrapped]] = {}
        for number, session in enumerate(self._joint.sessions):
            for template_id, map_id, offset in session.anchors:
                merged = self._fused.templates.get((number, template_id))
                if merged is None:
                    continue
                at = self._joint.starts[number] + map_id
                own = self._fused.id_of[at]
                pose = composed(composed(self._poses[own], self._fused.offset_of[at]), offset)
                found.setdefault((merged, self._components[own]), self._placed(pose))
        decay = self._p.vt_active_decay
        memories = [
            [template, *place, order, decay, 0]
            for order, ((template, _), (place, _)) in enumerate(found.items())
        ]
        positions = [list(unwrapped) for _, unwrapped in found.values()]
        return memories, positions, [component for _, component in found]

    def _transitions(self) -> list[list[int]]:
        pairs = set()
        for number, session in enumerate(self._joint.sessions):
            for ends in listed(session.cell_state['transitions']):
                source, target = self._new_id(number, ends[0]), self._new_id(number, ends[1])
                if source is not None and target is not None and source != target:
                    pairs.add((source, target))
        return [list(pair) for pair in sorted(pairs)]

    def _visits(self) -> State:
        counts = np.zeros(len(self._poses), np.int64)
        last = np.zeros(len(self._poses), np.int64)
        now = 0
        for number, session in enumerate(self._joint.sessions):
            visits = session.cell_state['visits']
            for cell_id, (count, at) in enumerate(
                zip(visits['counts'].tolist(), visits['last'].tolist(), strict=True)
            ):
                new_id = self._new_id(number, cell_id)
                if new_id is not None:
                    counts[new_id] += count
                    last[new_id] = max(int(last[new_id]), now + at)
            now += visits['now']
        return {'now': now, 'counts': counts, 'last': last}

    def _gaps(self) -> State:
        distances = DistanceGraph()
        for number, session in enumerate(self._joint.sessions):
            gaps = session.cell_state['gaps']
            for ends, length_m in zip(gaps['ends'].tolist(), gaps['ways_m'].tolist(), strict=True):
                a, b = self._new_id(number, ends[0]), self._new_id(number, ends[1])
                if a is not None and b is not None:
                    distances.connect(a, b, length_m)
        return distances.state()
