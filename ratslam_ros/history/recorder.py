# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Recorder: writes what RatSLAM does, step by step, to a history."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Callable
from functools import partial

import numpy as np

from ratslam_ros.core.common.scan import Scan, points_of
from ratslam_ros.core.mapping.map_changes import MapChange, MapChangeTracker
from ratslam_ros.core.pose_cells.active_cells import ActiveCells, active_cells
from ratslam_ros.core.pose_cells.map_action import NO_EXPERIENCE, MapAction
from ratslam_ros.core.vision.encoder import View
from ratslam_ros.core.vision.local_view import LocalView, ViewMatch
from ratslam_ros.core.vision.prepared_image import PreparedImage
from ratslam_ros.core.vision.recognition import FIXED_THRESHOLD
from ratslam_ros.history.recorded_images import jpeg_of
from ratslam_ros.history.records import (
    CellsRecord,
    CommandRecord,
    ImageRecord,
    MatchRecord,
    PoseRecord,
    ScanRecord,
    ViewRecord,
)
from ratslam_ros.history.writer import HistoryWriter
from ratslam_ros.images import Image, UndecodableImage
from ratslam_ros.messages.commands import CommandPayload
from ratslam_ros.messages.json_schema import encode
from ratslam_ros.pipeline.codec import command_state
from ratslam_ros.pipeline.commands import Command
from ratslam_ros.pipeline.items import OdometryStep, Step, ViewStep
from ratslam_ros.pipeline.pipeline import COMMAND
from ratslam_ros.pipeline.ratslam import RatSLAM

IMAGE_WIDTH_PX = 320
"""Width of the images: recognisable, and about 8 kB."""

IMAGE_QUALITY = 60
"""Quality of the JPEG images; higher ones cost more bytes than they show at this width."""

SCAN_POINTS = 180
"""Number of points to which a scan is thinned: one for every two degrees of a full turn."""

MIN_ACTIVITY = 0.01
"""Activity below which cells are left out, as a share of the most active one."""

MAX_HELD = 64
"""Number of images that wait for their view; more than the lateness of odometry lets wait."""


class Recorder:
    """Turns the steps and commands of RatSLAM into records. It changes nothing of RatSLAM."""

    def __init__(self, slam: RatSLAM, open_writer: Callable[[], HistoryWriter]) -> None:
        """Record the steps that follow.

        Args:
            slam: the system whose steps are recorded.
            open_writer: opens the history; called at the first step, so that a run that fails
                before it leaves no file.
        """
        self._slam = slam
        self._threshold = slam.config.local_view.vt_match_threshold
        """Match threshold of the views, unless they have one of their own."""
        self._open_writer = open_writer
        self._writer: HistoryWriter | None = None
        self._map = MapChangeTracker()
        self._images: dict[int, tuple[Image, PreparedImage | None]] = {}
        self._scan: Scan | None = None
        self._commands: deque[tuple[int, str]] = deque()
        """Stamps and payloads of commands that wait for the next step."""
        self._view_ns = 0
        slam.pipeline.observe(COMMAND, self._add_command)

    def add_image(self, stamp_ns: int, image: Image, prepared: PreparedImage | None) -> None:
        """Hold an image until its view is processed.

        Args:
            stamp_ns: stamp of the image.
            image: the image.
            prepared: the same for the stages, None if it could not be decoded.
        """
        self._images[stamp_ns] = image, prepared
        if len(self._images) > MAX_HELD:
            del self._images[next(iter(self._images))]

    def add_scan(self, scan: Scan) -> None:
        """Hold a scan until the robot has got there; only the newest is held."""
        if self._writer is None or self._writer.wants(ScanRecord, scan.stamp_ns):
            self._scan = scan

    def add(self, step: Step) -> None:
        """Record a step, right after it was processed."""
        writer, stamp_ns = self._writer, step.stamp_ns
        if writer is None:
            writer = self._writer = self._open_writer()
        # Commands before the first input have no stamp.
        while self._commands and self._commands[0][0] <= stamp_ns:
            given_ns, payload = self._commands.popleft()
            writer.add(CommandRecord(given_ns or stamp_ns, payload))
        if isinstance(step, ViewStep):
            self._add_view(writer, step)
        elif writer.wants(PoseRecord, stamp_ns):
            self._add_pose(writer, step)
        if self._scan is not None and self._scan.stamp_ns <= stamp_ns:
            scan, self._scan = self._scan, None
            writer.add(scan_record(scan))

    def flush(self) -> None:
        """Make all records visible to readers."""
        if self._writer is not None:
            self._writer.flush()

    def close(self) -> None:
        """Record the rest of the map, and close the history."""
        writer = self._writer
        if writer is None:
            return
        for stamp_ns, payload in self._commands:
            writer.add(CommandRecord(stamp_ns, payload))
        for change in self._map.changes(self._slam.experience_map, self._view_ns):
            writer.add(change)
        writer.close()

    def discard(self) -> None:
        """Remove the history."""
        if self._writer is not None:
            self._writer.discard()

    def _add_command(self, stamp_ns: int, command: Command) -> None:
        payload = CommandPayload.of(stamp_ns, command_state(command))
        self._commands.append((stamp_ns, encode(payload)))

    def _add_pose(self, writer: HistoryWriter, step: OdometryStep) -> None:
        found = self._slam.experience_map.covariance
        (xx, xy, _), (_, yy, _), _ = found.on_map(step.pose.heading_rad).tolist()
        covariance = None if found.reason else (xx, xy, yy)
        writer.add(PoseRecord(
            step.stamp_ns, step.pose, step.dead_reckoning, covariance=covariance
        ))

    def _add_view(self, writer: HistoryWriter, step: ViewStep) -> None:
        stamp_ns = self._view_ns = step.stamp_ns
        writer.add(view_record(
            stamp_ns, step.match, step.action, self._threshold, step.reason, step.relocated_to
        ))
        self._add_pictures(writer, step)
        if writer.wants(CellsRecord, stamp_ns):
            cells = self._slam.pose_cells
            writer.add(cells_record(stamp_ns, cells.dims, active_cells(cells)))
        if writer.wants(MapChange, stamp_ns):
            writer.add_map(self._map.restart, partial(
                self._map.next_change, self._slam.experience_map, stamp_ns
            ))

    def _add_pictures(self, writer: HistoryWriter, step: ViewStep) -> None:
        stamp_ns, match = step.stamp_ns, step.match
        image, prepared = self._images.get(stamp_ns, (None, None))
        while self._images and (held_ns := next(iter(self._images))) <= stamp_ns:
            del self._images[held_ns]
        if image is None or prepared is None:
            return
        if writer.wants(ImageRecord, stamp_ns, match.is_new):
            try:
                writer.add(image_record(stamp_ns, image), match.is_new)
            except UndecodableImage:
                return
        local_view = self._slam.local_view
        if local_view is None or not writer.wants(MatchRecord, stamp_ns):
            return
        # A held step may be of a template that has been removed since.
        if match.template_id not in local_view:
            return
        template = local_view.template(match.template_id)
        view = template if match.is_new else _view(local_view, prepared)
        if view is not None:
            writer.add(MatchRecord(
                stamp_ns, match.template_id, local_view.picture(view),
                local_view.picture(template), local_view.shift_of(match.relative_rad),
            ))


def image_record(stamp_ns: int, image: Image) -> ImageRecord:
    """Return the record of an image, reduced to ``IMAGE_WIDTH_PX``; raises UndecodableImage."""
    return ImageRecord(stamp_ns, jpeg_of(image, IMAGE_WIDTH_PX, IMAGE_QUALITY))


def scan_record(scan: Scan) -> ScanRecord:
    """Return the record of a scan, thinned to ``SCAN_POINTS``."""
    points = points_of(scan)
    stride = max(math.ceil(len(points) / SCAN_POINTS), 1)
    return ScanRecord(scan.stamp_ns, points[::stride])


def _view(local_view: LocalView, image: PreparedImage) -> View | None:
    if image.encoded is None:
        return local_view.encode(image.pixels, image.colour)
    return image.encoded.view


def view_record(
    stamp_ns: int, match: ViewMatch, action: MapAction, fixed_threshold: float, reason: str = '',
    relocated_to: int = NO_EXPERIENCE,
) -> ViewRecord:
    """Return the record of a view; ``fixed_threshold``: for views without one of their own."""
    threshold = fixed_threshold if match.threshold == FIXED_THRESHOLD else match.threshold
    return ViewRecord(
        stamp_ns, action.template_id, match.is_new, match.error, threshold, action.relative_rad,
        action.action, action.source_id, action.target_id, action.place, action.recognised_id,
        action.agreement, reason, relocated_to,
    )


def cells_record(
    stamp_ns: int, dims: tuple[int, int, int], active: ActiveCells
) -> CellsRecord:
    """Return the record of the activity, without cells below ``MIN_ACTIVITY``.

    Args:
        stamp_ns: the stamp.
        dims: numbers of cells in x, y and theta.
        active: the activity.
    """
    shown = active.activity >= MIN_ACTIVITY * np.max(active.activity, initial=0.0)
    return CellsRecord(
        stamp_ns, dims, active.cells[shown],
        *(each.astype(np.float32) for each in (
            active.activity[shown], active.packets, active.injections,
        )),
    )
