# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Merge the maps of several sessions or robots; see docs/maps.md, "Several sessions"."""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cache

import numpy as np
from numpy.typing import NDArray

from ratslam_ros.core.common.pose import Pose
from ratslam_ros.core.common.rows import listed
from ratslam_ros.core.common.state import State
from ratslam_ros.core.config import Config
from ratslam_ros.core.mapping.experience_map import ExperienceMap
from ratslam_ros.core.mapping.id_map import MIN_MEMORY_NS
from ratslam_ros.core.mapping.scan_matching import ScanMatcher
from ratslam_ros.core.merging.fusing import Fused, fuse, template_of
from ratslam_ros.core.merging.joining import Join, Joiner
from ratslam_ros.core.merging.joint_map import JointMap, links_of, residual
from ratslam_ros.core.merging.merged_cells import MergedCells
from ratslam_ros.core.merging.merged_map import merged_experience_map
from ratslam_ros.core.merging.session import EncoderOf, Session, SessionMap, in_canonical_order
from ratslam_ros.core.merging.view_memory import (
    TemplatePair,
    common_threshold,
    match_views,
    merged_local_view,
)
from ratslam_ros.core.pose_cells.pose_cells import PoseCells
from ratslam_ros.core.vision.built_in import built_in_encoder
from ratslam_ros.core.vision.local_view import LocalView
from ratslam_ros.errors import UnusableInput

BESIDE_SPACINGS = 5.0
"""Distance between components on the merged map, in view spacings. It has no meaning."""


@dataclass(frozen=True)
class JoinReport:
    """Result of comparing two sessions, or components of them.

    Attributes:
        known, seen: their names.
        refused: why they are not joined; '' if they are.
        by: what the shared places were recognised by, `views` or `scans`.
        matched: number of matches.
        places: number of different shared places, a view spacing apart.
        overlapping: number of places that lie on the other map.
        share: share of these that are recognised.
        residual_m: median distance by which the merged map deviates from a match, in m.
    """

    known: str
    seen: str
    refused: str
    by: str
    matched: int
    places: int
    overlapping: int
    share: float
    residual_m: float


@dataclass(frozen=True)
class MergedMap:
    """One map of several sessions.

    Attributes:
        config: configuration of the largest session, with which the map is used.
        states: state of each part, for `RatSLAM.restore`.
        names: names of the different sessions, in the order of the merge.
        joins: result of each comparison, the most certain join first.
        experience_ids: for each of the sessions (n,) the merged id of each of its experiences.
        offsets: for each of the sessions (n, 3) the pose of each of its experiences in the frame
            of the merged one.
        templates, experiences: numbers in each session.
    """

    config: Config
    states: dict[str, State] = field(repr=False)
    names: tuple[str, ...]
    joins: tuple[JoinReport, ...]
    experience_ids: tuple[NDArray[np.int64], ...] = field(repr=False)
    offsets: tuple[NDArray[np.float64], ...] = field(repr=False)
    templates: tuple[int, ...]
    experiences: tuple[int, ...]

    @property
    def components(self) -> int:
        """Number of parts whose relative poses are unknown."""
        core = self.states['experience_map']['core']
        saved = core.get('components', {'experiences': [0]})
        return len(set(listed(saved['experiences'])))


def merge_sessions(
    sessions: Sequence[Session], encoder_of: EncoderOf = built_in_encoder
) -> MergedMap:
    """Merge maps. The result does not depend on the order of the sessions.

    Equal sessions count once; a single one is returned unchanged.

    Args:
        sessions: the maps; the largest one keeps its frame, and its configuration is used.
        encoder_of: function from parameters to the encoder of the views.

    Raises:
        UnusableInput: there is no session, one of them is incomplete or damaged, or the views of
            one of them are encoded in another way and no scans join it.
    """
    if not sessions:
        raise UnusableInput('there is no map to merge; expected at least one')
    maps = in_canonical_order([_opened(one, encoder_of) for one in sessions])
    maps = [one for one in maps if len(one) > 0] or maps[:1]
    first = maps[0]
    maps.sort(key=lambda one: one.encoding != first.encoding)
    names = tuple(one.name for one in maps)
    sizes = tuple(len(one.local_view) for one in maps), tuple(len(one) for one in maps)
    if len(maps) == 1:
        states = dict(first.session.states)
        ids, offsets = (np.arange(len(first)),), (np.zeros((len(first), 3)),)
        return MergedMap(first.config, states, names, (), ids, offsets, *sizes)
    joint = JointMap(maps)
    comparable = [one for one in maps if one.encoding == first.encoding]
    threshold = common_threshold(comparable)

    @cache
    def pairs_of(known: int, seen: int) -> list[TemplatePair]:
        if max(known, seen) >= len(comparable):
            return []
        return match_views(maps[known], maps[seen], threshold)

    joiner = Joiner(joint, pairs_of)
    joiner.run()
    _check_encodings(joint, joiner)
    fused = fuse(joint, joiner)
    states = _states(joint, joiner, fused, comparable)
    starts = joint.starts
    spans = list(itertools.pairwise(starts))
    return MergedMap(
        first.config, states, names, tuple(_report(joint, joiner, one) for one in joiner.joins),
        tuple(np.array(fused.id_of[start:end], np.int64) for start, end in spans),
        tuple(
            np.array(fused.offset_of[start:end], np.float64).reshape(-1, 3) for start, end in spans
        ),
        *sizes,
    )


def _opened(session: Session, encoder_of: EncoderOf) -> SessionMap:
    try:
        return SessionMap(session, encoder_of)
    except (KeyError, ValueError, TypeError, IndexError, AttributeError) as error:
        raise UnusableInput(
            f'{session.name} is damaged, or of another version ({error!r}); use a backup'
        ) from None


def _check_encodings(joint: JointMap, joiner: Joiner) -> None:
    """Refuse a session whose views cannot be used, and which no scans have joined."""
    first = joint.sessions[0]
    for number, session in enumerate(joint.sessions):
        parts = [part for part, (owner, _) in enumerate(joint.parts) if owner == number]
        differing = [
            f'{name} is {value}, expected {first.encoding[name]}'
            for name, value in session.encoding.items() if value != first.encoding[name]
        ]
        is_joined = any(
            joiner.cluster_of.count(joiner.cluster_of[part]) > 1 for part in parts
        )
        if differing and not is_joined:
            raise UnusableInput(
                f'the views of {session.name} are encoded differently from those of '
                f'{first.name} ({"; ".join(differing)}), and no scans join them: record the '
                'sessions with one configuration, or leave this one out'
            )


def _states(
    joint: JointMap, joiner: Joiner, fused: Fused, comparable: Sequence[SessionMap]
) -> dict[str, State]:
    """Return the states of all parts."""
    first = joint.sessions[0]
    clusters = sorted(set(joiner.cluster_of))
    components = [
        clusters.index(joiner.cluster_of[int(joint.part_of[number])]) for number in fused.kept
    ]
    table = joiner.poses[list(fused.kept)]
    links = links_of(fused.links)
    joint.settle(table, links)
    _set_apart(table, np.array(components), BESIDE_SPACINGS * first.spacing_m)
    poses = [Pose(*row) for row in table.tolist()]
    removed = len(fused.learned)
    templates = [
        fused.templates.get(template_of(joint, number), removed) for number in fused.kept
    ]
    cells = MergedCells(joint, fused, poses, components, templates)
    view = merged_local_view(comparable, fused.templates, fused.learned)
    if removed in templates:
        # Ids are not used again, so that no view is recognised as a removed template.
        view['template_ids'], view['next_id'] = np.arange(removed), removed + 1
    labels = list(zip(templates, cells.places, strict=True))
    states: dict[str, State] = {
        'local_view': {'core': view}, 'pose_cells': {'core': cells.state()},
        'experience_map': merged_experience_map(joint, fused, poses, components, labels, links),
    }
    systems: dict[str, LocalView | PoseCells | ExperienceMap] = {
        'local_view': LocalView(
            first.config.local_view, first.encoder, first.config.inputs, first.config.memory
        ),
        'pose_cells': PoseCells(
            first.config.pose_cells, first.config.inputs, first.config.memory
        ),
        'experience_map': ExperienceMap(joint.parameters),
    }
    for part, system in systems.items():  # in the form in which the parts hand out their states
        system.restore(states[part]['core'])
        states[part]['core'] = system.state()
    return with_numbering(states, len(poses))


def with_numbering(states: dict[str, State], count: int) -> dict[str, State]:
    """Add what only the nodes need: all have the same ids, and no message is on its way."""
    ids: State = {'memory_ns': MIN_MEMORY_NS, 'forgotten': 0, 'base': 0, 'end': 0}
    numbering: State = {**ids, 'end': count, 'own': [[i, i] for i in range(count)]}
    states['local_view']['memory_ns'] = MIN_MEMORY_NS
    states['pose_cells'].update(memory_ns=MIN_MEMORY_NS, sequence=0, numbering=ids)
    states['experience_map'].update(
        action_ns=0, joining={
            'missed': 0, 'forgotten': 0, 'next': 0, 'first_sequence': 0, 'numbering': numbering,
        },
    )
    if 'scans' not in states['experience_map']:
        states['experience_map']['scans'] = ScanMatcher().state()
    calibration = states['pose_cells']['core'].get('calibration')
    if calibration is not None:
        states['experience_map']['correction'] = calibration['correction']
    return states


def _set_apart(table: NDArray[np.float64], components: NDArray[np.int64], gap_m: float) -> None:
    """Place the components beside each other, along x."""
    right_m = float(table[components == 0, 0].max())
    for component in range(1, 1 + int(components.max())):
        rows = components == component
        table[rows, 0] += right_m + gap_m - table[rows, 0].min()
        right_m = float(table[rows, 0].max())


def _report(joint: JointMap, joiner: Joiner, join: Join) -> JoinReport:
    residuals = sorted(residual(joiner.poses, one)[0] for one in join.correspondences)
    return JoinReport(
        joint.part_name(join.known), joint.part_name(join.seen), join.refused, join.by,
        join.matched, join.place_count, join.overlapping, join.share,
        residuals[len(residuals) // 2] if residuals else 0.0,
    )
