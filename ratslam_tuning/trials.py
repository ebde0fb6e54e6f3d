# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Trials: the maps that several configurations build from the same recording.

The recording is read and decoded once for all configurations. Nothing is written.
"""

from __future__ import annotations

from array import array
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ratslam_ros.core.common.pose import Pose, composed
from ratslam_ros.core.common.scan import UnusableScan
from ratslam_ros.core.config import Config
from ratslam_ros.core.pose_cells.map_action import NO_EXPERIENCE
from ratslam_ros.core.vision.prepared_image import PreparedImage
from ratslam_ros.errors import UnusableParameter
from ratslam_ros.event_inputs import (
    calibrated,
    check_lasers,
    head_of,
    input_from_event,
    laser_mounts,
)
from ratslam_ros.messages.json_schema import MalformedMessage
from ratslam_ros.pipeline.items import OdometryStep, Step
from ratslam_ros.pipeline.ratslam import RatSLAM
from ratslam_ros.recordings import Event, ImageEvent, Recording, Selection
from ratslam_ros.recordings.prefetch import prefetch_prepared
from ratslam_ros.results.trajectory import Trajectory
from ratslam_ros.results.writer import LoopClosures, Places

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]


@dataclass(frozen=True)
class Span:
    """Part of a recording: skipped seconds at the start, and duration, None for the rest."""

    start_s: float = 0.0
    duration_s: float | None = None


WHOLE_SPAN = Span()


@dataclass(frozen=True)
class Trial:
    """The map that one configuration built.

    Attributes:
        config: the configuration.
        view_ns: (v,) stamps of the processed views.
        template_id: (v,) their templates, -1 for none.
        first_seen: (v,) index of the view at which the template was first seen.
        map: trajectory on the final map.
        dead_reckoning: trajectory by odometry alone, with the same stamps.
        loop_closures: number of transitions to experiences that are not among the newest.
        experiences: number of experiences.
    """

    config: Config
    view_ns: Ints
    template_id: Ints
    first_seen: Ints
    map: Trajectory
    dead_reckoning: Trajectory
    loop_closures: int
    experiences: int

    @property
    def templates(self) -> int:
        """Number of templates."""
        return len(np.unique(self.template_id[self.template_id >= 0]))


def run_trials(
    recording: Recording,
    selection: Selection,
    configs: Sequence[Config],
    span: Span = WHOLE_SPAN,
) -> list[Trial | UnusableParameter]:
    """Build one map per configuration.

    ``pose_cells.exp_max`` is ignored.

    Args:
        recording: the recording.
        selection: its topics to use.
        configs: the configurations.
        span: the part of the recording to use.

    Returns:
        The trials, in the order of the configurations; an error for a configuration that does
        not fit the images.
    """
    runs = [_Run(config, recording, selection) for config in configs]
    errors: dict[int, UnusableParameter] = {}
    greys = {config.inputs.image_grey for config in configs}
    wants_colour = any(run.wants_colour for run in runs)

    def decoded(event: ImageEvent) -> dict[str, PreparedImage]:
        colour = event.bgr() if wants_colour else None
        return {grey: PreparedImage(event.grey(grey), colour=colour) for grey in greys}

    events = recording.events(selection, span.start_s, span.duration_s)
    with prefetch_prepared(events, decoded) as prefetched:
        for event, images in prefetched:
            for index, run in enumerate(runs):
                if index not in errors:
                    try:
                        run.feed(event, None if images is None else images[run.grey])
                    except UnusableParameter as error:
                        errors[index] = error
    return [errors[index] if index in errors else run.finish() for index, run in enumerate(runs)]


class _Run:
    """RatSLAM with one configuration, and the record of its steps."""

    def __init__(
        self, config: Config, recording: Recording, selection: Selection
    ) -> None:
        self._config = config
        self.grey = config.inputs.image_grey
        used = config.with_values({'pose_cells.exp_max': 0, 'goal_memory.goal_memory': False})
        head = head_of(selection)
        if head == 'visual_odometry':
            used = calibrated(used, recording, selection)
        if used.experience_map.exp_align_scans:
            check_lasers(selection, used.experience_map.lasers)
        self._slam = RatSLAM(used, head)
        self._mounts = laser_mounts(recording, selection)
        self._view_ns, self._template_id = array('q'), array('q')
        self._stamp_ns, self._experience_id = array('q'), array('q')
        self._offset, self._dead_reckoning = array('d'), array('d')
        self._places = Places()
        self._closures = LoopClosures()

    @property
    def wants_colour(self) -> bool:
        """Whether the descriptor uses the colour of images."""
        return self._slam.wants_colour

    def feed(self, event: Event, image: PreparedImage | None) -> None:
        """Process one event; unusable scans and templates are skipped."""
        with suppress(UnusableScan, MalformedMessage):
            self._add(self._slam.feed(*input_from_event(event, self._mounts, image)))

    def _add(self, steps: list[Step]) -> None:
        for step in steps:
            if isinstance(step, OdometryStep):
                self._stamp_ns.append(step.stamp_ns)
                self._experience_id.append(self._places.of(step.experience_id))
                self._offset.extend(step.offset)
                self._dead_reckoning.extend(step.dead_reckoning)
                continue
            self._view_ns.append(step.stamp_ns)
            self._template_id.append(step.match.template_id)
            if step.pruned is not None:
                self._places.prune(step.pruned)
            self._closures.add(step)

    def finish(self) -> Trial:
        """Process all held messages and return the result."""
        self._add(self._slam.finish())
        template_id = np.array(self._template_id, np.int64)
        _, first, which = np.unique(template_id, return_index=True, return_inverse=True)
        offsets = np.array(self._offset).reshape(-1, 3).tolist()
        graph = self._slam.experience_map
        pose_of = self._places.poses(graph.pose_of)
        poses = {i: pose_of(i) for i in {NO_EXPERIENCE, *self._experience_id}}
        on_map = [
            composed(poses[i], Pose(*offset))
            for i, offset in zip(self._experience_id, offsets, strict=True)
        ]
        stamps = np.array(self._stamp_ns, np.int64)
        rising = np.flatnonzero(np.diff(stamps, prepend=-1) > 0)
        return Trial(
            self._config, np.array(self._view_ns, np.int64), template_id,
            first[which].astype(np.int64).reshape(-1),
            _trajectory(stamps, np.array(on_map).reshape(-1, 3), rising),
            _trajectory(stamps, np.array(self._dead_reckoning).reshape(-1, 3), rising),
            self._closures.count, len(graph),
        )


def _trajectory(stamps: Ints, poses: Floats, rows: NDArray[np.intp]) -> Trajectory:
    return Trajectory(stamps[rows], poses[rows, :2], poses[rows, 2], True)
