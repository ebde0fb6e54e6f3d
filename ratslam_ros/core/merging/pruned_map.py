# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Prune a saved map to a number of experiences, as a map with a limit (`exp_max`) does.

A running map prunes one experience whenever it creates another one under the same id. Here the
ids of the remaining experiences are assigned anew, as in a merged map, of which the pruned map is
a special case: every pruned experience is represented by the neighbour at its shortest link.
"""

from __future__ import annotations

from collections.abc import Iterator
from copy import copy
from dataclasses import replace

from ratslam_ros.core.common.pose import Pose, composed, inverse
from ratslam_ros.core.common.state import State
from ratslam_ros.core.config.pose_cells import LEAST_EXP_MAX
from ratslam_ros.core.mapping.links import Link, Links
from ratslam_ros.core.merging.fusing import AT_ITSELF, Fused
from ratslam_ros.core.merging.joint_map import JointMap, links_of
from ratslam_ros.core.merging.merge import with_numbering
from ratslam_ros.core.merging.merged_cells import MergedCells
from ratslam_ros.core.merging.merged_map import merged_experience_map
from ratslam_ros.core.merging.session import UNKNOWN_TEMPLATE, SessionMap
from ratslam_ros.core.pose_cells.pruning import DistanceGraph, VisitHistory
from ratslam_ros.errors import UnusableInput


class _Pruning:
    """Links, travelled distances and stand-ins while experiences are removed."""

    def __init__(self, session: SessionMap) -> None:
        self.links = links_of(session.links)
        self.visits, self.distances = VisitHistory(), DistanceGraph()
        self.visits.restore(session.cell_state['visits'])
        self.distances.restore(session.cell_state['gaps'])
        cells = {map_id: cell_id for cell_id, map_id in session.map_ids.items()}
        for link in session.links:  # Without a limit, the pose cells record no distances.
            a, b = cells.get(link.source_id), cells.get(link.target_id)
            if a is not None and b is not None and not self.distances.are_neighbours(a, b):
                self.distances.connect(a, b, link.distance_m)
        self.stand_in: dict[int, tuple[int, Pose]] = {}
        """Neighbour of each removed experience, and the pose of the experience in its frame."""
        self._poses = [Pose(*row) for row in session.poses.tolist()]

    def remove(self, map_id: int) -> bool:
        """Remove an experience and link its neighbours past it; False if it has no neighbour."""
        to_stand_in = self.links.bypass(map_id)
        if to_stand_in is None:
            return False
        stand_in = to_stand_in.target_id
        pose = composed(inverse(self._poses[stand_in]), self._poses[map_id])
        self.links.delete(self.links.rows_at(map_id))
        self.stand_in[map_id] = stand_in, pose
        return True

    def represented(self, map_id: int) -> tuple[int, Pose]:
        """Return the remaining experience that represents one, and its pose in that frame."""
        offset = AT_ITSELF
        while map_id in self.stand_in:
            map_id, pose = self.stand_in[map_id]
            offset = composed(pose, offset)
        return map_id, offset


def pruned_states(session: SessionMap, count: int) -> dict[str, State]:
    """Return the states of a map with at most ``count`` experiences.

    The templates stay, as they do while mapping. The position of the robot is unknown afterwards.

    Args:
        session: the map.
        count: number of experiences, at least ``LEAST_EXP_MAX``.

    Raises:
        UnusableInput: the number is too small, or more experiences have no neighbour.
    """
    if count < LEAST_EXP_MAX:
        raise UnusableInput(f'{count} places are too few; expected at least {LEAST_EXP_MAX}')
    pruning = _Pruning(session)
    remaining = len(session)
    for _ in range(len(session)):
        if remaining <= count:
            break
        cell_id = pruning.visits.prune_candidate(pruning.visits.may_go(pruning.distances))
        if pruning.remove(session.map_ids.get(cell_id, cell_id)):
            remaining -= 1
            pruning.distances.remove(cell_id)
        pruning.visits.retain(cell_id)
    if remaining > count:
        raise UnusableInput(f'{remaining} places cannot be pruned; expected at most {count}')
    kept = tuple(number for number in range(len(session)) if number not in pruning.stand_in)
    new_id = {number: one for one, number in enumerate(kept)}
    found = [pruning.represented(number) for number in range(len(session))]
    templates = {(0, one): one for one in session.local_view.template_ids.tolist()}
    fused = Fused(
        kept, tuple(new_id[number] for number, _ in found), tuple(pose for _, pose in found),
        templates, tuple(sorted(templates)), (),
    )
    return _states(session, fused, pruning)


def _states(session: SessionMap, fused: Fused, pruning: _Pruning) -> dict[str, State]:
    session = copy(session)
    session.cell_state = {**session.cell_state, 'gaps': pruning.distances.state()}
    joint, kept = JointMap([session]), list(fused.kept)
    numbers = sorted(set(session.components[kept].tolist()))
    components = [numbers.index(number) for number in session.components[kept].tolist()]
    poses = [Pose(*row) for row in session.poses[kept].tolist()]
    view = dict(session.view_state)
    next_id = int(view.get('next_id', len(view['templates'])))
    template_of = session.templates[kept].tolist()
    if UNKNOWN_TEMPLATE in template_of:
        # Ids are not used again, so that no view is recognised as a removed template.
        template_of = [next_id if one == UNKNOWN_TEMPLATE else one for one in template_of]
        view['template_ids'] = session.local_view.template_ids
        view['next_id'] = next_id + 1
    cells = MergedCells(joint, fused, poses, components, template_of)
    labels = list(zip(template_of, cells.places, strict=True))
    links = links_of(_renumbered_links(pruning.links, fused))
    states: dict[str, State] = {
        'local_view': {'core': view}, 'pose_cells': {'core': cells.state()},
        'experience_map': merged_experience_map(joint, fused, poses, components, labels, links),
    }
    return with_numbering(states, len(poses))


def _renumbered_links(links: Links, fused: Fused) -> Iterator[Link]:
    for row in range(len(links)):
        ends = fused.id_of[links[row].source_id], fused.id_of[links[row].target_id]
        yield replace(links[row], source_id=ends[0], target_id=ends[1])
