# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""JSON payloads of the mapping topics: templates, actions, what the map answers, and the map."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from itertools import count
from typing import Annotated, ClassVar, Literal

import numpy as np
from msgspec import Meta, Struct
from msgspec.structs import astuple
from numpy.typing import NDArray

from ratslam_ros.core.common.pose import Pose
from ratslam_ros.core.common.turn_correction import TurnCorrection
from ratslam_ros.core.config import ExperienceMapParameters
from ratslam_ros.core.mapping.experience_map import ExperienceMap
from ratslam_ros.core.mapping.link_learning import TIMED_OUT
from ratslam_ros.core.pose_cells.map_action import NO_EXPERIENCE, MapAction
from ratslam_ros.core.pose_cells.map_relocation import MapRelocation
from ratslam_ros.core.pose_cells.torus import Place
from ratslam_ros.core.vision.local_view import ViewMatch
from ratslam_ros.core.vision.recognition import FIXED_THRESHOLD
from ratslam_ros.messages.json_schema import (
    NS_PER_S,
    Angle,
    Count,
    Id,
    MalformedMessage,
    OptionalId,
    Payload,
    Stamp,
    decode,
    encode,
    encode_rows,
    only_if,
)

BLOCK_ROWS = 512
"""Number of experiences or links that are written in one step, in less than 1 ms."""
UNKNOWN_SENDER = 0
_Cells = Annotated[float, Meta(ge=0.0, le=100_000.0)]
_Memory = Annotated[Count, Meta(examples=[1_700_000_000 * NS_PER_S])]


class TemplatePayload(Payload, frozen=True, omit_defaults=True):
    """The template of one image."""

    TOPIC: ClassVar[str] = 'local_view/template'
    stamp: Stamp
    """Stamp of the image."""
    id: Annotated[OptionalId, Meta(examples=[17])]
    """The template; -1 if the image could not be decoded, or matches no template while learning is
    off."""
    is_new: bool
    """Whether the template was learned from this image."""
    error: Annotated[float, Meta(ge=-1.0, le=1.0, examples=[0.0213])]
    """Smallest mean difference to the templates learned before; -1 if there were none."""
    relative_rad: Annotated[Angle, Meta(examples=[0.0])]
    """Current heading minus the heading at which the template was learned, counter-clockwise; 0
    for a forward camera unless `vt_shift_fov_deg` is set."""
    memory: _Memory
    """Memory of the sender, see above."""
    threshold: Annotated[float, Meta(ge=FIXED_THRESHOLD, le=1.0)] = FIXED_THRESHOLD
    """The match threshold at this view, only if it is automatic (`vt_match_threshold: -1`)."""
    related: Id = 0
    """Number of newest templates that show the same scene as the view, apart from gradual changes;
    pose_cells measures the distance between scenes by it (`pc_cell_x_size: -1`); left out if 0,
    and unless `vt_recent_templates` is -1."""
    removed: tuple[Id, ...] = ()
    """Ids of the templates that were removed to make room for this one, at the limit `vt_max`;
    left out if there are none. Ids are never reused."""
    sender: Count = UNKNOWN_SENDER
    """Number that the node has drawn at its start. If two nodes publish the topic, receivers use
    the messages of one of them, and report the other."""

    @classmethod
    def of(
        cls, stamp_ns: int, match: ViewMatch, memory_ns: int, sender: int = UNKNOWN_SENDER
    ) -> TemplatePayload:
        """Return the payload of a matched or learned template."""
        return cls(
            Stamp.of(stamp_ns), match.template_id, match.is_new, match.error, match.relative_rad,
            memory_ns, only_if(match.threshold != FIXED_THRESHOLD, match.threshold),
            match.related_count, match.removed, sender,
        )

    @property
    def match(self) -> ViewMatch:
        """The matched or learned template."""
        return ViewMatch(
            self.id, self.is_new, self.error, self.relative_rad, self.threshold, self.related,
            self.removed,
        )


class _TurnCorrection(Struct, frozen=True):
    gain: Annotated[float, Meta(ge=0.001, le=1000.0)]
    """Factor of the turns."""
    per_m_rad: Annotated[float, Meta(ge=-1000.0, le=1000.0)]
    """Added per metre."""


class ActionPayload(Payload, frozen=True, kw_only=True):
    """The action of one template."""

    TOPIC: ClassVar[str] = 'pose_cells/action'
    stamp: Stamp
    """Stamp of the image."""
    sequence: Annotated[Count, Meta(examples=[125])]
    """Number of the action, from 0: a missing number means a lost action."""
    action: Annotated[Literal['create', 'link', 'set', 'none'], Meta(examples=['link'])]
    """`create`: a new experience; `link`: an existing one, by a new link; `set`: an existing one,
    by an existing link."""
    source_id: Annotated[OptionalId, Meta(examples=[40])]
    """The previous current experience; -1 for none."""
    target_id: Annotated[OptionalId, Meta(examples=[12])]
    """The new current experience; -1 for none."""
    template_id: Annotated[OptionalId, Meta(examples=[17])]
    """The template of the current view."""
    relative_rad: Annotated[Angle, Meta(examples=[0.0])]
    """Heading of the robot minus the heading of the view of the target."""
    pc_x: Annotated[_Cells, Meta(examples=[10.25])]
    """Location of the target in the pose cells, in cells."""
    pc_y: Annotated[_Cells, Meta(examples=[4.5])]
    pc_theta: Annotated[_Cells, Meta(examples=[18.0])]
    memory: _Memory
    """Memory of the sender, see above."""
    recognised_id: OptionalId = NO_EXPERIENCE
    """Experience that the view was recognised as, -1 if none: with `exp_view_links`, and with
    `exp_weigh_links` for a new experience."""
    agreement: Annotated[float, Meta(ge=0.0, le=1.0)] = 0.0
    """In the same cases: share of the required recognitions that agree."""
    view_spacing_m: Annotated[float, Meta(ge=0.0, le=1e9)] = 0.0
    """With `exp_view_links` or `exp_weigh_links` only: scale of the weights of links."""
    correction: _TurnCorrection | None = None
    """With `odom_calibration` only: correction of the odometry with later stamps."""
    sender: Count = UNKNOWN_SENDER
    """Number that the node has drawn at its start. If two nodes publish the topic, receivers use
    the messages of one of them, and report the other."""

    def __post_init__(self) -> None:
        if self.action != 'none' and min(self.target_id, self.template_id) < 0:
            raise ValueError(
                f'{self.action} has target_id {self.target_id} and template_id '
                f'{self.template_id}; expected at least 0'
            )

    @classmethod
    def of(
        cls, stamp_ns: int, sequence: int, action: MapAction, memory_ns: int,
        sender: int = UNKNOWN_SENDER,
    ) -> ActionPayload:
        """Return the payload of a change of the map."""
        is_recognised = action.view_spacing_m > 0.0
        return cls(
            stamp=Stamp.of(stamp_ns), sequence=sequence, action=action.action,
            source_id=action.source_id, target_id=action.target_id,
            template_id=action.template_id, relative_rad=action.relative_rad,
            pc_x=action.place.x, pc_y=action.place.y, pc_theta=action.place.theta,
            memory=memory_ns, recognised_id=only_if(is_recognised, action.recognised_id),
            agreement=only_if(is_recognised, action.agreement),
            view_spacing_m=only_if(is_recognised, action.view_spacing_m),
            correction=only_if(
                action.correction is not None,
                action.correction and _TurnCorrection(*action.correction),
            ),
            sender=only_if(sender != UNKNOWN_SENDER, sender),
        )

    @property
    def change(self) -> MapAction:
        """The change of the map."""
        return MapAction(
            self.action, self.source_id, self.target_id, self.template_id, self.relative_rad,
            Place(self.pc_x, self.pc_y, self.pc_theta),
            TurnCorrection(*astuple(self.correction)) if self.correction else None,
            self.recognised_id, self.agreement, self.view_spacing_m,
        )


class _Relocation(Struct, frozen=True):
    experience_id: Annotated[Id, Meta(examples=[12])]
    """The experience."""
    template_id: Annotated[Id, Meta(examples=[17])]
    """Its template."""
    relative_x_m: Annotated[float, Meta(examples=[0.25])]
    """Position of the robot in its frame at the stamp."""
    relative_y_m: Annotated[float, Meta(examples=[-0.1])]
    relative_rad: Annotated[Angle, Meta(examples=[1.5])]
    """Heading of the robot in its frame."""


class RelocationPayload(Payload, frozen=True, omit_defaults=True):
    """The map's answer to an action."""

    TOPIC: ClassVar[str] = 'experience_map/relocation'
    stamp: Stamp
    """That of the action."""
    sequence: Annotated[Count, Meta(examples=[125])]
    """That of the action."""
    memory: _Memory
    """Memory of the sender, see above."""
    relocation: Annotated[_Relocation | None, Meta(examples=[...])] = None
    """Left out unless scans have relocated the robot."""

    @classmethod
    def of(
        cls, stamp_ns: int, sequence: int, relocation: MapRelocation | None, memory_ns: int
    ) -> RelocationPayload:
        """Return the answer to an action; ``relocation`` has the ids of the pose cells."""
        place = relocation and _Relocation(
            relocation.experience_id, relocation.template_id, *relocation.offset
        )
        return cls(Stamp.of(stamp_ns), sequence, memory_ns, place)

    @property
    def adopted(self) -> MapRelocation | None:
        """Where scans have relocated the robot after the action; None if they have not."""
        if self.relocation is None:
            return None
        experience_id, template_id, *offset = astuple(self.relocation)
        return MapRelocation(experience_id, template_id, Pose(*offset))


class _Pose(Struct, frozen=True):
    x_m: Annotated[float, Meta(examples=[4.5])]
    """Position on the map."""
    y_m: Annotated[float, Meta(examples=[0.25])]
    heading_rad: Annotated[float, Meta(examples=[1.5])]
    """Heading on the map."""

    @property
    def pose(self) -> Pose:
        """The pose in the type of core."""
        return Pose(*astuple(self))


class Correction(Payload, frozen=True):
    """A correction of the robot's pose on the map by an action, and not by odometry."""

    TOPIC: ClassVar[str] = 'experience_map/correction'
    stamp: Stamp
    """Stamp of the odometry message to which both poses belong."""
    experience_id: Annotated[OptionalId, Meta(examples=[12])]
    """Current experience afterwards; -1 for none."""
    before: _Pose
    """Pose of the robot at `stamp`, without the action."""
    after: Annotated[_Pose, Meta(examples=[{'x_m': 4.25, 'y_m': 0.5, 'heading_rad': 1.625}])]
    """And with it."""

    @classmethod
    def of(cls, stamp_ns: int, experience_id: int, before: Pose, after: Pose) -> Correction:
        """Return the correction of a pose."""
        return cls(Stamp.of(stamp_ns), experience_id, _Pose(*before), _Pose(*after))


class _Experience(Struct, frozen=True, gc=False):
    id: Annotated[int, Meta(examples=[0])]
    """0, 1, 2, ...."""
    template_id: Annotated[int, Meta(examples=[0])]
    """Template of its view."""
    x_m: float
    """Position on the map."""
    y_m: float
    heading_rad: float
    """Heading of the view on the map."""
    pc_x: Annotated[float, Meta(examples=[10.25])]
    """Position in the pose cells, in cells."""
    pc_y: Annotated[float, Meta(examples=[4.5])]
    pc_theta: Annotated[float, Meta(examples=[18.0])]


class _Link(Struct, frozen=True, gc=False, omit_defaults=True):
    source_id: Annotated[int, Meta(examples=[0])]
    """Ids of the experiences it connects."""
    target_id: int
    distance_m: float
    """Straight-line distance."""
    heading_rad: float
    """Direction to the target, relative to the heading of the source."""
    facing_rad: float
    """Heading of the target relative to the heading of the source."""
    duration_s: float
    """Travel time."""
    behaviour: str
    """Behaviour of the robot during the transition; empty in a replay."""
    count: int
    """Number of transitions along the link."""
    recognised: bool = False
    """`true`: the view at the source was recognised as that of the target, and the link was not
    driven; left out if `false`."""
    share: float = 1.0
    """Share of its full weight that a recognition has in the relaxation; left out if 1."""
    timed_out: int = 0
    """Number of times that the robot was blocked on the link; left out if 0."""


class MapPayload(Payload, frozen=True, kw_only=True):
    """The whole map."""

    TOPIC: ClassVar[str] = 'experience_map/map'
    MAX_CHARACTERS: ClassVar[int] = 2**30
    frame_id: Annotated[str, Meta(examples=['map'])]
    """Value of `experience_map.map_frame`."""
    stamp: Stamp
    """Stamp of the last processed image that could be decoded."""
    current_experience_id: int
    """Experience at which the robot is; -1 before the first experience, and after an odometry gap
    before the next one."""
    components: tuple[int, ...] = ()
    """Component of each experience, if there are several ([Odometry
    gaps](algorithm.md#odometry-gaps)). Poses of different components cannot be compared.
    Components are numbered from 0 by their beginning, and a joined one has the lowest number of
    its parts."""
    view_spacing_m: Annotated[float | None, Meta(examples=[0.5])] = None
    """Distance between neighbouring views, which is the scale of the weights of links; 0 if it was
    not measured. Maps of earlier versions have neither it nor `recognised`."""
    experiences: list[_Experience]
    """Ordered by id."""
    links: list[_Link]
    """In the order of creation."""


def encode_map(stamp_ns: int, experience_map: ExperienceMap) -> str:
    """Return the whole graph as JSON: the content of map.json and of ``experience_map/map``.

    Args:
        stamp_ns: stamp of the last applied action that had a template, 0 before the first.
        experience_map: the graph.

    Raises:
        ValueError: a number of the graph is not finite.
    """
    return b''.join(map_text(stamp_ns, experience_map)).decode()


def map_text(stamp_ns: int, experience_map: ExperienceMap) -> Iterator[bytes]:
    """Yield the text of ``encode_map`` in parts, of the map as it is at the first one.

    Each part takes less than 1 ms, so that a node can receive messages in between.
    """
    components = experience_map.components
    rows = only_if(False, None)  # which follow in blocks
    head = encode(MapPayload(
        frame_id=experience_map.frame_id, stamp=Stamp.of(stamp_ns),
        current_experience_id=experience_map.current_id,
        components=only_if(any(components), components),
        view_spacing_m=experience_map.view_spacing_m, experiences=rows, links=rows,
    ))
    labels, poses = list(experience_map.labels), experience_map.poses
    table = experience_map.link_table
    ends, counts = table.ends.copy(), table.counts.copy()
    lengths = np.column_stack([table.shapes, table.durations_s])
    behaviours, names = table.behaviours.copy(), table.behaviour_names
    recognised, shares = table.recognised.copy(), table.shares.copy()
    timed_out = table.failures[:, TIMED_OUT].copy()
    yield f'{head[:-1]},"experiences":['.encode()
    for block, comma in _blocks(len(labels)):
        template_ids, places = zip(*labels[block], strict=True)
        axes = *poses[block].T.tolist(), *zip(*places, strict=True)
        experiences = map(_Experience, count(block.start), template_ids, *axes)
        yield comma + encode_rows(list(experiences))
    yield b'],"links":['
    for block, comma in _blocks(len(ends)):
        columns = (
            *ends[block].T.tolist(), *lengths[block].T.tolist(),
            [names[number] for number in behaviours[block].tolist()], counts[block].tolist(),
            recognised[block].tolist(),
            [only_if(share < 1.0, share) for share in shares[block].tolist()],
            timed_out[block].tolist(),
        )
        yield comma + encode_rows(list(map(_Link, *columns)))
    yield b']}'


def decode_map(text: str) -> tuple[MapPayload, ExperienceMap]:
    """Return the content of map.json, and the graph that ``encode_map`` was given.

    The graph has all that ``encode_map`` writes. What else influences how a map grows is in map
    files only.

    Raises:
        MalformedMessage: the text is no map, or contradicts itself.
    """
    payload = decode(MapPayload, text)
    experiences, links, count = payload.experiences, payload.links, len(payload.experiences)
    ends = _columns(links, 'source_id', 'target_id').astype(np.int64)
    components = payload.components or (0,) * count
    problem = (
        'ids of experiences that do not count from 0'
        if [one.id for one in experiences] != list(range(count)) else
        'a link to an experience that is not in the map'
        if not ((ends >= 0) & (ends < count)).all() else
        f'{len(components)} components for {count} experiences'
        if len(components) != count else
        f'current_experience_id {payload.current_experience_id} of {count} experiences'
        if not -1 <= payload.current_experience_id < count else ''
    )
    if problem:
        raise MalformedMessage(f'{payload.TOPIC}: {problem}')
    graph = ExperienceMap(ExperienceMapParameters(map_frame=payload.frame_id))
    names = sorted({link.behaviour for link in links})
    failures = np.zeros((len(links), 2), np.int64)
    failures[:, TIMED_OUT] = [link.timed_out for link in links]
    current = payload.current_experience_id
    graph.restore({
        **graph.state(),
        'poses': _columns(experiences, 'x_m', 'y_m', 'heading_rad'),
        'labels': _columns(experiences, 'template_id', 'pc_x', 'pc_y', 'pc_theta'),
        'made_m': np.zeros(count), 'current': current,
        'ends': ends, 'shapes': _columns(links, 'distance_m', 'heading_rad', 'facing_rad'),
        'durations_s': _columns(links, 'duration_s')[:, 0],
        'counts': _columns(links, 'count').astype(np.int64)[:, 0],
        'behaviours': np.array([names.index(link.behaviour) for link in links], np.int64),
        'behaviour_names': names,
        'failures': failures,
        'recognised': _columns(links, 'recognised').astype(np.bool_)[:, 0],
        'shares': _columns(links, 'share')[:, 0],
        'view_spacing_m': payload.view_spacing_m or 0.0,
        'components': {
            'current': components[current] if count else 0, 'gaps': max(components, default=0),
            'experiences': np.array(components, np.int64),
        },
    })
    return payload, graph


def _columns(rows: Sequence[Struct], *keys: str) -> NDArray[np.float64]:
    values = [[getattr(row, key) for key in keys] for row in rows]
    return np.array(values, np.float64).reshape(-1, len(keys))


def _blocks(count: int) -> Iterator[tuple[slice, bytes]]:
    """Yield slices of at most ``BLOCK_ROWS`` rows, and the comma before each."""
    for first in range(0, count, BLOCK_ROWS):
        yield slice(first, first + BLOCK_ROWS), b',' if first else b''
