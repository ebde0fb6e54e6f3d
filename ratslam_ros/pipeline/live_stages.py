# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Stages whose neighbours may be other processes, which can be restarted, reset or replaced.

Ids of templates and experiences are numbers in the memory of the stage that gives them. With each
id goes the stamp of that memory, so that a receiver notices that the ids mean other things now.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from typing import Any, ClassVar

from ratslam_ros.core.common.odometry import Motion
from ratslam_ros.core.common.saved import Field
from ratslam_ros.core.common.state import State
from ratslam_ros.core.config import Config
from ratslam_ros.core.mapping.id_map import MIN_MEMORY_NS, NO_MEMORY_NS, IdMap
from ratslam_ros.core.mapping.pose_covariance import OdometryVariance, PoseCovariance
from ratslam_ros.core.navigation.navigator import Navigator
from ratslam_ros.core.vision.local_view import NO_TEMPLATE, ViewMatch
from ratslam_ros.core.vision.prepared_image import PreparedImage
from ratslam_ros.errors import UnusableParameter
from ratslam_ros.pipeline.commands import Command, Reset
from ratslam_ros.pipeline.experience_map import ExperienceMapStage
from ratslam_ros.pipeline.items import NumberedAction, Template
from ratslam_ros.pipeline.landmark_map import LandmarkMapStage
from ratslam_ros.pipeline.local_view import LocalViewStage
from ratslam_ros.pipeline.pipeline import COMMAND
from ratslam_ros.pipeline.pose_cells import PoseCellsStage
from ratslam_ros.pipeline.stage import Output, Preparing, Reader, Stage
from ratslam_ros.pipeline.visual_odometry import VisualOdometryStage


class Reporter:
    """Takes what a stage notices for the user, and ignores it; ``Diagnostics`` reports it."""

    def __init__(self) -> None:
        self.counts: Counter[str] = Counter()
        """Messages that were not used, by reason."""

    def note(self, text: str) -> None:
        """Report a past event: once, and in all later diagnostics."""

    def drop(self, reason: str, text: str, number: int = 1) -> None:
        """Count messages that are not used, and warn."""


class Reporting:
    """A stage that reports what it notices, among it images that it cannot use."""

    def __init__(self, config: Config, reporter: Reporter) -> None:
        self._reporter = reporter
        super().__init__(config)  # type: ignore[call-arg]  # of the stage beside this class

    def _unusable(self, error: UnusableParameter) -> None:
        self._reporter.drop('undecodable', f'an image cannot be used: {error}')


VISUAL = OdometryVariance(m2_per_m=0.1, rad2_per_rad=0.02)
"""Variances that driving adds to visual odometry, in arbitrary units of length."""


class LiveVisualOdometry(Reporting, VisualOdometryStage):
    """Visual odometry that reports images which it cannot use, and its covariance."""

    SAVED = (
        *VisualOdometryStage.SAVED,
        Field('covariance', 'covariance', PoseCovariance, optional=True),
        Field('last_ns', '_last_ns', int, nullable=True, of_session=True, optional=True),
    )

    def __init__(self, config: Config, reporter: Reporter) -> None:
        super().__init__(config, reporter)
        self.covariance = PoseCovariance()
        """Covariance of the integrated pose."""
        self._last_ns: int | None = None

    def _obey(self, stamp_ns: int, command: Command) -> None:
        if isinstance(command, Reset):
            self.covariance, self._last_ns = PoseCovariance(), None
        super()._obey(stamp_ns, command)

    def _see(self, stamp_ns: int, image: PreparedImage | None) -> tuple[Output, ...]:
        outputs = super()._see(stamp_ns, image)
        before_ns = self._last_ns
        if image is not None:
            self._last_ns = stamp_ns
        if outputs and self.estimate is not None and before_ns is not None:
            twist, dt_s = self.estimate.twist, (stamp_ns - before_ns) * 1e-9
            motion = Motion(dt_s, twist.linear_x_mps * dt_s, twist.angular_z_radps * dt_s)
            self.covariance.integrate(motion, VISUAL)
        return outputs


class LiveLocalView(Reporting, LocalViewStage):
    """Local view that reports images which it cannot use."""


class LiveTemplates:
    """A stage in the place of local_view, whose templates carry the stamp of its memory."""

    NAME: ClassVar[str] = 'local_view'
    WRITES: ClassVar[tuple[str, ...]] = ('template',)

    def __init__(self, stage: Stage) -> None:
        self.stage = stage
        self.SAVED = getattr(stage, 'SAVED', ())
        self.memory_ns = NO_MEMORY_NS

    def readers(self) -> dict[str, Reader]:
        """Return the readers of the stage."""
        readers = self.stage.readers()
        found = {name: partial(self._read, reader) for name, reader in readers.items()}
        return {**found, COMMAND: partial(self._obey, readers.get(COMMAND))}

    def _read(self, reader: Reader, stamp_ns: int, item: Any) -> list[Output]:
        return [self._marked(output) for output in reader(stamp_ns, item) or ()]

    def _marked(self, output: Output) -> Output:
        stream, stamp_ns, match = output
        if match.is_new and self.memory_ns == NO_MEMORY_NS:
            self.memory_ns = max(stamp_ns, MIN_MEMORY_NS)
        return Output(stream, stamp_ns, Template(match, self.memory_ns))

    def _obey(self, reader: Reader | None, stamp_ns: int, command: Command) -> None:
        if isinstance(command, Reset):
            self.memory_ns = NO_MEMORY_NS
        if reader is not None:
            reader(stamp_ns, command)

    @property
    def wants_colour(self) -> bool:
        """Whether the stage uses the colour of images."""
        return bool(getattr(self.stage, 'wants_colour', False))

    def prepare(self, image: PreparedImage) -> PreparedImage:
        """Return the image with what the stage will need of it."""
        return self.stage.prepare(image) if isinstance(self.stage, Preparing) else image

    def state(self) -> State:
        """Return everything, for ``restore``."""
        return {**self.stage.state(), 'memory_ns': self.memory_ns}

    def restore(self, state: State) -> None:
        """Restore what ``state`` returned, or the state of a replay."""
        self.stage.restore(state)
        # A replay has no other memory that its ids could be confused with.
        is_empty = isinstance(self.stage, LocalViewStage) and len(self.stage.core) == 0
        assumed_ns = NO_MEMORY_NS if is_empty else MIN_MEMORY_NS
        self.memory_ns = int(state.get('memory_ns', assumed_ns))


class LivePoseCells(Reporting, PoseCellsStage):
    """Pose cells that notice when the ids of the templates mean other views."""

    SAVED = (
        *PoseCellsStage.SAVED, Field('numbering', '_ids', IdMap, of_session=True, optional=True),
    )

    def _begin(self) -> None:
        super()._begin()
        self._ids = IdMap()

    def _view(self, stamp_ns: int, item: Any) -> tuple[Output, ...]:
        self._check_memory(stamp_ns, *item)
        match: ViewMatch = item.match
        match = replace(
            match, template_id=self._ids.own_id(match.template_id),
            removed=tuple(self._ids.own_id(i) for i in match.removed),
        )
        return super()._view(stamp_ns, match)

    def _check_memory(self, stamp_ns: int, match: ViewMatch, memory_ns: int) -> None:
        """Detect that local_view has another memory than before, and renumber its templates."""
        first = self._ids.memory_ns == NO_MEMORY_NS
        if match.is_new and not first and memory_ns == self._ids.memory_ns and (
            self._ids.was_used(match.template_id)
        ):
            self._ids.restart()
            self.core.forget()
            self._reporter.note(
                'local_view has gone back to an earlier memory: its ids mean other views now, so '
                'places seen before will not be recognised; load or reset all nodes together'
            )
        if self._ids.set_memory(memory_ns):
            self.core.forget()
            self._reporter.note(
                'local_view has started with an empty memory: places seen before will not be '
                'recognised; to start over, call pose_cells/reset and experience_map/reset too'
            )
        elif first and match.template_id > NO_TEMPLATE and memory_ns < stamp_ns:
            self._reporter.counts['missed'] += match.template_id + 1
            self._reporter.note(
                'this node started late: local_view had learned before; views learned then are '
                'associated with pose cells when they are seen again. To start over, call reset '
                'on all nodes'
            )

    def _restored(self, state: State) -> None:
        super()._restored(state)
        if 'numbering' not in state and len(self.core):
            self._ids.assume(self.core.next_template_id)  # a replay has no other memory


class LiveExperienceMap(Reporting, ExperienceMapStage):
    """Experience map that may have missed actions, and whose robot may drive to goals."""

    SAVED = (
        *ExperienceMapStage.SAVED, Field('goals', 'navigator', Navigator, optional=True),
        Field('action_ns', 'action_ns', int, of_session=True, optional=True),
    )

    def _begin(self) -> None:
        super()._begin()
        self.navigator = Navigator(self._config.goal_recall, self.core, self.goals)
        """Requested goals. They are no part of the stream, and do not influence the map."""
        self.core.on_pruned.append(self.navigator.remove_pruned)
        self.action_ns = 0
        """Stamp of the last action with a template, 0 if there was none."""

    def _act(self, stamp_ns: int, item: NumberedAction) -> tuple[Output, ...]:
        missed, restarts = self.late_join.missed, self.late_join.restarts
        outputs = super()._act(stamp_ns, item)
        if item.action.template_id != NO_TEMPLATE:
            self.action_ns = stamp_ns
        self._report_missed(item.number, missed, restarts)
        return outputs

    def _report_missed(self, number: int, missed: int, restarts: int) -> None:
        join = self.late_join
        if join.missed > missed:
            self._reporter.drop(
                'missed', f'{join.missed - missed} actions of pose_cells were lost: the map '
                'differs from that of a replay', join.missed - missed,
            )
        if join.restarts > restarts:
            self._reporter.note(
                'pose_cells has started with an empty memory: the map is continued, but places '
                'mapped before will not be recognised. To start over, call experience_map/reset'
            )
        elif number > 0 and number == join.first_sequence and not missed:
            self._reporter.note(
                f'this node started late: {number} actions of pose_cells were sent before and '
                'are missing from the map. To start over, call reset on all nodes'
            )


LIVE_STAGES: dict[str, Callable[[Config, Reporter], Stage]] = {
    'visual_odometry': LiveVisualOdometry,
    'local_view': lambda config, reporter: LiveTemplates(LiveLocalView(config, reporter)),
    'pose_cells': LivePoseCells, 'experience_map': LiveExperienceMap,
    'landmark_map': lambda config, _: LandmarkMapStage(config),
}
"""The stages of the nodes of this package, by name."""
