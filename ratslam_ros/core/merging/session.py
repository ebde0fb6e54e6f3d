# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Sessions: the maps to be merged, in the form that merging needs."""

from __future__ import annotations

import hashlib
import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ratslam_ros.core.common.pose import Pose, composed, inverse
from ratslam_ros.core.common.rows import listed
from ratslam_ros.core.common.state import State
from ratslam_ros.core.config import Config, LocalViewParameters
from ratslam_ros.core.mapping.experience_map import ExperienceMap
from ratslam_ros.core.mapping.links import Link
from ratslam_ros.core.mapping.place_landmarks import PlaceLandmarks
from ratslam_ros.core.mapping.scan_matching import ScanMatcher
from ratslam_ros.core.pose_cells.lengths import lengths_of
from ratslam_ros.core.pose_cells.torus import Torus
from ratslam_ros.core.vision.built_in import built_in_encoder
from ratslam_ros.core.vision.encoder import Encoder
from ratslam_ros.core.vision.local_view import LocalView
from ratslam_ros.errors import UnusableInput

Reals = NDArray[np.float64]
Ints = NDArray[np.int64]
EncoderOf = Callable[[LocalViewParameters], Encoder]

UNKNOWN_TEMPLATE = -1
"""Template of an experience whose template was removed from the memory."""

ENCODING = (
    'vt_descriptor', 'template_x_size', 'template_y_size', 'image_crop_x_min', 'image_crop_x_max',
    'image_crop_y_min', 'image_crop_y_max', 'vt_normalisation', 'vt_patch_normalise',
    'vt_min_patch_normalisation_std', 'vt_panoramic',
)
"""Parameters of the local view on which the bytes of a view depend."""


class Anchor(NamedTuple):
    """Where the pose cells have placed a template.

    ``experience``: the one created there or, if there is none, the nearest one in the component.
    ``offset``: pose of the place in its frame.
    """

    template: int
    experience: int
    offset: Pose


@dataclass(frozen=True)
class Session:
    """A saved map.

    Attributes:
        name: for messages, such as the name of the file.
        config: configuration with which the map was made.
        states: state of each part by name, as `RatSLAM.state` returns them; the learned state of a
            part is its item `core`. Parts other than `local_view`, `pose_cells` and
            `experience_map` are not used.
    """

    name: str
    config: Config
    states: Mapping[str, State] = field(repr=False)


class SessionMap:
    """The content of a session.

    The ids of experiences are those of the map, and templates have the ids of the local view, also
    if the pose cells or the local view were restarted during the session.
    """

    def __init__(self, session: Session, encoder_of: EncoderOf = built_in_encoder) -> None:
        """Read a session.

        Raises:
            UnusableInput: a part is missing or does not fit the configuration.
        """
        self.session, self.name, self.config = session, session.name, session.config
        for part in ('local_view', 'pose_cells', 'experience_map'):
            if 'core' not in session.states.get(part, {}):
                raise UnusableInput(
                    f'{session.name} has no {part}; expected a map that was saved by all '
                    'nodes, with the stages of this package'
                )
        self.view_state: State = session.states['local_view']['core']
        self.cell_state: State = session.states['pose_cells']['core']
        graph_part = session.states['experience_map']
        self.graph = ExperienceMap(session.config.experience_map)
        self.graph.restore(graph_part['core'])
        self.poses: Reals = self.graph.poses
        self.links: list[Link] = self.graph.links()
        self.components: Ints = np.array(self.graph.components, np.int64)
        self.encoder = encoder_of(session.config.local_view)
        self.local_view = LocalView(
            session.config.local_view, self.encoder, session.config.inputs, session.config.memory
        )
        self.local_view.restore(self.view_state)
        self._read_cells(session.states)
        self.scans = ScanMatcher()
        if 'scans' in graph_part:
            self.scans.restore(graph_part['scans'])
        self.landmarks = PlaceLandmarks()
        self.misplaced: set[int] = set()
        """Experiences that lie in a wrong place, because the robot was lost."""
        if 'relocator' in graph_part:
            self.landmarks.restore(graph_part['relocator']['landmarks'])
            self.misplaced = set(graph_part['relocator']['misplaced'])

    def _read_cells(self, states: Mapping[str, State]) -> None:
        """Find the template of each experience, and the experience of each of the pose cells."""
        base = states['pose_cells'].get('numbering', {}).get('base', 0)
        joining = states['experience_map'].get('joining', {}).get('numbering', {})
        own = {peer: one for peer, one in joining['own']} if 'own' in joining else None
        self.templates = np.full(len(self), UNKNOWN_TEMPLATE, np.int64)
        """(n,) template of each experience, -1 if it is not in the memory."""
        self.map_ids: dict[int, int] = {}
        """Id in the pose cells -> id on the map."""
        for cell_id, row in enumerate(listed(self.cell_state['experiences'])):
            template_id = int(row[0])
            map_id = cell_id if own is None else own.get(cell_id)
            if map_id is None or map_id >= len(self):
                continue
            self.map_ids[cell_id] = map_id
            if template_id >= base and template_id - base in self.local_view:
                self.templates[map_id] = template_id - base
        self.template_base = base
        p = self.config.pose_cells
        self.torus = Torus(p.pc_dim_x, p.pc_dim_y, p.pc_dim_th)
        self.lengths = lengths_of(p)
        if self.lengths.is_automatic and 'lengths' in self.cell_state:
            self.lengths.restore(self.cell_state['lengths'])
        self.first: dict[tuple[int, int], int] = {}
        """Template and component -> the first experience, at which the template was learned."""
        for map_id in range(len(self)):
            key = int(self.templates[map_id]), int(self.components[map_id])
            if key[0] != UNKNOWN_TEMPLATE:
                self.first.setdefault(key, map_id)
        self.anchors = _anchors(self)
        """Places of templates in the pose cells; a template has one in each component."""

    def __len__(self) -> int:
        """Return the number of experiences."""
        return len(self.graph)

    @property
    def spacing_m(self) -> float:
        """View spacing: distance after which a view shows another scene; 0 if it is unknown."""
        return self.lengths.scale_m

    @property
    def encoding(self) -> dict[str, object]:
        """Parameters that determine the bytes of a view."""
        return {name: getattr(self.config.local_view, name) for name in ENCODING}

    def digest(self) -> str:
        """Return a digest of what was learned, without the state of the robot.

        Equal maps have equal digests, and the order of the sessions does not matter if they are
        sorted by them.
        """
        found = hashlib.sha256(repr(self.encoding).encode())
        arrays = (
            self.local_view.template_ids, self.local_view.templates, self.templates,
            self.components, self.poses, self.graph.link_ends, self.graph.link_table.shapes,
            self.graph.link_table.durations_s,
        )
        for array in arrays:
            found.update(repr((array.dtype.str, array.shape)).encode())
            found.update(np.ascontiguousarray(array).tobytes())
        return found.hexdigest()


def _anchors(session: SessionMap) -> list[Anchor]:
    """Return the associations of templates with places in the pose cells of a session."""
    state, cell_m = session.cell_state, session.lengths.cell_m
    planes_per_rad = session.config.pose_cells.pc_dim_th / math.tau
    positions = state['unrolled']
    saved = state['components']
    components, numbers = listed(saved['experiences']), listed(saved['memories'])
    poses = [
        Pose(x * cell_m, y * cell_m, place[2] / planes_per_rad)
        for (x, y), place in zip(
            listed(positions['experiences']), listed(saved['places']), strict=True
        )
    ]
    first: dict[tuple[int, int], int] = {}
    for cell_id, map_id in sorted(session.map_ids.items()):
        template = int(session.templates[map_id])
        if template != UNKNOWN_TEMPLATE:
            first.setdefault((template, components[cell_id]), cell_id)
    known = sorted(session.map_ids)
    places_m = np.array([poses[cell_id][:2] for cell_id in known]).reshape(-1, 2)
    component_of = np.array([components[cell_id] for cell_id in known], np.int64)
    found = []
    for (template_id, _x, _y, theta, *_), (x, y), component in zip(
        listed(state['memories']), listed(positions['memories']), numbers, strict=True
    ):
        pose = Pose(x * cell_m, y * cell_m, theta / planes_per_rad)
        template = int(template_id) - session.template_base
        nearest = first.get((template, component))
        if nearest is None or poses[nearest][:2] != pose[:2]:
            rows = np.flatnonzero(component_of == component)
            if len(rows) == 0:
                continue
            away_m = np.hypot(places_m[rows, 0] - pose.x_m, places_m[rows, 1] - pose.y_m)
            nearest = known[int(rows[away_m.argmin()])]
        offset = composed(inverse(poses[nearest]), pose)
        found.append(Anchor(template, session.map_ids[nearest], offset))
    return found


def in_canonical_order(sessions: list[SessionMap]) -> list[SessionMap]:
    """Return the different sessions, the largest map first; equal ones by their digests.

    The first session keeps its frame and ids, and its configuration is that of the merged map.
    """
    by_digest: dict[str, SessionMap] = {}
    for one in sorted(sessions, key=lambda session: session.name):
        by_digest.setdefault(one.digest(), one)
    return [
        by_digest[digest]
        for digest in sorted(by_digest, key=lambda digest: (-len(by_digest[digest]), digest))
    ]
