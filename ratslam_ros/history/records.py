# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Records: what a run reports, moment by moment. A history consists of them."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from ratslam_ros.core.common.pose import Pose
from ratslam_ros.core.mapping.map_changes import MapChange
from ratslam_ros.core.pose_cells.map_action import NO_EXPERIENCE, Action
from ratslam_ros.core.pose_cells.torus import Place


@dataclass(frozen=True, slots=True)
class ViewRecord:
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

    stamp_ns: int
    template_id: int
    is_new: bool
    error: float
    threshold: float
    relative_rad: float
    action: Action
    source_id: int
    target_id: int
    place: Place
    recognised_id: int = NO_EXPERIENCE
    agreement: float = 0.0
    reason: str = ''
    relocated_to: int = NO_EXPERIENCE


@dataclass(frozen=True, slots=True)
class PoseRecord:
    """Poses of the robot: on the map, by odometry alone, and true; None if unknown.

    ``covariance``: of x and x, x and y, y and y of the pose on the map in m^2, None if unknown.
    """

    stamp_ns: int
    pose: Pose
    dead_reckoning: Pose | None = None
    truth: Pose | None = None
    covariance: tuple[float, float, float] | None = None


@dataclass(frozen=True, slots=True)
class CellsRecord:
    """Activity of the pose cells.

    Attributes:
        stamp_ns: stamp of the last odometry or view.
        dims: numbers of cells in x, y and theta.
        cells: (n, 3) x, y and theta of every active cell.
        activity: (n,) their activities.
        packets: (m, 4) x, y, theta of the peak of every packet, and the sum of its activities.
        injections: (k, 4) x, y, theta and energy of every injection at the last view.
    """

    stamp_ns: int
    dims: tuple[int, int, int]
    cells: NDArray[np.int64]
    activity: NDArray[np.float64]
    packets: NDArray[np.float64] = field(default_factory=lambda: np.empty((0, 4)))
    injections: NDArray[np.float64] = field(default_factory=lambda: np.empty((0, 4)))


@dataclass(frozen=True, slots=True)
class ImageRecord:
    """A camera image, reduced and compressed as JPEG."""

    stamp_ns: int
    jpeg: bytes


@dataclass(frozen=True, slots=True)
class MatchRecord:
    """Pictures of a view as it was compared, and of its template.

    Attributes:
        stamp_ns: stamp of the image.
        template_id: the template.
        view, template: (height, width) grey levels.
        shift_px: columns by which the view is shifted relative to the template.
    """

    stamp_ns: int
    template_id: int
    view: NDArray[np.uint8]
    template: NDArray[np.uint8]
    shift_px: int = 0


@dataclass(frozen=True, slots=True)
class ScanRecord:
    """A laser scan: (n, 2) points in m in the frame of the robot."""

    stamp_ns: int
    points_m: NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class RouteRecord:
    """The route to the goal: (n, 2) points in m on the map; empty if there is none."""

    stamp_ns: int
    points_m: NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class StatusRecord:
    """Goals and their outcomes: the payload of ``experience_map/status``."""

    stamp_ns: int
    payload: str


@dataclass(frozen=True, slots=True)
class CommandRecord:
    """What has changed a stage besides the inputs: the payload of ``ratslam/command``.

    The payload has the stamp of the command. ``stamp_ns`` is the place of the record in the run,
    which is later if the command was given before the first input, or became known late.
    """

    stamp_ns: int
    payload: str


Record = (
    MapChange | ViewRecord | PoseRecord | CellsRecord | ImageRecord | MatchRecord | ScanRecord
    | RouteRecord | StatusRecord | CommandRecord
)
