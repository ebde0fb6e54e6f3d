# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Records: what a run reports, moment by moment. A history consists of them."""

from __future__ import annotations

from dataclasses import replace
from typing import Annotated

import numpy as np
from msgspec import Meta, Struct, field, structs
from numpy.typing import NDArray

from ratslam_ros.core.common.pose import Pose
from ratslam_ros.core.common.rows import require_shapes
from ratslam_ros.core.mapping.map_changes import MAX_ROWS, MapChange
from ratslam_ros.core.pose_cells.map_action import NO_EXPERIENCE, Action
from ratslam_ros.core.pose_cells.torus import Place

OptionalId = Annotated[int, Meta(lt=MAX_ROWS)]
"""Id of an experience, -1 for none."""


class _Record(Struct, frozen=True, array_like=True, gc=False):
    """A moment of a run. The tags are those of the file."""

    stamp_ns: int


class ViewRecord(_Record, frozen=True, gc=False, tag=1):
    """One template message and the action that followed.

    Attributes:
        stamp_ns: stamp of the image.
        template_id: the matched or new template, -1 if there is none.
        is_new: whether the template was learned from this image.
        error: error of the best match, from 0 to 1; -1 if it was not computed.
        threshold: threshold that the error was compared with.
        relative_rad: heading of the robot minus the heading at which the template was learned.
        action, source_id, target_id, recognised_id, agreement, place: see ``MapAction``.
        reason: why the loop-closure gate rejected the action; '' if it did not.
        relocated_to: experience to which scans have relocated the robot, -1 if they have not.
    """

    template_id: int
    is_new: bool
    error: float
    threshold: float
    relative_rad: float
    action: Action
    source_id: OptionalId
    target_id: OptionalId
    place: Place
    recognised_id: OptionalId = NO_EXPERIENCE
    agreement: float = 0.0
    reason: str = ''
    relocated_to: OptionalId = NO_EXPERIENCE


class PoseRecord(_Record, frozen=True, gc=False, tag=2):
    """Poses of the robot: on the map, by odometry alone, and true; None if unknown.

    ``covariance``: of x and x, x and y, y and y of the pose on the map in m^2, None if unknown.
    """

    pose: Pose
    dead_reckoning: Pose | None = None
    truth: Pose | None = None
    covariance: tuple[float, float, float] | None = None


def _no_places() -> NDArray[np.float32]:
    return np.empty((0, 4), np.float32)


class CellsRecord(_Record, frozen=True, gc=False, tag=3):
    """Activity of the pose cells.

    Attributes:
        stamp_ns: stamp of the last odometry or view.
        dims: numbers of cells in x, y and theta.
        cells: (n, 3) x, y and theta of every active cell.
        activity: (n,) their activities.
        packets: (m, 4) x, y, theta of the peak of every packet, and the sum of its activities.
        injections: (k, 4) x, y, theta and energy of every injection at the last view.
    """

    dims: tuple[int, int, int]
    cells: NDArray[np.int64]
    activity: NDArray[np.float32]
    packets: NDArray[np.float32] = field(default_factory=_no_places)
    injections: NDArray[np.float32] = field(default_factory=_no_places)

    def __post_init__(self) -> None:
        n, m, k = len(self.cells), len(self.packets), len(self.injections)
        require_shapes(self, cells=(n, 3), activity=(n,), packets=(m, 4), injections=(k, 4))


class ImageRecord(_Record, frozen=True, gc=False, tag=4):
    """A camera image, reduced and compressed as JPEG."""

    jpeg: bytes


class MatchRecord(_Record, frozen=True, gc=False, tag=5):
    """Pictures of a view as it was compared, and of its template.

    Attributes:
        stamp_ns: stamp of the image.
        template_id: the template.
        view, template: (height, width) grey levels.
        shift_px: columns by which the view is shifted relative to the template.
    """

    template_id: int
    view: NDArray[np.uint8]
    template: NDArray[np.uint8]
    shift_px: int = 0

    def __post_init__(self) -> None:
        require_shapes(
            self, view=(*self.view.shape, 1)[:2], template=(*self.template.shape, 1)[:2]
        )


class ScanRecord(_Record, frozen=True, gc=False, tag=6):
    """A laser scan: (n, 2) points in m in the frame of the robot."""

    points_m: NDArray[np.float64]

    def __post_init__(self) -> None:
        require_shapes(self, points_m=(len(self.points_m), 2))


class RouteRecord(_Record, frozen=True, gc=False, tag=7):
    """The route to the goal: (n, 2) points in m on the map; empty if there is none."""

    points_m: NDArray[np.float64]

    def __post_init__(self) -> None:
        require_shapes(self, points_m=(len(self.points_m), 2))


class StatusRecord(_Record, frozen=True, gc=False, tag=8):
    """Goals and their outcomes: the payload of ``experience_map/status``."""

    payload: str


class CommandRecord(_Record, frozen=True, gc=False, tag=9):
    """What has changed a stage besides the inputs: the payload of ``ratslam/command``.

    The payload has the stamp of the command. ``stamp_ns`` is the place of the record in the run,
    which is later if the command was given before the first input, or became known late.
    """

    payload: str


Record = (
    MapChange | ViewRecord | PoseRecord | CellsRecord | ImageRecord | MatchRecord | ScanRecord
    | RouteRecord | StatusRecord | CommandRecord
)


def restamped(record: Record, stamp_ns: int) -> Record:
    """Return a record with another stamp."""
    if isinstance(record, MapChange):
        return replace(record, stamp_ns=stamp_ns)
    return structs.replace(record, stamp_ns=stamp_ns)
